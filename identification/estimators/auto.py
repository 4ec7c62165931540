"""The default: filtered regression to start from, output error to finish."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.estimators.output_error import estimate_of
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.problem import Problem


class Auto(Estimator):
    """Output error from the better of the declared values and the filter's estimate."""

    method: ClassVar[str] = "auto"

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters."""
        experiment = Experiment.of(problem)
        start = best_start(experiment)
        fit = experiment.fit_stages(start.values)[-1]
        found = estimate_of(problem, fit, self.method)
        return replace(found, details={**found.details, "start": start})
