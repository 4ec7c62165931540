"""When frames were sent, where a bus only says when they were read.

A serial adapter does not stamp frames; they are stamped when the process comes to read them, and on
a busy machine that is late, several at once, and looks like another plant. A frame that is sent
periodically arrives at

    t_k = t_0 + k T + d_k,    d_k >= 0,

and those that were read without delay lie on a line below all others: the lower envelope tells the
sender's clock, as minimum-delay filters do for packets of NTP (the line below all points that is
nearest to them is an edge of their lower convex hull: Zhang, Liu, Xia, "Clock synchronization
algorithms for network measurements", INFOCOM 2002). Late frames are given that line's time; frames
that are in time keep their own, so that on an idle machine nothing changes. `recordings.clock` does
it for a whole recording at once, and finds no beat where a third of the frames or more is late.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.readers.can_frames import Frames

Stamps = NDArray[np.int64]

_WINDOW, _SPAN = 64, 500_000_000
"""Frames of a message, and time [ns], between two looks at its clock, at least."""
_PROMPT = 200_000
"""A process that nothing holds up has a frame within this [ns]."""
_NEAR, _WIDEST = 0.05, 0.2
"""Of a period: so much is in time for any sender, and no more for one that is quick."""
_IN_TIME = 0.15
"""Share of frames in time from which a line is taken for a clock."""
_BEYOND, _CLEAR = 4, 2
"""So many times that wide is the stretch in which frames must be so many times fewer than those in
time: a line below a sender that jitters, or has no period, is not as clear."""
_CLEARER = 1.5
"""So many times more are in time if frames were lost, or none is taken for lost."""
_MISSING = 3
"""Ticks that can be on their way when later ones come; with more the sender has paused."""
_HELD = 64
"""Windows for which a clock is believed that they do not show."""
_SAME, _SLOW = 0.002, 0.25
"""Relative change of a period up to which it is the same, and the share of it that is believed."""
_APART = 1000
"""Between two frames of a bus [ns]: recordings keep microseconds."""


class ArrivalStamps:
    """Times of sending for the frames of one bus, from the times at which they were read.

    Periodic messages are found by themselves, from their first 64 frames and half second on. Lost
    frames, pauses, other periods and clocks that are set are followed. Messages that are not
    periodic keep their times, unless one that came later was sent earlier than that. Frames stay in
    order, and none is stamped later than it was read.

    Example:
        >>> sent = 10_000_000 * np.arange(200)
        >>> read = sent + np.where(np.arange(200) % 10 == 9, 7_000_000, 0)
        >>> found = ArrivalStamps().corrected(read, np.full(200, 0x123))
        >>> int(max(found[:64] - sent[:64])), int(max(found[64:] - sent[64:]))
        (7000000, 0)
    """

    def __init__(self) -> None:
        self._restart()

    def _restart(self) -> None:
        self._senders: dict[int, _Sender] = {}
        self._read = self._stamped = 0

    def frames(self, frames: Frames) -> Frames:
        """Return frames of the bus with the times at which they were sent."""
        if not len(frames):
            return frames
        return replace(frames, nanoseconds=self.corrected(frames.nanoseconds, frames.identifier))

    def corrected(self, read: Stamps, identifier: NDArray[np.integer[Any]]) -> Stamps:
        """Return when frames were sent, (n,) [ns].

        Args:
            read: (n,), when they were read, in the order in which they were [ns].
            identifier: (n,), of their messages.
        """
        times, names = read.tolist(), identifier.tolist()
        found: list[int] = []
        begin = 0
        for k, (before, time) in enumerate(pairwise([self._read, *times])):
            if time < before:
                # The machine's clock was set back: what is known is of another one.
                found += self._ordered(times[begin:k], names[begin:k])
                self._restart()
                begin = k
        found += self._ordered(times[begin:], names[begin:])
        return np.array(found, np.int64)

    def _ordered(self, read: list[int], names: list[int]) -> list[int]:
        rows: dict[int, list[int]] = {}
        for row, name in enumerate(names):
            rows.setdefault(name, []).append(row)
        found = read.copy()
        for name, of in rows.items():
            sender = self._senders.setdefault(name, _Sender())
            for row, time in zip(of, sender.take([read[row] for row in of]), strict=True):
                found[row] = time
        # A bus keeps its frames in order: what came before a frame was sent before it.
        for row in range(len(found) - 2, -1, -1):
            found[row] = min(found[row], found[row + 1] - _APART)
        for row, time in enumerate(read):
            self._stamped = found[row] = min(max(found[row], self._stamped + _APART), time)
            self._read = time
        return found


@dataclass(frozen=True)
class _Clock:
    """A sender's.

    Attributes:
        origin: When tick 0 arrives, if it is not late [ns].
        period: Between two ticks [ns].
        near: How near to its tick a frame is in time, as a share of the period.
    """

    origin: int
    period: float
    near: float = field(init=False)

    def __post_init__(self) -> None:
        near = min(max(_NEAR, _PROMPT / self.period), _WIDEST)
        object.__setattr__(self, "near", near)

    def ticks(self, time: int) -> float:
        """Return how many ticks there were by a time [ns]."""
        return (time - self.origin) / self.period

    def at(self, tick: int) -> int:
        """Return when a tick arrives, if it is not late [ns]."""
        return self.origin + round(tick * self.period)


class _Sender:
    """What is known of the clock that one message is sent by."""

    def __init__(self) -> None:
        self._clock: _Clock | None = None
        self._tick = 0
        # What came since the last look at the clock, and the ticks that it was taken for.
        self._times: list[int] = []
        self._ticks: list[int] = []
        self._held = 0

    def take(self, times: list[int]) -> list[int]:
        """Return when frames were sent that were read at some times [ns]."""
        found: list[int] = []
        begin = 0
        while begin < len(times):
            clock, end = self._clock, begin + 1
            if clock is None:
                self._note(times[begin:end], self._tick + 1)
                found.append(times[begin])
            else:
                # Frames of several ticks that come together were all waiting.
                together = clock.near * clock.period
                while end < len(times) and times[end] - times[end - 1] < together:
                    end += 1
                found += self._burst(clock, times[begin:end])
            begin = end
            if len(self._times) >= _WINDOW and self._times[-1] - self._times[0] >= _SPAN:
                self._look()
        return found

    def _burst(self, clock: _Clock, times: list[int]) -> list[int]:
        """Return when frames were sent that came together."""
        passed = clock.ticks(times[-1])
        newest = math.floor(passed + clock.near)
        in_time = len(times) == 1 and passed - newest <= clock.near
        before, missing = self._tick, newest - self._tick - len(times)
        if missing > _MISSING and not in_time:
            # It has paused, and goes on by another clock.
            self._clock, self._times, self._ticks = None, [], []
            self._note(times, before + 1)
            return times
        # A frame that comes with a tick is that tick's: those missing are lost. Late ones are those
        # that had to come next; if they are not, one that comes in time will tell.
        late = missing >= 0 and not in_time
        first = before + 1 if late else newest + 1 - len(times)
        self._note(times, first)
        if in_time:
            return times
        due = [clock.at(first + k) for k in range(len(times))]
        least = 2 * clock.near * clock.period
        return [
            d if first + k > before and t - d > least else t
            for k, (t, d) in enumerate(zip(times, due, strict=True))
        ]

    def _note(self, times: list[int], first: int) -> None:
        self._times += times
        self._ticks += range(first, first + len(times))
        self._tick = self._ticks[-1]

    def _look(self) -> None:
        """Look at the clock anew."""
        times, ticks, before = self._times, self._ticks, self._clock
        self._times, self._ticks = [], []
        # As if none were lost, or by the ticks that they were taken for if that is much clearer.
        last = ticks[-1]
        consecutive = list(range(last + 1 - len(ticks), last + 1))
        found, share = _envelope(consecutive, times)
        if ticks != consecutive and all(b > a for a, b in pairwise(ticks)):
            other, better = _envelope(ticks, times)
            if better > _CLEARER * share:
                found, share = other, better
        if share >= _IN_TIME:
            self._held = 0
            if before is not None and abs(found.period / before.period - 1) < _SAME:
                period = before.period + _SLOW * (found.period - before.period)
                found = _Clock(found.at(last) - round(last * period), period)
            self._clock = found
        elif before is not None:
            self._held += 1
            # Where few frames are in time they do not tell the period, but where it begins.
            shift = min(t - before.at(k) for k, t in zip(ticks, times, strict=True))
            if abs(shift) < 2 * before.near * before.period:
                self._clock = _Clock(before.origin + shift, before.period)
            if self._held == _HELD:
                self._clock = None


def _envelope(ticks: Sequence[int], times: list[int]) -> tuple[_Clock, float]:
    """Return the clock of the line below all frames, and the share of those in time.

    The share is 0 if it is no clear line.
    """
    hull: list[tuple[int, int]] = []
    for c in zip(ticks, times, strict=True):
        while len(hull) > 1:
            a, b = hull[-2:]
            if (b[1] - a[1]) * (c[0] - a[0]) < (c[1] - a[1]) * (b[0] - a[0]):
                break
            hull.pop()
        hull.append(c)
    middle = sum(ticks) / len(ticks)
    a, b = next((a, b) for a, b in pairwise(hull) if b[0] >= middle)
    period = (b[1] - a[1]) / (b[0] - a[0])
    clock = _Clock(a[1] - round(a[0] * period), period)
    near = clock.near * period
    after = [t - clock.at(k) for k, t in zip(ticks, times, strict=True)]
    in_time = sum(d <= near for d in after)
    beyond = sum(near < d <= _BEYOND * near for d in after)
    return clock, in_time / len(ticks) if in_time >= _CLEAR * beyond else 0.0
