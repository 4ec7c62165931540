"""From the covariance of [A B] to standard deviations of entries and of poles."""

from __future__ import annotations

import numpy as np

from identification.pole_placement.gains import Poles
from identification.pole_placement.samples import Matrix, Vector


def entry_sd(covariance: Matrix, n: int, m: int) -> tuple[Matrix, Matrix]:
    """Return standard deviations of A (n, n) and B (n, m).

    Args:
        covariance: Of the rows of [A B], (n(n+m), n(n+m)).
        n: Number of states.
        m: Number of inputs.

    Example:
        >>> entry_sd(np.diag([0.04, 0.09]), 1, 1)
        (array([[0.2]]), array([[0.3]]))
    """
    sd = np.sqrt(np.maximum(np.diag(covariance), 0)).reshape(n, n + m)
    return sd[:, :n], sd[:, n:]


def poles_with_sd(A: Matrix, B: Matrix, F: Matrix, covariance: Matrix) -> tuple[Poles, Vector]:
    """Return the poles of A + B F and their standard deviations √E|δλ|², both (n,).

    The gain is held, the plant varies: where the closed loop's poles may be with this gain. To
    first order, δλ = wᴴ δ[A B] [I; F] v / wᴴ v with left and right eigenvectors w and v (Horn and
    Johnson, "Matrix Analysis", theorem 6.3.12); infinite for a pole that is repeated, whose
    perturbation is not of first order, or if the covariance is unknown.

    Args:
        A: (n, n).
        B: (n, m).
        F: (m, n); zeros for the plant's own poles.
        covariance: Of the rows of [A B].

    Example:
        >>> poles, sd = poles_with_sd(
        ...     np.array([[0.5]]), np.array([[1.0]]), np.array([[-0.2]]), np.diag([0.01, 0.04])
        ... )
        >>> poles.round(6).tolist(), sd.round(6).tolist()
        ([(0.3+0j)], [0.107703])
    """
    n = len(A)
    values, right = np.linalg.eig(A + B @ F)
    poles = values.astype(np.complex128)
    if not np.all(np.isfinite(covariance)):
        return poles, np.full(n, np.inf)
    seen = np.vstack([np.eye(n), F]) @ right
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        return poles, np.full(n, np.inf)
    if np.linalg.cond(right) > 1e10:
        return poles, np.full(n, np.inf)
    gradients = np.einsum("pi,jp->pij", left, seen).reshape(n, -1)
    variances = np.einsum("pi,ij,pj->p", gradients, covariance, gradients.conj()).real
    return poles, np.sqrt(np.maximum(variances, 0))
