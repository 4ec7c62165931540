"""What a file format must offer to be read: two small classes.

A new reader implements `Reader.read` and lists its suffixes; `RawTable` holds what it found. The
table reads values only when they are asked for, so a log may be larger than what is used of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ChannelError
from recordings.names import suggestion


@dataclass(frozen=True, eq=False)
class RawSignal:
    """A signal as the file has it.

    Attributes:
        name: Its name in the file.
        values: Shape (n,), in `unit`.
        time: Shape (n,), s; None in a table whose rows share a time column.
        unit: As the file says; None where it does not say.
        resolution: Smallest difference that the file can hold, in `unit`, where it is known.
        notes: What was left out in reading it.
    """

    name: str
    values: NDArray[np.float64]
    time: NDArray[np.float64] | None = None
    unit: str | None = None
    resolution: float | None = None
    notes: tuple[str, ...] = ()


class RawTable(ABC):
    """What a file holds, by name."""

    origin: str
    """The file, for messages."""
    notes: tuple[str, ...] = ()
    """What was left out or changed in reading."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the signals there are, in the file's order."""

    @abstractmethod
    def signals(self, names: Sequence[str]) -> list[RawSignal]:
        """Return the named signals.

        Raises:
            ChannelError: A name is not there, or its values are not numbers.
        """

    def missing(self, name: str, kind: str = "column") -> ChannelError:
        """Return the error for a name that is not there."""
        return ChannelError(
            f"no {kind} '{name}'", where=self.origin, remedy=suggestion(kind, name, self.names)
        )


class ColumnTable(RawTable):
    """Columns of equal standing, held in memory; time, where there is one, is a column too."""

    def __init__(
        self, columns: Mapping[str, NDArray[np.float64]], origin: str, notes: tuple[str, ...] = ()
    ) -> None:
        self._columns = columns
        self.origin = origin
        self.notes = notes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in the file's order."""
        return tuple(self._columns)

    def signals(self, names: Sequence[str]) -> list[RawSignal]:
        """Return the named columns."""
        for name in names:
            if name not in self._columns:
                raise self.missing(name)
        return [RawSignal(name, self._columns[name]) for name in names]


class Reader(ABC):
    """A file format."""

    suffixes: ClassVar[tuple[str, ...]]
    """Endings of its file names, in small letters, such as `.csv` or `.log.gz`."""

    @abstractmethod
    def read(self, path: Path, *, dbc: Path | None = None) -> RawTable:
        """Open a file.

        Args:
            path: The file; it exists.
            dbc: Describes the messages of a CAN log; other formats leave it alone.

        Raises:
            FormatError: The file is empty, damaged, or not of this format.
        """
