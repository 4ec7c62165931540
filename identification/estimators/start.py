"""Where a fit starts: the declared values or those of filtered regression, whichever is better."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foundation.errors import TwinproofError
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.experiment import STAGES, Experiment
from identification.gauss_newton import fit
from identification.prediction import WINDOW


@dataclass(frozen=True)
class Start:
    """Starting values and where they come from.

    Attributes:
        values: Every independent parameter.
        origin: `declared` or `output-filter`.
        reason: Why the filter's estimate was not used, if it was not.
    """

    values: Mapping[str, float]
    origin: str
    reason: str = ""


def best_start(experiment: Experiment) -> Start:
    """Return the better start for an output-error fit.

    Both are compared by their cost over the shortest windows of the continuation, initial states
    fitted, parameters held.
    """
    problem = experiment.problem
    declared = dict(problem.values)
    try:
        filtered = {
            **declared,
            **_inside(experiment, FilteredLeastSquares().estimate(problem).values),
        }
    except TwinproofError as error:
        return Start(declared, "declared", str(error))
    sd = np.fmax(np.std(problem.outputs, axis=0), 1e-300) * 1e-3
    windows = experiment.cut(STAGES[0] * WINDOW)
    costs = [
        fit(
            problem,
            experiment.shooting,
            windows,
            experiment.guess(windows),
            values,
            free=(),
            fixed_sd=sd,
            iterations=4,
        ).at.cost
        for values in (declared, filtered)
    ]
    if costs[1] < costs[0]:
        return Start(filtered, "output-filter")
    return Start(declared, "declared", "the declared values explain the record better")


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
