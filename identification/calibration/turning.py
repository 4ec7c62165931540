"""Where a motion back and forth turns round."""

from __future__ import annotations

import numpy as np

from identification.calibration.measured import Vector


def turning_points(values: Vector, least: float) -> Vector:
    """Return the extremes between which the values change by more than `least`.

    What lies before the first and behind the last change of that size is no turn.

    Example:
        >>> turning_points(np.array([0.0, 5.0, 4.9, 5.2, -5.0, 3.0, 1.5]), 1.0).tolist()
        [5.2, -5.0, 3.0]
    """
    ends: list[float] = []
    low = high = float(values[0])
    way = 0
    for value in values[1:].tolist():
        low, high = min(low, value), max(high, value)
        turns_down = way >= 0 and high - value > least
        turns_up = way <= 0 and value - low > least
        if not (turns_down or turns_up):
            continue
        # The first change only tells which way the motion goes.
        if way:
            ends.append(high if turns_down else low)
        low = high = value
        way = -1 if turns_down else 1
    return np.array(ends)
