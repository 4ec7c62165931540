"""Instrumental variables on filtered equations, consistent in closed loop as well.

Least squares asks for residuals orthogonal to the columns, which hold the same noise. Instruments Z
hold none of it: Zᵀ(y - A θ) = 0 (T. Söderström, P. Stoica, Instrumental Variable Methods for System
Identification, 1983). In closed loop that is not easily had: the controller carries the sensors'
noise into the input, and by it into everything the plant does *later*. Therefore

- the equations are filtered backwards in time (`OutputFilter.apply_backwards`): their error at t
  holds the sensors' noise from t on;
- instruments are filtered forwards: they hold noise up to t, and nothing later.

White sensor noise is then on one side of t only, whatever the controller makes of it, and neither
the reference nor the controller need be known.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from foundation.errors import ExcitationError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.estimators.filtered_least_squares import (
    FilteredLeastSquares,
)
from identification.output_filter import Array, OutputFilter, correlated_samples
from identification.problem import Problem
from identification.regressors import Regression
from identification.regressors.least_squares import (
    Reduced,
    Reduction,
    Solution,
    solve,
    to_estimate,
)
from identification.regressors.signals import Rows, filtered_rows

_LAGS = (0.0, 1.0, 2.0, 4.0)  # of the instruments, in units of τ
_SAMPLES = 5  # for each instrument, at least


@dataclass(frozen=True)
class Instruments(Estimator):
    """What methods with instrumental variables share.

    Args:
        tau: Time constants τ1, τ2 of the filter [s]; None: see `FilteredLeastSquares`.
        delay: Samples between the newest measurement in an instrument and the oldest in the
            equation's error; more than one where the sensors' noise is coloured.
    """

    tau: tuple[float, float] | None = None
    delay: int = 1

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model has no linear regression in recorded signals.
            ExcitationError: The record is too short or shows none of the parameters.
            DivergenceError: A term is not finite on the record.
        """
        made = FilteredLeastSquares(tau=self.tau).prepare(problem)
        regression, tau = made.regression, made.tau
        equations = _backward_rows(regression, problem, tau)
        solution, doubts = self.solve(problem, regression, equations, tau)
        return to_estimate(
            self.method,
            problem.dae,
            regression,
            replace(solution, warnings=(*solution.warnings, *doubts)),
            problem.values,
            made.details(problem),
        )

    @abstractmethod
    def solve(
        self, problem: Problem, regression: Regression, equations: Rows, tau: tuple[float, float]
    ) -> tuple[Solution, list[str]]:
        """Solve the equations with this method's instruments; also return warnings."""

    def with_measured(
        self, problem: Problem, regression: Regression, equations: Rows, tau: tuple[float, float]
    ) -> Solution:
        """Solve with the measured columns, filtered forwards and delayed."""
        columns = forward_columns(regression, problem, tau)
        instruments = _delayed(columns, self.delay)
        return self.with_instruments(problem, regression, equations, tau, instruments)

    def with_instruments(
        self,
        problem: Problem,
        regression: Regression,
        equations: Rows,
        tau: tuple[float, float],
        instruments: Array,
    ) -> Solution:
        """Solve with given instruments (m, n, columns), and what they were some τ ago.

        Between a column filtered backwards and one filtered forwards lies a phase that depends on
        frequency; instruments of several delays together make up for it.
        """
        n, k = instruments.shape[1:]
        if n < _SAMPLES * k * len(_LAGS):
            raise ExcitationError(
                f"{n} samples for {k * len(_LAGS)} instruments",
                remedy=f"record at least {_SAMPLES * k * len(_LAGS)}",
            )
        steps = [round(lag * max(tau) / problem.sample_time) for lag in _LAGS]
        instruments = np.concatenate([_delayed(instruments, k) for k in steps], axis=2)
        return solve(
            regression,
            equations,
            problem.values,
            correlation=correlated_samples(tau, problem.sample_time),
            reduction=_projected(instruments),
        )


def _delayed(columns: Array, samples: int) -> Array:
    """Return (m, n, k) columns as they were some samples ago, zero before the record."""
    samples = min(samples, columns.shape[1])
    return np.concatenate(
        [np.zeros_like(columns[:, :samples]), columns[:, : columns.shape[1] - samples]], axis=1
    )


def forward_columns(regression: Regression, problem: Problem, tau: tuple[float, float]) -> Array:
    """Return the columns (m, n, k) of a record, filtered forwards."""
    return FilteredLeastSquares().rows(regression, problem, tau).matrix


def _backward_rows(regression: Regression, problem: Problem, tau: tuple[float, float]) -> Rows:
    output_filter = OutputFilter(*tau, problem.sample_time)

    def operator(start: Array, end: Array, order: int) -> Array:
        return output_filter.apply_backwards(start, end, order=order)

    transients = output_filter.transients(len(problem.time))[::-1]
    return filtered_rows(regression, problem, operator, transients)


def _projected(instruments: Array) -> Reduction:
    """Two-stage least squares: the columns are replaced by their projection on the instruments."""

    def reduction(matrix: Array, right: Array) -> Callable[[Array], Reduced]:
        m, n, k = matrix.shape

        def reduced(weights: Array) -> Reduced:
            w = weights[:, None, None]
            z = (w * instruments).reshape(m * n, -1)
            norms = np.linalg.norm(z, axis=0)
            q, r = np.linalg.qr(z / np.where(norms > 0, norms, 1.0))
            # A column without an instrument of its own gives no direction.
            q = q[:, np.abs(np.diag(r)) > 1e-12]
            factor = q.T @ (w * matrix).reshape(m * n, k)
            target = q.T @ (weights[:, None] * right).reshape(m * n)
            return Reduced(factor, target, (q @ factor).reshape(m, n, k))

        return reduced

    return reduction
