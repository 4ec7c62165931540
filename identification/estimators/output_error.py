"""Output error: the simulation itself is fitted, in windows with free initial states.

Ljung, System Identification (1999), section 7.2; multiple shooting after Bock (1983). With the
inputs known it is unbiased in closed loop as well, and it needs no measurement of any state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from identification.estimate import Estimate, ParameterEstimate
from identification.estimators.base import Estimator
from identification.experiment import Experiment, fit_stages
from identification.gauss_newton import Fit
from identification.priors import NO_PRIORS, Prior, check_priors
from identification.problem import Problem

_ILL_CONDITIONED = 1e6
_DOMINANT = 0.9  # of a prior's sd that, if it is left, says that the record added nothing
_WIDER = 1.1  # of a prior's sd: no record can take away from it, only a wrong model
_CONTRADICTED = 4.0  # standard deviations
NOT_CONVERGED = "the fit stopped before it converged: give better starting values with --param"


@dataclass(frozen=True)
class OutputError(Estimator):
    """Windowed output error through windows of growing length.

    Args:
        start: Values to start from; None for those of the problem.
        priors: What is known of fitted parameters beforehand.
    """

    method: ClassVar[str] = "output-error"
    start: Mapping[str, float] | None = None
    priors: Mapping[str, Prior] = field(default_factory=lambda: NO_PRIORS)

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters and every window's initial state."""
        return self.estimate_together([problem])

    def estimate_together(self, problems: Sequence[Problem]) -> Estimate:
        """Fit parameters common to several records of one machine; each has its own weights.

        Args:
            problems: Of the same model, with the same channels and free parameters.

        Raises:
            ChannelError: The records have not the same channels.
            InputError: A prior is of no fitted parameter, or outside its range.
        """
        first, *others = problems
        check_priors(first, self.priors)
        experiment = Experiment.of(first, through_fmi=True)
        experiments = [experiment, *(experiment.beside(other) for other in others)]
        fit = fit_stages(experiments, self.start, priors=self.priors)[-1]
        estimate = estimate_of(first, fit, self.method)
        doubtful = [*_dominated(estimate, self.priors), *_contradicted(fit, self.priors)]
        return replace(estimate, warnings=(*estimate.warnings, *doubtful))


def _dominated(estimate: Estimate, priors: Mapping[str, Prior]) -> list[str]:
    """Return which values are their priors', more or less, or no better than these."""
    found: list[str] = []
    for name, prior in priors.items():
        sd = estimate.parameters[name].sd
        change = f"(standard deviation {sd:.3g} after, {prior.sd:.3g} before)"
        if sd > _WIDER * prior.sd:
            found.append(
                f"{name} is less certain than its prior {change}: the residuals have memory, so "
                "the model lacks something; try diagnose, or hold it: --param, and not in --free"
            )
        elif sd > _DOMINANT * prior.sd:
            found.append(
                f"{name} is known from its prior, not from the record {change}: excite what it "
                "acts on"
            )
    return found


def _contradicted(fit: Fit, priors: Mapping[str, Prior]) -> list[str]:
    """Return which priors cannot be right.

    A prior (m, p²) and what all else says (z, v²) differ by z - m with variance v² + p². In terms
    of the posterior (x, s²) the squared ratio is (x - m)²/(p² - s²).
    """
    index = [k for k, name in enumerate(fit.free) if name not in fit.held]
    normal = fit.at.normal[np.ix_(index, index)]
    scale = np.sqrt(np.diag(normal))
    variances = np.diag(np.linalg.pinv(normal / np.outer(scale, scale))) / scale**2
    found: list[str] = []
    for k, variance in zip(index, variances.tolist(), strict=True):
        name = fit.free[k]
        prior = priors.get(name)
        if prior is None:
            continue
        left = max(1.0 - variance * prior.precision, 1e-9)
        distance = abs(fit.values[name] - prior.value) / (prior.sd * np.sqrt(left))
        if distance > _CONTRADICTED:
            found.append(
                f"the prior of {name} and the record contradict each other ({distance:.0f} "
                "standard deviations apart): the prior, the model or a channel's unit is wrong"
            )
    return found


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
