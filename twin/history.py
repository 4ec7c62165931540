"""The last while of a twin, for pages and for a diagnosis: bounded, block by block."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.resumable import Resumable

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Predictions:
    """Samples of the last while, as columns.

    Attributes:
        time: (n,) [s].
        input_names, output_names: Of the columns.
        inputs: (n, nu) commands in force.
        measured: (n, ny); NaN where missing.
        predicted: (n, ny) one sample ahead, from all that was before.
        sd: (n, ny) of the prediction's error, as predicted.
    """

    time: Array
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    inputs: Array
    measured: Array
    predicted: Array
    sd: Array

    @property
    def residual(self) -> Array:
        """(n, ny) measured less predicted; NaN where nothing was measured."""
        return self.measured - self.predicted


class History(Resumable):
    """Keeps blocks for a time.

    Args:
        seconds: That are kept.
        block: Length of a block [s].
    """

    _changes = ("_blocks",)

    def __init__(
        self,
        input_names: tuple[str, ...],
        output_names: tuple[str, ...],
        *,
        seconds: float,
        block: float,
        sample_time: float,
    ) -> None:
        self._inputs, self._outputs = input_names, output_names
        self._h = sample_time
        self._blocks: deque[tuple[int, Array, Array, Array, Array]] = deque(
            maxlen=max(1, round(seconds / block))
        )

    def add(self, start: int, inputs: Array, measured: Array, predicted: Array, sd: Array) -> None:
        """Keep a block that begins at a stamp [ns]."""
        self._blocks.append((start, inputs, measured, predicted, sd))

    def __len__(self) -> int:
        return len(self._blocks)

    def last(self, blocks: int | None = None) -> Predictions:
        """Return the last blocks, or all; times are not even where data were missing."""
        kept = list(self._blocks)
        kept = kept if blocks is None else kept[-blocks:]
        nu, ny = len(self._inputs), len(self._outputs)

        def column(k: int, width: int) -> Array:
            parts = [block[k] for block in kept]
            return np.concatenate([np.zeros((0, width)), *parts])

        times = [
            block[0] / 1e9 + self._h * np.arange(len(block[2]), dtype=np.float64) for block in kept
        ]
        return Predictions(
            np.concatenate([np.zeros(0), *times]),
            self._inputs,
            self._outputs,
            column(1, nu),
            column(2, ny),
            column(3, ny),
            column(4, ny),
        )
