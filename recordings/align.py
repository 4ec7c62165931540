"""Signals that were sampled at different times, put on one time base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.errors import TimeError
from recordings.readers import RawSignal
from recordings.recording import LONGEST_GAP


@dataclass(frozen=True, eq=False)
class Aligned:
    """Signals on one time base.

    Attributes:
        time: Shape (n,), s.
        values: One array of shape (n,) for each signal, in the order given.
        notes: What was interpolated.
    """

    time: NDArray[np.float64]
    values: list[NDArray[np.float64]]
    notes: tuple[str, ...]


def align(signals: Sequence[RawSignal], origin: str) -> Aligned:
    """Put signals on the time base of the fastest one, by linear interpolation.

    Signals that share their time stamps keep every number. Others are cut to the span that all
    of them cover.

    Args:
        signals: At least one; each with a time of its own.
        origin: Named in the error.

    Raises:
        TimeError: There is no span that all of them cover.

    Example:
        >>> fast = RawSignal("a", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
        >>> slow = RawSignal("b", np.array([0.0, 20.0]), np.array([0.0, 2.0]))
        >>> align([fast, slow], "run").values[1].tolist()
        [0.0, 10.0, 20.0]
    """
    times = [_time(signal) for signal in signals]
    fastest = max(range(len(times)), key=lambda k: times[k].size)
    base = times[fastest]
    if all(np.array_equal(base, time) for time in times):
        return Aligned(base, [signal.values for signal in signals], ())
    start, stop = max(time[0] for time in times), min(time[-1] for time in times)
    time = base[(base >= start) & (base <= stop)]
    if time.size < 2:
        late = max(range(len(times)), key=lambda k: times[k][0])
        early = min(range(len(times)), key=lambda k: times[k][-1])
        raise TimeError(
            f"signals that do not overlap: '{signals[late].name}' starts at {start:.6g} s, "
            f"'{signals[early].name}' ends at {stop:.6g} s",
            where=origin,
            remedy="leave one of them out",
        )
    moved: list[str] = []
    gaps: list[str] = []
    for signal, own in zip(signals, times, strict=True):
        if not np.array_equal(own, base):
            moved.append(signal.name)
            gaps += _gaps(signal.name, own)
    notes = [f"interpolated to the times of '{signals[fastest].name}': {', '.join(moved)}", *gaps]
    values = [np.interp(time, own, s.values) for s, own in zip(signals, times, strict=True)]
    return Aligned(time, values, tuple(notes))


def _time(signal: RawSignal) -> NDArray[np.float64]:
    if signal.time is None:
        raise TimeError(f"'{signal.name}' has no time stamps", remedy="name a time column")
    return signal.time


def _gaps(name: str, time: NDArray[np.float64]) -> list[str]:
    steps = np.diff(time)
    long = steps > LONGEST_GAP * np.median(steps)
    if not np.any(long):
        return []
    k = int(np.argmax(steps))
    return [
        f"'{name}' has {np.count_nonzero(long)} gaps, bridged by straight lines; the longest is "
        f"{steps[k]:.4g} s at {time[k]:.6g} s"
    ]
