"""Long records as few points that draw the same picture."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from identification.problem import Vector

POINTS = 600


def envelope(time: Vector, values: Vector, bins: int = POINTS) -> tuple[Vector, Vector]:
    """Return a record's extremes: of each of `bins` spans its least and its largest, in order.

    A span that holds no finite value becomes one NaN, at which a line breaks.

    Args:
        time: (n,).
        values: (n,); NaN where nothing is known.
        bins: Spans; a record of at most twice as many samples is returned as it is.

    Example:
        >>> t, y = envelope(np.arange(6.0), np.array([0.0, 5, 1, -3, 2, 2]), bins=2)
        >>> t.tolist(), y.tolist()
        ([0.0, 1.0, 3.0, 4.0], [0.0, 5.0, -3.0, 2.0])
    """
    if len(time) <= 2 * bins:
        return time, values
    keep: list[int] = []
    edges = np.linspace(0, len(time), bins + 1).astype(int)
    for begin, end in itertools.pairwise(edges):
        part = values[begin:end]
        finite = np.flatnonzero(np.isfinite(part))
        if len(finite) == 0:
            keep.append(begin)
            continue
        low = finite[int(np.argmin(part[finite]))]
        high = finite[int(np.argmax(part[finite]))]
        keep += [begin + k for k in sorted({int(low), int(high)})]
    index = np.array(keep)
    return time[index], values[index]


@dataclass(frozen=True)
class Profile:
    """One variable against another, in bins: (m,) where, median, and the inner 80 %."""

    x: Vector
    middle: Vector
    low: Vector
    high: Vector


def profile(x: Vector, y: Vector, bins: int = 24, fewest: int = 8) -> Profile:
    """Return how y spreads in bins of x between x's 0.5 % and 99.5 % quantiles.

    Args:
        x, y: (n,); pairs that are not finite are left out.
        bins: Bins of equal width.
        fewest: A bin with fewer samples is left out.
    """
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    if len(x) == 0 or not np.ptp(x) > 0:
        nothing = np.zeros(0)
        return Profile(nothing, nothing, nothing, nothing)
    low, high = (float(q) for q in np.quantile(x, [0.005, 0.995]))
    edges = np.linspace(low, max(high, low + 1e-12 * max(abs(low), 1e-300)), bins + 1)
    number = np.digitize(x, edges) - 1
    rows = [
        (float(np.mean(x[here])), *(float(q) for q in np.quantile(y[here], [0.5, 0.1, 0.9])))
        for here in (number == k for k in range(bins))
        if np.count_nonzero(here) >= fewest
    ]
    table = np.array(rows).reshape(-1, 4).T
    return Profile(table[0], table[1], table[2], table[3])
