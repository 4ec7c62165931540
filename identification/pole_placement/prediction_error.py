"""Prediction error: the most likely A and B, with the noise's variances beside them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from foundation.errors import DivergenceError
from identification.pole_placement.base import (
    Method,
    RowMethod,
    Solution,
    column_scales,
    require_rank,
    rows_of,
)
from identification.pole_placement.gains import Poles, gain
from identification.pole_placement.kalman import (
    Directions,
    Local,
    Noisy,
    linearise,
    minus_log_likelihood,
    run_filter,
)
from identification.pole_placement.noise import known_variances, noise_variances
from identification.pole_placement.samples import Matrix, Samples, Vector, floats
from identification.pole_placement.two_step import TwoStep, regress

_FLOOR = 1e-14
"""Least variance of any noise, in units of the state's mean square: arithmetic's share."""
_ROUNDS = 60
_TRIES = 9
_TOLERANCE = 1e-2
"""Log likelihood that a further step promises at which to stop: a tenth of a standard deviation."""
_PRIOR = 1e-9
_NEAR = 0.3
_LARGEST_DROP, _LARGEST_RISE = -0.9, 20.0


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Minus log likelihood of scaled samples as a function of θ = [A B] and log variances.

    Variances are floor + exp(θ): a noise that is absent goes to minus infinity and does no harm.

    Attributes:
        states: (N+1, n) in units of their root mean squares.
        inputs: (N, m) likewise.
        known: (n,) variances of measurement noise that are known, NaN where not, scaled.
    """

    states: Matrix
    inputs: Matrix
    known: Vector

    @property
    def shape(self) -> tuple[int, int]:
        """Of [A B]."""
        n = self.states.shape[1]
        return n, n + self.inputs.shape[1]

    @property
    def size(self) -> int:
        """Number of entries of [A B]."""
        n, k = self.shape
        return n * k

    def vector(self, A: Matrix, B: Matrix, r: Vector, q: Vector) -> Vector:
        """Return θ of a model and its variances."""
        free = np.concatenate([q, r[np.isnan(self.known)]])
        logs = np.log(np.maximum(free, 10 * _FLOOR))
        return np.concatenate([np.hstack([A, B]).ravel(), logs])

    def model(self, theta: Vector) -> Noisy:
        """Return the model of θ."""
        n, _ = self.shape
        entries = theta[: self.size].reshape(self.shape)
        variances = _FLOOR + np.exp(theta[self.size :])
        r = self.known.copy()
        r[np.isnan(self.known)] = variances[n:]
        return Noisy(entries[:, :n], entries[:, n:], variances[:n], r)

    def directions(self, theta: Vector) -> Directions:
        """Return the derivatives of the model with respect to θ."""
        n, k = self.shape
        slopes = np.diag(np.exp(theta[self.size :]))
        entries = np.zeros((theta.size, n, k))
        entries[: self.size] = np.eye(self.size).reshape(self.size, n, k)
        q, r = np.zeros((2, theta.size, n))
        q[self.size :] = slopes[:, :n]
        r[self.size :, np.isnan(self.known)] = slopes[:, n:]
        return Directions(entries[:, :, :n], entries[:, :, n:], q, r)

    def value(self, theta: Vector) -> float:
        """Return minus the log likelihood, infinite where the filter does not run."""
        try:
            run = run_filter(self.model(theta), self.states, self.inputs)
            return minus_log_likelihood(run)
        except DivergenceError:
            return np.inf

    def local(self, theta: Vector) -> Local:
        """Return value, gradient and Fisher's information.

        Raises:
            DivergenceError: The filter does not run with this model.
        """
        return linearise(self.model(theta), self.directions(theta), self.states, self.inputs)


@dataclass(frozen=True, eq=False)
class Scaled:
    """Samples in units of their root mean squares, and the way back.

    Attributes:
        likelihood: Of the scaled samples.
        state_scales: (n,).
        input_scales: (m,).
    """

    likelihood: Likelihood
    state_scales: Vector
    input_scales: Vector

    @classmethod
    def of(cls, samples: Samples) -> Scaled:
        """Scale samples."""
        sx, su = column_scales(samples.states), column_scales(samples.inputs)
        known = np.maximum(known_variances(samples) / sx**2, _FLOOR)
        return cls(Likelihood(samples.states / sx, samples.inputs / su, known), sx, su)

    @property
    def factors(self) -> Matrix:
        """What an entry of the scaled [A B] is multiplied with to be one of the samples'."""
        return self.state_scales[:, None] / np.concatenate([self.state_scales, self.input_scales])

    def vector(self, A: Matrix, B: Matrix, samples: Samples) -> Vector:
        """Return θ of a model of the samples, its variances estimated from its residual."""
        r, q = noise_variances(samples, A, B)
        scaled = np.hstack([A, B]) / self.factors
        n, square = len(A), self.state_scales**2
        # A trace of the residual is put down to either noise: neither starts out impossible.
        residual = samples.states[1:] - samples.states[:-1] @ A.T - samples.inputs @ B.T
        least = 1e-6 * np.mean(residual**2, axis=0)
        r, q = np.maximum(r, least), np.maximum(q, least)
        return self.likelihood.vector(scaled[:, :n], scaled[:, n:], r / square, q / square)


@dataclass(frozen=True)
class PredictionError(Method):
    """Maximum likelihood of one-step predictions by a Kalman filter.

    Estimates A, B, the variances of process and of measurement noise (the sensors' own, where
    known). Serves noisy states of any signal-to-noise ratio, closed loop or not: the filter's
    innovations are independent of earlier inputs (Ljung, "System Identification", 2nd ed., 1999,
    sections 7.4 and 13.4). Trust-region steps with Fisher's information.

    Attributes:
        start: Gives the model to start from.
    """

    word: ClassVar[str] = "prediction-error"
    start: RowMethod = field(default_factory=lambda: TwoStep(prefilter=1))

    def solve(self, samples: Samples, poles: Poles) -> Solution:
        """Fit the model and place the poles."""
        rows = self.start.rows(samples)
        require_rank(rows_of(samples), samples)
        scaled = Scaled.of(samples)
        return self.refine(scaled, scaled.vector(*regress(rows), samples), poles)

    def refine(self, scaled: Scaled, theta: Vector, poles: Poles) -> Solution:
        """Return the most likely solution, from a start.

        Raises:
            DivergenceError: The iteration left the finite numbers.
        """
        likelihood = scaled.likelihood
        theta, local, converged = descend(likelihood, theta)
        n, k = likelihood.shape
        model = theta[: n * k].reshape(n, k) * scaled.factors
        everything = np.ones(theta.size, bool)
        covariance = Scoring.at(local, everything).covariance()[: n * k, : n * k]
        factors = scaled.factors.ravel()
        notes = () if converged else ("prediction error stopped before it converged",)
        A, B = model[:, :n], model[:, n:]
        return Solution(
            A, B, gain(A, B, poles), covariance * factors[:, None] * factors[None, :], notes
        )


@dataclass(frozen=True, eq=False)
class Scoring:
    """Gradient and information of some parameters, each in units of its own information.

    Attributes:
        scale: (p,) square roots of the informations.
        slope: (p,).
        information: (p, p), ones on the diagonal but for a trace of prior, which keeps directions
            that the data do not see where they are.
    """

    scale: Vector
    slope: Vector
    information: Matrix

    @classmethod
    def at(cls, local: Local, free: NDArray[np.bool_]) -> Scoring:
        """Scale what is known at a point."""
        scale = np.sqrt(np.diag(local.information)[free] + 1e-6)
        information = local.information[np.ix_(free, free)] / scale / scale[:, None]
        return cls(scale, local.gradient[free] / scale, information + _PRIOR * np.eye(scale.size))

    def step(self, damping: float) -> Vector:
        """Return the step of scoring, damped by a multiple of the information's diagonal."""
        damped = self.information + damping * np.eye(self.scale.size)
        return floats(-np.linalg.solve(damped, self.slope)) / self.scale

    def promised(self) -> float:
        """Return twice the log likelihood that an undamped step is to gain."""
        return float(-self.slope @ (self.step(0.0) * self.scale))

    def covariance(self) -> Matrix:
        """Return the inverse of the information."""
        return floats(np.linalg.inv(self.information)) / self.scale / self.scale[:, None]

    def is_top(self, size: int) -> bool:
        """Whether an undamped step moves the first `size` parameters by little of their sd."""
        sd = np.sqrt(np.abs(np.diag(self.covariance())[:size]))
        return bool(np.all(np.abs(self.step(0.0)[:size]) < _NEAR * sd))


def descend(likelihood: Likelihood, theta: Vector) -> tuple[Vector, Local, bool]:
    """Return the most likely θ from a start, the likelihood there, and whether [A B] is settled.

    Fisher's scoring with Levenberg–Marquardt damping. A variance that is e times too great would
    shrink by one e a step in its logarithm; the step is made in the variance, where it is exact. A
    noise that is absent stays at the floor.

    Raises:
        DivergenceError: The filter does not run at the start.
    """
    damping, size = 1e-3, likelihood.size
    local = likelihood.local(theta)
    for _ in range(_ROUNDS):
        absent = (theta <= np.log(_FLOOR)) & (local.gradient > 0)
        absent[:size] = False
        scoring = Scoring.at(local, ~absent)
        if scoring.promised() < _TOLERANCE:
            return theta, local, True
        for _ in range(_TRIES):
            step = np.zeros(theta.size)
            step[~absent] = scoring.step(damping)
            trial = _moved(theta, step, size)
            if likelihood.value(trial) < local.value:
                break
            damping = 10 * max(damping, 1e-4)
        else:
            return theta, local, scoring.is_top(size)
        theta, damping = trial, damping / 10
        local = likelihood.local(theta)
    everything = np.ones(theta.size, bool)
    return theta, local, Scoring.at(local, everything).is_top(size)


def _moved(theta: Vector, step: Vector, size: int) -> Vector:
    moved = theta + step
    relative = np.clip(step[size:], _LARGEST_DROP, _LARGEST_RISE)
    moved[size:] = np.clip(theta[size:] + np.log1p(relative), np.log(_FLOOR) - 1, 20.0)
    return moved
