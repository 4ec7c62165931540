"""`demo`: the main job on bundled things, on a recording or live."""

from __future__ import annotations

import shlex
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

import click

from recordings import Recording
from twinproof.api import read_recording
from twinproof.cli.journey import run_improvement
from twinproof.cli.options import Output, Request, json_option
from twinproof.documents import Document, document
from twinproof.model import Model

if TYPE_CHECKING:
    from twinproof.story import Told

MODEL = "Twinproof.Plants.WheeledPendulum"


@click.command()
@click.option(
    "-o",
    "output_dir",
    default=Path("demo-out"),
    show_default=True,
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the results.",
)
@click.option(
    "--live",
    is_flag=True,
    help="Instead: a plant in the loop and the twin service beside it, in real time (1 to 2 min).",
)
@json_option
def demo(output_dir: Path, live: bool, json_path: str | None) -> None:
    """Find the hidden effect in a bundled CAN log of a balancing wheeled pendulum.

    \b
    Example:
      twinproof demo -o demo-out
      twinproof demo --live -o demo-live
    """
    if live:
        _live(output_dir, Output(json_path))
        return
    with as_file(files("twinproof") / "demo_data") as folder:
        chosen = Model.of(MODEL)
        channel_map, dbc = folder / "channels.toml", folder / "wheeled_pendulum.dbc"

        def read(name: str) -> Recording:
            return read_recording(folder / name, chosen, channel_map=channel_map, dbc=dbc)

        request = Request(chosen, read("balancing.blf"), {}, None, read, Output(json_path))
        request.output.note(
            f"{request.recording.duration:.0f} s of CAN log from a machine that balances on its "
            "wheels; the model of it lacks something"
        )
        command = shlex.join(
            [
                *("twinproof", "improve", MODEL, str(folder / "balancing.blf")),
                *("--holdout", str(folder / "held_out.blf"), "--map", str(channel_map)),
                *("--dbc", str(dbc), "-o", str(output_dir)),
            ]
        )
        run_improvement(request, read("held_out.blf"), output_dir, command)


def _live(folder: Path, output: Output) -> None:
    from twinproof.story import tell_live  # a web server is slow to import

    output.note("an arm with its controller, and a twin of it; friction appears after 20 s")

    def say(time: float, words: str) -> None:
        output.console.print(f"{time:7.1f} s  {words}", markup=False, soft_wrap=True)

    told = tell_live(folder, say)
    config = shlex.quote(str(folder / "config.toml"))
    recordings = shlex.quote(str(folder / "recordings" / "arm"))
    output.note(f"the log cannot have been changed: twinproof twin audit {config}")
    output.note(f"the same from the recording: twinproof twin replay {config} {recordings}")
    output.document(told_document(told, folder))


def told_document(told: Told, folder: Path) -> Document:
    """Return the document of `demo --live`."""
    return document(
        "demo-live",
        {
            "ending": told.telling.ending,
            "seconds": told.seconds,
            "chapters": [
                {"chapter": name, "seconds": time - told.began}
                for name, time in told.telling.chapters.items()
            ],
            "events": [entry.document() for entry in told.entries],
            "folder": str(folder),
        },
    )
