"""The default: prediction error from the most likely of several two-step starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from foundation.errors import ComputationError, ExcitationError
from identification.pole_placement.base import Method, RowMethod, Solution, require_rank, rows_of
from identification.pole_placement.gains import Poles
from identification.pole_placement.instrumental import Instrumental, two_stage
from identification.pole_placement.prediction_error import PredictionError, Scaled
from identification.pole_placement.samples import Matrix, Samples
from identification.pole_placement.two_step import TwoStep, regress

_ORDERS = (1, 3, 6, 12)


@dataclass(frozen=True)
class Auto(Method):
    """Two-step with several prefilters and instrumental variables, then prediction error.

    The start is whichever is the most likely under the Kalman filter; prediction error only climbs
    from there, so the result is never less likely on the data than two-step with any of the
    prefilters. Where prediction error fails, the start is the answer, and a note says so.

    Attributes:
        prefilter: An order to try beside 1, 3, 6 and 12.
    """

    word: ClassVar[str] = "auto"
    prefilter: int = 1

    def solve(self, samples: Samples, poles: Poles) -> Solution:
        """Fit the model and place the poles."""
        require_rank(rows_of(samples), samples)
        scaled = Scaled.of(samples)
        ranked: list[tuple[float, int, RowMethod, tuple[Matrix, Matrix]]] = []
        for k, (method, model) in enumerate(self._starts(samples)):
            value = scaled.likelihood.value(scaled.vector(*model, samples))
            ranked.append((value, k, method, model))
        ranked.sort(key=lambda start: start[:2])
        _, _, method, model = ranked[0]
        try:
            return PredictionError().refine(scaled, scaled.vector(*model, samples), poles)
        except (ComputationError, ExcitationError, np.linalg.LinAlgError) as error:
            found = method.solve(samples, poles)
            note = f"prediction error failed ({error}); this is {method.word}"
            return replace(found, notes=(*found.notes, note))

    def _starts(self, samples: Samples) -> list[tuple[RowMethod, tuple[Matrix, Matrix]]]:
        starts: list[tuple[RowMethod, tuple[Matrix, Matrix]]] = []
        for order in sorted({*_ORDERS, self.prefilter}):
            method = TwoStep(order)
            try:
                rows = method.rows(samples)
                require_rank(rows, samples)
                starts.append((method, regress(rows)))
            except ExcitationError:
                if order == 1:
                    raise
        try:
            instrumental = Instrumental()
            starts.append((instrumental, two_stage(instrumental.rows(samples))))
        except ExcitationError:
            pass
        return starts
