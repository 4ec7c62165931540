"""The default: filtered regression to start from, output error, and the Kalman filter to finish.

Each serves the next. Filtered regression needs no start; output error from there forgives a wrong
model, and its windows an unstable plant; the Kalman filter uses all the record says of the initial
state and of unknown disturbances, and is used where it explains the record down to the noise of
known sensors. Otherwise something is missing, of which a filter would make a disturbance, and
output error's estimate stands.
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from foundation.errors import TwinproofError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.estimators.kalman import explains_all, refined
from identification.estimators.output_error import estimate_of
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.problem import Problem

_LONGEST = 500_000  # samples that the filter is run over some hundred times
_LARGE = 1.5  # residuals over the noise at which the model is in doubt


class Auto(Estimator):
    """Output error from the best start, then the Kalman filter where it explains the record.

    `details["chain"]` holds the methods that led to the answer, the last one being its own.
    """

    method: ClassVar[str] = "auto"

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters."""
        experiment = Experiment.of(problem, through_fmi=True)
        start = best_start(experiment)
        fit = experiment.fit_stages(start.values)[-1]
        rough = estimate_of(problem, fit, self.method)
        chain = (start.origin, "output-error")
        found, doubts = _finished(problem, rough, fit)
        if found is not rough:
            chain = (*chain, "kalman")
        details = {**rough.details, **found.details, "start": start, "chain": chain}
        return replace(
            found, warnings=(*found.warnings, *doubts), details=MappingProxyType(details)
        )


def _finished(problem: Problem, rough: Estimate, fit: Fit) -> tuple[Estimate, list[str]]:
    """Return the filter's estimate, or output error's with what speaks against it."""
    known = problem.noise_sd > 0
    if not np.all(known):
        return rough, []
    larger = fit.at.rms / problem.noise_sd
    doubts = [
        f"{name} is off by {ratio:.2g} times its sensor's noise: the model lacks an effect (try "
        "diagnose), a disturbance acts, or the sensor is noisier than stated"
        for name, ratio in zip(problem.output_names, larger, strict=True)
        if ratio > _LARGE
    ]
    if problem.inputs.shape[1] == 0 or len(problem.time) > _LONGEST:
        return rough, doubts
    try:
        found = refined(problem, rough, fit.values)
    except TwinproofError:
        return rough, doubts
    if "maximum" not in found.details or not explains_all(found.details["maximum"]):
        return rough, doubts
    return found, []
