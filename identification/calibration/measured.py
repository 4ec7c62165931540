"""A measured number with its standard deviation, and the arrays it is measured from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.errors import InputError

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """One number with its doubt.

    Attributes:
        value: In the unit of what was measured.
        sd: Standard deviation of `value`; infinite if there was one measurement only.
    """

    value: float
    sd: float


def mean(values: ArrayLike) -> Measured:
    """Return the mean of independent measurements and its standard deviation.

    Example:
        >>> mean([2.0, 4.0])
        Measured(value=3.0, sd=1.0)
    """
    data = vector(values, "measurements")
    if data.size == 1:
        return Measured(float(data[0]), float("inf"))
    return Measured(float(data.mean()), float(data.std(ddof=1) / np.sqrt(data.size)))


def vector(values: ArrayLike, name: str) -> Vector:
    """Return (n,) finite numbers, n >= 1.

    Raises:
        InputError: They are not; says what.
    """
    found = np.asarray(values, np.float64)
    if found.ndim != 1 or found.size == 0:
        raise InputError(f"{name} have shape {found.shape}", remedy="give one vector of numbers")
    bad = np.flatnonzero(~np.isfinite(found))
    if bad.size:
        raise InputError(
            f"{name} are not finite", where=f"sample {bad[0]}", remedy="remove those samples"
        )
    return found


def pair(first: ArrayLike, second: ArrayLike, names: tuple[str, str]) -> tuple[Vector, Vector]:
    """Return two vectors of equal length.

    Raises:
        InputError: They are not.
    """
    a, b = vector(first, names[0]), vector(second, names[1])
    if a.size != b.size:
        raise InputError(
            f"{a.size} {names[0]} and {b.size} {names[1]}", remedy="give as many of each"
        )
    return a, b
