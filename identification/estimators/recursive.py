"""The recursive output filter, run over a record: what the on-line estimator ends with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.online.recursive_filter import RecursiveFilter
from identification.problem import Problem
from identification.regressors.least_squares import to_estimate


@dataclass(frozen=True)
class Recursive(Estimator):
    """Filtered least squares, sample by sample (`online.RecursiveFilter`).

    Without forgetting and with all of the record in memory it is `FilteredLeastSquares`.

    Args:
        tau: Time constants τ1, τ2 of the filter [s]; None: see `FilteredLeastSquares`, which looks
            at the record beforehand.
        forgetting: Time over which old samples lose weight by 1/e [s]; None: they keep it.
        memory: Length of the window at the record's end that counts [s]; None: all.

    Example:
        >>> Recursive().method
        'recursive'
    """

    tau: tuple[float, float] | None = None
    forgetting: float | None = None
    memory: float | None = None

    method: ClassVar[str] = "recursive"

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model has no linear regression in recorded signals.
            ExcitationError: The record is too short or shows none of the parameters.
            DivergenceError: A term is not finite on the record.
        """
        made = FilteredLeastSquares(tau=self.tau).prepare(problem)
        online = RecursiveFilter(
            made.regression,
            problem.output_names,
            problem.values,
            tau=made.tau,
            sample_time=problem.sample_time,
            forgetting=self.forgetting,
            memory=self.memory,
            ramps=[v.name in problem.measured_inputs for v in problem.dae.inputs],
            every=len(problem.time) + 1,
        )
        for inputs, outputs in zip(problem.inputs.tolist(), problem.outputs.tolist(), strict=True):
            online.update(inputs, outputs)
        return to_estimate(
            self.method,
            problem.dae,
            made.regression,
            online.solution(),
            problem.values,
            made.details(problem),
        )
