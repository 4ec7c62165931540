"""The covariance of fitted parameters that holds where residuals have memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from identification.linearisation import Linearised, eliminate
from identification.problem import Matrix, Vector

_DETERMINED = 1e-14  # smallest share of the largest eigenvalue that is not rounding


def covariance_of(at: Linearised, index: NDArray[np.intp]) -> tuple[Matrix, float]:
    """Return the covariance of some parameters, and the condition number of their Jacobian.

    The sandwich H⁻¹ S H⁻¹ (H. White, Econometrica 50 (1982) 1), so that residuals that correlate in
    time (a model error, a coloured disturbance) widen it. S comes from the windows' scores: each
    has an initial state of its own, so what correlates within a window does not reach the next. Too
    few windows for that are cut into short blocks. In no direction is the result narrower than what
    white noise of the present size would make it, and a combination that the data do not determine
    has a variance beyond all others. A prior counts as an observation of the variance it states.
    """
    normal = at.normal[np.ix_(index, index)]
    scale = np.sqrt(np.diag(normal))
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    largest = eigenvalues[-1]
    condition = float(np.sqrt(largest / max(eigenvalues[0], 1e-300)))
    root = vectors / np.sqrt(np.fmax(eigenvalues, _DETERMINED * largest))
    k, nx = len(index), len(at.grams[0][1]) - len(at.raw)
    per_window = np.array([_projected(gram, score, nx) for gram, score in at.grams])
    scores = per_window if len(per_window) > k else at.scores
    # In the coordinates of `root`, the data and the priors add up to the information I.
    # At the solution the data's scores add up to what holds against the priors' pull.
    centred = scores[:, index] + at.pull[index] / len(scores)
    whitened = (centred / scale) @ root
    spread = whitened.T @ whitened * (len(scores) / max(len(scores) - k, 1))
    freedom = int(np.sum(at.counts)) - k - nx * len(at.grams)
    white = (at.cost - at.penalty) / max(freedom, 1)
    prior = (root.T * (at.precision[index] / scale**2)) @ root
    least = white * (np.eye(k) - prior)
    sizes, directions = np.linalg.eigh(spread - least)
    more = (directions * np.fmax(sizes, 0.0)) @ directions.T
    half = root / scale[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        # What the data do not see at all may overflow: infinite, which is what is meant.
        covariance = half @ (least + more + prior) @ half.T
    return (covariance + covariance.T) / 2, condition


def _projected(gram: Matrix, score: Vector, nx: int) -> Vector:
    """Return (ns,) a window's score with its initial state eliminated."""
    weight, _ = eliminate(gram, score, nx, 0.0)
    return score[nx:] - weight.T @ score[:nx]
