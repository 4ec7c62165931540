"""CAN logs: frames as columns, and signals taken out of them as a DBC describes.

A format only turns its file into `Frames` (`CanReader.frames`); all else is here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cantools
import numpy as np
from cantools.database.can import Database, Message, Signal
from numpy.typing import NDArray

from foundation.errors import ChannelError, FormatError, RecordingError, TimeError
from recordings.names import listing
from recordings.readers.base import RawSignal, RawTable, Reader
from recordings.readers.can_bits import byte_span, raw_values, scaled_values

EXTENDED = 1 << 31
"""Flag that tells a 29-bit identifier from an 11-bit one of the same number."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Data frames in the order of the log, as columns of n.

    Attributes:
        nanoseconds: Time stamps, ns, int64: exact where a float of seconds since 1970 is not.
        identifier: CAN identifiers, uint32; those of 29 bits have the flag `EXTENDED`.
        bus: Number of the bus, int64.
        length: Bytes of payload, uint8.
        payload: Bytes, shape (n, width), filled up with zeros.
        error_frames: How many error frames were left out.
        remote_frames: How many remote frames were left out.
    """

    nanoseconds: NDArray[np.int64]
    identifier: NDArray[np.uint32]
    bus: NDArray[np.int64]
    length: NDArray[np.uint8]
    payload: NDArray[np.uint8]
    error_frames: int = 0
    remote_frames: int = 0

    def __len__(self) -> int:
        return self.identifier.size

    def __getitem__(self, rows: NDArray[np.bool_]) -> Frames:
        return Frames(
            self.nanoseconds[rows],
            self.identifier[rows],
            self.bus[rows],
            self.length[rows],
            self.payload[rows],
            self.error_frames,
            self.remote_frames,
        )

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Return the frames of all parts, one part after the other."""
        width = max((part.payload.shape[1] for part in parts), default=0)
        wide = [np.pad(p.payload, ((0, 0), (0, width - p.payload.shape[1]))) for p in parts]
        return Frames(
            np.concatenate([part.nanoseconds for part in parts]),
            np.concatenate([part.identifier for part in parts]),
            np.concatenate([part.bus for part in parts]),
            np.concatenate([part.length for part in parts]),
            np.concatenate(wide),
            sum(part.error_frames for part in parts),
            sum(part.remote_frames for part in parts),
        )


@dataclass
class FrameList:
    """Collects frames one by one; `frames` makes columns of them."""

    error_frames: int = 0
    remote_frames: int = 0
    _nanoseconds: list[int] = field(default_factory=list[int])
    _identifiers: list[int] = field(default_factory=list[int])
    _buses: list[int] = field(default_factory=list[int])
    _payloads: list[bytes] = field(default_factory=list[bytes])

    def __len__(self) -> int:
        return len(self._payloads)

    def add(self, nanoseconds: int, identifier: int, bus: int, payload: bytes) -> None:
        """Add a data frame; `identifier` has the flag `EXTENDED` where it has 29 bits."""
        self._nanoseconds.append(nanoseconds)
        self._identifiers.append(identifier)
        self._buses.append(bus)
        self._payloads.append(payload)

    def frames(self) -> Frames:
        """Return what was added."""
        length = np.array([len(payload) for payload in self._payloads], np.uint8)
        width = int(length.max(initial=0))
        filled = b"".join(payload.ljust(width, b"\0") for payload in self._payloads)
        return Frames(
            np.array(self._nanoseconds, np.int64),
            np.array(self._identifiers, np.uint32),
            np.array(self._buses, np.int64),
            length,
            np.frombuffer(filled, np.uint8).reshape(len(length), width),
            self.error_frames,
            self.remote_frames,
        )


class CanReader(Reader):
    """A format of CAN logs."""

    @abstractmethod
    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames of a log, in parts that fit in memory.

        Raises:
            FormatError: The log is damaged or not of this format; says at which line or byte.
        """

    def read(self, path: Path, *, dbc: Path | None = None) -> RawTable:
        """Read the log; see `Reader.read`."""
        if dbc is None:
            raise FormatError(
                "a CAN log needs a DBC file that describes its messages",
                where=str(path),
                remedy="name one with --dbc",
            )
        messages = read_dbc(dbc)
        known = np.array(list(messages), np.uint32)
        parts: list[Frames] = []
        identifiers: set[int] = set()
        count, start = 0, None
        for part in self.frames(path):
            if len(part):
                count += len(part)
                start = int(part.nanoseconds[0]) if start is None else start
                identifiers.update(np.unique(part.identifier).tolist())
            parts.append(part[np.isin(part.identifier, known)])
        if start is None:
            raise FormatError("no frame in the log", where=str(path), remedy="record it again")
        frames = Frames.joined(parts)
        if not len(frames):
            raise FormatError(
                f"the DBC {dbc.name} describes none of the log's messages",
                where=str(path),
                remedy=f"give the DBC of this bus: the log has {_identifiers(identifiers)}; "
                f"the DBC has {_identifiers(messages)}",
            )
        return CanTable(frames, messages, start=start, count=count, origin=str(path))


class CanTable(RawTable):
    """The signals of a log.

    A signal whose name several messages have is told apart as `Message.Signal`; that longer name
    may always be used.
    """

    def __init__(
        self,
        frames: Frames,
        messages: Mapping[int, Message],
        *,
        start: int,
        count: int,
        origin: str,
    ) -> None:
        self._frames = frames
        self._messages = messages
        self._start = start
        self.origin = origin
        self._present = set(np.unique(frames.identifier).tolist())
        self._places = _places(messages)
        self.notes = tuple(_log_notes(frames, start, count))

    @property
    def names(self) -> tuple[str, ...]:
        """Signals of the messages that are in the log."""
        found: list[str] = []
        for identifier, message in self._messages.items():
            if identifier in self._present:
                found += [
                    s.name if len(self._places[s.name]) == 1 else f"{message.name}.{s.name}"
                    for s in message.signals
                ]
        return tuple(found)

    def signals(self, names: Sequence[str]) -> list[RawSignal]:
        """Decode the named signals; each has the time stamps of its own frames."""
        return [self._signal(name) for name in names]

    def _signal(self, name: str) -> RawSignal:
        identifier, message, signal = self._place(name)
        rows = self._frames[self._frames.identifier == identifier]
        if not len(rows):
            raise ChannelError(
                f"signal '{name}' is in the DBC, but no frame of its message "
                f"{message.name} ({_identifiers([identifier])}) is in the log",
                where=self.origin,
                remedy=f"the log has: {listing(self.names)}",
            )
        if rows.bus.min() != rows.bus.max():
            buses = ", ".join(map(str, np.unique(rows.bus)))
            raise ChannelError(
                f"message {message.name} arrives on several buses ({buses})",
                where=self.origin,
                remedy="keep only the frames of one bus in the log",
            )
        notes: list[str] = []
        selectors = _selectors(message, signal)
        needed = max(byte_span(s)[1] for s in (signal, *selectors))
        if short := int(np.count_nonzero(rows.length < needed)):
            notes.append(f"{short} frames of {message.name} are too short for '{name}'")
            rows = rows[rows.length >= needed]
        for carried, selector in zip((signal, *selectors), selectors, strict=False):
            chosen = np.array(carried.multiplexer_ids or [], np.int64)
            rows = rows[np.isin(raw_values(selector, rows.payload), chosen)]
        rows, repeated = self._increasing(rows, message)
        if repeated:
            notes.append(
                f"{repeated} frames of {message.name} have the time stamp of the next: left out"
            )
        if len(rows) < 2:
            raise ChannelError(
                "; ".join([f"signal '{name}' has fewer than two values", *notes]),
                where=self.origin,
                remedy="leave it out, or record for longer",
            )
        return RawSignal(
            name,
            scaled_values(signal, rows.payload),
            (rows.nanoseconds - self._start) / 1e9,
            signal.unit or None,
            None if signal.is_float else abs(float(signal.conversion.scale)),
            tuple(notes),
        )

    def _increasing(self, rows: Frames, message: Message) -> tuple[Frames, int]:
        """Return the frames without those whose stamp repeats, and how many those were."""
        steps = np.diff(rows.nanoseconds)
        if np.any(steps < 0):
            k = int(np.argmax(steps < 0)) + 1
            before, after = (rows.nanoseconds[k - 1 : k + 1] - self._start) / 1e9
            raise TimeError(
                f"time goes back: {after:.9g} s follows {before:.9g} s",
                where=f"{self.origin}, message {message.name}, its frame {k + 1}",
                remedy="cut the log there: two recordings may have been put into one file",
            )
        last_of_stamp = np.append(steps > 0, True)[: len(rows)]
        return rows[last_of_stamp], int(np.count_nonzero(~last_of_stamp))

    def _place(self, name: str) -> tuple[int, Message, Signal]:
        message_name, dot, signal_name = name.rpartition(".")
        places = self._places.get(signal_name if dot else name, [])
        if dot:
            places = [place for place in places if place[1].name == message_name]
        if not places:
            raise self.missing(name, kind="signal")
        present = [place for place in places if place[0] in self._present] or places
        if len(present) > 1:
            longer = [f"{message.name}.{name}" for _, message, _ in present]
            raise ChannelError(
                f"signal '{name}' is in several messages",
                where=self.origin,
                remedy=f"write source as {' or '.join(longer)}",
            )
        return present[0]


def read_dbc(path: Path) -> dict[int, Message]:
    """Read a DBC file; return its messages by identifier, flagged `EXTENDED` for 29 bits.

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
    return {m.frame_id | (EXTENDED if m.is_extended_frame else 0): m for m in messages}


def _places(messages: Mapping[int, Message]) -> dict[str, list[tuple[int, Message, Signal]]]:
    places: dict[str, list[tuple[int, Message, Signal]]] = {}
    for identifier, message in messages.items():
        for signal in message.signals:
            places.setdefault(signal.name, []).append((identifier, message, signal))
    return places


def _selectors(message: Message, signal: Signal) -> list[Signal]:
    """Return the multiplexers that say whether a frame carries a signal, the nearest first."""
    if not signal.multiplexer_signal:
        return []
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    return [selector, *_selectors(message, selector)]


def _log_notes(frames: Frames, start: int, count: int) -> Iterator[str]:
    if start:
        yield f"time 0 is the log's first frame, stamped {start / 1e9:.6f} s"
    if others := count - len(frames):
        yield f"{others} of {count} frames are of messages that the DBC does not describe"
    if frames.error_frames:
        yield f"{frames.error_frames} error frames left out"
    if frames.remote_frames:
        yield f"{frames.remote_frames} remote frames left out"


def _identifiers(identifiers: Mapping[int, Message] | Sequence[int] | set[int]) -> str:
    return listing(
        [f"0x{i & ~EXTENDED:08X}" if i & EXTENDED else f"0x{i:03X}" for i in sorted(identifiers)],
        most=8,
    )
