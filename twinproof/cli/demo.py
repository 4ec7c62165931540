"""`demo`: the main job on a bundled recording whose truth has an effect that the model lacks."""

from __future__ import annotations

import shlex
from importlib.resources import as_file, files
from pathlib import Path

import click

from recordings import Recording
from twinproof.api import read_recording
from twinproof.cli.journey import run_improvement
from twinproof.cli.options import Output, Request, json_option
from twinproof.model import Model

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
@json_option
def demo(output_dir: Path, json_path: str | None) -> None:
    """Find the hidden effect in a bundled CAN log of a balancing wheeled pendulum.

    \b
    Example:
      twinproof demo -o demo-out
    """
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
