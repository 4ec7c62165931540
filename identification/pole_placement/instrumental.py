"""Instrumental variables: earlier states and the excitation, which know nothing of the noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foundation.errors import ExcitationError, InputError
from identification.pole_placement.base import ModelMethod, Rows, column_scales
from identification.pole_placement.noise import feedback
from identification.pole_placement.samples import Matrix, Samples, floats, moving_average

_WEAK = 1e-8


@dataclass(frozen=True)
class Instrumental(ModelMethod):
    """Two-stage least squares with x(k-1) … x(k-p) and v(k) … v(k-p) as instruments.

    Consistent for white noise on the states, fed back or not, of unknown size. The excitation v is
    the recorded one, where there is one, else what regression of u on x leaves.

    Reference: Söderström and Stoica, "Instrumental variable methods for system identification",
    Springer 1983.

    Attributes:
        lags: p.
    """

    word: ClassVar[str] = "instrumental"
    lags: int = 6

    def rows(self, samples: Samples) -> Rows:
        """Return the equations that have all their instruments."""
        if self.lags < 1:
            raise InputError(f"{self.lags} lags", remedy="give 1 or more")
        filtered = samples.prefiltered(self.prefilter)
        count = len(filtered) - self.lags
        if count < samples.n + samples.m:
            raise ExcitationError(
                f"{len(samples)} steps are too few for {self.lags} lagged instruments",
                remedy="record longer, or use --method two-step",
            )
        # Averages run forward from sample k: instruments are averages of v from k or before, and
        # single states before k, none of which shares noise with the average.
        v = moving_average(feedback(samples)[1], self.prefilter)
        lag = self.lags
        instruments = np.hstack(
            [samples.states[lag - i : lag - i + count] for i in range(1, lag + 1)]
            + [v[lag - i : lag - i + count] for i in range(lag + 1)]
        )
        return Rows(
            filtered.states[lag + 1 :],
            filtered.states[lag:-1],
            filtered.inputs[lag:],
            instruments,
        )

    def model(self, rows: Rows) -> tuple[Matrix, Matrix]:
        """Return A and B."""
        return two_stage(rows)


def two_stage(rows: Rows) -> tuple[Matrix, Matrix]:
    """Return A and B by two-stage least squares.

    Raises:
        ExcitationError: The instruments do not tell states and inputs apart.
    """
    assert rows.instruments is not None
    W = rows.instruments / column_scales(rows.instruments)
    scales = column_scales(rows.regressors)
    Z = rows.regressors / scales
    fitted = W @ np.linalg.lstsq(W, Z, rcond=1e-10)[0]
    gram = fitted.T @ Z
    values = np.linalg.svd(gram, compute_uv=False)
    if values[-1] <= _WEAK * values[0]:
        raise ExcitationError(
            "earlier samples do not tell states and inputs apart",
            remedy="excite more, or use --method two-step",
        )
    theta = floats(np.linalg.solve(gram, fitted.T @ rows.after)).T / scales
    n = rows.after.shape[1]
    return theta[:, :n], theta[:, n:]
