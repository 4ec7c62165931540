"""A project: a folder of plain files that holds everything the workbench knows.

    workbench.json        what was chosen, and the steps that were accepted
    channels.toml         which column or signal is which variable
    recordings/ models/   what was uploaded, and every accepted step's Modelica
    results/              one document and one piece of page for every question answered
    improved/             what the automatic ladder leaves: .mo, .fmu, ladder.csv, report.html
    .cache/               curves for drawing; not for git

Paths in it are relative to the folder, so that it can be moved, and the commands shown in the
workbench can be typed there.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from fmus.sources import check_libraries
from foundation.errors import FormatError, InputError
from foundation.files import write_text

_SCHEMA = "twinproof/workbench/1"
_STATE = "workbench.json"
_MAP = "channels.toml"
_FITS = ("identify", "diagnose", "improve")
_SAFE_NAME = re.compile(r"[\w][\w .+-]*\Z")
UPLOADS = {
    "recordings": (
        *(".csv", ".parquet", ".mat", ".mf4", ".blf", ".asc", ".log", ".log.gz", ".trc", ".dbc"),
    ),
    "models": (".mo", ".fmu"),
}
"""Folder → endings of the files that may be put there."""


@dataclass(frozen=True)
class Step:
    """An accepted step: effects with their values, and the model file that has them."""

    additions: tuple[str, ...]
    model: str


@dataclass(frozen=True)
class Choices:
    """What the user chose.

    Attributes:
        model: The MODEL.
        recording: The DATA that is fitted.
        holdout: Unseen DATA; empty: none.
        dbc: Describes CAN logs; empty: none.
        also: Further DATA of the same machine, fitted at once; commas between them.
        libraries: Folders of further Modelica libraries; commas between them.
        horizon: `auto`, `free` or a length [s].
        max_effects: For the automatic ladder.
        steps: What was added and accepted, in order.
    """

    model: str = ""
    recording: str = ""
    holdout: str = ""
    dbc: str = ""
    also: str = ""
    libraries: str = ""
    horizon: str = "auto"
    max_effects: str = "4"
    steps: tuple[Step, ...] = ()

    @property
    def present_model(self) -> str:
        """The model with every accepted step."""
        return self.steps[-1].model if self.steps else self.model

    @property
    def also_words(self) -> tuple[str, ...]:
        """The further DATA, one by one."""
        return _words(self.also)

    @property
    def fitted_words(self) -> tuple[str, ...]:
        """All DATA that are fitted at once."""
        return (self.recording, *self.also_words)

    @property
    def library_words(self) -> tuple[str, ...]:
        """The folders of further libraries, one by one."""
        return _words(self.libraries)


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


TEXTS = tuple(f.name for f in fields(Choices) if f.name != "steps")
"""The choices that are fields of the form."""


@dataclass(frozen=True)
class Project:
    """A project folder.

    Args:
        folder: Created with the first file that is written.

    Example:
        >>> import tempfile
        >>> project = Project(Path(tempfile.mkdtemp()))
        >>> project.choose({"model": "Twinproof.Plants.Positioner", "recording": "emps"})
        >>> project.command("compare")
        'twinproof compare Twinproof.Plants.Positioner emps'
    """

    folder: Path
    results: Path = field(init=False)
    cache: Path = field(init=False)
    map_file: Path = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "results", self.folder / "results")
        object.__setattr__(self, "cache", self.folder / ".cache")
        object.__setattr__(self, "map_file", self.folder / _MAP)

    @property
    def choices(self) -> Choices:
        """What was chosen; nothing in a new folder.

        Raises:
            FormatError: The file was edited and is no longer what it should be.
        """
        path = self.folder / _STATE
        if not path.is_file():
            return Choices()
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            texts = {name: str(found.get(name, getattr(Choices, name))) for name in TEXTS}
            steps = [
                Step(tuple(map(str, step["additions"])), str(step["model"]))
                for step in found.get("steps", [])
            ]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FormatError(
                f"the project's file cannot be read: {error}",
                where=str(path),
                remedy="mend it, or remove it to choose anew",
            ) from error
        return Choices(**texts, steps=tuple(steps))

    def save(self, choices: Choices) -> None:
        """Write the choices."""
        self._ignore_cache()
        text = json.dumps({"schema": _SCHEMA, **asdict(choices)}, indent=2, ensure_ascii=False)
        write_text(self.folder / _STATE, text + "\n")

    def choose(self, changed: Mapping[str, str]) -> None:
        """Change fields of the form; another model begins without steps.

        Raises:
            InputError: There is no such field.
        """
        for name in changed:
            if name not in TEXTS:
                raise InputError(f"there is no field '{name}'", remedy=f"use {', '.join(TEXTS)}")
        before = self.choices
        texts = {name: value.strip() for name, value in changed.items()}
        after = replace(before, **texts)
        if after.model != before.model:
            after = replace(after, steps=())
        self.save(after)

    def accept(self, step: Step) -> None:
        """Append an accepted step."""
        choices = self.choices
        self.save(replace(choices, steps=(*choices.steps, step)))

    def undo(self) -> None:
        """Take the last accepted step back; its file stays."""
        choices = self.choices
        self.save(replace(choices, steps=choices.steps[:-1]))

    def upload_path(self, folder: str, name: str) -> Path:
        """Return where an uploaded file goes.

        Raises:
            InputError: Its name or its ending is not one that the workbench takes.
        """
        endings = UPLOADS.get(folder)
        if endings is None:
            raise InputError(f"nothing can be put into '{folder}'", remedy="upload a model or data")
        if not _SAFE_NAME.match(name):
            raise InputError(
                f"'{name}' is no name for a file here",
                remedy="rename it: letters, digits, space, dot, dash, underscore",
            )
        if not name.lower().endswith(endings):
            raise InputError(
                f"'{name}' is none of the kinds of file that are read",
                remedy=f"give one of {' '.join(endings)}",
            )
        return self.folder / folder / name

    def files(self, folder: str, endings: Sequence[str]) -> list[str]:
        """Return the files there are of some endings, as words of the command line."""
        there = self.folder / folder
        if not there.is_dir():
            return []
        return sorted(
            f"{folder}/{path.name}"
            for path in there.iterdir()
            if path.is_file() and path.name.lower().endswith(tuple(endings))
        )

    def curves(self, record: int) -> Path:
        """Return where the curves of one of the records compared are."""
        return self.cache / "compare" / str(record)

    def write_result(self, name: str, document: Mapping[str, Any], page: str) -> None:
        """Write a result: its document, as the command line's `--json`, and its piece of page."""
        self._ignore_cache()
        made_with = json.dumps(self.question(), ensure_ascii=False, sort_keys=True)
        write_text(
            self.results / f"{name}.json",
            json.dumps({**document, "made_with": json.loads(made_with)}, indent=1) + "\n",
        )
        write_text(self.results / f"{name}.html", page)

    def result(self, name: str) -> dict[str, Any] | None:
        """Return a result's document; None if there is none."""
        path = self.results / f"{name}.json"
        if not path.is_file():
            return None
        try:
            return dict(json.loads(path.read_text(encoding="utf-8")))
        except (ValueError, TypeError):
            # Edited by hand, or half merged: as if it had never been answered.
            return None

    def page(self, name: str) -> str:
        """Return a result's piece of page; empty if there is none."""
        path = self.results / f"{name}.html"
        return path.read_text(encoding="utf-8") if path.is_file() else ""

    def question(self) -> dict[str, str]:
        """Return what results depend on: a result made with something else is out of date."""
        choices = self.choices
        text = self.map_file.read_text(encoding="utf-8") if self.map_file.is_file() else ""
        data = self.folder / choices.recording
        # Of a file the size as well: one of the same name may have been put in its place.
        size = f" ({data.stat().st_size} bytes)" if choices.recording and data.is_file() else ""
        return {
            "model": choices.present_model,
            "recording": choices.recording + size,
            "dbc": choices.dbc,
            "also": choices.also,
            "libraries": choices.libraries,
            "horizon": choices.horizon,
            "channels": text,
        }

    def command(
        self,
        name: str,
        *,
        model: str | None = None,
        recording: str | None = None,
        more: Sequence[str] = (),
    ) -> str:
        """Return the command line that does the same, to be typed in the project's folder."""
        choices = self.choices
        data = recording or choices.recording
        words = ["twinproof", name, model or choices.present_model, data, *more]
        if self.map_file.is_file():
            words += ["--map", _MAP]
        if choices.dbc:
            words += ["--dbc", choices.dbc]
        if name in _FITS:
            words += [part for word in choices.also_words for part in ("--also", word)]
        words += self.library_options()
        if choices.horizon != "auto" and name != "diagnose":
            words += ["--horizon", choices.horizon]
        return shlex.join(words)

    def library_options(self) -> list[str]:
        """Return the further libraries as options of the command line."""
        return [p for word in self.choices.library_words for p in ("--modelica-path", word)]

    def library_folders(self) -> tuple[Path, ...]:
        """Return the folders of further libraries.

        Raises:
            TwinproofError: See `fmus.sources.check_libraries`.
        """
        return check_libraries([self.folder / word for word in self.choices.library_words])

    def _ignore_cache(self) -> None:
        self.cache.mkdir(parents=True, exist_ok=True)
        path = self.folder / ".gitignore"
        if not path.exists():
            write_text(path, ".cache/\n")
