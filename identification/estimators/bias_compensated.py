"""Bias-compensated least squares on filtered equations: noise in the columns of known size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from identification.estimators.compensated import Compensated


@dataclass(frozen=True)
class BiasCompensated(Compensated):
    """Least squares with the noise of known sensors subtracted (`compensated`).

    Give the sensors' `sd` in a channel map; an estimate from the record serves otherwise, and its
    error remains as bias. Disturbances that act on the plant do no harm.

    Example:
        >>> BiasCompensated().method
        'bias-compensated'
    """

    method: ClassVar[str] = "bias-compensated"
    scale_is_known: ClassVar[bool] = True
