"""Where a fit starts: the declared values or those of a filtered regression."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foundation.errors import TwinproofError
from identification.estimators.delayed_instruments import DelayedInstruments
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.experiment import STAGES, Experiment
from identification.gauss_newton import fit
from identification.prediction import WINDOW


@dataclass(frozen=True)
class Start:
    """Starting values and where they come from.

    Attributes:
        values: Every independent parameter.
        origin: `declared`, or the word of the method they come from.
        reason: Why no method's estimate was used, if none was.
    """

    values: Mapping[str, float]
    origin: str
    reason: str = ""


_NOISY = 0.1  # share of noise in the filtered record at which instruments are worth a try


def best_start(experiment: Experiment) -> Start:
    """Return the best start for an output-error fit.

    The declared values, those of the output filter and, where noise biases these, those of
    instrumental variables are compared by their cost over the shortest windows of the continuation,
    initial states fitted, parameters held.
    """
    problem = experiment.problem
    declared = dict(problem.values)
    starts = {"declared": declared}
    reason = "the declared values explain the record better"
    try:
        filtered = FilteredLeastSquares().estimate(problem)
        starts[filtered.method] = {**declared, **_inside(experiment, filtered.values)}
        if filtered.details["noise_share"] > _NOISY:
            unbiased = DelayedInstruments().estimate(problem)
            starts[unbiased.method] = {**declared, **_inside(experiment, unbiased.values)}
    except TwinproofError as error:
        reason = str(error)
    if len(starts) == 1:
        return Start(declared, "declared", reason)
    sd = np.fmax(np.std(problem.outputs, axis=0), 1e-300) * 1e-3
    windows = experiment.cut(STAGES[0] * WINDOW)
    costs = {
        origin: fit(
            problem,
            experiment.shooting,
            windows,
            experiment.guess(windows),
            values,
            free=(),
            fixed_sd=sd,
            iterations=4,
        ).at.cost
        for origin, values in starts.items()
    }
    best = min(costs, key=lambda origin: costs[origin])
    return Start(starts[best], best, reason if best == "declared" else "")


def _inside(experiment: Experiment, values: Mapping[str, float]) -> dict[str, float]:
    """Keep a start within the declared ranges."""
    dae = experiment.problem.dae
    return {
        name: float(
            np.clip(
                value,
                dae.number(dae.variables[name].minimum, -np.inf),
                dae.number(dae.variables[name].maximum, np.inf),
            )
        )
        for name, value in values.items()
        if name in dae.variables
    }
