"""The contract of an estimator.

A new estimator
1. subclasses `Estimator` in a file of its own and sets `method`, its word in `--method`;
2. implements `estimate(problem)`: a pure function of the problem, random only through a seed that
   is a field of the estimator;
3. raises `UnsupportedModelError` for models it cannot serve, `ExcitationError` for data that cannot
   answer, `DivergenceError` if it left the finite numbers; it never returns NaN as a value;
4. reports a parameter that the data do not see as `identifiable=False` at its start value;
5. is named in `tests/identification/test_conformance.py`, which then runs the suite on it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from identification.estimate import Estimate
from identification.problem import Problem


class Estimator(ABC):
    """From a problem to parameters with standard deviations."""

    method: ClassVar[str]

    @abstractmethod
    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model is outside what this method can serve.
            ExcitationError: The data cannot answer.
            DivergenceError: The iteration left the finite numbers.
        """
