"""Estimators, one a file, behind one small interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from foundation.errors import UnknownNameError
from identification.estimators.auto import Auto
from identification.estimators.base import Estimator
from identification.estimators.bias_compensated import BiasCompensated
from identification.estimators.delayed_instruments import DelayedInstruments
from identification.estimators.differencing import Differencing
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.estimators.kalman import Kalman
from identification.estimators.output_error import OutputError
from identification.estimators.recursive import Recursive
from identification.estimators.simulated_instruments import SimulatedInstruments
from identification.estimators.total_least_squares import TotalLeastSquares

ESTIMATORS: Mapping[str, Callable[[], Estimator]] = {
    "auto": Auto,
    "differencing": Differencing,
    "output-filter": FilteredLeastSquares,
    "instrumental": DelayedInstruments,
    "simulated-instruments": SimulatedInstruments,
    "recursive": Recursive,
    "total-least-squares": TotalLeastSquares,
    "bias-compensated": BiasCompensated,
    "output-error": OutputError,
    "kalman": Kalman,
}
"""Every estimator by its word in `--method`."""


def estimator(method: str) -> Estimator:
    """Return the estimator of a word.

    Raises:
        UnknownNameError: There is none of that word.

    Example:
        >>> estimator("output-error").method
        'output-error'
    """
    if method not in ESTIMATORS:
        raise UnknownNameError("method", method, ESTIMATORS)
    return ESTIMATORS[method]()


__all__ = [
    "ESTIMATORS",
    "Auto",
    "BiasCompensated",
    "DelayedInstruments",
    "Differencing",
    "Estimator",
    "FilteredLeastSquares",
    "Kalman",
    "OutputError",
    "Recursive",
    "SimulatedInstruments",
    "TotalLeastSquares",
    "estimator",
]
