"""What can be done with a model alone: `export`, `check`, `simulate`, `places`, `effects`."""

from __future__ import annotations

import time
from pathlib import Path

import click
from rich.table import Table
from rich.text import Text

from fmus.compiler import NATIVE, TARGETS
from foundation.errors import InputError
from twinproof.cli.completing import complete_fmu
from twinproof.cli.options import (
    Output,
    data_options,
    json_option,
    model_argument,
    modelica_path_option,
    param_option,
    parse_params,
)


@click.command()
@model_argument
@click.option(
    "-o",
    "output_path",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.fmu",
    help="The FMU to write.",
)
@click.option("--fmi", default="2", show_default=True, metavar="2|3", help="Version of FMI.")
@click.option(
    "--target",
    default=NATIVE,
    show_default=True,
    metavar="|".join(TARGETS),
    help="Platform of the binary.",
)
@click.option(
    "--compiler",
    default="own",
    show_default=True,
    metavar="own|omc",
    help="Translator: twinproof's own, or OpenModelica's.",
)
@param_option
@modelica_path_option
@json_option
def export(
    model: str,
    output_path: Path,
    fmi: str,
    target: str,
    compiler: str,
    params: tuple[str, ...],
    modelica_path: tuple[Path, ...],
    json_path: str | None,
) -> None:
    """Translate MODEL to an FMU (Co-Simulation and Model Exchange in one file).

    \b
    Example:
      twinproof export Twinproof.Plants.WheeledPendulum -o pendulum.fmu
    """
    from fmus.package import export as export_fmu
    from twinproof import documents
    from twinproof.model import Model

    output = Output(json_path)
    chosen = Model.of(model, modelica_path)
    result = export_fmu(
        chosen.source,
        output_path,
        parameters=parse_params(params),
        fmi=fmi,
        target=target,
        compiler=compiler,
    )
    output.console.print(
        f"{result.fmu}: FMI {result.fmi}, {result.variables} variables, {result.seconds:.2f} s",
        soft_wrap=True,
    )
    output.document(
        documents.document(
            "export",
            {
                "fmu": str(result.fmu),
                "fmi": result.fmi,
                "sha256": result.sha256,
                "variables": result.variables,
                "seconds": result.seconds,
            },
        )
    )


@click.command()
@click.argument(
    "fmu",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.fmu",
    shell_complete=complete_fmu,
)
@json_option
@click.pass_context
def check(context: click.Context, fmu: Path, json_path: str | None) -> None:
    """Try an FMU against a conformance list; exit status 1 if a line fails.

    \b
    Example:
      twinproof check pendulum.fmu
    """
    from fmus.checking import check_fmu
    from twinproof import documents

    output = Output(json_path)
    checks = check_fmu(fmu)
    table = Table("check", "", "seen")
    for line in checks:
        table.add_row(line.name, "pass" if line.ok else Text("FAIL", style="bold"), line.detail)
    output.console.print(table)
    output.document(
        documents.document(
            "check",
            {"checks": [{"name": c.name, "ok": c.ok, "detail": c.detail} for c in checks]},
        )
    )
    if not all(line.ok for line in checks):
        context.exit(1)


@click.command()
@model_argument
@click.option("--input", "input_data", metavar="DATA", help="Recording that drives the inputs.")
@click.option("--stop", type=float, metavar="S", help="End of the simulation [s].")
@click.option("--step", type=float, metavar="S", help="Step of the result [s].")
@click.option(
    "-o",
    "output_path",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.csv",
    help="The CSV to write.",
)
@data_options
@param_option
@modelica_path_option
@json_option
def simulate(
    model: str,
    input_data: str | None,
    stop: float | None,
    step: float | None,
    output_path: Path,
    channel_map: Path | None,
    dbc: Path | None,
    params: tuple[str, ...],
    modelica_path: tuple[Path, ...],
    json_path: str | None,
) -> None:
    """Run MODEL (Modelica, FMU or SSP) and write its outputs as CSV.

    \b
    Example:
      twinproof simulate Twinproof.Plants.Pendulum --param theta_start=0.5 --stop 5 -o swing.csv
    """
    import numpy as np
    import pandas as pd

    from fmus.master.ssp import simulate_ssp
    from fmus.running import simulate_model
    from foundation.files import written_whole
    from recordings import load
    from twinproof import documents

    output = Output(json_path)
    inputs = None
    if input_data is not None:
        driven = _inputs(model, modelica_path)
        recording = load(
            input_data, variables=driven, channel_map=channel_map, dbc=dbc, inputs=list(driven)
        )
        inputs = (recording.time, {n: c.values for n, c in recording.channels.items()})
    began = time.perf_counter()
    if model.endswith(".ssp"):
        times = {name: t for name, t in (("stop", stop), ("step", step)) if t is not None}
        run = simulate_ssp(
            Path(model), inputs=inputs, parameters=parse_params(params), order=2, **times
        )
    else:
        run = simulate_model(
            model,
            roots=tuple(modelica_path),
            inputs=inputs,
            parameters=parse_params(params),
            stop=stop,
            step=step,
        )
    seconds = time.perf_counter() - began
    frame = pd.DataFrame({"time": run.time, **run.columns})
    if not np.all(np.isfinite(frame.to_numpy())):
        raise InputError(
            "the simulation left the finite numbers",
            where=model,
            remedy="check parameters and inputs, or stop earlier",
        )
    with written_whole(output_path) as beside:
        frame.to_csv(beside, index=False)
    output.console.print(f"{output_path}: {len(frame)} rows, {seconds:.2f} s", soft_wrap=True)
    output.document(documents.document("simulate", {"rows": len(frame), "seconds": seconds}))


def _inputs(model: str, modelica_path: tuple[Path, ...]) -> dict[str, str]:
    from fmus.master.ssp import read_ssp
    from fmus.running import Fmu
    from twinproof.model import Model

    if model.endswith(".ssp"):
        with read_ssp(Path(model)) as opened:
            return dict.fromkeys(opened.system.inputs, "")
    if model.endswith(".fmu"):
        with Fmu(Path(model)) as fmu:
            return {v.name: v.unit for v in fmu.description.inputs}
    return {v.name: v.unit for v in Model.of(model, modelica_path).dae.inputs}


@click.command()
@model_argument
@modelica_path_option
@json_option
def places(model: str, modelica_path: tuple[Path, ...], json_path: str | None) -> None:
    """Where effects can act on MODEL, with units.

    \b
    Example:
      twinproof places Twinproof.Plants.WheeledPendulum
    """
    from twinproof import documents
    from twinproof.model import Model

    output = Output(json_path)
    found = Model.of(model, modelica_path).places
    table = Table("place", "kind", "unit", "what")
    for place in found:
        table.add_row(place.name, place.kind, place.unit, place.description)
    output.console.print(table)
    output.document(documents.places(found))


@click.command()
@modelica_path_option
@json_option
def effects(modelica_path: tuple[Path, ...], json_path: str | None) -> None:
    """Which effects there are.

    \b
    Example:
      twinproof effects
    """
    from identification.discovery.effects import find_effects
    from twinproof import documents
    from twinproof.model import Model

    output = Output(json_path)
    # Any class will do: what counts are the libraries.
    source = Model.of("Twinproof.Plants.Positioner", modelica_path).source
    found = find_effects(source)
    table = Table()
    for heading in ("effect", "kind", "main parameters", "what it is"):
        table.add_column(heading, overflow="fold")
    for effect in found:
        table.add_row(
            effect.name, effect.kind, ", ".join(effect.main_parameters), effect.description
        )
    output.console.print(table)
    output.document(documents.effects(found))
