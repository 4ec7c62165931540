"""`demo`: the main job on a bundled recording whose truth has an effect that the model lacks."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

import click

from twinproof import api, documents
from twinproof.cli.journey import show_improvement
from twinproof.cli.options import Output, json_option
from twinproof.model import Model
from twinproof.results import write_improvement

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
    output = Output(json_path)
    with as_file(files("twinproof") / "demo_data") as folder, output.progress() as progress:
        chosen = Model.of(MODEL)
        words = [
            "twinproof",
            "improve",
            MODEL,
            str(folder / "balancing.blf"),
            "--holdout",
            str(folder / "held_out.blf"),
            "--map",
            str(folder / "channels.toml"),
            "--dbc",
            str(folder / "wheeled_pendulum.dbc"),
            "-o",
            str(output_dir),
        ]
        fitted, unseen = (
            api.read_recording(
                folder / name,
                chosen,
                channel_map=folder / "channels.toml",
                dbc=folder / "wheeled_pendulum.dbc",
            )
            for name in ("balancing.blf", "held_out.blf")
        )
        output.note(
            f"{fitted.duration:.0f} s of CAN log from a pendulum balancing on its wheels; "
            "its model lacks something"
        )
        result = api.improve(chosen, fitted, unseen, progress=progress)
        written = write_improvement(result, output_dir, command=" ".join(words), progress=progress)
    show_improvement(output, result, output_dir)
    output.document(documents.improved(result, written))
