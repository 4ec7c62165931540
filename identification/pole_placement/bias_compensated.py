"""Least squares less the bias that known noise causes, feedback and prefilter included."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from foundation.errors import ComputationError
from identification.pole_placement.base import ModelMethod, Rows, column_scales
from identification.pole_placement.noise import feedback, noise_variances
from identification.pole_placement.samples import Matrix, Samples, Vector, floats
from identification.pole_placement.two_step import regress

_ROUNDS = 50


def noise_moments(A: Matrix, B: Matrix, F: Matrix, r: Vector, order: int) -> tuple[Matrix, Matrix]:
    """Return E[ε̄(k) z̄(k)ᵀ] and E[ε̄(k+1) z̄(k)ᵀ], each (n, n+m), z = [x; u] as measured.

    Feedback of the measured state, u = F (x + ε) + v, carries ε(k) into u(k) and, through the
    plant, into all later x and u; averages over `order` samples share samples. For order 1 these
    are [R, R Fᵀ] and 0.

    Args:
        A: (n, n).
        B: (n, m).
        F: (m, n) of the feedback while recording.
        r: (n,) variances of the noise.
        order: Of the prefilter.
    """
    R = np.diag(r)
    response = np.eye(len(A))
    now, later = np.zeros((2, len(A), len(A) + B.shape[1]))
    for lag in range(order):
        # What ε(k) adds to z(k + lag).
        shared = R @ np.hstack([response.T, response.T @ F.T])
        now += (order - lag) / order**2 * shared
        later += max(order - 1 - lag, 0) / order**2 * shared
        response = B @ F if lag == 0 else (A + B @ F) @ response
    return now, later


@dataclass(frozen=True)
class BiasCompensated(ModelMethod):
    """Two steps with the regression's bias taken off.

    The normal equations are Θ S = S_+ - E[ε̄(k+1) z̄ᵀ] + A E[ε̄(k) z̄ᵀ]; without a prefilter
    that is Θ (S - [[R, R Fᵀ], [0, 0]]) = S_+: the noise is in u as well if it was fed back.
    Variances of the noise are the sensors', where known, else estimated.

    Reference: Stoica and Söderström, "Bias correction in least-squares identification",
    Int. J. Control 35 (1982), for the idea.
    """

    word: ClassVar[str] = "bias-compensated"

    def rows(self, samples: Samples) -> Rows:
        """Return the (prefiltered) equations with noise and feedback."""
        rows = super().rows(samples)
        r, _ = noise_variances(samples, *regress(rows))
        return replace(rows, noise=r, feedback=feedback(samples)[0])

    def model(self, rows: Rows) -> tuple[Matrix, Matrix]:
        """Return A and B; the moments depend on both, so it is iterated to a fixed point.

        Raises:
            ComputationError: The noise is said to be greater than what was measured.
        """
        assert rows.noise is not None
        assert rows.feedback is not None
        n = rows.before.shape[1]
        scales = column_scales(rows.regressors)
        Z = rows.regressors / scales
        S, S_after = Z.T @ Z / len(rows), rows.after.T @ Z / len(rows)
        theta = np.hstack(regress(rows))
        change = size = np.inf
        for _ in range(_ROUNDS):
            now, later = noise_moments(
                theta[:, :n], theta[:, n:], rows.feedback, rows.noise, self.prefilter
            )
            bias = np.zeros_like(S)
            bias[:n] = now / scales / scales[:n, None]
            solved = floats(np.linalg.solve((S - bias).T, (S_after - later / scales).T)).T / scales
            change = float(np.max(np.abs((solved - theta) * scales)))
            size = float(np.max(np.abs(solved * scales)))
            theta = solved
            if change <= 1e-12 * size or not np.isfinite(change):
                break
        if not np.isfinite(change) or change > 1e-3 * size:
            raise ComputationError(
                "the bias of the noise is too great to be taken off",
                remedy="check the sensors' sd, or use --method auto",
            )
        return theta[:, :n], theta[:, n:]
