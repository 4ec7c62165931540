"""What a twin knows about its plant at one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

_CHANCE = 0.05
"""That an estimate which has arrived is taken for one on its way: it waits a little longer."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The parameters of a plant, from its telemetry.

    Attributes:
        time: Of the last sample that is in it [s]; before any is, of the first block.
        names: The k parameters that are estimated.
        values: Parameter → value; also of those that are held.
        sd: Parameter → standard deviation, of those that are estimated.
        covariance: (k, k), in the order of `names`.
        excitation: How well the recent data tell the parameters: 1 suffices for an update; with
            less the estimate rests, and its time stays.
        units: Parameter → unit.
        moved: How far it has come in the last `settle` of the twin's settings, as `distance`.

    Example:
        >>> e = Estimate(0.0, ("J",), {"J": 2.0}, {"J": 0.1}, np.array([[0.01]]), 1.0, {})
        >>> round(e.distance({"J": 2.2}), 6)
        2.0
    """

    time: float
    names: tuple[str, ...]
    values: Mapping[str, float]
    sd: Mapping[str, float]
    covariance: NDArray[np.float64]
    excitation: float
    units: Mapping[str, str]
    moved: float = 0.0

    @property
    def rests(self) -> bool:
        """Whether it moves no more than chance would have it: it has arrived at the plant."""
        return self.moved <= float(np.sqrt(chi2.isf(_CHANCE, max(1, len(self.names)))))

    def distance(self, other: Mapping[str, float]) -> float:
        """Return the Mahalanobis distance of other values from these, in this covariance."""
        apart = np.array([other[n] - self.values[n] for n in self.names])
        scale = np.sqrt(np.diag(self.covariance))
        scale[~(scale > 0)] = 1.0
        # In units of the standard deviations: parameters differ by many powers of ten.
        correlation = self.covariance / np.outer(scale, scale)
        scaled = apart / scale
        solved = np.linalg.lstsq(correlation, scaled, rcond=None)[0]
        return float(np.sqrt(max(0.0, scaled @ solved)))
