"""The published total-least-squares form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foundation.errors import ComputationError
from identification.pole_placement.base import RowMethod, Rows, Triple
from identification.pole_placement.gains import Poles
from identification.pole_placement.published import desired_pair, linear_equation, unpack
from identification.pole_placement.samples import floats


@dataclass(frozen=True)
class TotalLeastSquares(RowMethod):
    """Total least squares of the published equation, (3.5)–(3.8).

    Reference: P. E. E. Shwe, dissertation, Kanazawa University, 2017, Ch. 3 (there with a prefilter
    of order 6). All entries of 𝒳 and 𝒰 are taken to be equally wrong, which holds for no plant:
    see `generalised-total-least-squares` and `prediction-error`.

    Example:
        >>> import numpy as np
        >>> from identification.pole_placement.samples import Samples
        >>> rng = np.random.default_rng(1)
        >>> u, x = rng.normal(size=(20, 1)), np.zeros((21, 1))
        >>> for k in range(20):
        ...     x[k + 1] = 1.1 * x[k] + 0.5 * u[k]
        >>> TotalLeastSquares().solve(Samples(x, u), np.array([0.5 + 0j])).F.round(9).tolist()
        [[-1.2]]
    """

    word: ClassVar[str] = "total-least-squares"

    def fit(self, rows: Rows, poles: Poles) -> Triple:
        """Return A, B and F."""
        pair = desired_pair(poles, rows.inputs.shape[1])
        table, right = linear_equation(rows, *pair)
        # The last right singular vector of [𝒳 𝒰]: that of its triangular factor, which is small
        # however long the record.
        triangle = floats(np.linalg.qr(np.column_stack([table, right]), mode="r"))
        last = floats(np.linalg.svd(triangle)[2][-1])
        if abs(last[-1]) < 1e-12:
            raise ComputationError(
                "total least squares has no solution: the smallest singular vector of the "
                "equation does not involve its right side",
                remedy="use --method two-step or auto",
            )
        return unpack(-last[:-1] / last[-1], *pair)
