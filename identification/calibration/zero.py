"""The true zero of a pendulum's angle, which friction hides from a pendulum at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from foundation.errors import ExcitationError, InputError
from identification.calibration.measured import Measured, vector
from identification.calibration.turning import turning_points

_BLOCKS = 10
_LEAST_ENDS = 4


def rest_shift(friction: float, weight: float) -> float:
    """Return how far from the vertical friction can hold a pendulum at rest, rad.

    A zero that is taken from the rest position is wrong by up to this, and so is "upright".

    Args:
        friction: Torque of the pivot's friction at rest, N.m.
        weight: Mass times gravity times the distance of its centre from the pivot, N.m.

    Raises:
        InputError: A torque is negative, or friction holds the pendulum anywhere.

    Example:
        >>> round(rest_shift(4.8e-4, 0.0276 * 9.81 * 0.145) * 180 / np.pi, 2)
        0.7
    """
    if not 0 <= friction <= weight:
        raise InputError(
            f"friction of {friction:g} N.m against a weight of {weight:g} N.m",
            remedy="give 0 <= friction <= weight",
        )
    return float(np.arcsin(friction / weight))


def zero_from_swing(angle: ArrayLike, *, resolution: float) -> Measured:
    """Return the angle about which a pendulum swings freely: its true zero.

    Three successive ends of a swing x0, x1, x2 give (x0 + 2 x1 + x2)/4, in which Coulomb friction
    cancels exactly and viscous friction to second order. Only swings of more than four counts are
    used, since a swing that stops is held by friction.

    Args:
        angle: (n,) of a free swing, unwrapped.
        resolution: Value of one count, in the unit of `angle`.

    Returns:
        In the unit of `angle`.

    Raises:
        InputError: `resolution` is not positive.
        ExcitationError: Fewer than four swings.

    Example:
        >>> t = np.arange(0, 10, 0.01)
        >>> swing = 0.012 + 0.5 * np.exp(-0.1 * t) * np.cos(7 * t)
        >>> found = zero_from_swing(np.round(swing / 0.006) * 0.006, resolution=0.006)
        >>> abs(found.value - 0.012) < 0.002
        True
    """
    if not resolution > 0:
        raise InputError(f"a resolution of {resolution:g}", remedy="give the value of one count")
    ends = turning_points(vector(angle, "angles"), 4 * resolution)
    if ends.size < _LEAST_ENDS:
        raise ExcitationError(
            f"the record holds {ends.size} ends of swings",
            remedy="let the pendulum go from a large angle, and record until it is nearly at rest",
        )
    centres = (ends[:-2] + 2 * ends[1:-1] + ends[2:]) / 4
    # Each end is in three centres: independent errors e of the ends give var(centre) = 3/8 var(e).
    # Ends are rounded even where the centres happen to agree.
    scatter = max(float(np.std(centres, ddof=1)) / np.sqrt(3 / 8), resolution / np.sqrt(12))
    return Measured(float(centres.mean()), float(scatter / np.sqrt(centres.size)))


def zero_from_balance(tilt: ArrayLike) -> Measured:
    """Return what a sensor reads at upright, from a record of the pendulum being balanced.

    A pendulum that stays up, on a base that stays where it is, has no mean acceleration, so its
    mean tilt is zero; what the sensor reads in the mean is the error of its zero. Subtract it from
    the readings, and the base stops wandering.

    Args:
        tilt: (n,) readings while balanced, without the catch before.

    Returns:
        In the unit of `tilt`, with a standard deviation from ten blocks of the record.

    Raises:
        ExcitationError: Fewer than a hundred samples.

    Example:
        >>> t = np.arange(0, 20, 0.01)
        >>> found = zero_from_balance(0.7 + 0.5 * np.sin(3 * t))
        >>> abs(found.value - 0.7) < 3 * found.sd
        True
    """
    data = vector(tilt, "tilts")
    if data.size < 10 * _BLOCKS:
        raise ExcitationError(f"{data.size} samples", remedy="balance for some seconds longer")
    blocks = np.array([block.mean() for block in np.array_split(data, _BLOCKS)])
    # A slow swing that the record cuts off would shift a plain mean; tapered ends cost a factor
    # of 3/2 in variance.
    taper = np.hanning(data.size + 2)[1:-1]
    sd = float(blocks.std(ddof=1) * np.sqrt(1.5 / _BLOCKS))
    return Measured(float(taper @ data / taper.sum()), sd)
