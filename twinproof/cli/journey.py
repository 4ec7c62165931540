"""The journey from a model to a better one: `compare` … `improve`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.text import Text

from twinproof.cli.completing import METHODS, complete_data, complete_method
from twinproof.cli.options import (
    Output,
    Request,
    also_option,
    command_line,
    horizon_option,
    journey,
    json_option,
    model_argument,
    modelica_path_option,
    parse_priors,
    read_verified,
    report_option,
)

if TYPE_CHECKING:
    from identification.discovery.diagnosis import Diagnosis, Outcome
    from recordings import Recording
    from twinproof.answers import FittedRecord


@click.command()
@journey
@horizon_option
@report_option
def compare(request: Request, horizon: str, report_dir: Path | None) -> None:
    """How well MODEL explains DATA, and where it fails.

    \b
    Example:
      twinproof compare Twinproof.Plants.Positioner emps --report out
    """
    from twinproof import api, documents
    from twinproof.cli import tables
    from twinproof.report import write_comparison

    output = request.output
    result = api.compare(
        request.model, request.recording, parameters=request.parameters, horizon=horizon
    )
    output.console.print(tables.channels(result.problem, result.comparison))
    output.console.print(tables.failures(result.problem, result.comparison))
    if report_dir is not None:
        write_comparison(
            result.comparison, result.problem, report_dir / "report.html", command=command_line()
        )
    output.document(documents.compared(result))


@click.command()
@journey
@click.option(
    "--method",
    default="auto",
    show_default=True,
    metavar="M",
    help="One of: " + ", ".join(METHODS) + ".",
    shell_complete=complete_method,
)
@also_option
@click.option(
    "--prior",
    "priors",
    multiple=True,
    metavar="NAME=VALUE±SD",
    help="What is known of a fitted parameter, also written NAME=VALUE,SD (output error); may be "
    "repeated.",
)
@horizon_option
@report_option
def identify(
    request: Request,
    method: str,
    also: tuple[str, ...],
    priors: tuple[str, ...],
    horizon: str,
    report_dir: Path | None,
) -> None:
    """Fit MODEL's parameters to DATA, with standard deviations.

    \b
    Example:
      twinproof identify Twinproof.Plants.Positioner emps --method output-filter
      twinproof identify Twinproof.Plants.Positioner emps --also emps-pulses --prior M=95±2
    """
    from twinproof import api, documents
    from twinproof.cli import tables
    from twinproof.report import write_identification
    from twinproof.report.tables import estimate_rows

    output = request.output
    with output.progress() as progress:
        progress("fitting the parameters")
        result = api.identify(
            request.model,
            [request.recording, *map(request.read, also)],
            method=method,
            free=request.free,
            parameters=request.parameters,
            horizon=horizon,
            priors=parse_priors(priors),
        )
    output.console.print(
        tables.parameters(estimate_rows(result.estimate, result.problem), result.estimate.method)
    )
    for record in result.records:
        if also:
            output.console.print(record.origin, soft_wrap=True)
        output.console.print(tables.channels(record.problem, record.comparison))
    for warning in result.estimate.warnings:
        output.note(f"warning: {warning}")
    if report_dir is not None:
        write_identification(
            result.estimate,
            result.comparison,
            result.problem,
            report_dir / "report.html",
            command=command_line(),
            notes=_together_notes(result.records),
        )
    output.document(documents.identified(result))


@click.command()
@journey
@also_option
@click.option(
    "--verified",
    "verified_path",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.json",
    help="What `identify --json` said of an earlier record: have its parameters moved since?",
)
@report_option
def diagnose(
    request: Request, also: tuple[str, ...], verified_path: Path | None, report_dir: Path | None
) -> None:
    """Fit MODEL to DATA and find which physical effect it lacks.

    \b
    Example:
      twinproof diagnose Twinproof.Plants.Positioner emps --json -
    """
    from twinproof import api, documents
    from twinproof.cli import tables
    from twinproof.report import write_diagnosis
    from twinproof.report.wording import diagnosis_headline

    output = request.output
    verified = None if verified_path is None else read_verified(verified_path)
    with output.progress() as progress:
        result = api.diagnose(
            request.model,
            [request.recording, *map(request.read, also)],
            parameters=request.parameters,
            free=request.free,
            verified=verified,
            progress=progress,
        )
    found = result.diagnosis
    output.console.print(tables.ranking(found))
    _print_verdict(output, found.outcome, diagnosis_headline(found, result.problem.dae.name))
    _print_what_is_left(output, found)
    for tie in found.ties:
        output.console.print("not told apart: " + ", ".join(tie))
    if found.next_experiment:
        output.console.print("next experiment: " + found.next_experiment)
    if result.drift is not None:
        output.console.print(tables.drift(result.drift))
    if report_dir is not None:
        write_diagnosis(
            found,
            result.comparison,
            result.problem,
            report_dir / "report.html",
            command=command_line(),
            notes=_together_notes(result.records),
        )
    output.document(documents.diagnosed(result))


@click.command()
@model_argument
@click.option(
    "--add",
    "additions",
    multiple=True,
    required=True,
    metavar="EFFECT@PLACE[,P=V]…",
    help="An effect and where it acts; may be repeated.",
)
@click.option(
    "-o",
    "output_path",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="NEW.mo",
    help="The Modelica file to write; of an FMU, a system: NEW.ssp.",
)
@modelica_path_option
@json_option
def extend(
    model: str,
    additions: tuple[str, ...],
    output_path: Path,
    modelica_path: tuple[Path, ...],
    json_path: str | None,
) -> None:
    """Write the Modelica class that has effects added to MODEL, or the system around an FMU.

    \b
    Example:
      twinproof extend Twinproof.Plants.Positioner \\
          --add CoulombFriction@carriage,f_c=20 -o Positioner_1.mo
    """
    from identification.discovery.extension import text_diff
    from twinproof import api, documents
    from twinproof.model import Model
    from twinproof.results import write_extended

    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    stem = output_path.stem
    extended = api.extend(chosen, additions, name=stem if stem.isidentifier() else None)
    difference = text_diff(chosen.extensible, extended)
    written = write_extended(extended, output_path)
    output.console.print(difference, soft_wrap=True)
    output.document(documents.document("extend", {"model": written, "diff": difference}))


def _together_notes(records: Sequence[FittedRecord]) -> list[str]:
    """Return what a report says of the further records."""
    from twinproof.report.comparison import error_sentence

    return [
        f"Fitted at once with {record.origin}. " + error_sentence(record.problem, record.comparison)
        for record in records[1:]
    ]


@click.command()
@journey
@also_option
@click.option(
    "--holdout",
    required=True,
    metavar="DATA2",
    shell_complete=complete_data,
    help="An unseen record; read by nothing but the final score.",
)
@click.option(
    "-o",
    "output_dir",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Folder for every step's .mo and .fmu (of an FMU: .ssp), ladder.csv and report.html.",
)
@click.option(
    "--max-effects",
    default=4,
    show_default=True,
    type=click.IntRange(min=0),
    metavar="N",
    help="Add at most N effects.",
)
@horizon_option
def improve(
    request: Request,
    also: tuple[str, ...],
    holdout: str,
    output_dir: Path,
    max_effects: int,
    horizon: str,
) -> None:
    """Compare, diagnose, add, refit, step by step; score on unseen data once at the end.

    \b
    Example:
      twinproof improve Twinproof.Plants.Positioner emps --holdout emps-pulses -o out
    """
    run_improvement(
        request,
        request.read(holdout),
        output_dir,
        command_line(),
        max_effects,
        horizon,
        also=[request.read(word) for word in also],
    )


def _print_verdict(output: Output, outcome: Outcome, sentence: str) -> None:
    output.console.print(Text.assemble((outcome.value, "bold"), ": ", sentence), soft_wrap=True)


def _print_what_is_left(output: Output, diagnosis: Diagnosis) -> None:
    if diagnosis.disturbance:
        output.console.print(f"beside an unknown disturbance: {diagnosis.disturbance}")
    if diagnosis.proposal is not None:
        proposal = diagnosis.proposal
        nearest = f" (nearest by name: {', '.join(proposal.nearest)})" if proposal.nearest else ""
        output.console.print(
            f"a curve over {proposal.over} at {proposal.refit.addition.place.name} explains "
            f"{100 * proposal.verdict.removed:.0f} % of it on unseen windows{nearest}; "
            f"to have it: extend --add {proposal.addition}",
            soft_wrap=True,
        )


def run_improvement(
    request: Request,
    unseen: Recording,
    folder: Path,
    command: str,
    max_effects: int = 4,
    horizon: str = "auto",
    also: Sequence[Recording] = (),
) -> None:
    """Improve a model, write the folder, print the ladder, the verdict and where the report is."""
    from twinproof import api, documents
    from twinproof.cli import tables
    from twinproof.report.tables import fit_rows
    from twinproof.report.wording import improvement_headline, remaining
    from twinproof.results import write_improvement

    output = request.output
    with output.progress() as progress:
        result = api.improve(
            request.model,
            [request.recording, *also],
            unseen,
            max_effects=max_effects,
            parameters=request.parameters,
            free=request.free,
            horizon=horizon,
            progress=progress,
        )
        files = write_improvement(result, folder, command=command, progress=progress)
    found = result.improvement
    last = found.steps[-1]
    rows = fit_rows(last.model, last.fit, result.problem)
    output.console.print(tables.ladder(found, result.problem))
    output.console.print(tables.parameters(rows, f"step {last.number}"))
    output.console.print(improvement_headline(found), soft_wrap=True)
    _print_verdict(output, found.outcome, f"what is left: {remaining(found)}")
    _print_what_is_left(output, last.diagnosis)
    output.console.print(f"report: {folder / 'report.html'}", soft_wrap=True)
    output.document(documents.improved(result, files))
