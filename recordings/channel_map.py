"""Channel maps: which column or CAN signal is which variable of the model, as TOML.

[channels.theta_p]        # a variable of the model
source = "Pitch"          # column or signal; the variable's own name where left out
unit = "deg"              # of the source; the file's own, else the model's, where left out
factor = -1               # the source, in the model's unit, times this: a sign, counts to radians
offset = 0.02             # added after that, in the model's unit: where the sensor's zero is
kind = "measured"         # between samples: measured (straight lines), command (holds until the
                          # next), state (holds, never averaged); command where it is an input
sd = 8.7e-3               # noise, resolution, delay: SI units of the model's variable; a signal
resolution = 1.7e-4       # is read earlier by its delay
delay = 0.002
bus = "can1"              # where a CAN message is on several buses: name or number in the log
address = 0x21            # where several units send a J1939 message: the sender's address

[time]                    # only where time is not a column `time` in seconds
source = "t"
unit = "ms"
step = 0.001              # instead of `source`: equal steps in s, starting at 0; where signals have
                          # stamps of their own (CAN, MDF): the step of the grid they are put on
clock = "software"        # stamps were taken late by a busy computer: periodic messages are put
                          # back on their even beat; "hardware": taken as they are
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

from foundation.errors import ChannelError, FormatError, RecordingError
from recordings.names import suggestion
from recordings.recording import Sensor
from recordings.resample import Kind

T = TypeVar("T")
_CHANNEL_KEYS = (
    "source",
    "unit",
    "factor",
    "offset",
    "kind",
    "sd",
    "resolution",
    "delay",
    "bus",
    "address",
)


@dataclass(frozen=True)
class ChannelSource:
    """Where a variable's values are found, and what is known of their sensor.

    Attributes:
        source: Column or signal; None: it has the variable's own name.
        unit: Unit of the source's numbers; None: what the file says, else the model's unit.
        sensor: In the SI unit of the model's variable.
        factor: Multiplies the source's numbers once they are in the model's unit; None: 1.
        offset: Added after that, in the model's unit; None: 0.
        kind: What happens between samples; None: by what the variable and the file are.
        bus: Where a CAN message is on several buses: name or number in the log.
        address: Where several units send a J1939 message: the sender's.
    """

    source: str | None = None
    unit: str | None = None
    sensor: Sensor = field(default_factory=Sensor)
    factor: float | None = None
    offset: float | None = None
    kind: Kind | None = None
    bus: str | None = None
    address: int | None = None

    def updated(self, other: ChannelSource) -> ChannelSource:
        """Return this with what `other` says in place of it."""
        mine, new = self.sensor, other.sensor
        return ChannelSource(
            _later(self.source, other.source),
            _later(self.unit, other.unit),
            Sensor(
                _later(mine.sd, new.sd),
                _later(mine.resolution, new.resolution),
                new.delay or mine.delay,
            ),
            _later(self.factor, other.factor),
            _later(self.offset, other.offset),
            _later(self.kind, other.kind),
            _later(self.bus, other.bus),
            _later(self.address, other.address),
        )


def _later(first: T | None, second: T | None) -> T | None:
    return first if second is None else second


@dataclass(frozen=True)
class TimeSource:
    """Where time is found: a column, or equal steps where nobody wrote it down.

    Attributes:
        source: Column.
        unit: Unit of the column.
        step: Where there is no such column: step in s. Where signals have time stamps of their own:
            that of the grid they are put on.
        software_clock: Stamps were taken late, by software; see `recordings.clock`.
    """

    source: str = "time"
    unit: str = "s"
    step: float | None = None
    software_clock: bool = False


@dataclass(frozen=True)
class ChannelMap:
    """A channel map; one that says nothing by default.

    Attributes:
        channels: By name of the model's variable.
        time: Where time is found.
        origin: The file, for messages.
    """

    channels: Mapping[str, ChannelSource] = field(default_factory=dict[str, ChannelSource])
    time: TimeSource = field(default_factory=TimeSource)
    origin: str = "no channel map"

    def updated(self, other: ChannelMap) -> ChannelMap:
        """Return this map with what `other` says added to it, or in place of it."""
        channels = dict(self.channels)
        for name, source in other.channels.items():
            channels[name] = channels.get(name, ChannelSource()).updated(source)
        time = self.time if other.time == TimeSource() else other.time
        return ChannelMap(channels, time, other.origin)


def read_map(path: Path) -> ChannelMap:
    """Read a channel map.

    Raises:
        RecordingError: There is no such file.
        FormatError: It is not TOML; says at which line.
        ChannelError: A key is unknown or its value is of the wrong kind; says in which table.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(
            f"the channel map is not text: {error.reason} at byte {error.start}",
            where=str(path),
            remedy="save it as UTF-8",
        ) from error
    except OSError as error:
        raise RecordingError(
            f"the channel map cannot be read: {error.strerror}",
            where=str(path),
            remedy="correct --map",
        ) from error
    return parse_map(text, origin=str(path))


def parse_map(text: str, *, origin: str = "channel map") -> ChannelMap:
    """Parse the text of a channel map; errors as in `read_map`.

    Example:
        >>> parse_map('[channels.q]\\nsource = "qm"\\nunit = "mm"').channels["q"].source
        'qm'
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(
            f"the channel map is not TOML: {error}",
            where=origin,
            remedy='write tables such as [channels.q] with source = "qm"',
        ) from error
    _check_keys(document, ("channels", "time"), "table", origin)
    tables = _table(document.get("channels", {}), "channels", origin)
    channels = {
        name: _channel(name, _table(entry, f"channels.{name}", origin), origin)
        for name, entry in tables.items()
    }
    time = _time(_table(document.get("time", {}), "time", origin), origin)
    return ChannelMap(channels, time, origin)


def _channel(name: str, entry: Mapping[str, Any], origin: str) -> ChannelSource:
    where = f"{origin}, [channels.{name}]"
    _check_keys(entry, _CHANNEL_KEYS, "key", where)
    factor = _number(entry, "factor", where, signed=True)
    if factor == 0:
        raise ChannelError("'factor' is 0", where=where, remedy="leave the channel out instead")
    bus = entry.get("bus")
    address = _number(entry, "address", where)
    if address is not None and address not in range(256):
        raise ChannelError(
            f"'address' is {entry['address']}", where=where, remedy="J1939 has 0 to 253"
        )
    kind = _choice(entry, "kind", [kind.value for kind in Kind], where)
    return ChannelSource(
        source=_text(entry, "source", where),
        unit=_text(entry, "unit", where),
        sensor=Sensor(
            sd=_number(entry, "sd", where),
            resolution=_number(entry, "resolution", where),
            delay=_number(entry, "delay", where) or 0.0,
        ),
        factor=factor,
        offset=_number(entry, "offset", where, signed=True),
        kind=None if kind is None else Kind(kind),
        bus=str(bus) if type(bus) is int else _text(entry, "bus", where),
        address=None if address is None else int(address),
    )


def _time(entry: Mapping[str, Any], origin: str) -> TimeSource:
    where = f"{origin}, [time]"
    _check_keys(entry, ("source", "unit", "step", "clock"), "key", where)
    step = _number(entry, "step", where)
    if step is not None and ("source" in entry or "unit" in entry or step == 0):
        raise ChannelError(
            "'step' is for data without a time column",
            where=where,
            remedy="give either a step in s above 0, or the column's source and unit",
        )
    return TimeSource(
        _text(entry, "source", where) or "time",
        _text(entry, "unit", where) or "s",
        step,
        _choice(entry, "clock", ["hardware", "software"], where) == "software",
    )


def _choice(entry: Mapping[str, Any], key: str, known: Sequence[str], where: str) -> str | None:
    value = _text(entry, key, where)
    if value is not None and value not in known:
        raise ChannelError(
            f"'{key}' is '{value}'", where=where, remedy=f"write one of: {', '.join(known)}"
        )
    return value


def _check_keys(table: Mapping[str, Any], known: Iterable[str], kind: str, where: str) -> None:
    for key in table:
        if key not in known:
            raise ChannelError(
                f"unknown {kind} '{key}'", where=where, remedy=suggestion(kind, key, known)
            )


def _table(value: object, name: str, origin: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ChannelError(
            f"'{name}' is not a table", where=origin, remedy="write [channels.<model variable>]"
        )
    return cast("dict[str, Any]", value)


def _text(entry: Mapping[str, Any], key: str, where: str) -> str | None:
    value = entry.get(key)
    if value is not None and not isinstance(value, str):
        raise ChannelError(f"'{key}' is not a text", where=where, remedy="put it in quotes")
    return value


def _number(
    entry: Mapping[str, Any], key: str, where: str, *, signed: bool = False
) -> float | None:
    value = entry.get(key)
    if value is None:
        return None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or (value < 0 and not signed):
        sign = "" if signed else ", not negative"
        raise ChannelError(
            f"'{key}' is {value!r}",
            where=where,
            remedy=f"give a finite number{sign}, in the SI unit of the model's variable",
        )
    return float(value)
