"""What the story is made of: the files that an engineer would write for a twin and its rig."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import tomli_w

from fmus.sources import find_source
from foundation.errors import InputError
from foundation.files import write_bytes, write_text
from identification.discovery.extension import extend, parse_addition

PLANT = "Twinproof.Plants.Pendulum"
EFFECT = "CoulombFriction@joint"
"""What appears: in the worn plant's model from the start, but zero until the scenario says so."""
_CONFIG = "config.toml"


@dataclass(eq=False)
class StoryFiles:
    """The files as documents, to be changed at will before they are written.

    Attributes:
        config: Of the service; its one twin is called `arm`.
        study: What the controller must hold.
        controller: The deployed one.
        scenario: The plant in the loop, without its controller.
        fit: What the plant was identified to be.
        dbc: Of the bus.

    Example:
        >>> story = StoryFiles.bundled()
        >>> story.twin["verification"]["draws"] = 4
        >>> story.config["twin"][0]["verification"]["draws"]
        4
    """

    config: dict[str, Any]
    study: dict[str, Any]
    controller: dict[str, Any]
    scenario: dict[str, Any]
    fit: dict[str, Any]
    dbc: bytes

    @staticmethod
    def bundled() -> StoryFiles:
        """Return them as they are shipped."""
        folder = files("twinproof") / "demo_data" / "live"
        tables = {
            name: tomllib.loads((folder / f"{name}.toml").read_text("utf-8"))
            for name in ("config", "study", "scenario")
        }
        return StoryFiles(
            **tables,
            controller=tomllib.loads((folder / "pid.toml").read_text("utf-8")),
            fit=json.loads((folder / "fit.json").read_text("utf-8")),
            dbc=(folder / "arm.dbc").read_bytes(),
        )

    @property
    def twin(self) -> dict[str, Any]:
        """The table of the twin in `config`."""
        return self.config["twin"][0]

    @property
    def friction(self) -> float:
        """What appears [N.m]."""
        return float(self.scenario["faults"][0]["to"])

    @property
    def appears(self) -> float:
        """When [s of the run]."""
        return float(self.scenario["faults"][0]["start"])

    def write(self, folder: Path) -> None:
        """Write them, with the scenario's controller and the model of a plant that can wear.

        Args:
            folder: Made if it is not there. What an earlier story left in it is removed.

        Raises:
            InputError: Somebody else's files are in it.
            OSError: It cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        config = tomli_w.dumps(self.config)
        _clear(folder, config)
        write_text(folder / _CONFIG, config)
        write_text(folder / "study.toml", tomli_w.dumps(self.study))
        write_text(folder / "pid.toml", tomli_w.dumps(self.controller))
        scenario = {**self.scenario, "controller": self.controller}
        write_text(folder / "scenario.toml", tomli_w.dumps(scenario))
        write_text(folder / "fit.json", json.dumps(self.fit, indent=2) + "\n")
        write_bytes(folder / "arm.dbc", self.dbc)
        source = find_source(PLANT)
        worn = extend(source, [parse_addition(f"{EFFECT},tau_c=0", source)], name="Worn")
        write_text(folder / "Worn.mo", worn.source.text)


def _clear(folder: Path, config: str) -> None:
    """Remove what a service has left, so that the story begins with nothing known."""
    theirs = folder / _CONFIG
    if not theirs.exists():
        left = next(folder.glob("twin.db*"), None)
    else:
        left = None if theirs.read_text(encoding="utf-8") == config else theirs
    if left is not None:
        raise InputError(
            "another service's files are there", where=str(left), remedy="choose another folder: -o"
        )
    for pattern in ("twin.db*", "audit.key*", "recordings/arm/*.log", "models/*.mo"):
        for path in folder.glob(pattern):
            path.unlink()
