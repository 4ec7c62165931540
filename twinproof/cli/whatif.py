"""`whatif`: controllers against plants drawn from what the data say, offline."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pandas as pd
from rich.table import Table

from foundation.files import written_whole
from hil.study import Study, read_study
from hil.whatif import RunResult, StudyResult, replay, run_study
from twinproof.cli.hil import verdict
from twinproof.cli.options import (
    Output,
    command_line,
    json_option,
    modelica_path_option,
    report_option,
)
from twinproof.documents import Document, document
from twinproof.report import write_whatif


@click.command("whatif")
@click.argument("study", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="A Dask scheduler, tcp://host:8786; default: workers on this machine.",
)
@click.option(
    "--workers", type=click.IntRange(0), metavar="N", help="On this machine; default: one a core."
)
@click.option(
    "--results",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Finished runs, from which a study that was stopped goes on; default: beside the study.",
)
@click.option("--replay", "number", type=int, metavar="RUN", help="Do one run again.")
@click.option(
    "-o",
    "--output",
    "signals",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.csv",
    help="Signals of the run that is replayed.",
)
@modelica_path_option
@report_option
@json_option
def whatif(
    study: Path,
    scheduler: str | None,
    workers: int | None,
    results: Path | None,
    number: int | None,
    signals: Path | None,
    modelica_path: tuple[Path, ...],
    report_dir: Path | None,
    json_path: str | None,
) -> int:
    """Run STUDY.toml; exit status 1 if a run does not meet a criterion.

    \b
    Example:
      twinproof whatif robust.toml --json robust.json
      twinproof whatif robust.toml --replay 17 -o run.csv
    """
    output = Output(json_path)
    read = read_study(study, roots=modelica_path)
    if number is not None:
        result, columns = replay(read, number)
        output.console.print(_run_table([result]))
        if signals is not None:
            _write_signals(signals, read, columns)
        output.document(
            document("whatif", {"runs": 1, "passed": int(result.passed), **_run(result)})
        )
        return 0 if result.passed else 1
    with output.progress() as progress:
        done = run_study(
            read, scheduler=scheduler, workers=workers, results=results, progress=progress
        )
    output.console.print(_rate_table(done))
    output.console.print(_run_table(done.worst()))
    for pair in done.pairs():
        output.console.print(
            f"{pair.first} against {pair.second}: {pair.only_first} runs only the first passes, "
            f"{pair.only_second} only the second (p = {pair.p:.2g})"
        )
    for note in done.notes:
        output.note(f"note: {note}")
    if report_dir is not None:
        write_whatif(done, report_dir / "report.html", command=command_line())
    output.document(studied(done))
    return 0 if done.passed else 1


def studied(result: StudyResult) -> Document:
    """Return the document of `whatif`."""
    names = dict.fromkeys(v.name for r in result.runs for v in r.verdicts)
    rates = {name: result.rate(criterion=name) for name in names}
    total = result.rate()
    return document(
        "whatif",
        {
            "study": result.study.name,
            "runs": total.runs,
            "passed": total.passed,
            "interval": [total.low, total.high],
            "confidence": result.study.run.confidence,
            "criteria": [
                {
                    "name": name,
                    "passed": r.passed,
                    "runs": r.runs,
                    "interval": [r.low, r.high],
                }
                for name, r in rates.items()
            ],
            "controllers": {
                name: {"passed": r.passed, "runs": r.runs, "interval": [r.low, r.high]}
                for name in result.study.controllers
                for r in [result.rate(name)]
            },
            "comparisons": [
                {
                    "first": p.first,
                    "second": p.second,
                    "only_first": p.only_first,
                    "only_second": p.only_second,
                    "p": p.p,
                }
                for p in result.pairs()
            ],
            "worst": [_run(r) for r in result.worst()],
            "resumed": result.resumed,
            "seconds": result.seconds,
            "seed": result.study.run.seed,
            "notes": list(result.notes),
        },
    )


def _run(result: RunResult) -> Document:
    case = result.case
    return {
        "run": case.number,
        "controller": case.controller,
        "effect": case.variant,
        "draw": case.draw,
        "reference": case.reference,
        "disturbance": case.disturbance,
        "parameters": dict(result.parameters),
        "criteria": [verdict(v) for v in result.verdicts],
    }


def _rate_table(result: StudyResult) -> Table:
    confidence = f"{100 * result.study.run.confidence:g} % interval"
    table = Table(title=f"{len(result.runs)} runs", title_justify="left")
    for heading in ("", "passed", "runs", "rate", confidence):
        table.add_column(heading, justify="left" if not heading else "right")
    rows = [(name, result.rate(name)) for name in result.study.controllers]
    names = dict.fromkeys(v.name for r in result.runs for v in r.verdicts)
    rows += [(f"  {name}", result.rate(criterion=name)) for name in names]
    for name, r in [*rows, ("all", result.rate())]:
        share = r.passed / r.runs if r.runs else 0.0
        table.add_row(
            name,
            str(r.passed),
            str(r.runs),
            f"{100 * share:.1f} %",
            f"{100 * r.low:.1f} to {100 * r.high:.1f} %",
        )
    return table


def _run_table(results: list[RunResult]) -> Table:
    table = Table(title="worst runs (again with --replay)", title_justify="left")
    for heading in ("run", "controller", "effect", "draw", "reference", "disturbance", "not met"):
        table.add_column(heading)
    for r in results:
        failed = "; ".join(f"{v.name}: {v.detail}" for v in r.verdicts if not v.passed)
        c = r.case
        table.add_row(
            str(c.number), c.controller, c.variant, str(c.draw), c.reference, c.disturbance, failed
        )
    return table


def _write_signals(path: Path, study: Study, columns: dict[str, Any]) -> None:
    n = len(next(iter(columns.values())))
    times = study.run.step * pd.RangeIndex(n).to_numpy(float)
    with written_whole(path) as beside:
        frame = pd.DataFrame({"time": times, **columns})
        frame.to_csv(beside, index=False, lineterminator="\n")
