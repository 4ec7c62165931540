"""`place-poles`: a linear model and a gain from sampled states and inputs."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from rich.table import Table

from identification.pole_placement import METHODS, Placement, place, read_poles, samples_of
from recordings import load
from twinproof.cli.options import Output, data_options, json_option, parse_names
from twinproof.documents import Document, document
from twinproof.report.numbers import uncertain


@click.command("place-poles")
@click.argument("data")
@click.option(
    "--poles",
    required=True,
    metavar="P,…",
    help="Desired poles of the sampled closed loop, one a state: 0.8,0.9+0.05j,0.9-0.05j.",
)
@click.option("--states", metavar="C,…", help="Columns of the states; default: x*.")
@click.option("--inputs", metavar="C,…", help="Columns of the inputs; default: u*.")
@click.option(
    "--excitation",
    metavar="C,…",
    help="Columns of v in u = F x + v, one an input, where recorded; helps `instrumental`.",
)
@click.option(
    "--method",
    default="auto",
    show_default=True,
    metavar="M",
    help="One of: " + ", ".join(METHODS) + ".",
)
@click.option(
    "--prefilter",
    default=1,
    show_default=True,
    type=int,
    metavar="M",
    help="Order of the FIR prefilter: moving averages over M samples; 1: none.",
)
@data_options
@json_option
def place_poles(
    data: str,
    poles: str,
    states: str | None,
    inputs: str | None,
    excitation: str | None,
    method: str,
    prefilter: int,
    channel_map: Path | None,
    dbc: Path | None,
    json_path: str | None,
) -> None:
    """Data-driven pole placement: model and gain u = F x + v from states and inputs in DATA.

    \b
    Example:
      twinproof place-poles run.csv --poles 0.8,0.9,0.9+0.05j,0.9-0.05j
    """
    output = Output(json_path)
    wanted = read_poles(poles)
    recording = load(data, channel_map=channel_map, dbc=dbc)
    samples = samples_of(
        recording, parse_names(states), parse_names(inputs), parse_names(excitation)
    )
    found = place(samples, wanted, method=method, prefilter=prefilter)
    output.console.print(_model_table(found))
    output.console.print(_gain_table(found))
    output.console.print(_pole_table(found))
    for warning in found.warnings:
        output.note(f"warning: {warning}")
    output.document(placed(found))


def placed(found: Placement) -> Document:
    """Return the document of `place-poles`; poles are [real, imaginary]."""
    samples = found.samples
    return document(
        "place-poles",
        {
            "A": found.A.tolist(),
            "B": found.B.tolist(),
            "F": found.F.tolist(),
            "poles": _pairs(found.poles),
            "warnings": list(found.warnings),
            "method": found.method,
            "states": list(samples.state_names),
            "inputs": list(samples.input_names),
            "sample_time": samples.step,
            "A_sd": found.A_sd.tolist(),
            "B_sd": found.B_sd.tolist(),
            "poles_sd": found.poles_sd.tolist(),
            "desired_poles": _pairs(found.desired),
            "open_loop_poles": _pairs(found.open_loop_poles),
            "open_loop_poles_sd": found.open_loop_poles_sd.tolist(),
            "condition_number": found.condition_number,
            "region": {
                name: {"holds_to": reach.holds_to, "seen_to": reach.seen_to}
                for name, reach in found.region.items()
            },
        },
    )


def _pairs(poles: np.ndarray) -> list[list[float]]:
    return [[float(p.real), float(p.imag)] for p in poles]


def _model_table(found: Placement) -> Table:
    names = (*found.samples.state_names, *found.samples.input_names)
    table = Table(title=f"x(k+1) = A x(k) + B u(k) ({found.method})", title_justify="left")
    table.add_column("next")
    for name in names:
        table.add_column(name, justify="right")
    values = np.hstack([found.A, found.B])
    doubts = np.hstack([found.A_sd, found.B_sd])
    for name, row, sd in zip(found.samples.state_names, values, doubts, strict=True):
        table.add_row(name, *(uncertain(float(v), float(s)) for v, s in zip(row, sd, strict=True)))
    return table


def _gain_table(found: Placement) -> Table:
    table = Table(title="u = F x + v", title_justify="left")
    table.add_column("input")
    for name in found.samples.state_names:
        table.add_column(name, justify="right")
    for name, row in zip(found.samples.input_names, found.F, strict=True):
        table.add_row(name, *(f"{v:.6g}" for v in row))
    return table


def _pole_table(found: Placement) -> Table:
    table = Table(title="poles", title_justify="left")
    for heading in ("with F", "± sd on the plant", "without F", "± sd"):
        table.add_column(heading, justify="right")
    rows = zip(
        found.poles, found.poles_sd, found.open_loop_poles, found.open_loop_poles_sd, strict=True
    )
    for placed_pole, placed_sd, own, own_sd in rows:
        table.add_row(_pole(placed_pole), f"{placed_sd:.2g}", _pole(own), f"{own_sd:.2g}")
    return table


def _pole(pole: complex) -> str:
    return f"{pole.real:.5g}" if abs(pole.imag) < 1e-12 else f"{pole:.5g}"
