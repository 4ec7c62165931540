"""What a file format must offer to be read: two small classes.

A new reader implements `Reader.read` and lists its suffixes; `RawTable` holds what it found. The
table reads values only when they are asked for, so a log may be larger than what is used of it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ChannelError
from recordings.names import suggestion


@dataclass(frozen=True)
class Request:
    """Which signal of a file is wanted.

    Attributes:
        name: Its name in the file.
        bus: Of a CAN log with several buses: its name or number there.
        address: Of a J1939 message: address of the unit that sends it.
    """

    name: str
    bus: str | None = None
    address: int | None = None


@dataclass(frozen=True)
class Scope:
    """How much of a file is wanted, so that a long one need not be kept whole.

    Attributes:
        names: Signals that may be asked for; None: any.
        start: Beginning of the part that is wanted, s.
        stop: Its end, s.
    """

    names: frozenset[str] | None = None
    start: float = -math.inf
    stop: float = math.inf

    @property
    def bounded(self) -> bool:
        """Whether only a part is wanted."""
        return self.start > -math.inf or self.stop < math.inf


EVERYTHING = Scope()
"""The whole file."""


@dataclass(frozen=True, eq=False)
class RawSignal:
    """A signal as the file has it.

    Attributes:
        name: Its name in the file.
        values: Shape (n,), in `unit`.
        time: Shape (n,), s; None in a table whose rows share a time column.
        unit: As the file says; None where it does not say.
        resolution: Smallest difference that the file can hold, in `unit`, where it is known.
        is_state: The file says that it has no values in between: an enumeration, a bit.
        notes: What was left out in reading it.
    """

    name: str
    values: NDArray[np.float64]
    time: NDArray[np.float64] | None = None
    unit: str | None = None
    resolution: float | None = None
    is_state: bool = False
    notes: tuple[str, ...] = ()


class RawTable(ABC):
    """What a file holds, by name."""

    uses_dbc: ClassVar[bool] = False
    """Whether the signals are described by a DBC."""
    origin: str
    """The file, for messages."""
    notes: tuple[str, ...] = ()
    """What was left out or changed in reading."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the signals there are, in the file's order."""

    @abstractmethod
    def signals(self, requests: Sequence[Request]) -> list[RawSignal]:
        """Return the requested signals.

        Raises:
            ChannelError: One is not there, or its values are not numbers.
        """

    def missing(self, name: str, kind: str = "column") -> ChannelError:
        """Return the error for a name that is not there."""
        return ChannelError(
            f"no {kind} '{name}'", where=self.origin, remedy=suggestion(kind, name, self.names)
        )

    def plain(self, request: Request) -> str:
        """Return the name of a request that names neither bus nor address.

        Raises:
            ChannelError: It does; in a table there are none.
        """
        if request.bus is not None or request.address is not None:
            key = "bus" if request.bus is not None else "address"
            raise ChannelError(
                f"'{request.name}' is asked for by '{key}', but the file is no CAN log",
                where=self.origin,
                remedy=f"remove {key} from the channel map",
            )
        return request.name


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

    def signals(self, requests: Sequence[Request]) -> list[RawSignal]:
        """Return the named columns."""
        names = [self.plain(request) for request in requests]
        for name in names:
            if name not in self._columns:
                raise self.missing(name)
        return [RawSignal(name, self._columns[name]) for name in names]


class Reader(ABC):
    """A file format."""

    suffixes: ClassVar[tuple[str, ...]]
    """Endings of its file names, in small letters, such as `.csv` or `.log.gz`."""

    @abstractmethod
    def read(self, path: Path, *, dbc: Path | None = None, scope: Scope = EVERYTHING) -> RawTable:
        """Open a file.

        Args:
            path: The file; it exists.
            dbc: Describes the messages of a CAN log; other formats leave it alone.
            scope: What will be asked for; a reader may leave out the rest, or not.

        Raises:
            FormatError: The file is empty, damaged, or not of this format.
        """
