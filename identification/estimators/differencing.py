"""The baseline: least squares on equations of motion with differenced accelerations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.signal import butter, sosfiltfilt

from foundation.errors import InputError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.problem import Problem
from identification.regressors import derive
from identification.regressors.least_squares import solve, to_estimate
from identification.regressors.signals import differenced_rows

_ORDER = 4


@dataclass(frozen=True)
class Differencing(Estimator):
    """Least squares with central differences for what is not recorded.

    Differencing a noisy signal of step T multiplies its noise by about 1/T each time, and least
    squares then pulls every inertia towards zero. It is here to be compared with, and for records
    without noise.

    Args:
        band: Corner [Hz] of a low-pass that the measurements go through before: a Butterworth
            filter of fourth order run forwards and backwards, so without delay; with it this is the
            inverse dynamic identification of robots (M. Gautier, A. Janot, P.-O. Vandanjon, IEEE
            Trans. Control Systems Technology 21 (2013) 428-444). None: no filter.
        correlation_time: Time over which residuals are taken as correlated [s], for the standard
            deviations.

    Example:
        >>> Differencing().method
        'differencing'
    """

    band: float | None = None
    correlation_time: float = 0.1

    method: ClassVar[str] = "differencing"

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model has no linear regression in recorded signals.
            ExcitationError: The record is too short or shows none of the parameters.
            DivergenceError: A term is not finite on the record.
        """
        regression = derive(
            problem.dae, free=problem.free, values=problem.values, measured=problem.output_names
        )
        rows = differenced_rows(regression, self._smooth(problem))
        solution = solve(
            regression,
            rows,
            problem.values,
            correlation=int(np.ceil(self.correlation_time / problem.sample_time)),
        )
        return to_estimate(self.method, problem.dae, regression, solution, problem.values, {})

    def _smooth(self, problem: Problem) -> Problem:
        if self.band is None:
            return problem
        nyquist = 0.5 / problem.sample_time
        if not 0 < self.band < nyquist:
            raise InputError(
                f"a band of {self.band:g} Hz for samples every {problem.sample_time:g} s",
                remedy=f"give a frequency between 0 and {nyquist:g} Hz",
            )
        sections = butter(_ORDER, self.band / nyquist, output="sos")
        return replace(problem, outputs=sosfiltfilt(sections, problem.outputs, axis=0))
