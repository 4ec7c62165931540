"""Two steps: regress x(k+1) on x(k) and u(k), then place the poles of that model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from identification.pole_placement.base import ModelMethod, Rows, column_scales
from identification.pole_placement.samples import Matrix, floats


def regress(rows: Rows) -> tuple[Matrix, Matrix]:
    """Return A (n, n) and B (n, m) by least squares."""
    scales = column_scales(rows.regressors)
    solved = np.linalg.lstsq(rows.regressors / scales, rows.after, rcond=None)[0]
    theta = floats(solved / scales[:, None]).T
    n = rows.after.shape[1]
    return theta[:, :n], theta[:, n:]


@dataclass(frozen=True)
class TwoStep(ModelMethod):
    """Least squares of x(k+1) on [x(k); u(k)], then a gain for that model.

    Without noise it is the published form. With noise on x it is biased by -A R S⁻¹ (R: covariance
    of the noise, S: second moments of x and u); a prefilter of order M shrinks the noise M times
    and the bias of slow states about M² times.

    Example:
        >>> from identification.pole_placement.samples import Samples
        >>> rng = np.random.default_rng(1)
        >>> u, x = rng.normal(size=(20, 1)), np.zeros((21, 1))
        >>> for k in range(20):
        ...     x[k + 1] = 1.1 * x[k] + 0.5 * u[k]
        >>> TwoStep().solve(Samples(x, u), np.array([0.5 + 0j])).F.round(9).tolist()
        [[-1.2]]
    """

    word: ClassVar[str] = "two-step"

    def model(self, rows: Rows) -> tuple[Matrix, Matrix]:
        """Return A and B."""
        return regress(rows)
