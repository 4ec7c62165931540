"""Parameters that follow the plant: a recursive fit, block by block.

`KalmanFit` is the recursive prediction-error method (L. Ljung, System Identification, 2nd ed.,
1999, section 11.4) on the innovations of a Kalman filter with a disturbance at every input: each
block's score moves the parameters by a Gauss–Newton step, and old information fades. `FilterFit` is
the recursive output filter with least squares in a window. Both rest while the data cannot support
an update.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.dae import Dae
from foundation.errors import TwinproofError
from foundation.resumable import Resumable
from identification.online import RecursiveFilter
from identification.online.scored_filter import Scored, ScoredFilter
from identification.regressors import derive
from twin.excitation import ExcitationMonitor

Array = NDArray[np.float64]

LOOSE = 0.3
"""Standard deviation, relative to the values, of parameters of which nothing is known any more."""
_LOOSENED = 30.0
"""The same for what fades or has changed: a small friction may have become one that matters. If it
were held back by its old value the others would move in its place."""
_LONGEST_STEP = 0.1
"""Of a parameter in one block, relative to its value: a filter needs time to follow."""
_SMALLEST = 1e-3
_SETTLED = 8.0


class OnlineFit(Resumable, ABC):
    """Follows the parameters; the base of all.

    Args:
        names: The k parameters.
        values: To begin with.
        covariance: (k, k) of these; where it is zero nothing is known.
        fading: Weight of old data after a block.
        wanted: See `ExcitationMonitor`.

    Attributes:
        names: As given.
        excitation: Of the recent data.
        updates: How often the values have become others.
    """

    _changes = (
        "_theta",
        "scale",
        "_covariance",
        "updates",
        "excitation",
    )

    def __init__(
        self,
        names: Sequence[str],
        values: Mapping[str, float],
        covariance: Array,
        *,
        fading: float,
        wanted: float,
    ) -> None:
        self.names = tuple(names)
        self.updates = 0
        self.start(values, covariance)
        self.excitation = ExcitationMonitor(len(names), fading=fading, wanted=wanted)
        self._fading = fading

    def start(self, values: Mapping[str, float], covariance: Array) -> None:
        """Begin anew from values and their covariance."""
        self.updates += 1
        self._theta = np.array([values[n] for n in self.names])
        self.scale = np.where(self._theta != 0, np.abs(self._theta), 1.0)
        relative = covariance / np.outer(self.scale, self.scale)
        unknown = np.diag(relative) <= 0
        relative = relative + np.diag(np.where(unknown, LOOSE**2, 0.0))
        self._covariance = relative

    @property
    def values(self) -> dict[str, float]:
        """Parameter → value."""
        return dict(zip(self.names, self._theta.tolist(), strict=True))

    @property
    def covariance(self) -> Array:
        """(k, k) of the values."""
        return self._covariance * np.outer(self.scale, self.scale)

    @abstractmethod
    def take(self, inputs: Array, outputs: Array, scored: Scored) -> None:
        """Take a block.

        Args:
            inputs: (n + 1, nu).
            outputs: (n, ny); NaN where missing.
            scored: What it says of the parameters in `filtered`.
        """

    @abstractmethod
    def loosen(self) -> None:
        """Believe the data to come rather than what was: the plant has changed."""

    def adopt(self, values: Mapping[str, float], covariance: Array) -> None:
        """Go on from a fit of recent data: after a change a recursion may have gone astray.

        Args:
            values: Of all parameters, at least.
            covariance: (k, k).
        """


class KalmanFit(OnlineFit):
    """Recursive prediction-error method; `scored` comes from a filter at these very `values`."""

    _changes = (*OnlineFit._changes, "_whole", "_spread")

    def start(self, values: Mapping[str, float], covariance: Array) -> None:
        """Begin anew; see `OnlineFit`."""
        super().start(values, covariance)
        # The estimate's weights sum up in `whole`, what their noise adds up to in `spread`.
        self._whole = np.linalg.pinv(self._covariance, hermitian=True)
        self._spread = self._whole.copy()

    def take(self, inputs: Array, outputs: Array, scored: Scored) -> None:
        """Take a block; see `OnlineFit`."""
        del inputs, outputs
        information = scored.information * np.outer(self.scale, self.scale)
        self.excitation.take(information)
        if not self.excitation.suffices:
            return
        fading = self._fading
        # What fades and is not renewed, in directions that the data do not show, is let go.
        renewed = information + (1 - fading) * np.eye(len(self.names)) / _LOOSENED**2
        self._whole = fading * self._whole + renewed
        self._spread = fading**2 * self._spread + renewed
        inverse = np.linalg.pinv(self._whole, rcond=1e-14, hermitian=True)
        step = inverse @ (scored.score * self.scale)
        # Of its present value: one that grows far beyond what it was would crawl otherwise.
        longest = _LONGEST_STEP * np.maximum(1.0, np.abs(self._theta) / self.scale)
        step /= max(1.0, float(np.max(np.abs(step) / longest)))
        moved = self._theta + step * self.scale
        # A mass, an inertia, a friction does not change its sign.
        floor = _SMALLEST * self.scale
        sign = np.where(self._theta >= 0, 1.0, -1.0)
        self._theta = sign * np.maximum(sign * moved, floor)
        self.updates += 1
        self._covariance = inverse @ self._spread @ inverse

    def adopt(self, values: Mapping[str, float], covariance: Array) -> None:
        """Begin anew from there; see `OnlineFit`."""
        self.start(values, covariance)

    def loosen(self) -> None:
        """Forget what was; see `OnlineFit`."""
        self._whole = np.eye(len(self.names)) / _LOOSENED**2
        self._spread = self._whole.copy()
        self._covariance = np.linalg.inv(self._whole)


class FilterFit(OnlineFit):
    """Recursive output filter and least squares in a window.

    Args:
        dae: The model.
        outputs: Measured variables.
        window: Length of the window [s].
        block: Samples in a block.
        sample_time: [s].
        tau: Both time constants of the output filter [s].
        others: See `OnlineFit`.

    Raises:
        UnsupportedModelError: The model has no linear regression in recorded signals.
    """

    _changes = (*OnlineFit._changes, "_online", "_samples")

    def __init__(
        self,
        dae: Dae,
        outputs: Sequence[str],
        names: Sequence[str],
        values: Mapping[str, float],
        covariance: Array,
        *,
        window: float,
        block: int,
        sample_time: float,
        tau: float,
        fading: float,
        wanted: float,
    ) -> None:
        self._regression = derive(dae, free=list(names), values={}, measured=list(outputs))
        known = {**dae.parameter_values, **values}

        def make() -> RecursiveFilter:
            return RecursiveFilter(
                self._regression,
                outputs,
                known,
                tau=(tau, tau),
                sample_time=sample_time,
                memory=window,
                every=block,
            )

        self._make = make
        self._settling = round(_SETTLED * tau / sample_time)
        super().__init__(names, values, covariance, fading=fading, wanted=wanted)

    def start(self, values: Mapping[str, float], covariance: Array) -> None:
        """Begin anew; see `OnlineFit`."""
        super().start(values, covariance)
        self._online = self._make()
        self._samples = 0

    def take(self, inputs: Array, outputs: Array, scored: Scored) -> None:
        """Take a block; see `OnlineFit`."""
        self.excitation.take(scored.information * np.outer(self.scale, self.scale))
        for u, y in zip(inputs[:-1].tolist(), outputs.tolist(), strict=True):
            self._online.update(u, y)
        self._samples += len(outputs)
        if not self.excitation.suffices or self._samples < self._settling:
            return
        try:
            solution = self._online.solution()
        except TwinproofError:
            return
        if any(n not in solution.fitted for n in self.names):
            return
        self.updates += 1
        places = [solution.fitted.index(n) for n in self.names]
        self._theta = np.array([solution.values[n] for n in self.names])
        matrix = solution.covariance[np.ix_(places, places)]
        self._covariance = matrix / np.outer(self.scale, self.scale)

    def loosen(self) -> None:
        """Forget the window; see `OnlineFit`."""
        self._online = self._make()
        self._samples = 0


def shares_filter(fit: OnlineFit, filtered: ScoredFilter) -> None:
    """Let a filter believe what a fit has found."""
    if isinstance(fit, KalmanFit):
        filtered.set_values({**filtered.values, **fit.values})
