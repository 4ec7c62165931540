"""The contract of an on-line estimator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class OnlineEstimate:
    """What is known after a sample.

    Attributes:
        samples: How many there were.
        values: Name → value of every free parameter.
        sd: Name → standard deviation; infinite while the samples do not show it.
        innovation: What the sample brought that was not expected: an entry for each equation of
            motion or each output. NaN where nothing was expected yet, or nothing measured.
        innovation_sd: Of that, as predicted.
    """

    samples: int
    values: Mapping[str, float]
    sd: Mapping[str, float]
    innovation: NDArray[np.float64]
    innovation_sd: NDArray[np.float64]


class OnlineEstimator(ABC):
    """From samples to parameters, one by one.

    Neither memory nor the time of an update grows with the number of samples.
    """

    @abstractmethod
    def update(self, inputs: Sequence[float], outputs: Sequence[float]) -> OnlineEstimate:
        """Take one sample; samples follow each other at the sample time.

        Args:
            inputs: (nu,) held from this sample to the next.
            outputs: (ny,) measured; NaN where a measurement is missing.
        """
