"""`design`: what an experiment can tell, before it is made, and a better excitation."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import pandas as pd
from rich.table import Table

from foundation.errors import InputError
from foundation.files import written_whole
from identification.design import (
    Bound,
    Limits,
    Suggestion,
    bound_of_record,
    suggest,
)
from identification.problem import match
from twinproof.api import read_recording
from twinproof.cli.completing import complete_data
from twinproof.cli.options import (
    Output,
    data_options,
    free_option,
    json_option,
    model_argument,
    modelica_path_option,
    param_option,
    parse_names,
    parse_params,
)
from twinproof.documents import Document, document
from twinproof.model import Model
from twinproof.report.numbers import significant, typeset, uncertain


@click.command()
@model_argument
@click.argument("data", required=False, shell_complete=complete_data)
@click.option(
    "--amplitude",
    metavar="A,…",
    help="Largest input, one for all or one each; a must without DATA.",
)
@click.option(
    "--band",
    metavar="LO,HI",
    default="0.1,10",
    show_default=True,
    help="Frequencies of the excitation [Hz].",
)
@click.option("--duration", type=float, default=20.0, show_default=True, help="In seconds.")
@click.option("--step", type=float, default=1e-3, show_default=True, help="Between samples [s].")
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar="OUTPUT=LO:HI",
    help="Range that an output must not leave; may be repeated.",
)
@click.option(
    "--sd",
    "sds",
    multiple=True,
    metavar="OUTPUT=S",
    help="Standard deviation of a sensor; may be repeated. Only named outputs are measured.",
)
@click.option(
    "--criterion",
    type=click.Choice(["D", "A"]),
    default="D",
    show_default=True,
    help="D: volume of the uncertainty; A: root mean square of relative deviations.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the search.")
@click.option(
    "-o",
    "output_path",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.csv",
    help="Write the suggested input, with the outputs expected.",
)
@data_options
@free_option
@param_option
@modelica_path_option
@json_option
def design(
    model: str,
    data: str | None,
    amplitude: str | None,
    band: str,
    duration: float,
    step: float,
    limits: tuple[str, ...],
    sds: tuple[str, ...],
    criterion: str,
    seed: int,
    output_path: Path | None,
    channel_map: Path | None,
    dbc: Path | None,
    free: str | None,
    params: tuple[str, ...],
    modelica_path: tuple[Path, ...],
    json_path: str | None,
) -> None:
    """Plan an experiment that tells MODEL's parameters, or judge the one in DATA.

    Reports the Cramér-Rao bound: the smallest standard deviations that any estimate can have.

    \b
    Example:
      twinproof design Twinproof.Plants.Pendulum --amplitude 1.5 --limit theta=-1:1 --sd theta=1e-3
    """
    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    values, names = parse_params(params), parse_names(free)
    noise = dict(_equation(word, "--sd") for word in sds)
    suggestion: Suggestion | None = None
    if data is not None:
        recording = read_recording(data, chosen, channel_map=channel_map, dbc=dbc)
        problem = match(chosen.dae, recording, free=names, values=values)
        bound = bound_of_record(problem)
    else:
        if amplitude is None:
            raise InputError(
                "how large the input may be is not said",
                where="--amplitude",
                remedy="give it in the input's unit, or DATA to judge a record",
            )
        with output.progress() as progress:
            suggestion = suggest(
                chosen.dae,
                Limits(
                    amplitude=_numbers(amplitude, "--amplitude"),
                    band=_pair(_numbers(band, "--band"), "--band"),
                    duration=duration,
                    step=step,
                    outputs=dict(_range(word) for word in limits),
                ),
                noise_sd=noise,
                outputs=tuple(noise) or None,
                free=names,
                values=values,
                criterion="D" if criterion == "D" else "A",
                seed=seed,
                progress=progress,
            )
        bound, problem = suggestion.bound, suggestion.problem
    units = {n: v.unit for n, v in chosen.dae.variables.items()}
    output.console.print(_table(bound, units))
    if suggestion is not None:
        for name, peak in _peaks(suggestion).items():
            output.console.print(f"{name}: {peak[0]:.4g} … {peak[1]:.4g} {units[name]}")
        if output_path is not None:
            columns = np.column_stack([problem.time, problem.inputs, problem.outputs])
            header = ["time", *(v.name for v in chosen.dae.inputs), *problem.output_names]
            with written_whole(output_path) as beside:
                pd.DataFrame(columns, columns=header).to_csv(beside, index=False)
    for line in (*bound.advice, *bound.notes):
        output.note(f"warning: {line}")
    output.document(_document(bound, units, suggestion))


def _table(bound: Bound, units: dict[str, str]) -> Table:
    table = Table(title="what this experiment can tell at best", title_justify="left")
    for heading in ("parameter", "value ± smallest sd", "unit", "relative"):
        table.add_column(heading)
    for name, sd in bound.sd.items():
        value = bound.values[name]
        share = f"{100 * sd / abs(value):.2g} %" if value and np.isfinite(sd) else ""
        known = uncertain(value, sd) if np.isfinite(sd) else f"{significant(value, 4)} (unseen)"
        table.add_row(name, known, typeset(units[name]), share)
    return table


def _peaks(suggestion: Suggestion) -> dict[str, tuple[float, float]]:
    problem = suggestion.problem
    names = [*(v.name for v in problem.dae.inputs), *problem.output_names]
    columns = np.column_stack([problem.inputs, problem.outputs])
    low, high = np.min(columns, axis=0).tolist(), np.max(columns, axis=0).tolist()
    return dict(zip(names, zip(low, high, strict=True), strict=True))


def _document(bound: Bound, units: dict[str, str], suggestion: Suggestion | None) -> Document:
    body: Document = {
        "parameters": {
            name: {
                "value": bound.values[name],
                "sd": sd,
                "unit": units[name],
                "identifiable": name not in bound.unseen,
            }
            for name, sd in bound.sd.items()
        },
        "condition_number": bound.condition_number,
        "unseen": list(bound.unseen),
        "correlated": [list(pair) for pair in bound.correlated],
        "advice": list(bound.advice),
        "warnings": list(bound.notes),
    }
    if suggestion is not None:
        body |= {
            "family": suggestion.family,
            "tried": dict(suggestion.tried),
            "peaks": {name: list(peak) for name, peak in _peaks(suggestion).items()},
        }
    return document("design", body)


def _numbers(text: str, where: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InputError(
            f"'{text}' is not a list of numbers", where=where, remedy="write it like 0.1,10"
        ) from None


def _pair(numbers: tuple[float, ...], where: str) -> tuple[float, float]:
    if len(numbers) != 2:
        raise InputError(f"{len(numbers)} numbers", where=where, remedy="give two: 0.1,10")
    return numbers[0], numbers[1]


def _equation(word: str, where: str) -> tuple[str, float]:
    name, _, number = word.partition("=")
    return name, _numbers(number, where)[0]


def _range(word: str) -> tuple[str, tuple[float, float]]:
    name, _, text = word.partition("=")
    return name, _pair(_numbers(text.replace(":", ","), "--limit"), "--limit")
