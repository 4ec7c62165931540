"""Output error: the simulation itself is fitted, in windows with free initial states.

Ljung, System Identification (1999), section 7.2; multiple shooting after Bock (1983). With the
inputs known it is unbiased in closed loop as well, and it needs no measurement of any state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from identification.estimate import Estimate, ParameterEstimate
from identification.estimators.base import Estimator
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.problem import Problem

_ILL_CONDITIONED = 1e6
NOT_CONVERGED = "the fit stopped before it converged: give better starting values with --param"


@dataclass(frozen=True)
class OutputError(Estimator):
    """Windowed output error through windows of growing length.

    Args:
        start: Values to start from; None for those of the problem.
    """

    method: ClassVar[str] = "output-error"
    start: Mapping[str, float] | None = None

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters and every window's initial state."""
        experiment = Experiment.of(problem, through_fmi=True)
        fit = experiment.fit_stages(self.start)[-1]
        return estimate_of(problem, fit, self.method)


def estimate_of(problem: Problem, fit: Fit, method: str) -> Estimate:
    """Return a fit as an estimate, with warnings about what is doubtful."""
    variables = problem.dae.variables
    sd = np.sqrt(np.diag(fit.covariance))
    parameters = {
        name: ParameterEstimate(
            fit.values[name], float(sd[k]), variables[name].unit, name not in fit.held
        )
        for k, name in enumerate(fit.free)
    }
    return Estimate(
        method=method,
        parameters=parameters,
        covariance=fit.covariance,
        condition_number=fit.condition_number,
        warnings=tuple(_warnings(problem, fit)),
        details=MappingProxyType({"fit": fit}),
    )


def _warnings(problem: Problem, fit: Fit) -> list[str]:
    found = [
        f"{name} has no effect that this record shows; it is held at {fit.values[name]:.6g}: "
        "excite what it acts on, or declare it known"
        for name in sorted(fit.held)
    ]
    if not fit.converged:
        found.append(NOT_CONVERGED)
    found += [
        f"{a} and {b} cannot be told apart in this record (correlation {value:+.5f}): "
        "excite them differently, or hold one with --free"
        for a, b, value in correlated(fit)
    ]
    if fit.condition_number > _ILL_CONDITIONED:
        found.append(
            f"the condition number is {fit.condition_number:.1e}: some combination of the "
            "parameters is not determined"
        )
    for name in fit.free:
        variable = problem.dae.variables[name]
        for word, bound in (("lower", variable.minimum), ("upper", variable.maximum)):
            if bound is not None and fit.values[name] == problem.dae.number(bound, np.nan):
                found.append(
                    f"{name} is at the {word} bound of its range: the model or the range is wrong"
                )
    return found


def correlated(fit: Fit, limit: float = 0.9999) -> list[tuple[str, str, float]]:
    """Return the pairs of parameters whose estimates move together beyond a limit."""
    sd = np.sqrt(np.diag(fit.covariance))
    pairs: list[tuple[str, str, float]] = []
    for i, a in enumerate(fit.free):
        for j in range(i):
            value = float(fit.covariance[i, j] / (sd[i] * sd[j]))
            if np.isfinite(value) and abs(value) > limit:
                pairs.append((fit.free[j], a, value))
    return pairs
