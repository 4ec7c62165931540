"""Instrumental variables simulated with the model itself, refined from those of the past."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from foundation.errors import TwinproofError
from identification.estimators.instruments import Instruments, forward_columns
from identification.output_filter import Array
from identification.prediction import predict
from identification.problem import Problem
from identification.regressors import Regression
from identification.regressors.least_squares import Solution
from identification.regressors.signals import Rows
from identification.shooting import Shooting

_ITERATIONS = 3
_WINDOW = 1.0
_FEWEST = 0.5  # share of the record that a simulation must follow
_NEAR = 3.0  # standard deviations of the measurement within which it does
_LEAD = 5.0  # time constants that the filter runs before a window


@dataclass(frozen=True)
class SimulatedInstruments(Instruments):
    """Instrumental variables from simulations of the model with the last estimate (`instruments`).

    Where noise is white these are not better than the measured ones of `DelayedInstruments` (they
    start from a noisy state); where it is coloured, or a sensor far worse than the model, they are.
    The record is simulated in windows; each estimates its initial state from its first tenth, and
    only what comes after that is used, so that the instruments hold nothing of the future. The
    first estimate has the measured columns of the past as instruments.

    Args:
        iterations: How often the simulation is renewed.

    Example:
        >>> SimulatedInstruments().method
        'simulated-instruments'
    """

    iterations: int = _ITERATIONS

    method: ClassVar[str] = "simulated-instruments"

    def solve(
        self, problem: Problem, regression: Regression, equations: Rows, tau: tuple[float, float]
    ) -> tuple[Solution, list[str]]:
        """Solve with simulated columns, again and again."""
        solution = self.with_measured(problem, regression, equations, tau)
        try:
            shooting = Shooting.of(problem, ())
            for _ in range(self.iterations):
                instruments = _simulated(problem, shooting, regression, solution.values, tau)
                if instruments is None:
                    return solution, [
                        "the simulation runs away from the record even over windows of "
                        f"{_WINDOW:g} s, so the instruments are measured, not simulated: the model "
                        "may lack an effect (try diagnose), or an input have the wrong sign"
                    ]
                solution = self.with_instruments(problem, regression, equations, tau, instruments)
        except TwinproofError as error:
            return solution, [f"instruments are measured, not simulated: {error}"]
        return solution, []


def _simulated(
    problem: Problem,
    shooting: Shooting,
    regression: Regression,
    values: Mapping[str, float],
    tau: tuple[float, float],
) -> Array | None:
    """Return (m, n, k) instruments, zero where none are to be had; None if nearly nowhere."""
    prediction = predict(problem, shooting, values, _WINDOW)
    spread = np.std(problem.outputs, axis=0) + 1e-300
    near = np.all(np.abs(prediction.error) < _NEAR * spread, axis=1)
    lead = round(_LEAD * max(tau) / problem.sample_time)
    instruments, used = [], 0
    for window in prediction.windows:
        # The filter runs over what was measured before, so that it does not see the jump from the
        # end of one simulation to the beginning of the next.
        first = max(0, window.begin - lead)
        part = problem.part(first, window.end)
        inside = slice(window.begin, window.end)
        if np.all(near[inside]):
            outputs = part.outputs.copy()
            outputs[window.begin - first :] = prediction.simulated[inside]
            columns = forward_columns(regression, replace(part, outputs=outputs), tau)
            instruments.append(
                columns[:, window.begin - first :] * prediction.scored[inside][:, None]
            )
            used += len(window)
        else:
            m, k = len(regression.known), len(regression.columns)
            instruments.append(np.zeros((m, len(window), k)))
    if used < _FEWEST * len(problem.time):
        return None
    return np.concatenate(instruments, axis=1)
