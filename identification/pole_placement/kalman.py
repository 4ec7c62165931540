"""Likelihood of a linear model with noisy measured states, by the Kalman filter, with its slopes.

x(k+1) = A x(k) + B u(k) + w(k), y(k) = x(k) + ε(k); w and ε are white with variances q and r.
Slopes are exact: the filter's equations differentiated (Gupta and Mehra, "Computational aspects of
maximum likelihood estimation", IEEE Trans. Autom. Control 19 (1974)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.errors import DivergenceError
from identification.pole_placement.samples import Matrix, Vector

Stack = NDArray[np.float64]

_SETTLED = 1e-10
_CHECK_EVERY = 8
_LONGEST = 1000
"""Steps after which the covariance is kept in any case: what still changes goes as 1/k."""


@dataclass(frozen=True, eq=False)
class Noisy:
    """A linear model with its noise.

    Attributes:
        A: (n, n).
        B: (n, m).
        q: (n,) variances of process noise.
        r: (n,) variances of measurement noise.
    """

    A: Matrix
    B: Matrix
    q: Vector
    r: Vector


@dataclass(frozen=True, eq=False)
class Directions:
    """Derivatives of a model with respect to p parameters.

    Attributes:
        A: (p, n, n).
        B: (p, n, m).
        q: (p, n).
        r: (p, n).
    """

    A: Stack
    B: Stack
    q: Stack
    r: Stack


@dataclass(frozen=True, eq=False)
class Filtered:
    """A run of the filter; it settles after K steps, and what has settled is kept once.

    Attributes:
        errors: (N, n) innovations: measured less predicted states.
        predicted: (N, n).
        P: (K, n, n) covariances of the predictions.
        S: (K, n, n) covariances of the innovations; the last is that of all later ones.
        gains: (K, n, n) of the predictor; the last is that of all later ones.
    """

    errors: Matrix
    predicted: Matrix
    P: Stack
    S: Stack
    gains: Stack

    def __len__(self) -> int:
        return len(self.errors)

    @property
    def index(self) -> NDArray[np.intp]:
        """Which covariance belongs to which error, (N,)."""
        return np.minimum(np.arange(len(self)), len(self.S) - 1)


@dataclass(frozen=True, eq=False)
class Local:
    """Minus log likelihood near a model: value, gradient (p,), Fisher's information (p, p)."""

    value: float
    gradient: Vector
    information: Matrix


def run_filter(model: Noisy, states: Matrix, inputs: Matrix) -> Filtered:
    """Run the filter from the first measured state, whose error is that of its sensors.

    Args:
        model: The model.
        states: (N+1, n) measured.
        inputs: (N, m).

    Raises:
        DivergenceError: A covariance is singular, or numbers overflow.
    """
    A, R, Q = model.A, np.diag(model.r), np.diag(model.q)
    errors, predicted = np.empty((2, len(inputs), len(A)))
    covariances: list[Matrix] = []
    gains: list[Matrix] = []
    driven, measured = inputs @ model.B.T, states[1:]
    gain, settled = R, False
    with np.errstate(over="ignore", invalid="ignore"):
        now = A @ R @ A.T + Q
        x = A @ states[0] + driven[0]
        for k in range(len(inputs)):
            predicted[k] = x
            errors[k] = error = measured[k] - x
            if not settled:
                try:
                    gain = A @ now @ np.linalg.inv(now + R)
                except np.linalg.LinAlgError:
                    raise DivergenceError("the Kalman filter's covariance is singular") from None
                covariances.append(now)
                gains.append(gain)
                new = (A - gain) @ now @ A.T + Q
                new = (new + new.T) / 2
                settled = k % _CHECK_EVERY == 0 and (k >= _LONGEST or _settled(now, new))
                now = new
            if k + 1 < len(inputs):
                x = A @ x + gain @ error + driven[k + 1]
    if not np.all(np.isfinite(errors[-1])):
        raise DivergenceError("the Kalman filter left the finite numbers")
    P = np.array(covariances)
    return Filtered(errors, predicted, P, P + R, np.array(gains))


def _settled(old: Matrix, new: Matrix) -> bool:
    """Whether a covariance stays; entries are compared with the states' own variances."""
    size = np.sqrt(np.abs(np.diag(new)))
    return bool(np.all(np.abs(new - old) <= _SETTLED * size[:, None] * size))


def minus_log_likelihood(run: Filtered) -> float:
    """Return ½ Σ (log det S + eᵀ S⁻¹ e).

    Raises:
        DivergenceError: A covariance is not positive definite.
    """
    signs, logs = np.linalg.slogdet(run.S)
    white = np.linalg.solve(run.S[run.index], run.errors[..., None])[..., 0]
    value = float(np.sum(logs[run.index]) + np.sum(run.errors * white)) / 2
    if not (np.all(signs > 0) and np.isfinite(value)):
        raise DivergenceError("the Kalman filter's covariance is not positive definite")
    return value


def linearise(model: Noisy, directions: Directions, states: Matrix, inputs: Matrix) -> Local:
    """Return minus the log likelihood, its gradient and Fisher's information.

    Args:
        model: The model.
        directions: Its derivatives with respect to p parameters.
        states: (N+1, n) measured.
        inputs: (N, m).

    Raises:
        DivergenceError: The filter does not run with this model.
    """
    run = run_filter(model, states, inputs)
    slopes, spreads = _sensitivities(run, model, directions, states, inputs)
    index, K = run.index, len(run.S)
    white = np.linalg.inv(np.linalg.cholesky(run.S))
    e = np.einsum("kij,kj->ki", white[index], run.errors)
    slopes = white[index][:, None] @ slopes[..., None]
    slopes = slopes[..., 0]
    spreads = white[:, None] @ spreads @ np.swapaxes(white, 1, 2)[:, None]
    weights = np.bincount(index, minlength=K).astype(np.float64)
    squares = np.zeros((K, e.shape[1], e.shape[1]))
    np.add.at(squares, index, e[:, :, None] * e[:, None, :])
    gradient = np.einsum("ki,kpi->p", e, slopes)
    gradient += np.einsum("k,kpii->p", weights, spreads) / 2
    gradient -= np.einsum("kpij,kij->p", spreads, squares) / 2
    p = slopes.shape[1]
    first = slopes.transpose(1, 0, 2).reshape(p, -1)
    second = (spreads * np.sqrt(weights / 2)[:, None, None, None]).transpose(1, 0, 2, 3)
    second = second.reshape(p, -1)
    return Local(minus_log_likelihood(run), gradient, first @ first.T + second @ second.T)


def _sensitivities(
    run: Filtered, model: Noisy, directions: Directions, states: Matrix, inputs: Matrix
) -> tuple[Stack, Stack]:
    """Return derivatives of the innovations (N, p, n) and of their covariances (K, p, n, n)."""
    identity = np.eye(len(model.A))
    dA, dR = directions.A, directions.r[:, :, None] * identity
    dQ = directions.q[:, :, None] * identity
    A, R = model.A, np.diag(model.r)
    # One matrix a filter step and parameter; the gain is optimal: to first order its own change
    # does not change P.
    M = (A - run.gains)[:, None]
    K, P = run.gains[:, None], run.P[:, None]
    added = _plus_transposed(dA @ P @ _transposed(M)) + K @ dR @ _transposed(K) + dQ
    dP = np.empty_like(added)
    dP[0] = _plus_transposed(dA @ R @ A.T) + A @ dR @ A.T + dQ
    for k in range(len(run.P) - 1):
        dP[k + 1] = M[k] @ dP[k] @ M[k, 0].T + added[k]
    spreads = dP + dR
    dgains = (dA @ P + A @ dP - K @ spreads) @ np.linalg.inv(run.S)[:, None]
    length, last, p = len(run), len(run.S) - 1, len(dA)
    forcing = np.einsum("pij,kj->kpi", dA, run.predicted)
    forcing[: last + 1] += np.einsum("kpij,kj->kpi", dgains, run.errors[: last + 1])
    forcing[last + 1 :] += np.einsum("pij,kj->kpi", dgains[last], run.errors[last + 1 :])
    driven = np.einsum("pij,kj->kpi", directions.B, inputs)
    slopes = np.empty((length, p, len(A)))
    dx = dA @ states[0] + driven[0]
    transitions = np.swapaxes(A - run.gains, 1, 2)
    for k in range(length):
        slopes[k] = -dx
        if k + 1 < length:
            dx = dx @ transitions[min(k, last)] + forcing[k] + driven[k + 1]
    return slopes, spreads


def _transposed(stack: Stack) -> Stack:
    return np.swapaxes(stack, -1, -2)


def _plus_transposed(stack: Stack) -> Stack:
    return stack + _transposed(stack)
