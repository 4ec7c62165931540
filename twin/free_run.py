"""What the model does by itself: the FMU from the filtered state on, with the plant's commands.

One-step predictions hardly show a wrong parameter, since each begins from what was measured. A free
run over a horizon shows what a simulation of this plant is worth; a controller's study is one.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fmus.plant import Plant
from foundation.errors import FmuError
from foundation.resumable import Resumable
from twin.history import Predictions

Array: TypeAlias = NDArray[np.float64]


class FreeRun(Resumable):
    """Runs the FMU over each horizon once it has been measured.

    Args:
        fmu: Of the plant.
        inputs, outputs: Variables, in the order of the samples.
        starts: Start parameter of every state, in the filter's order.
        sample_time: [s].
        samples: In a horizon.

    Attributes:
        last: The last horizon; None: none yet, or the run failed.
        rms: Output → root mean square of what the run was off by, its unit; of that horizon.
    """

    _changes = (
        "last",
        "rms",
        "_blocks",
        "_begin",
    )

    def __init__(
        self,
        fmu: Path,
        inputs: Sequence[str],
        outputs: Sequence[str],
        starts: Sequence[str],
        *,
        sample_time: float,
        samples: int,
    ) -> None:
        self._plant = Plant(fmu, outputs=list(outputs))
        # Given back in any case, in order, when nobody follows this plant any more.
        self._closing = weakref.finalize(self, self._plant.close)
        order = [list(inputs).index(name) for name in self._plant.inputs]
        self._order, self._inputs, self._outputs = order, tuple(inputs), tuple(outputs)
        self._starts, self._h, self._samples = tuple(starts), sample_time, samples
        self.last: Predictions | None = None
        self.rms = dict.fromkeys(outputs, 0.0)
        self.restart()

    def restart(self) -> None:
        """Begin a new horizon: samples are missing."""
        self._blocks: list[tuple[Array, Array]] = []
        self._begin: tuple[int, Array, dict[str, float]] | None = None

    def add(
        self,
        start: int,
        inputs: Array,
        measured: Array,
        states: Array,
        values: Mapping[str, float],
    ) -> None:
        """Take a block; at the end of a horizon, run.

        Args:
            start: Stamp of its first sample [ns].
            inputs: (n, nu).
            measured: (n, ny); NaN where missing.
            states: (nx,) filtered, at the first sample.
            values: Parameters of the model.
        """
        if self._begin is None:
            self._begin = start, states, dict(values)
        self._blocks.append((inputs, measured))
        if sum(len(u) for u, _ in self._blocks) < self._samples:
            return
        begin, state, parameters = self._begin
        u = np.concatenate([block[0] for block in self._blocks])
        y = np.concatenate([block[1] for block in self._blocks])
        self.restart()
        self.last = self._run(begin, state, parameters, u, y)
        if self.last is not None:
            square = np.square(self.last.residual)
            there = np.isfinite(square)
            mean = np.where(there, square, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
            self.rms = dict(zip(self._outputs, np.sqrt(mean).tolist(), strict=True))

    def _run(
        self, begin: int, state: Array, parameters: Mapping[str, float], u: Array, y: Array
    ) -> Predictions | None:
        n = len(u)
        found = np.zeros((n + 1, len(self._outputs)))
        try:
            self._plant.reset({**parameters, **dict(zip(self._starts, state, strict=True))})
            tick = self._plant.ticker(self._h, np.ascontiguousarray(u[:, self._order]), found)
            for k in range(n):
                tick(k)
        except FmuError:
            # A model that fails from here shows that by having no prediction.
            return None
        time = begin / 1e9 + self._h * np.arange(n, dtype=np.float64)
        return Predictions(
            time, self._inputs, self._outputs, u, y, found[:n], np.full(y.shape, np.nan)
        )

    def close(self) -> None:
        """Let go of the FMU."""
        self._closing()


def start_parameters(states: Sequence[str], starts: Mapping[str, str]) -> tuple[str, ...] | None:
    """Return the start parameter of every state; None: a state has none.

    Args:
        states: Of the model.
        starts: Parameter → state whose start it is.
    """
    of = {state: parameter for parameter, state in starts.items()}
    return tuple(of[s] for s in states) if all(s in of for s in states) else None
