"""Total least squares on filtered equations: noise in every column, of known shape only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from identification.estimators.compensated import Compensated


@dataclass(frozen=True)
class TotalLeastSquares(Compensated):
    """Least squares that allows for noise in the columns, whose size it finds (`compensated`).

    Every misfit counts as sensor noise here: a disturbance or a missing effect makes λ larger than
    the sensors do, and what is subtracted too large. `noise_scale` in the details is λ, 1 where the
    sensors explain all.

    Example:
        >>> TotalLeastSquares().method
        'total-least-squares'
    """

    method: ClassVar[str] = "total-least-squares"
    scale_is_known: ClassVar[bool] = False
