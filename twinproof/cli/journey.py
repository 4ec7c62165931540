"""The journey from a model to a better one: `compare` … `improve`."""

from __future__ import annotations

from pathlib import Path

import click

from foundation.files import write_text
from identification.discovery.diagnosis import Outcome
from identification.discovery.extension import text_diff
from identification.estimators import ESTIMATORS
from twinproof import api, documents
from twinproof.cli import tables
from twinproof.cli.options import (
    Output,
    command_line,
    data_options,
    free_option,
    horizon_option,
    json_option,
    modelica_path_option,
    param_option,
    parse_names,
    parse_params,
    report_option,
)
from twinproof.model import Model
from twinproof.report import (
    write_comparison,
    write_diagnosis,
    write_identification,
)
from twinproof.results import write_improvement

SAID = {
    Outcome.COMPLETE: "nothing is missing: what is left is the sensors' noise",
    Outcome.EFFECT: "an effect is missing",
    Outcome.UNDETERMINED: "an effect is missing, and this record does not tell which of several",
    Outcome.UNKNOWN_SHAPE: "something is left that no effect of the library explains",
    Outcome.SENSOR: "a sensor is wrong, not the dynamics",
}


@click.command()
@click.argument("model")
@click.argument("data")
@data_options
@param_option
@horizon_option
@modelica_path_option
@json_option
@report_option
def compare(
    model: str,
    data: str,
    channel_map: Path | None,
    dbc: Path | None,
    params: tuple[str, ...],
    horizon: str,
    modelica_path: tuple[Path, ...],
    json_path: str | None,
    report_dir: Path | None,
) -> None:
    """How well MODEL explains DATA, and where it fails.

    \b
    Example:
      twinproof compare Twinproof.Plants.Positioner emps --report out
    """
    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    recording = api.read_recording(data, chosen, channel_map=channel_map, dbc=dbc)
    result = api.compare(chosen, recording, parameters=parse_params(params), horizon=horizon)
    output.console.print(tables.channels(result.comparison, result.horizon))
    output.console.print(tables.failures(result.comparison))
    if report_dir is not None:
        write_comparison(
            result.comparison, result.problem, report_dir / "report.html", command=command_line()
        )
    output.document(documents.compared(result))


@click.command()
@click.argument("model")
@click.argument("data")
@click.option(
    "--method",
    default="auto",
    show_default=True,
    metavar="M",
    help="One of: " + ", ".join(ESTIMATORS) + ".",
)
@free_option
@data_options
@param_option
@horizon_option
@modelica_path_option
@json_option
@report_option
def identify(
    model: str,
    data: str,
    method: str,
    free: str | None,
    channel_map: Path | None,
    dbc: Path | None,
    params: tuple[str, ...],
    horizon: str,
    modelica_path: tuple[Path, ...],
    json_path: str | None,
    report_dir: Path | None,
) -> None:
    """Fit MODEL's parameters to DATA, with standard deviations.

    \b
    Example:
      twinproof identify Twinproof.Plants.Positioner emps --method output-filter
    """
    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    recording = api.read_recording(data, chosen, channel_map=channel_map, dbc=dbc)
    result = api.identify(
        chosen,
        recording,
        method=method,
        free=parse_names(free),
        parameters=parse_params(params),
        horizon=horizon,
    )
    output.console.print(tables.parameters(result.estimate))
    output.console.print(tables.channels(result.comparison, result.horizon))
    for warning in result.estimate.warnings:
        output.note(f"warning: {warning}")
    if report_dir is not None:
        write_identification(
            result.estimate,
            result.comparison,
            result.problem,
            report_dir / "report.html",
            command=command_line(),
        )
    output.document(documents.identified(result))


@click.command()
@click.argument("model")
@click.argument("data")
@free_option
@data_options
@param_option
@modelica_path_option
@json_option
@report_option
def diagnose(
    model: str,
    data: str,
    free: str | None,
    channel_map: Path | None,
    dbc: Path | None,
    params: tuple[str, ...],
    modelica_path: tuple[Path, ...],
    json_path: str | None,
    report_dir: Path | None,
) -> None:
    """Fit MODEL to DATA and find which physical effect it lacks.

    \b
    Example:
      twinproof diagnose Twinproof.Plants.Positioner emps --json -
    """
    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    recording = api.read_recording(data, chosen, channel_map=channel_map, dbc=dbc)
    with output.progress() as progress:
        result = api.diagnose(
            chosen,
            recording,
            parameters=parse_params(params),
            free=parse_names(free),
            progress=progress,
        )
    found = result.diagnosis
    output.console.print(tables.ranking(found))
    output.console.print(f"[bold]{found.outcome.value}[/bold]: {SAID[found.outcome]}")
    for tie in found.ties:
        output.console.print("not told apart: " + ", ".join(tie))
    if found.next_experiment:
        output.console.print("next experiment: " + found.next_experiment)
    if report_dir is not None:
        write_diagnosis(
            found,
            result.comparison,
            result.problem,
            report_dir / "report.html",
            command=command_line(),
        )
    output.document(documents.diagnosed(result))


@click.command()
@click.argument("model")
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
    help="The Modelica file to write.",
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
    """Write the Modelica class that has effects added to MODEL.

    \b
    Example:
      twinproof extend Twinproof.Plants.Positioner \\
          --add CoulombFriction@carriage,f_c=20 -o Positioner_1.mo
    """
    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    extended = api.extend(chosen, additions, name=_class_name(output_path))
    difference = text_diff(chosen.source, extended)
    write_text(output_path, extended.source.text)
    output.console.print(difference, markup=False, soft_wrap=True)
    output.document(
        documents.document(
            "extend", {"model": f"{output_path}:{extended.name}", "diff": difference}
        )
    )


def _class_name(path: Path) -> str | None:
    return path.stem if path.stem.isidentifier() else None


@click.command()
@click.argument("model")
@click.argument("data")
@click.option(
    "--holdout",
    required=True,
    metavar="DATA2",
    help="An unseen record; read by nothing but the final score.",
)
@click.option(
    "-o",
    "output_dir",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Folder for every step's .mo and .fmu, ladder.csv and report.html.",
)
@click.option(
    "--max-effects",
    default=4,
    show_default=True,
    type=click.IntRange(min=0),
    metavar="N",
    help="Add at most N effects.",
)
@free_option
@data_options
@param_option
@horizon_option
@modelica_path_option
@json_option
def improve(
    model: str,
    data: str,
    holdout: str,
    output_dir: Path,
    max_effects: int,
    free: str | None,
    channel_map: Path | None,
    dbc: Path | None,
    params: tuple[str, ...],
    horizon: str,
    modelica_path: tuple[Path, ...],
    json_path: str | None,
) -> None:
    """Compare, diagnose, add, refit, step by step; score on unseen data once at the end.

    \b
    Example:
      twinproof improve Twinproof.Plants.Positioner emps --holdout emps-pulses -o out
    """
    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    recording = api.read_recording(data, chosen, channel_map=channel_map, dbc=dbc)
    unseen = api.read_recording(holdout, chosen, channel_map=channel_map, dbc=dbc)
    with output.progress() as progress:
        result = api.improve(
            chosen,
            recording,
            unseen,
            max_effects=max_effects,
            parameters=parse_params(params),
            free=parse_names(free),
            horizon=horizon,
            progress=progress,
        )
        files = write_improvement(result, output_dir, command=command_line(), progress=progress)
    show_improvement(output, result, output_dir)
    output.document(documents.improved(result, files))


def show_improvement(output: Output, result: api.Improved, folder: Path) -> None:
    """Print the ladder, the verdict and where the report is."""
    found = result.improvement
    output.console.print(tables.ladder(found))
    if not found.added:
        output.console.print("nothing was added")
    output.console.print(f"[bold]{found.outcome.value}[/bold]: {SAID[found.outcome]}")
    output.console.print(f"report: {folder / 'report.html'}", soft_wrap=True)
