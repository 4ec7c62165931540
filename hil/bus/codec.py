"""From values in a model's units to frames and back, with counters, checksums and statistics."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import can
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import DecodeError

from foundation.errors import BusError, DivergenceError, UnitError, UnknownNameError
from foundation.units import factor_and_offset
from hil.bus.dbc import Port, protection_of
from hil.bus.e2e import Checking, Counting, Status
from hil.bus.statistics import Statistics

_LATE = 1.5
"""Frames that come after more than so many periods are late."""


@dataclass(frozen=True)
class Field:
    """A variable in a message.

    Attributes:
        variable: Its name in the model.
        signal: Its name in the DBC.
        factor, offset: `variable = factor * signal + offset`, between their units.
        low, high: Between which the signal's bits can say it, in the signal's unit.
    """

    variable: str
    signal: str
    factor: float
    offset: float
    low: float
    high: float


@dataclass(frozen=True)
class Layout:
    """A message and the variables in it.

    Attributes:
        message: Of the DBC.
        fields: The variables.
        period: After which the message is sent again [s]; None where the DBC does not say.
    """

    message: Message
    fields: tuple[Field, ...]
    period: float | None


def layouts(
    database: Database,
    ports: Sequence[Port],
    *,
    signals: Mapping[str, str] | None = None,
    where: str = "",
) -> list[Layout]:
    """Return the messages that carry some variables.

    Args:
        database: Of the bus.
        ports: The variables, with their units in the model.
        signals: Variable → signal, where they are not called the same.
        where: The DBC file, for messages.

    Raises:
        UnknownNameError: A variable has no signal in the DBC.
        BusError: A signal is in several messages, or multiplexed.
        UnitError: A signal's unit does not fit the variable's.
    """
    names = dict(signals or {})
    places: dict[str, list[tuple[Message, Signal]]] = {}
    for message in database.messages:
        for signal in message.signals:
            places.setdefault(signal.name, []).append((message, signal))
    found: dict[str, tuple[Message, list[Field]]] = {}
    for port in ports:
        name = names.get(port.name, port.name)
        if name not in places:
            raise UnknownNameError("signal", name, places, where=f"{where}, for '{port.name}'")
        if len(places[name]) > 1:
            several = ", ".join(message.name for message, _ in places[name])
            raise BusError(
                f"the signal '{name}' is in several messages: {several}",
                where=where,
                remedy="rename it in the DBC",
            )
        message, signal = places[name][0]
        if signal.multiplexer_signal:
            raise BusError(
                f"the signal '{name}' is multiplexed",
                where=f"{where}, message {message.name}",
                remedy="give it a message of its own",
            )
        found.setdefault(message.name, (message, []))[1].append(_field(port, message, signal))
    return [
        Layout(message, tuple(fields), message.cycle_time / 1e3 if message.cycle_time else None)
        for message, fields in found.values()
    ]


def _field(port: Port, message: Message, signal: Signal) -> Field:
    where = f"message {message.name}, signal {signal.name}"
    factor, offset = 1.0, 0.0
    if signal.unit and port.unit:
        try:
            factor, offset = factor_and_offset(signal.unit, port.unit, where=where)
        except UnitError as error:
            raise UnitError(
                f"{error.what} of the variable '{port.name}'",
                where=where,
                remedy="correct the signal's unit in the DBC, or choose another signal",
            ) from error
    raw = (1 << signal.length) - 1
    lowest, highest = (-(raw + 1) // 2, raw // 2) if signal.is_signed else (0, raw)
    ends = [signal.conversion.scale * r + signal.conversion.offset for r in (lowest, highest)]
    low, high = (-math.inf, math.inf) if signal.is_float else (min(ends), max(ends))
    return Field(port.name, signal.name, factor, offset, low, high)


class Packer:
    """Makes frames of one message; counts and protects them.

    Attributes:
        layout: The message.
        clipped: How many values did not fit into their signal.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.clipped = 0
        protection = protection_of(layout.message)
        self._counting = None if protection is None else Counting(protection)
        self._blank = {signal.name: 0.0 for signal in layout.message.signals}

    def pack(self, values: Mapping[str, float], *, time: float = 0.0) -> can.Message:
        """Return the next frame.

        Args:
            values: Of the variables, in the model's units; those of other messages do not matter.
            time: Stamp [s].

        Raises:
            DivergenceError: A value is not finite.
        """
        signals = dict(self._blank)
        for f in self.layout.fields:
            value = (values[f.variable] - f.offset) / f.factor
            if not math.isfinite(value):
                raise DivergenceError(
                    f"'{f.variable}' is {value}, which no frame can carry",
                    where=f"message {self.layout.message.name} at {time:g} s",
                    remedy="check the plant's parameters and the controller's gains",
                )
            if not f.low <= value <= f.high:
                self.clipped += 1
                value = min(max(value, f.low), f.high)
            signals[f.signal] = value
        message = self.layout.message
        payload = bytearray(message.encode(signals, strict=False))
        if self._counting is not None:
            self._counting.protect(payload)
        return can.Message(
            timestamp=time,
            arbitration_id=message.frame_id,
            is_extended_id=message.is_extended_frame,
            data=payload,
            is_fd=message.is_fd,
        )


@dataclass(frozen=True)
class Reading:
    """What a frame said.

    Attributes:
        message: Name in the DBC.
        values: Variable → value in the model's unit; empty if the frame is not to be believed.
        status: Of its end-to-end protection; OK where there is none.
        time: Of the frame [s].
    """

    message: str
    values: Mapping[str, float]
    status: Status
    time: float


@dataclass
class Unpacker:
    """Takes the values out of frames; frames that are damaged, doubled or old are only counted.

    Attributes:
        layouts: The messages that are wanted.
        statistics: Counts what came.
        period: Of all these messages [s], where it is not that of the DBC.

    Example:
        >>> from hil.bus.dbc import Port, parse_dbc, plant_dbc
        >>> ports = [Port("theta", "rad")]
        >>> (layout,) = layouts(parse_dbc(plant_dbc([], ports)), ports)
        >>> packer, unpacker = Packer(layout), Unpacker([layout])
        >>> frame = packer.pack({"theta": 0.5})
        >>> unpacker.unpack(frame).values
        {'theta': 0.5}
        >>> frame.data[3] ^= 1
        >>> unpacker.unpack(frame).status.value, unpacker.statistics.wrong_checksum
        ('wrong checksum', 1)
    """

    layouts: Sequence[Layout]
    statistics: Statistics = field(default_factory=Statistics)
    period: float | None = None

    def __post_init__(self) -> None:
        self._by_id = {
            (layout.message.frame_id, layout.message.is_extended_frame): (
                layout,
                None if (p := protection_of(layout.message)) is None else Checking(p),
            )
            for layout in self.layouts
        }
        self._came: dict[str, float] = {}
        self._known: Collection[tuple[int, bool]] = set(self._by_id)

    def know(self, messages: Iterable[Message]) -> None:
        """Take frames of these messages for known, though nothing of them is wanted."""
        self._known = {*self._known, *((m.frame_id, m.is_extended_frame) for m in messages)}

    def unpack(self, frame: can.Message, time: float | None = None) -> Reading | None:
        """Return what a frame says; None: it carries no variable that is wanted.

        Args:
            frame: As it came.
            time: When [s]; None: by its stamp.
        """
        time = frame.timestamp if time is None else time
        counts = self.statistics
        if frame.is_error_frame:
            counts.error_frames += 1
            return None
        counts.received += 1
        key = (frame.arbitration_id, frame.is_extended_id)
        entry = self._by_id.get(key)
        if entry is None or frame.is_remote_frame:
            counts.unknown += key not in self._known
            return None
        layout, checking = entry
        name = layout.message.name
        if len(frame.data) < layout.message.length:
            counts.too_short += 1
            return Reading(name, {}, Status.WRONG_CHECKSUM, time)
        status = Status.OK
        if checking is not None:
            before = checking.lost
            status = checking.check(frame.data)
            counts.note(status, checking.lost - before)
            if not status.is_good:
                return Reading(name, {}, status, time)
        # After a frame that is known to be lost the next one is not late.
        period = self.period or layout.period
        last = self._came.get(name)
        if period and last is not None and status is Status.OK:
            counts.late += time - last > _LATE * period + 1e-9
        self._came[name] = time
        try:
            decoded = layout.message.decode(bytes(frame.data), decode_choices=False)
        except (DecodeError, ValueError):
            counts.too_short += 1
            return Reading(name, {}, Status.WRONG_CHECKSUM, time)
        raw = cast("dict[str, float]", decoded)  # numbers: no named values were asked for
        values = {f.variable: f.factor * raw[f.signal] + f.offset for f in layout.fields}
        return Reading(name, values, status, time)
