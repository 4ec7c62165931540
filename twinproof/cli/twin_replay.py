"""`twin replay`: a recorded log through a twin's pipeline, faster than real time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from foundation.errors import InputError
from twinproof.cli.options import Output, json_option, modelica_path_option
from twinproof.documents import Document, document

if TYPE_CHECKING:
    from twin.replay import Replay
    from twin.settings import Settings, TwinSettings


@click.command("replay")
@click.argument("config", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("data", type=click.Path(path_type=Path))
@click.option("--twin", "name", metavar="NAME", help="Which; not needed where there is one.")
@modelica_path_option
@json_option
def replay_command(
    config: Path,
    data: Path,
    name: str | None,
    modelica_path: tuple[Path, ...],
    json_path: str | None,
) -> None:
    """What the twin in CONFIG.toml says of DATA: a CAN log, or a folder of the service's own.

    \b
    Example:
      twinproof twin replay line-3.toml recordings/robot --json -
    """
    # The other commands of `twin` need no compiler of models, and shall be there at once.
    from twin.replay import replay
    from twin.settings import read_settings

    output = Output(json_path)
    settings = _chosen(read_settings(config, roots=modelica_path), name)
    with output.progress() as progress:
        found = replay(settings, data, roots=modelica_path, progress=progress)
    output.console.print(_parameter_table(settings, found))
    events = _event_table(found)
    output.console.print(events if events.row_count else "no events")
    output.note(
        f"{settings.name}: {found.state} after {found.span:.1f} s of data, "
        f"replayed {found.speed:.0f} times as fast"
    )
    output.document(replayed(settings, found))


def _chosen(settings: Settings, name: str | None) -> TwinSettings:
    if name is not None:
        return settings.twin(name)
    first, *others = settings.twins
    if others:
        raise InputError(
            f"{1 + len(others)} twins",
            where=str(settings.path),
            remedy=f"name one: --twin {first.name}",
        )
    return first


def replayed(settings: TwinSettings, found: Replay) -> Document:
    """Return the document of `twin replay`."""
    fit = settings.plant.fit
    estimate = found.estimate
    parameters = (
        {}
        if estimate is None
        else {
            n: {
                "value": estimate.values[n],
                "sd": estimate.sd[n],
                "unit": estimate.units[n],
                "verified": None if fit is None else fit.values.get(n),
            }
            for n in estimate.names
        }
    )
    return document(
        "twin-replay",
        {
            "twin": settings.name,
            "state": found.state,
            "parameters": parameters,
            "excitation": None if estimate is None else estimate.excitation,
            "drift": found.drift,
            "events": [event.document() for event in found.events],
            "counts": dict(found.health.counts),
            "span": found.span,
            "seconds": found.seconds,
        },
    )


def _parameter_table(settings: TwinSettings, found: Replay) -> Table:
    table = Table(title="parameters", title_justify="left")
    for heading in ("parameter", "verified", "now", "sd", "unit", "z"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    estimate, fit = found.estimate, settings.plant.fit
    statistics = found.drift["statistics"]
    if estimate is None:
        return table
    for n in estimate.names:
        known = settings.plant.parameters.get(n) if fit is None else fit.values.get(n)
        z = statistics.get(n) if isinstance(statistics, dict) else None
        table.add_row(
            n,
            "" if known is None else f"{known:.5g}",
            f"{estimate.values[n]:.5g}",
            f"{estimate.sd[n]:.2g}",
            estimate.units[n],
            f"{z:.1f}" if isinstance(z, float) else "",
        )
    return table


def _event_table(found: Replay) -> Table:
    table = Table(title="events", title_justify="left")
    for heading in ("time in s", "what", "about"):
        table.add_column(heading, justify="right" if heading == "time in s" else "left")
    for event in found.events:
        if event.kind.value != "parameters":
            about = event.detail.get("parameter") or event.detail.get("name")
            about = about or event.detail.get("message") or event.detail.get("what") or ""
            table.add_row(f"{event.time:.3f}", event.kind.value.replace("_", " "), str(about))
    return table
