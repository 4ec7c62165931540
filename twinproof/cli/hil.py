"""`hil run`: a controller against a plant over CAN."""

from __future__ import annotations

import time
from pathlib import Path

import click
from rich.table import Table
from rich.text import Text

from hil.criteria import Verdict
from hil.junit import write_junit
from hil.rig import HilResult, run_scenario
from hil.scenario import read_scenario
from twinproof.cli.options import (
    Output,
    command_line,
    json_option,
    modelica_path_option,
    report_option,
)
from twinproof.documents import Document, document
from twinproof.report import write_hil


@click.group()
def hil() -> None:
    """Hardware in the loop: controllers against a plant over a CAN bus."""


@hil.command("run")
@click.argument("scenario", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--junit",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.xml",
    help="Write the verdicts as JUnit XML.",
)
@click.option(
    "--recording",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="What went over the bus: .blf .asc .log .trc .csv .mf4; default: as the scenario says.",
)
@modelica_path_option
@report_option
@json_option
def run(
    scenario: Path,
    junit: Path | None,
    recording: Path | None,
    modelica_path: tuple[Path, ...],
    report_dir: Path | None,
    json_path: str | None,
) -> int:
    """Run SCENARIO.toml; exit status 1 if a criterion is not met.

    \b
    Example:
      twinproof hil run balance.toml --junit balance.xml
    """
    output = Output(json_path)
    read = read_scenario(scenario, roots=modelica_path)
    began = time.monotonic()
    with output.progress() as progress:
        result = run_scenario(read, recording=recording, progress=progress)
    seconds = time.monotonic() - began
    if result.verdicts:
        output.console.print(_verdict_table(result.verdicts))
    else:
        output.note("the scenario has no criteria: nothing was judged")
    output.console.print(_bus_table(result))
    for note in result.loop.notes:
        output.note(f"note: {note}")
    output.note(f"recording: {result.recording}")
    if junit is not None:
        write_junit(junit, read.name, result.verdicts, seconds)
    if report_dir is not None:
        write_hil(result, report_dir / "report.html", command=command_line())
    output.document(ran(result))
    return 0 if result.passed else 1


def ran(result: HilResult) -> Document:
    """Return the document of `hil run`."""
    loop = result.loop
    return document(
        "hil-run",
        {
            "verdict": "pass" if result.passed else "fail",
            "scenario": result.scenario.name,
            "cycles": loop.trace.count,
            "missed": loop.missed,
            "jitter_us": {
                "p50": 1e6 * loop.jitter.percentile(50),
                "p99": 1e6 * loop.jitter.percentile(99),
                "max": 1e6 * loop.jitter.longest,
            },
            "latency_us": {
                "p50": 1e6 * loop.latency.percentile(50),
                "p99": 1e6 * loop.latency.percentile(99),
                "max": 1e6 * loop.latency.longest,
            },
            "faults": [{"kind": kind, "happened": n} for kind, n in result.faults],
            "criteria": [verdict(v) for v in result.verdicts],
            "safe": [[start, stop] for start, stop in result.safe],
            "frames": {
                "plant": dict(result.plant.counts()),
                "controller": None
                if result.controller is None
                else dict(result.controller.counts()),
            },
            "recording": str(result.recording),
            "seed": result.scenario.run.seed,
            "notes": list(loop.notes),
        },
    )


def verdict(value: Verdict) -> Document:
    """Return what became of a criterion."""
    return {
        "name": value.name,
        "kind": value.kind,
        "ok": value.passed,
        "value": value.value,
        "limit": value.limit,
        "detail": value.detail,
    }


def _verdict_table(verdicts: tuple[Verdict, ...]) -> Table:
    table = Table(title="criteria", title_justify="left")
    for heading in ("criterion", "found", "limit", ""):
        table.add_column(heading, justify="left" if heading == "criterion" else "right")
    for v in verdicts:
        mark = Text("met", "green") if v.passed else Text("not met", "red")
        table.add_row(v.name, v.detail, f"{v.limit:.4g}", mark)
    return table


def _bus_table(result: HilResult) -> Table:
    table = Table(title="bus", title_justify="left")
    for heading in ("", "plant", "controller"):
        table.add_column(heading, justify="left" if not heading else "right")
    other = {} if result.controller is None else result.controller.counts()
    for name, count in result.plant.counts().items():
        if count or other.get(name):
            table.add_row(name.replace("_", " "), str(count), str(other.get(name, "")))
    for kind, happened in result.faults:
        table.add_row(f"fault: {kind}", str(happened), "")
    loop = result.loop
    table.add_row("missed deadlines", str(loop.missed), "")
    if loop.jitter.count:
        table.add_row("jitter p99", f"{1e6 * loop.jitter.percentile(99):.0f} µs", "")
        table.add_row("latency p99", f"{1e6 * loop.latency.percentile(99):.0f} µs", "")
    return table
