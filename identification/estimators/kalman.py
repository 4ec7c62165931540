"""Kalman filter with an unknown disturbance at every input, by maximum likelihood.

Where a simulation is fitted, an unmeasured voltage of 0.02 V rms in a loop of 5 V biases parameters
by tens of per cent (the reference experiment). Here the disturbance is a state of its own, a
first-order Gauss–Markov process whose rate and size are found with the parameters; the record that
has none ends at size zero and at output error's estimate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from fmus.black_box import check_equations
from foundation.errors import DivergenceError
from identification.estimate import Estimate, ParameterEstimate
from identification.estimators.base import Estimator
from identification.estimators.output_error import estimate_of
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.innovations import (
    Disturbance,
    disturbed_values,
    with_input_disturbances,
)
from identification.likelihood import Likelihood, Maximum, maximise
from identification.problem import Problem

_RATES = (1.0, 10.0)
_SHARE = 0.01
_WHITE = (0.8, 1.25)


@dataclass(frozen=True)
class Kalman(Estimator):
    """Maximum likelihood over the innovations, from output error's estimate.

    Args:
        rates: Rates [1/s] at which the disturbances start; the best end is kept.
    """

    method: ClassVar[str] = "kalman"
    rates: Sequence[float] = _RATES

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters and the disturbances' numbers."""
        check_equations(problem.dae)
        experiment = Experiment.of(problem)
        fit = experiment.fit_stages(best_start(experiment).values)[-1]
        rough = estimate_of(problem, fit, self.method)
        seen = tuple(name for name in problem.free if rough.parameters[name].identifiable)
        if not seen:
            return rough
        maximum = most_likely(replace(problem, free=seen), fit.values, self.rates)
        return _estimate(problem, rough, maximum)


def most_likely(
    problem: Problem, values: Mapping[str, float], rates: Sequence[float] = _RATES
) -> Maximum:
    """Return the best maximum from several starts of the disturbances.

    Raises:
        DivergenceError: The filter leaves the finite numbers from every start.
    """
    dae, names = with_input_disturbances(problem.dae)
    start = disturbed_values({**problem.values, **values}, names)
    likelihood = Likelihood.of(replace(problem, dae=dae, values=start), names)
    sizes = _SHARE * np.maximum(np.std(problem.inputs, axis=0), 1e-6)
    maxima = [
        maximise(likelihood, start, [Disturbance(rate, float(sd)) for sd in sizes])
        for rate in rates
    ]
    best = max(maxima, key=lambda m: m.log_likelihood)
    if not np.isfinite(best.log_likelihood):
        raise DivergenceError(
            f"the filter of {problem.dae.name} leaves the finite numbers",
            remedy="check units and signs of the inputs, or use --method output-error",
        )
    return best


def _estimate(problem: Problem, rough: Estimate, maximum: Maximum) -> Estimate:
    sd = dict(zip(maximum.free, np.sqrt(np.diag(maximum.covariance)), strict=True))
    parameters = {
        name: ParameterEstimate(maximum.values[name], float(sd[name]), p.unit) if name in sd else p
        for name, p in rough.parameters.items()
    }
    covariance = np.full_like(rough.covariance, np.nan)
    np.fill_diagonal(covariance, np.inf)
    index = [list(rough.parameters).index(name) for name in maximum.free]
    covariance[np.ix_(index, index)] = maximum.covariance
    scale = np.sqrt(np.diag(maximum.information))
    eigenvalues = np.linalg.eigvalsh(maximum.information / np.outer(scale, scale))
    return replace(
        rough,
        parameters=parameters,
        covariance=covariance,
        condition_number=float(np.sqrt(eigenvalues[-1] / max(eigenvalues[0], 1e-300))),
        warnings=(*rough.warnings, *_doubts(problem, maximum)),
        details=MappingProxyType({"maximum": maximum}),
    )


def _doubts(problem: Problem, maximum: Maximum) -> list[str]:
    doubts: list[str] = []
    squares = np.mean(maximum.innovations.normalised**2, axis=0)
    for name, value in zip(problem.output_names, squares, strict=True):
        if not _WHITE[0] < value < _WHITE[1]:
            doubts.append(
                f"the innovations of {name} are {np.sqrt(value):.2g} times as large as predicted: "
                "its noise is other than stated, or the model lacks an effect (try diagnose)"
            )
    for v, d in zip(problem.dae.inputs, maximum.disturbances, strict=True):
        if d.sd > 0:
            doubts.append(
                f"an unknown disturbance of {d.sd:.2g} {v.unit} rms, {d.rate:.2g} 1/s wide, acts "
                f"like {v.name}"
            )
    if not maximum.converged:
        doubts.append("the likelihood had not reached its maximum: start nearer with --param")
    return doubts
