"""The output-filtering method: least squares on equations of motion that have been filtered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from foundation.errors import ExcitationError, InputError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.output_filter import Array, OutputFilter, choose_tau
from identification.problem import Problem
from identification.regressors import Regression, derive
from identification.regressors.least_squares import solve, to_estimate
from identification.regressors.signals import Rows, filtered_rows, signals

_SETTLED = 10.0  # time constants after which unknown initial values have died out
_CORRELATED = 4.0  # time constants over which filtered residuals are taken as correlated


@dataclass(frozen=True)
class FilteredLeastSquares(Estimator):
    """Least squares on filtered equations of motion.

    Every equation is passed through I(s) = 1/((τ1 s + 1)(τ2 s + 1)); accelerations become filtered
    positions or rates (C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12 (2023) 4569, with the
    corrections named in `identification.output_filter`). No iteration, no start values, no
    simulation: unstable and chaotic plants are no special case, and a start for methods that need
    one comes out.

    What it cannot do: noise in the regressors biases it towards zero, by about the square of the
    noise-to-signal ratio of the filtered accelerations times the condition number; standard
    deviations do not hold this bias. Use output error for final values.

    Args:
        tau: Time constants τ1, τ2 [s]; None chooses from the record (`choose_tau`).
        initial_columns: True lets each equation hold the filter's two transients in any amount, so
            that initial values need not be known; False discards the first 10 τ.
        use_rates: Where a rate is recorded, its derivative is the acceleration; False
            differentiates positions twice, as the paper does.

    Example:
        >>> FilteredLeastSquares(tau=(0.05, 0.08)).method
        'output-filter'
    """

    tau: tuple[float, float] | None = None
    initial_columns: bool = True
    use_rates: bool = True

    method: ClassVar[str] = "output-filter"

    def __post_init__(self) -> None:
        if self.tau is not None and not all(np.isfinite(t) and t > 0 for t in self.tau):
            raise InputError(
                f"filter time constants {self.tau} s",
                remedy="give two positive numbers of seconds",
            )

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model has no linear regression in recorded signals.
            ExcitationError: The record is too short or shows none of the parameters.
            DivergenceError: A term is not finite on the record.
        """
        regression = derive(
            problem.dae,
            free=problem.free,
            values=problem.values,
            measured=problem.output_names,
            use_rates=self.use_rates,
        )
        tau1, tau2 = self.tau if self.tau is not None else _choose(regression, problem)
        rows = self._rows(regression, problem, OutputFilter(tau1, tau2, problem.sample_time))
        solution = solve(
            regression,
            rows,
            problem.values,
            correlation=int(np.ceil(_CORRELATED * (tau1 + tau2) / problem.sample_time)),
        )
        return to_estimate(
            self.method,
            problem.dae,
            regression,
            solution,
            problem.values,
            {"tau": (tau1, tau2), "initial_columns": self.initial_columns},
        )

    def _rows(self, regression: Regression, problem: Problem, output_filter: OutputFilter) -> Rows:
        def operator(start: Array, end: Array, order: int) -> Array:
            return output_filter.apply(start, end, order=order)

        n = len(problem.time)
        if self.initial_columns:
            return filtered_rows(regression, problem, operator, output_filter.transients(n))
        rows = filtered_rows(regression, problem, operator, np.zeros((n, 0)))
        settling = _SETTLED * max(output_filter.tau1, output_filter.tau2)
        begin = int(np.ceil(settling / problem.sample_time))
        if begin >= n:
            raise ExcitationError(
                f"the record of {n * problem.sample_time:.3g} s is shorter than the filter's "
                f"settling time of {settling:.3g} s",
                remedy="choose shorter time constants, or initial_columns=True",
            )
        return replace(
            rows,
            matrix=rows.matrix[:, begin:],
            right=rows.right[:, begin:],
            nuisance=rows.nuisance[begin:],
        )


def _choose(regression: Regression, problem: Problem) -> tuple[float, float]:
    known = signals(regression, problem)
    tau = choose_tau([known[c.position] for c in regression.coordinates], problem.sample_time)
    return tau, tau
