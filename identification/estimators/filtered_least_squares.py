"""The output-filtering method: least squares on equations of motion that have been filtered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foundation.errors import ExcitationError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.output_filter import OutputFilter
from identification.problem import Problem
from identification.regressors import derive
from identification.regressors.least_squares import solve, to_estimate
from identification.regressors.signals import filtered_rows


@dataclass(frozen=True)
class FilteredLeastSquares(Estimator):
    tau: tuple[float, float] | None = None
    initial_columns: bool = True

    method: ClassVar[str] = "output-filter"

    def estimate(self, problem: Problem) -> Estimate:
        regression = derive(
            problem.dae, free=problem.free, values=problem.values, measured=problem.output_names
        )
        tau = self.tau
        assert tau
        filter_ = OutputFilter(*tau, problem.sample_time)
        n = len(problem.time)
        rows = filtered_rows(
            regression, problem,
            lambda start, end, order: filter_.apply(start, end, order=order),
            filter_.transients(n) if self.initial_columns else np.zeros((n, 0)),
        )
        if not self.initial_columns:
            skip = int(np.ceil(10 * max(tau) / problem.sample_time))
            from dataclasses import replace
            rows = replace(rows, matrix=rows.matrix[:, skip:], right=rows.right[:, skip:], nuisance=rows.nuisance[skip:])
        solution = solve(regression, rows, problem.values, correlation=int(4 * sum(tau) / problem.sample_time))
        return to_estimate(self.method, problem.dae, regression, solution, problem.values, {"tau": tau})
