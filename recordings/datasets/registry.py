"""The registered data sets, read from `registry.toml`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from foundation.errors import UnknownNameError


@dataclass(frozen=True)
class DataFile:
    """One file of a data set.

    Attributes:
        path: Its path in the origin's repository.
        local: Its path below `$TWINPROOF_DATA` and in the cache.
        sha256: Checksum of its content, hexadecimal.
    """

    path: str
    local: str
    sha256: str


@dataclass(frozen=True)
class DataSet:
    """A recording that anybody can get.

    Attributes:
        name: What users type.
        title: What was measured, in one line.
        repository: The origin on GitHub, `owner/name`.
        commit: The commit of the origin, 40 hexadecimal digits.
        licence: SPDX identifier.
        citation: The work that the data belong to.
        data: The recording.
        dbc: Describes the messages of a CAN log.
        map_text: The channel map, as TOML, from columns to the variables of the library's plants.
    """

    name: str
    title: str
    repository: str
    commit: str
    licence: str
    citation: str
    data: DataFile
    dbc: DataFile | None
    map_text: str

    @property
    def path(self) -> str:
        """Path of the recording in the origin's repository."""
        return self.data.path

    def url(self, file: DataFile) -> str:
        """Return where the origin serves a file, at the pinned commit."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{file.path}"


def list_sets() -> tuple[DataSet, ...]:
    """Return all registered data sets, in the registry's order.

    Example:
        >>> "emps" in [data_set.name for data_set in list_sets()]
        True
    """
    return tuple(_registry().values())


def find(name: str) -> DataSet:
    """Return a data set by name.

    Raises:
        UnknownNameError: There is none of that name.
    """
    try:
        return _registry()[name]
    except KeyError:
        raise UnknownNameError("data set or file", name, _registry()) from None


@cache
def _registry() -> dict[str, DataSet]:
    folder = files(__package__ or "recordings.datasets")
    document = tomllib.loads(folder.joinpath("registry.toml").read_text(encoding="utf-8"))
    origins: dict[str, dict[str, str]] = document["origins"]
    found: dict[str, DataSet] = {}
    for name, entry in document["sets"].items():
        dbc: dict[str, Any] | None = entry.get("dbc")
        map_file = folder.joinpath("maps", f"{entry['map']}.toml")
        found[name] = DataSet(
            name=name,
            title=entry["title"],
            **origins[entry["origin"]],
            data=DataFile(**entry["data"]),
            dbc=DataFile(**dbc) if dbc else None,
            map_text=map_file.read_text(encoding="utf-8"),
        )
    return found
