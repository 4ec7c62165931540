"""Generalised total least squares: errors in x(k+1) and x(k) of known size, none in u."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from foundation.errors import ComputationError
from identification.pole_placement.base import ModelMethod, Rows, column_scales
from identification.pole_placement.noise import noise_variances
from identification.pole_placement.samples import Matrix, Samples, Vector, floats
from identification.pole_placement.two_step import regress

_LEAST = 1e-7
"""Noise of a state relative to its size below which it is taken to be this: arithmetic's share."""


def total_regression(rows: Rows, sd: Vector) -> tuple[Matrix, Matrix]:
    """Return A and B with errors of standard deviations `sd` in x(k+1) and x(k), none in u.

    Van Huffel and Vandewalle, "The Total Least Squares Problem", SIAM 1991, ch. 10: the exact
    columns are eliminated by QR, the others divided by their errors' size.

    Args:
        rows: R equations.
        sd: (n,) sizes of the errors, up to a common factor, > 0.

    Raises:
        ComputationError: There is no generic solution.
    """
    n, m = rows.before.shape[1], rows.inputs.shape[1]
    table = np.hstack([rows.inputs, rows.before / sd, rows.after / sd])
    triangle = floats(np.linalg.qr(table, mode="r"))
    vectors = np.linalg.svd(triangle[m:, m:])[2][n:].T
    upper, lower = vectors[:n], vectors[n:]
    if np.linalg.cond(lower) > 1e12:
        raise ComputationError(
            "total least squares has no generic solution",
            remedy="use --method two-step or auto",
        )
    A = floats(-np.linalg.solve(lower.T, upper.T) * sd[:, None] / sd[None, :])
    rest = rows.after - rows.before @ A.T
    return A, floats(np.linalg.lstsq(rows.inputs, rest, rcond=None)[0]).T


@dataclass(frozen=True)
class GeneralisedTotalLeastSquares(ModelMethod):
    """Total least squares of the regression, each state's error in units of its own noise.

    Sizes of the noise are the sensors', where known, else estimated from the residual's
    autocovariance. Inputs are taken to be known exactly, as commanded ones are.
    """

    word: ClassVar[str] = "generalised-total-least-squares"

    def rows(self, samples: Samples) -> Rows:
        """Return the (prefiltered) equations with the sizes of the noise."""
        rows = super().rows(samples)
        r, _ = noise_variances(samples, *regress(rows))
        return replace(rows, noise=r)

    def model(self, rows: Rows) -> tuple[Matrix, Matrix]:
        """Return A and B."""
        assert rows.noise is not None
        return total_regression(
            rows, np.maximum(np.sqrt(rows.noise), _LEAST * column_scales(rows.before))
        )
