"""Time stamps that a busy computer gave late, brought back to the sender's even beat.

Hardware stamps are taken on the wire. A software stamp is taken when the driver's reader wakes up,
a random time later. A message that its sender repeats with a constant period was really on the
wire at the instants of a straight line, and a stamp can be late but never early: the line lies
along the lower edge of the stamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

EARLIEST = 0.01
"""Share of the stamps that may lie before the line: rounding and small steps of the clock."""
MOST_JITTER = 0.5
"""If nine tenths of the stamps are not this near, in periods, there is no beat to be told."""

_FEWEST, _FIRST_FIT = 8, 32


@dataclass(frozen=True, eq=False)
class Beat:
    """An even beat behind late stamps.

    Attributes:
        time: Shape (n,), s: when the frames were sent.
        period: s.
        lateness: Root mean square of stamp minus time, s.
    """

    time: Vector
    period: float
    lateness: float


def even_beat(stamps: Vector) -> Beat | None:
    """Return the even beat of periodic frames that were stamped late; None if there is none.

    Frames that were lost leave their beats out. A period that drifts by more than half of itself
    over the recording is no even beat.

    Args:
        stamps: Shape (n,), s, increasing.

    Example:
        >>> late = np.array([0.0, 1e-3, 0.0, 2e-3, 0.0, 0.0, 1e-3, 0.0])
        >>> beat = even_beat(0.01 * np.arange(8) + late)
        >>> np.round(beat.time, 3).tolist()
        [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07]
    """
    if stamps.size < _FEWEST:
        return None
    # The median step is a rough period, and a long record would count wrong beats with it: each
    # fit is good for somewhat more beats than it was made of.
    slope, start = float(np.median(np.diff(stamps))), float(stamps[0])
    size = min(_FIRST_FIT, stamps.size)
    while True:
        part = stamps[:size]
        beats = _beats(part, start, slope)
        slope, start = np.polyfit(beats, part, 1)
        if not slope > 0:
            return None
        if size == stamps.size:
            break
        size = min(3 * size // 2, stamps.size)
    beats = _beats(stamps, start, slope)
    slope, start = np.polyfit(beats, stamps, 1)
    late = stamps - (start + slope * beats)
    if np.quantile(np.abs(late - np.median(late)), 0.9) > MOST_JITTER * slope:
        return None
    time = start + slope * beats + np.quantile(late, EARLIEST)
    return Beat(time, float(slope), float(np.sqrt(np.mean((stamps - time) ** 2))))


def _beats(stamps: Vector, start: float, period: float) -> Vector:
    """Return which beat each stamp belongs to: increasing by one or, where frames are lost, more.

    Frames that waited together have nearly one stamp, which is right for the last of them.
    """
    nearest = np.rint((stamps - start) / period)
    order = np.arange(stamps.size)
    return np.asarray(np.minimum.accumulate((nearest - order)[::-1])[::-1] + order, np.float64)
