"""DBC files: which message a frame is, which values say that there is none.

J1939 messages are known by their parameter group, whoever sends them: the identifier's priority,
source address and, of messages to one receiver, destination do not count (SAE J1939-21, 5.1.2).
Their highest raw values are not numbers but `error` and `not available` (SAE J1939-71, 5.1.4).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cantools
import numpy as np
from cantools.database.can import Database, Message, Signal
from numpy.typing import NDArray

from foundation.errors import FormatError, RecordingError
from recordings.names import listing
from recordings.readers.can_frames import EXTENDED

_STANDARD = 1 << 11
"""How many 11-bit identifiers there are."""
_NO_VALUE = re.compile(
    r"s\.?n\.?a\.?|.*not[ _]*av.*|n/?a|.*invalid.*|.*error.*|.*undefined.*|.*unavail.*", re.I
)


class Messages:
    """The messages of a DBC, numbered, and the frames that belong to them.

    Attributes:
        messages: In the DBC's order; a message's number is its place.
    """

    def __init__(self, messages: Sequence[Message]) -> None:
        self.messages = tuple(messages)
        self._by_identifier = {identifier(m): k for k, m in enumerate(self.messages)}
        self._by_group = {
            parameter_group(m.frame_id): k for k, m in enumerate(self.messages) if is_j1939(m)
        }
        self._standard = np.full(_STANDARD, -1, np.int32)
        for key, number in self._by_identifier.items():
            if key < _STANDARD:
                self._standard[key] = number

    def numbers(self, identifiers: NDArray[np.uint32]) -> NDArray[np.int32]:
        """Return each frame's message by number, shape (n,); -1 where the DBC has none.

        Args:
            identifiers: Shape (n,), 29-bit ones with the flag `EXTENDED`.
        """
        found = self._standard[identifiers & np.uint32(_STANDARD - 1)]
        if np.any(long := identifiers >= _STANDARD):
            several, places = np.unique(identifiers[long], return_inverse=True)
            found[long] = np.array([self._number(int(i)) for i in several], np.int32)[places]
        return found

    def _number(self, key: int) -> int:
        exact = self._by_identifier.get(key)
        if exact is None and key & EXTENDED:
            exact = self._by_group.get(parameter_group(key))
        return -1 if exact is None else exact


def identifier(message: Message) -> int:
    """Return a message's identifier, flagged `EXTENDED` for 29 bits."""
    return message.frame_id | (EXTENDED if message.is_extended_frame else 0)


def is_j1939(message: Message) -> bool:
    """Return whether a message is known by its parameter group."""
    return message.protocol == "j1939" and message.is_extended_frame


def parameter_group(frame_id: int) -> int:
    """Return the parameter group number of a J1939 identifier.

    Example:
        >>> parameter_group(0x0CF004FE) == parameter_group(0x18F00403) == 0xF004
        True
        >>> parameter_group(0x0CEF2103) == 0xEF00  # to one receiver, 0x21
        True
    """
    group = (frame_id >> 8) & 0x3FFFF
    return group if group & 0xFF00 >= 0xF000 else group & 0x3FF00


def read_dbc(path: Path) -> Messages:
    """Read a DBC file.

    Raises:
        RecordingError: There is no such file.
        FormatError: It cannot be parsed, or describes no message; says at which line.
    """
    try:
        # Not strict: signals that overlap are common in real files, and do no harm in reading.
        database = cantools.database.load_file(path, database_format="dbc", strict=False)
    except OSError as error:
        raise RecordingError(
            f"the DBC file cannot be read: {error.strerror}",
            where=str(path),
            remedy="correct --dbc",
        ) from error
    except Exception as error:  # parser, number and text errors of three libraries
        raise FormatError(
            f"not a DBC file: {' '.join(str(error).split())}",
            where=str(path),
            remedy="repair the line, or export the DBC again",
        ) from error
    messages = database.messages if isinstance(database, Database) else []
    if not messages:
        raise FormatError(
            "the DBC describes no message", where=str(path), remedy="is it the right file?"
        )
    return Messages(messages)


def available(
    message: Message,
    signal: Signal,
    raw: NDArray[np.integer[Any]] | NDArray[np.floating[Any]],
) -> NDArray[np.bool_] | None:
    """Return which unscaled values, shape (n,), are measurements; None: all of them.

    Not values are: floats that are not finite; of a J1939 signal its error and not-available
    ranges; and the highest two values where the DBC's value table calls them so (`SNA`).

    Example:
        >>> speed = Signal("speed", 0, 16)
        >>> ccvs = Message(0x18FEF100, "CCVS", 8, [speed], is_extended_frame=True, protocol="j1939")
        >>> available(ccvs, speed, np.array([0xFAFF, 0xFE00, 0xFFFF], np.uint64)).tolist()
        [True, False, False]
    """
    if signal.is_float:
        finite = np.isfinite(raw)
        return None if np.all(finite) else finite
    if signal.is_signed:
        return None
    top = (1 << signal.length) - 1
    limit = top + 1
    if is_j1939(message) and signal.length > 1:
        # From 8 bits on the first byte counts: 0xFB to 0xFD are reserved, 0xFE error, 0xFF absent.
        limit = 0xFB << signal.length - 8 if signal.length >= 8 else top - 1
    named = [
        value
        for value, name in (signal.choices or {}).items()
        if signal.length > 1 and value in (top, top - 1) and _NO_VALUE.fullmatch(str(name))
    ]
    if limit > top and not named:
        return None
    there = raw < np.uint64(limit) if limit <= top else np.ones(raw.shape, np.bool_)
    for value in named:
        there &= raw != np.uint64(value)
    return None if np.all(there) else there


def is_state(signal: Signal) -> bool:
    """Return whether a signal jumps between states: a bit, or a number whose values have names.

    Example:
        >>> is_state(Signal("gear", 0, 4)), is_state(Signal("reverse", 0, 1))
        (False, True)
    """
    if signal.is_float or signal.length == 1:
        return not signal.is_float
    top = (1 << signal.length) - 1
    named = [value for value in signal.choices or {} if value not in (top, top - 1)]
    return len(named) > 1 and (signal.conversion.scale, signal.conversion.offset) == (1, 0)


def selectors(message: Message, signal: Signal) -> list[Signal]:
    """Return the multiplexers that say whether a frame carries a signal, the nearest first."""
    if not signal.multiplexer_signal:
        return []
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    return [selector, *selectors(message, selector)]


def places(messages: Sequence[Message]) -> Mapping[str, list[tuple[int, Message, Signal]]]:
    """Return where signals are, by name: number of the message, message, signal."""
    found: dict[str, list[tuple[int, Message, Signal]]] = {}
    for number, message in enumerate(messages):
        for signal in message.signals:
            found.setdefault(signal.name, []).append((number, message, signal))
    return found


def identifier_listing(identifiers: Iterable[int]) -> str:
    """Return identifiers as people write them, the first few.

    Example:
        >>> identifier_listing([0x100, EXTENDED | 0x18F00403])
        '0x100, 0x18F00403'
    """
    return listing(
        [f"0x{i & ~EXTENDED:08X}" if i & EXTENDED else f"0x{i:03X}" for i in sorted(identifiers)],
        most=8,
    )
