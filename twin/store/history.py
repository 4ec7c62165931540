"""Numbers over time, kept finely while they are new and coarsely when they are old."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Span:
    """What a number did for a while.

    Attributes:
        start: [s]; a multiple of the length.
        length: [s].
        count: How many values.
        mean, low, high: Of them.
    """

    start: float
    length: float
    count: int
    mean: float
    low: float
    high: float


def down_sample(spans: Iterable[Span], length: float) -> list[Span]:
    """Join spans into longer ones; no value is lost from count, mean and extremes.

    Args:
        spans: Of one number, each within one of the longer ones.
        length: Of the longer ones [s].

    Example:
        >>> down_sample([Span(0, 1, 1, 2.0, 2.0, 2.0), Span(5, 1, 3, 6.0, 5.0, 7.0)], 60)
        [Span(start=0, length=60, count=4, mean=5.0, low=2.0, high=7.0)]
    """
    groups: dict[float, list[Span]] = {}
    for span in spans:
        groups.setdefault(math.floor(span.start / length) * length, []).append(span)
    return [_joined(start, length, group) for start, group in sorted(groups.items())]


def _joined(start: float, length: float, group: list[Span]) -> Span:
    count = sum(s.count for s in group)
    low, high = min(s.low for s in group), max(s.high for s in group)
    # Rounding must not put the mean outside.
    mean = min(high, max(low, math.fsum(s.count / count * s.mean for s in group)))
    return Span(start, length, count, mean, low, high)


@dataclass(frozen=True)
class Retention:
    """How long what is kept [s].

    Attributes:
        steps: (span, kept for), from fine to coarse: each span a multiple of the one before. What
            is older than its step goes into the next one's; after the last it is forgotten.
    """

    steps: tuple[tuple[float, float], ...] = (
        (10.0, 86_400.0),
        (60.0, 30 * 86_400.0),
        (3600.0, 5 * 365 * 86_400.0),
    )
