"""Values out of frames, a batch at a time; what is damaged, doubled or old is only counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from foundation.resumable import Resumable
from hil.bus.codec import Layout
from hil.bus.dbc import protection_of
from hil.bus.e2e import Checking, Status
from hil.bus.statistics import Statistics
from recordings.readers.can_bits import scaled_values
from recordings.readers.can_frames import EXTENDED, Frames

Nanoseconds = NDArray[np.int64]
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Decoded:
    """What a batch of frames says.

    Attributes:
        variables: Variable → (stamps [ns], values in the model's unit), in order of the stamps.
        messages: Message → stamps of its first and its last good frame [ns]; of those that came.
    """

    variables: dict[str, tuple[Nanoseconds, Values]] = field(
        default_factory=dict[str, tuple[Nanoseconds, Values]]
    )
    messages: dict[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])


class _Wanted(Resumable):
    """One message: its identifier, its protection, its fields."""

    _changes = (
        "last",
        "checking",
    )

    def __init__(self, layout: Layout, bus: int) -> None:
        message = layout.message
        self.layout, self.bus = layout, bus
        self.identifier = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        protection = protection_of(message)
        self.checking = None if protection is None else Checking(protection)
        self.signals = [(f, message.get_signal_by_name(f.signal)) for f in layout.fields]
        self.last = -1


class Decoder(Resumable):
    """Takes the variables out of frames of one or several buses.

    Args:
        buses: The wanted messages of each bus, by its number.

    Attributes:
        statistics: Counts what came.
        stale: Frames refused because their stamps are not later than those before.

    Example:
        >>> import can
        >>> from hil.bus.codec import Packer, layouts
        >>> from hil.bus.dbc import Port, parse_dbc, plant_dbc
        >>> from twin.ingest.receiver import columns
        >>> ports = [Port("theta", "rad")]
        >>> (layout,) = layouts(parse_dbc(plant_dbc([], ports)), ports)
        >>> frame = Packer(layout).pack({"theta": 0.5}, time=1.0)
        >>> decoder = Decoder([[layout]])
        >>> decoder.decode(columns([frame])).variables["theta"][1].tolist()
        [0.5]
        >>> decoder.decode(columns([frame])).variables, decoder.statistics.repeated
        ({}, 1)
    """

    _changes = (
        "statistics",
        "stale",
        "_wanted",
    )

    def __init__(self, buses: Sequence[Sequence[Layout]]) -> None:
        self.statistics = Statistics()
        self.stale = 0
        self._wanted = [_Wanted(layout, bus) for bus, found in enumerate(buses) for layout in found]

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the wanted messages."""
        return tuple(w.layout.message.name for w in self._wanted)

    def restart(self) -> None:
        """Take stamps of any time again: the clock was set."""
        for wanted in self._wanted:
            wanted.last = -1

    def decode(self, frames: Frames) -> Decoded:
        """Return what the frames say; the checks go on from the batch before."""
        found = Decoded()
        self.statistics.received += len(frames)
        self.statistics.error_frames += frames.error_frames
        for wanted in self._wanted:
            rows = np.flatnonzero(
                (frames.identifier == wanted.identifier) & (frames.bus == wanted.bus)
            )
            if rows.size:
                self._take(wanted, frames, rows, found)
        return found

    def _take(
        self, wanted: _Wanted, frames: Frames, rows: NDArray[np.intp], found: Decoded
    ) -> None:
        message = wanted.layout.message
        long_enough = frames.length[rows] >= message.length
        self.statistics.too_short += int(np.sum(~long_enough))
        rows = rows[long_enough]
        if wanted.checking is not None:
            rows = rows[self._checked(wanted.checking, frames, rows)]
        stamps = frames.nanoseconds[rows]
        before = np.maximum.accumulate(np.concatenate([[wanted.last], stamps]))[:-1]
        later = stamps > before
        self.stale += int(np.sum(~later))
        rows, stamps = rows[later], stamps[later]
        if not rows.size:
            return
        wanted.last = int(stamps[-1])
        found.messages[message.name] = int(stamps[0]), wanted.last
        payload = frames.payload[rows]
        for f, signal in wanted.signals:
            values = f.factor * scaled_values(signal, payload) + f.offset
            found.variables[f.variable] = (stamps, values)

    def _checked(
        self, checking: Checking, frames: Frames, rows: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        good = np.empty(rows.size, dtype=bool)
        width = frames.payload.shape[1]
        content = np.ascontiguousarray(frames.payload[rows]).tobytes()
        for k, length in enumerate(frames.length[rows].tolist()):
            before = checking.lost
            status = checking.check(content[k * width : k * width + length])
            good[k] = status is Status.OK or status.is_good
            if status is not Status.OK:
                self.statistics.note(status, checking.lost - before)
        return good
