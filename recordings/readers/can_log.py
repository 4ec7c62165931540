"""CAN logs: frames sorted by message as they are read, and signals taken out of them by a DBC.

A format only turns its file into `Frames` (`CanReader.frames`), part by part; of each part only
the frames are kept that carry a wanted signal, at 20 bytes a frame of up to 8 bytes of payload.
What a log needs of memory is what is asked of it, not its length.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import NDArray

from foundation.errors import ChannelError, FormatError, TimeError
from recordings.names import listing
from recordings.readers import dbc as database
from recordings.readers.base import EVERYTHING, RawSignal, RawTable, Reader, Request, Scope
from recordings.readers.can_bits import byte_span, raw_values, scaled
from recordings.readers.can_frames import WORD, Frames
from recordings.readers.dbc import Messages, identifier_listing, places, read_dbc


class CanReader(Reader):
    """A format of CAN logs."""

    @abstractmethod
    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames of a log, in parts that fit in memory.

        Raises:
            FormatError: The log is damaged or not of this format; says at which line or byte.
        """

    def read(self, path: Path, *, dbc: Path | None = None, scope: Scope = EVERYTHING) -> RawTable:
        """Read the log; see `Reader.read`."""
        if dbc is None:
            raise FormatError(
                "a CAN log needs a DBC file that describes its messages",
                where=str(path),
                remedy="name one with --dbc",
            )
        return table_of(self.frames(path), dbc, scope, str(path))


def table_of(parts: Iterator[Frames], dbc: Path, scope: Scope, origin: str) -> CanTable:
    """Read a log's frames through and return its signals.

    Args:
        parts: The frames, in the order of the log.
        dbc: Describes the messages.
        scope: What is kept of them.
        origin: The file, for messages.

    Raises:
        FormatError: There is no frame, or none that the DBC describes; or as the parts.
    """
    messages = read_dbc(dbc)
    log = _Log(messages, scope)
    for part in parts:
        log.add(part)
    if log.start is None:
        raise FormatError("no frame in the log", where=origin, remedy="record it again")
    if not log.present:
        own = [database.identifier(m) for m in messages.messages]
        raise FormatError(
            f"the DBC {dbc.name} describes none of the log's messages",
            where=origin,
            remedy=f"give the DBC of this bus: the log has {identifier_listing(log.strangers)}; "
            f"the DBC has {identifier_listing(own)}",
        )
    return CanTable(log, origin)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Frames of one message, as columns of n; see `Frames`. Addresses are those of J1939."""

    nanoseconds: NDArray[np.int64]
    bus: NDArray[np.int16]
    address: NDArray[np.uint8]
    length: NDArray[np.uint8]
    payload: NDArray[np.uint8]

    def __len__(self) -> int:
        return self.nanoseconds.size

    def __getitem__(self, rows: NDArray[np.bool_] | slice) -> _Rows:
        return _Rows(
            self.nanoseconds[rows],
            self.bus[rows],
            self.address[rows],
            self.length[rows],
            self.payload[rows],
        )


@dataclass
class _Log:
    """What is kept of a log while it is read.

    Attributes:
        messages: Those of the DBC.
        scope: What is wanted.
        start: Stamp of the first frame, ns.
        count: How many data frames there are.
        described: How many of them the DBC describes.
        present: Numbers of the messages that are in the log.
        strangers: Identifiers, as long as the DBC describes none.
        bus_names: By number; empty if the log has numbers only.
        error_frames: How many were left out.
        remote_frames: How many were left out.
        passed_over: How many lines of the log are no frames.
    """

    messages: Messages
    scope: Scope
    start: int | None = None
    count: int = 0
    described: int = 0
    present: set[int] = field(default_factory=set[int])
    strangers: set[int] = field(default_factory=set[int])
    bus_names: tuple[str, ...] = ()
    error_frames: int = 0
    remote_frames: int = 0
    passed_over: int = 0
    _parts: dict[int, list[_Rows]] = field(default_factory=dict[int, list[_Rows]])

    def __post_init__(self) -> None:
        self._wanted = np.array([self._is_wanted(m) for m in self.messages.messages])
        # Multiplexed pages and long payloads: bytes beyond the last signal's are not kept.
        self._width = [
            max([WORD, *(byte_span(s)[1] for s in m.signals)]) for m in self.messages.messages
        ]

    def _is_wanted(self, message: Message) -> bool:
        names = self.scope.names
        return names is None or any(
            s.name in names or f"{message.name}.{s.name}" in names for s in message.signals
        )

    def add(self, part: Frames) -> None:
        """Keep what is wanted of the log's next frames."""
        self.error_frames += part.error_frames
        self.remote_frames += part.remote_frames
        self.passed_over += part.passed_over
        self.bus_names = tuple(part.bus_names)
        if not len(part):
            return
        if self.start is None:
            self.start = int(part.nanoseconds[0])
        self.count += len(part)
        number = self.messages.numbers(part.identifier)
        known = np.flatnonzero(number >= 0)
        self.described += known.size
        self.present.update(np.flatnonzero(np.bincount(number[known])).tolist())
        if not self.present:
            self.strangers.update(np.unique(part.identifier).tolist())
        rows = known[self._wanted[number[known]]]
        if self.scope.bounded:
            time = (part.nanoseconds[rows] - self.start) / 1e9
            rows = rows[(time >= self.scope.start) & (time <= self.scope.stop)]
        # Small numbers are sorted by radix, and a stable order is that of the log.
        if not rows.size:
            return
        rows = rows[np.argsort(number[rows].astype(np.int16), kind="stable")]
        ordered = number[rows]
        first = np.flatnonzero(np.diff(ordered, prepend=-1))
        for begin, end in zip(first, [*first[1:], rows.size], strict=True):
            which = int(ordered[begin])
            of_message = rows[begin:end]
            self._parts.setdefault(which, []).append(
                _Rows(
                    part.nanoseconds[of_message],
                    part.bus[of_message].astype(np.int16),
                    part.identifier[of_message].astype(np.uint8),
                    part.length[of_message],
                    part.payload[of_message, : self._width[which]],
                )
            )

    def rows(self, number: int) -> _Rows:
        """Return all frames of a message that were kept."""
        parts = self._parts.get(number, [])
        if len(parts) != 1:
            width = max([WORD, *(part.payload.shape[1] for part in parts)])
            parts = [
                _Rows(
                    np.concatenate([_NO_ROWS.nanoseconds, *(p.nanoseconds for p in parts)]),
                    np.concatenate([_NO_ROWS.bus, *(p.bus for p in parts)]),
                    np.concatenate([_NO_ROWS.address, *(p.address for p in parts)]),
                    np.concatenate([_NO_ROWS.length, *(p.length for p in parts)]),
                    np.concatenate([np.zeros((0, width), np.uint8), *_padded(parts, width)]),
                )
            ]
            self._parts[number] = parts
        return parts[0]

    def bus_name(self, number: int) -> str:
        """Return what the log, and the channel map, call a bus."""
        return self.bus_names[number] if self.bus_names else str(number)

    def notes(self) -> Iterator[str]:
        """Yield what was left out."""
        if self.start:
            yield f"time 0 is the log's first frame, stamped {self.start / 1e9:.6f} s"
        if others := self.count - self.described:
            yield f"{others} of {self.count} frames are of messages that the DBC does not describe"
        if self.error_frames:
            yield f"{self.error_frames} error frames left out"
        if self.remote_frames:
            yield f"{self.remote_frames} remote frames left out"
        if self.passed_over:
            yield f"{self.passed_over} lines of the log are no frames"


_NO_ROWS = _Rows(
    np.zeros(0, np.int64),
    np.zeros(0, np.int16),
    np.zeros(0, np.uint8),
    np.zeros(0, np.uint8),
    np.zeros((0, WORD), np.uint8),
)


def _padded(parts: Sequence[_Rows], width: int) -> list[NDArray[np.uint8]]:
    return [
        part.payload
        if part.payload.shape[1] == width
        else np.pad(part.payload, ((0, 0), (0, width - part.payload.shape[1])))
        for part in parts
    ]


@dataclass(frozen=True, eq=False)
class _Sent:
    """The frames of one message from one sender.

    Attributes:
        all_rows: As they are in the log.
        rows: Those of increasing time.
        time: Their times, s, shape (n,).
        shortest: Bytes of the shortest payload.
        notes: What was left out.
    """

    all_rows: _Rows
    rows: _Rows
    time: NDArray[np.float64]
    shortest: int
    notes: list[str]


def _carrying(rows: _Rows, message: Message, signal: Signal, name: str) -> tuple[_Rows, list[str]]:
    """Return the frames that carry a signal, and what was left out."""
    notes: list[str] = []
    multiplexers = database.selectors(message, signal)
    needed = max(byte_span(s)[1] for s in (signal, *multiplexers))
    if short := int(np.count_nonzero(rows.length < needed)):
        notes.append(f"{short} frames of {message.name} are too short for '{name}'")
        rows = rows[rows.length >= needed]
    for carried, selector in zip((signal, *multiplexers), multiplexers, strict=False):
        chosen = np.array(carried.multiplexer_ids or [], np.int64)
        rows = rows[np.isin(raw_values(selector, rows.payload), chosen)]
    return rows, notes


class CanTable(RawTable):
    """The signals of a log.

    A signal whose name several messages have is told apart as `Message.Signal`; that longer name
    may always be used.
    """

    uses_dbc = True

    def __init__(self, log: _Log, origin: str) -> None:
        self._log = log
        self._start = log.start or 0
        self.origin = origin
        self._messages = log.messages.messages
        self._places = places(self._messages)
        self._sent_frames: dict[tuple[int, str | None, int | None], _Sent] = {}
        self.notes = tuple(log.notes())

    @property
    def names(self) -> tuple[str, ...]:
        """Signals of the messages that are in the log."""
        found: list[str] = []
        for number in sorted(self._log.present):
            message = self._messages[number]
            found += [
                s.name if len(self._places[s.name]) == 1 else f"{message.name}.{s.name}"
                for s in message.signals
            ]
        return tuple(found)

    def signals(self, requests: Sequence[Request]) -> list[RawSignal]:
        """Decode the requested signals; each has the time stamps of its own frames."""
        return [self._signal(request) for request in requests]

    def _signal(self, request: Request) -> RawSignal:
        name = request.name
        number, message, signal = self._place(name)
        if number not in self._log.present:
            raise ChannelError(
                f"signal '{name}' is in the DBC, but no frame of its message {message.name} "
                f"({identifier_listing([database.identifier(message)])}) is in the log",
                where=self.origin,
                remedy=f"the log has: {listing(self.names)}",
            )
        sent = self._sent(number, message, request)
        rows, time, notes = sent.rows, sent.time, list(sent.notes)
        multiplexers = database.selectors(message, signal)
        needed = max(byte_span(s)[1] for s in (signal, *multiplexers))
        if multiplexers or sent.shortest < needed:
            rows, more = _carrying(sent.all_rows, message, signal, name)
            rows, time, repeated = self._in_time(rows, message)
            notes = [*more, *repeated]
        raw = raw_values(signal, rows.payload)
        if (there := database.available(message, signal, raw)) is not None:
            notes.append(f"{np.count_nonzero(~there)} values of '{name}' say that there is none")
            time, raw = time[there], raw[there]
        if time.size < 2:
            raise ChannelError(
                "; ".join([f"signal '{name}' has fewer than two values", *notes]),
                where=self.origin,
                remedy="leave it out, or record for longer",
            )
        return RawSignal(
            name,
            scaled(signal, raw),
            time,
            signal.unit or None,
            None if signal.is_float else abs(float(signal.conversion.scale)),
            database.is_state(signal),
            tuple(notes),
        )

    def _sent(self, number: int, message: Message, request: Request) -> _Sent:
        """Return a message's frames in increasing time; its signals share them."""
        key = (number, request.bus, request.address)
        if key not in self._sent_frames:
            all_rows = self._from_one_sender(self._log.rows(number), message, request)
            rows, time, notes = self._in_time(all_rows, message)
            shortest = int(rows.length.min(initial=255))
            self._sent_frames[key] = _Sent(all_rows, rows, time, shortest, notes)
        return self._sent_frames[key]

    def _in_time(
        self, rows: _Rows, message: Message
    ) -> tuple[_Rows, NDArray[np.float64], list[str]]:
        """Return frames without those whose stamp repeats, their times, and what was left out."""
        steps = np.diff(rows.nanoseconds)
        least = int(steps.min(initial=1))
        if least < 0:
            k = int(np.argmax(steps < 0)) + 1
            before, after = (rows.nanoseconds[k - 1 : k + 1] - self._start) / 1e9
            raise TimeError(
                f"time goes back: {after:.9g} s follows {before:.9g} s",
                where=f"{self.origin}, message {message.name}, its frame {k + 1}",
                remedy="cut the log there: two recordings may have been put into one file",
            )
        notes: list[str] = []
        if least == 0:
            repeated = int(np.count_nonzero(steps == 0))
            notes.append(
                f"{repeated} frames of {message.name} have the time stamp of the next: left out"
            )
            rows = rows[np.append(steps > 0, True)]
        return rows, (rows.nanoseconds - self._start) / 1e9, notes

    def _from_one_sender(self, rows: _Rows, message: Message, request: Request) -> _Rows:
        """Return the frames of the bus and the sender that are asked for, or of the only one."""
        if not len(rows):
            return rows
        numbers = [rows.bus[0]] if rows.bus.min() == rows.bus.max() else np.unique(rows.bus)
        buses = dict(sorted((self._log.bus_name(int(bus)), int(bus)) for bus in numbers))
        if request.bus is not None:
            if request.bus not in buses:
                raise self._not_there(message, f"on bus {request.bus}", "bus", list(buses))
            rows = rows[rows.bus == buses[request.bus]]
        elif len(buses) > 1:
            raise ChannelError(
                f"message {message.name} arrives on several buses ({', '.join(buses)})",
                where=self.origin,
                remedy=f'choose one in the channel map: bus = "{next(iter(buses))}"',
            )
        if not database.is_j1939(message):
            return rows
        addresses = [int(address) for address in np.unique(rows.address)]
        if request.address is not None:
            if request.address not in addresses:
                what = f"from address {request.address}"
                raise self._not_there(message, what, "address", [str(a) for a in addresses])
            return rows[rows.address == request.address]
        if len(addresses) > 1:
            raise ChannelError(
                f"message {message.name} comes from several addresses "
                f"({', '.join(map(str, addresses))})",
                where=self.origin,
                remedy=f"choose one in the channel map: address = {addresses[0]}",
            )
        return rows

    def _not_there(self, message: Message, what: str, key: str, there: list[str]) -> ChannelError:
        return ChannelError(
            f"no frame of message {message.name} is {what}",
            where=self.origin,
            remedy=f"correct {key} in the channel map; there are: {listing(there)}",
        )

    def _place(self, name: str) -> tuple[int, Message, Signal]:
        message_name, dot, signal_name = name.rpartition(".")
        found = self._places.get(signal_name if dot else name, [])
        if dot:
            found = [place for place in found if place[1].name == message_name]
        if not found:
            raise self.missing(name, kind="signal")
        present = [place for place in found if place[0] in self._log.present] or found
        if len(present) > 1:
            longer = [f"{message.name}.{name}" for _, message, _ in present]
            raise ChannelError(
                f"signal '{name}' is in several messages",
                where=self.origin,
                remedy=f"write source as {' or '.join(longer)}",
            )
        return present[0]
