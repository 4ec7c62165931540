"""What a count is worth: readings at known positions, and sweeps over whole turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from foundation.errors import ExcitationError, InputError
from identification.calibration.measured import Measured, Vector, mean, pair, vector
from identification.calibration.turning import turning_points


@dataclass(frozen=True, eq=False)
class Scale:
    """readings = zero + slope · positions.

    Attributes:
        slope: Counts a unit of position.
        zero: Reading at position 0.
        residual_sd: Scatter of the readings, in counts: of the sensor and of whoever positioned.
    """

    slope: Measured
    zero: Measured
    residual_sd: float

    def position(self, readings: ArrayLike) -> Vector:
        """Return positions from readings, in the unit that the scale was fitted in."""
        return (vector(readings, "readings") - self.zero.value) / self.slope.value


def fit_scale(positions: ArrayLike, readings: ArrayLike) -> Scale:
    """Fit a straight line through readings at known positions.

    Args:
        positions: (n,) of the reference, any unit; n >= 3 with at least two different ones.
        readings: (n,) in counts, unwrapped.

    Raises:
        InputError: Shapes do not fit.
        ExcitationError: Too few or equal positions, or the readings do not follow them.

    Example:
        >>> scale = fit_scale([0.0, 90.0, 180.0], [1.0, 257.0, 513.0])
        >>> round(scale.slope.value, 3), round(scale.zero.value, 3)
        (2.844, 1.0)
    """
    at, read = pair(positions, readings, ("positions", "readings"))
    if at.size < 3 or np.ptp(at) == 0:
        raise ExcitationError(
            f"{at.size} readings at {np.unique(at).size} positions",
            remedy="read the sensor at two positions or more, three times or more in all",
        )
    middle = at.mean()
    spread = float(np.sum((at - middle) ** 2))
    slope = float(np.sum((at - middle) * read) / spread)
    residual = read - read.mean() - slope * (at - middle)
    sd = float(np.sqrt(np.sum(residual**2) / (at.size - 2)))
    if slope == 0 or abs(slope) < 2 * sd / np.sqrt(spread):
        raise ExcitationError(
            "the readings do not follow the positions",
            remedy="check which sensor was read, and unwrap its counts first",
        )
    zero = float(read.mean() - slope * middle)
    zero_sd = sd * float(np.sqrt(1 / at.size + middle**2 / spread))
    return Scale(Measured(slope, sd / float(np.sqrt(spread))), Measured(zero, zero_sd), sd)


def counts_per_turn(sweeps: ArrayLike, turns: float) -> Measured:
    """Return the counts of one turn from sweeps over several.

    Args:
        sweeps: (n,) counts between the ends of each sweep; signs do not matter.
        turns: Of one sweep, the same for all.

    Raises:
        InputError: `turns` is not positive.

    Example:
        >>> counts_per_turn([52254, -52242, 52170], 8).value
        6527.75
    """
    if not turns > 0:
        raise InputError(f"sweeps of {turns:g} turns", remedy="give the turns of one sweep")
    return mean(np.abs(vector(sweeps, "sweeps")) / turns)


def sweeps_of(counts: ArrayLike) -> Vector:
    """Return the counts between successive ends of a motion back and forth, signed.

    An end is where the motion turns round by more than a quarter of the record's span. The stretch
    before the first and behind the last end is no sweep: the report moves 4 turns one way, 8 the
    other and 4 back, of which only the 8 count.

    Args:
        counts: (n,) unwrapped.

    Example:
        >>> sweeps_of([0, 50, 101, 100, 40, -2, 50, 98]).tolist()
        [-103.0]
    """
    values = vector(counts, "counts")
    return np.diff(turning_points(values, 0.25 * float(np.ptp(values))))
