"""Instrumental variables made of the record itself: what was measured before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from identification.estimators.instruments import Instruments
from identification.problem import Problem
from identification.regressors import Regression
from identification.regressors.least_squares import Solution
from identification.regressors.signals import Rows


@dataclass(frozen=True)
class DelayedInstruments(Instruments):
    """Instrumental variables with the measured columns of the past (`instruments`).

    Needs no start values and no simulation. Its instruments are noisy, which costs some precision
    against simulated ones but does not bias.

    Example:
        >>> DelayedInstruments().method
        'delayed-instruments'
    """

    method: ClassVar[str] = "instrumental"

    def solve(
        self, problem: Problem, regression: Regression, equations: Rows, tau: tuple[float, float]
    ) -> tuple[Solution, list[str]]:
        """Solve with the measured columns of the past."""
        return self.with_measured(problem, regression, equations, tau), []
