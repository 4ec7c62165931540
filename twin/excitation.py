"""Can the recent data support an update of the parameters at all?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foundation.resumable import Resumable

Array = NDArray[np.float64]


class ExcitationMonitor(Resumable):
    """Watches how well the data of the last while tell the parameters.

    Args:
        count: k, how many parameters.
        fading: Weight of the data falls by this factor a block.
        wanted: Standard deviation, relative to its value, that the data must promise a parameter.

    Attributes:
        level: 1 suffices: at least half of the parameters are told that well; less does not.
        weakest: Number of the parameter that is told worst.

    Example:
        >>> monitor = ExcitationMonitor(1, fading=0.9, wanted=0.1)
        >>> monitor.take(np.array([[25.0]]))
        >>> round(monitor.level, 3)
        0.5
        >>> for _ in range(9):
        ...     monitor.take(np.array([[25.0]]))
        >>> monitor.suffices
        True
    """

    _changes = (
        "_information",
        "level",
        "weakest",
    )

    def __init__(self, count: int, *, fading: float, wanted: float) -> None:
        self._information = np.zeros((count, count))
        self._fading, self._wanted = fading, wanted
        self.level = 0.0
        self.weakest = 0

    @property
    def suffices(self) -> bool:
        """Whether an update may be made."""
        return self.level >= 1.0

    def take(self, information: Array) -> None:
        """Take a block's information (k, k) on the parameters relative to their values."""
        self._information = self._fading * self._information + information
        sd = relative_sd(self._information)
        self.weakest = int(np.argmax(sd)) if sd.size else 0
        self.level = float(self._wanted / np.sort(sd)[(len(sd) - 1) // 2]) if sd.size else 0.0


def relative_sd(information: Array) -> Array:
    """Return (k,) standard deviations that an information promises; infinite where it shows none.

    Example:
        >>> relative_sd(np.array([[4.0, 0.0], [0.0, 0.0]])).tolist()
        [0.5, inf]
    """
    diagonal = np.diag(information)
    sd = np.full(len(diagonal), np.inf)
    seen = np.flatnonzero(diagonal > 0)
    if not seen.size:
        return sd
    scale = np.sqrt(diagonal[seen])
    correlation = information[np.ix_(seen, seen)] / np.outer(scale, scale)
    eigenvalues, vectors = np.linalg.eigh(correlation)
    if eigenvalues[0] <= 1e-12:
        # A direction that the data do not show leaves all that it mixes with unknown.
        hidden = np.abs(vectors[:, eigenvalues <= 1e-12]).max(axis=1) > 1e-6
        variances = np.where(
            hidden, np.inf, (vectors**2 / np.maximum(eigenvalues, 1e-12)).sum(axis=1)
        )
    else:
        variances = (vectors**2 / eigenvalues).sum(axis=1)
    sd[seen] = np.sqrt(variances) / scale
    return sd
