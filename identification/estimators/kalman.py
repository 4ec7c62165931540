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
from identification.estimators.output_error import NOT_CONVERGED, estimate_of
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.innovations import (
    Disturbance,
    disturbed_values,
    with_input_disturbances,
)
from identification.likelihood import Likelihood, Maximum, maximise
from identification.problem import Problem, Vector

_RATES = (0.3, 1.0, 3.0, 10.0, 30.0)
_SHARES = (0.0003, 0.001, 0.003, 0.01, 0.03)  # of an input's own standard deviation
_WORTH = 3.0  # nats that a disturbance must bring for its two numbers
_CLEAR = 50.0  # nats at which it is there whatever the parameters
_WHITE = (0.8, 1.25)


@dataclass(frozen=True)
class Kalman(Estimator):
    """Maximum likelihood over the innovations, from output error's estimate.

    Args:
        rates: Rates [1/s] at which disturbances are looked for.
    """

    method: ClassVar[str] = "kalman"
    rates: Sequence[float] = _RATES

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters and the disturbances' numbers."""
        check_equations(problem.dae)
        experiment = Experiment.of(problem)
        fit = experiment.fit_stages(best_start(experiment).values)[-1]
        rough = estimate_of(problem, fit, self.method)
        return refined(problem, rough, fit.values, self.rates)


def refined(
    problem: Problem, rough: Estimate, values: Mapping[str, float], rates: Sequence[float] = _RATES
) -> Estimate:
    """Return the maximum of the likelihood that is reached from an output-error estimate.

    Raises:
        DivergenceError: The filter leaves the finite numbers.
    """
    seen = tuple(name for name in problem.free if rough.parameters[name].identifiable)
    if not seen:
        return rough
    maximum = most_likely(replace(problem, free=seen), values, rates)
    return _estimate(problem, rough, maximum)


def most_likely(
    problem: Problem, values: Mapping[str, float], rates: Sequence[float] = _RATES
) -> Maximum:
    """Return the maximum of the likelihood, with a disturbance at the inputs if there is one.

    Disturbances of several rates and sizes are tried with the parameters held. One that is not
    clearly there is tried again with parameters that are best without; one that seems to be, and
    with which the likelihood does not reach its maximum, is weighed against none from there.

    Raises:
        DivergenceError: The filter leaves the finite numbers from every start.
    """
    dae, names = with_input_disturbances(problem.dae)
    start = disturbed_values({**problem.values, **values}, names)
    likelihood = Likelihood.of(replace(problem, dae=dae, values=start), names)
    none = [Disturbance(rates[0], 0.0)] * len(names)
    begun, gain = _promising(likelihood, start, rates)
    without: Maximum | None = None
    if gain < _CLEAR:
        without = maximise(likelihood, start, none)
        begun, gain = _promising(likelihood, without.values, rates)
        if gain < _WORTH:
            return _finite(problem, without)
        start = dict(without.values)
    found = maximise(likelihood, start, begun)
    if without is None and not found.converged:
        # Where a disturbance only made up for the start, the way to none is long and flat.
        without = maximise(likelihood, found.values, none)
    if without is not None and not found.log_likelihood > without.log_likelihood + _WORTH:
        found = without
    return _finite(problem, found)


def _promising(
    likelihood: Likelihood, values: Mapping[str, float], rates: Sequence[float]
) -> tuple[list[Disturbance], float]:
    """Return the best of the disturbances tried, and what it gains over none [nats]."""
    spread = np.maximum(np.std(likelihood.problem.inputs, axis=0), 1e-6)

    def shaped(rate: float, share: float) -> list[Disturbance]:
        return [Disturbance(rate, float(share * size)) for size in spread]

    none = likelihood.run(values, shaped(1.0, 0.0)).log_likelihood
    rates = [rate for rate in rates if rate > likelihood.slowest]
    tried = [shaped(rate, share) for rate in rates for share in _SHARES]
    gains = [likelihood.run(values, d).log_likelihood for d in tried]
    if not tried or len(spread) == 0:
        return [], 0.0
    best = int(np.argmax(gains))
    if not np.isfinite(gains[best]):
        return tried[best], -np.inf
    return tried[best], float(gains[best] - none)


def _finite(problem: Problem, maximum: Maximum) -> Maximum:
    seen = np.diag(maximum.information)[: len(maximum.free)]
    if not (np.isfinite(maximum.log_likelihood) and np.all(np.isfinite(seen)) and np.all(seen > 0)):
        raise DivergenceError(
            f"the filter of {problem.dae.name} leaves the finite numbers",
            remedy="check units and signs of the inputs, or use --method output-error",
        )
    return maximum


def _estimate(problem: Problem, rough: Estimate, maximum: Maximum) -> Estimate:
    # Innovations larger than predicted speak for more doubt than the likelihood knows of.
    larger = max(1.0, float(np.mean(maximum.innovations.normalised**2)))
    maximum = replace(maximum, covariance=larger * maximum.covariance)
    sd = dict(zip(maximum.free, np.sqrt(np.diag(maximum.covariance)), strict=True))
    parameters = {
        name: ParameterEstimate(maximum.values[name], float(sd[name]), p.unit) if name in sd else p
        for name, p in rough.parameters.items()
    }
    covariance = np.full_like(rough.covariance, np.nan)
    np.fill_diagonal(covariance, np.inf)
    index = [list(rough.parameters).index(name) for name in maximum.free]
    covariance[np.ix_(index, index)] = maximum.covariance
    scale = np.sqrt(np.maximum(np.diag(maximum.information), 1e-300))
    eigenvalues = np.linalg.eigvalsh(maximum.information / np.outer(scale, scale))
    return replace(
        rough,
        parameters=parameters,
        covariance=covariance,
        condition_number=float(np.sqrt(eigenvalues[-1] / max(eigenvalues[0], 1e-300))),
        warnings=(*(w for w in rough.warnings if w != NOT_CONVERGED), *_doubts(problem, maximum)),
        details=MappingProxyType({"maximum": maximum}),
    )


def explains_all(maximum: Maximum) -> bool:
    """Tell whether the innovations of every channel are as large as predicted."""
    squares = _squares(maximum)
    return bool(np.all((squares > _WHITE[0]) & (squares < _WHITE[1])))


def _squares(maximum: Maximum) -> Vector:
    return np.mean(maximum.innovations.normalised**2, axis=0)


def _doubts(problem: Problem, maximum: Maximum) -> list[str]:
    doubts: list[str] = []
    for name, value in zip(problem.output_names, _squares(maximum), strict=True):
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
