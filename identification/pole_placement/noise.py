"""What the data tell of their own noise and of the feedback under which they were recorded."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from identification.pole_placement.samples import Matrix, Samples, Vector, floats


def feedback(samples: Samples) -> tuple[Matrix, Matrix]:
    """Return the gain F (m, n) of u = F x + v, and the excitation v (N, m), as regression tells.

    With the recorded excitation where there is one. Feedback of the measured state carries its
    noise into u; without feedback F comes out near 0 and v near u.
    """
    states, inputs = samples.states[:-1], samples.inputs
    response = inputs if samples.excitation is None else inputs - samples.excitation
    F = floats(np.linalg.lstsq(states, response, rcond=1e-10)[0]).T
    if samples.excitation is not None:
        return F, samples.excitation
    return F, inputs - states @ F.T


def noise_variances(samples: Samples, A: Matrix, B: Matrix) -> tuple[Vector, Vector]:
    """Return variances of measurement noise r (n,) and of process noise q (n,), all >= 0.

    The residual of a linear model is ε(k+1) - A ε(k) + w(k); its covariances at lag 0 and 1 are
    diag(r) + A diag(r) Aᵀ + diag(q) and -A diag(r). Both are fitted by non-negative least squares,
    every equation in units of its own standard error. What is known of the sensors is kept.

    Args:
        samples: N steps, not prefiltered.
        A: (n, n) a model of them.
        B: (n, m).
    """
    n, length = samples.n, len(samples)
    states = samples.states
    residual = states[1:] - states[:-1] @ A.T - samples.inputs @ B.T
    sd = np.sqrt(np.mean(residual**2, axis=0)) + 1e-300
    at_0 = residual.T @ residual / length
    at_1 = residual[1:].T @ residual[:-1] / max(length - 1, 1)
    table, right = [], []
    for i in range(n):
        for j in range(n):
            size = sd[i] * sd[j]
            lagged = np.zeros(2 * n)
            lagged[j] = -A[i, j]
            table.append(lagged / size)
            right.append(at_1[i, j] / size)
            if i <= j:
                now = np.concatenate([A[i] * A[j], np.zeros(n)])
                if i == j:
                    now[[i, n + i]] += 1
                table.append(now / size)
                right.append(at_0[i, j] / size)
    design, target = np.array(table), np.array(right)
    known = _known(samples)
    fixed = np.concatenate([~np.isnan(known), np.zeros(n, bool)])
    values = np.concatenate([np.nan_to_num(known) ** 2, np.zeros(n)])
    target = target - design @ values
    scales = np.concatenate([sd**2, sd**2])
    values[~fixed] = nnls((design * scales)[:, ~fixed], target)[0] * scales[~fixed]
    return values[:n], values[n:]


def _known(samples: Samples) -> Vector:
    return np.full(samples.n, np.nan) if samples.noise_sd is None else samples.noise_sd


def known_variances(samples: Samples) -> Vector:
    """Return what is known of the sensors' variances, (n,), NaN where nothing is."""
    return _known(samples) ** 2
