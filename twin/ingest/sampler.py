"""Readings at their own times put on the model's grid, in blocks; what is missing stays missing.

A sensor's reading belongs to the nearest sample: a Kalman filter takes what there is and needs
nothing made up in between. A command holds from its frame (and a known delay) until the next; where
several come in a sample, their mean over it keeps what they did to the plant. The grid is the time
axis of the frames' stamps and its phase that of the first sensor's frames, so the same frames give
the same samples, however they were handed over.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.resumable import Resumable
from twin.ingest.decoder import Decoded

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_PHASE_FROM = 16
"""Readings that the grid's phase is taken from."""
_MANY = 1.5
"""Commands a sample from which their mean is taken."""


@dataclass(frozen=True)
class Block:
    """Samples on the grid.

    Attributes:
        start: Stamp of the first sample [ns].
        inputs: (n + 1, nu); the last row is that of the next block's first sample.
        outputs: (n, ny); NaN where nothing was measured.
    """

    start: int
    inputs: Array
    outputs: Array


class Sampler(Resumable):
    """Collects readings and hands out whole blocks.

    Args:
        inputs, outputs: Variables, in the model's order.
        rate: Of the grid [Hz].
        length: Samples in a block.
        delays: Input → time from a command's frame until it acts [s].

    Attributes:
        missing: Samples of a sensor that were not there.

    Example:
        >>> sampler = Sampler(["u"], ["y"], rate=10.0, length=2)
        >>> stamps = np.arange(60) * 100_000_000
        >>> found = {"u": (stamps, np.arange(60.0)), "y": (stamps, -np.arange(60.0))}
        >>> sampler.add(Decoded(found))
        >>> block = next(iter(sampler.blocks()))
        >>> block.inputs[:, 0].tolist(), block.outputs[:, 0].tolist()
        ([0.0, 1.0, 2.0], [-0.0, -1.0])
    """

    _changes = (
        "missing",
        "_held",
        "_waiting",
        "_first",
        "_newest",
    )

    def __init__(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        rate: float,
        length: int,
        delays: Mapping[str, float] | None = None,
    ) -> None:
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        self.step = round(1e9 / rate)
        self.length = length
        self.missing = 0
        self._delays = {name: round(1e9 * s) for name, s in (delays or {}).items()}
        self.restart()

    def restart(self) -> None:
        """Forget everything: the next reading begins a new grid."""
        self._held: dict[str, float] = {}
        self._waiting: dict[str, tuple[Stamps, Array]] = {}
        self._first: int | None = None
        self._newest: dict[str, int] = {}

    def add(self, decoded: Decoded) -> None:
        """Take readings, later ones than before."""
        for name, (stamps, values) in decoded.variables.items():
            late = self._delays.get(name, 0)
            if name in self._waiting:
                old_stamps, old = self._waiting[name]
                pair = np.concatenate([old_stamps, stamps + late]), np.concatenate([old, values])
            else:
                pair = stamps + late, values
            self._waiting[name] = pair
            self._newest[name] = int(stamps[-1]) + late

    def blocks(self) -> list[Block]:
        """Return the blocks that are complete: all variables came two samples after their end."""
        if self._first is None and not self._begin():
            return []
        found: list[Block] = []
        span = self.length * self.step
        assert self._first is not None
        newest = min(self._newest.values())
        while newest >= self._first + span + 2 * self.step:
            found.append(self._block(self._first))
            self._first += span
        return found

    def _begin(self) -> bool:
        """Choose the grid: its phase is the mean of the sensors' first stamps."""
        if any(name not in self._waiting for name in (*self.inputs, *self.outputs)):
            return False
        sensors = [self._waiting[n][0] for n in self.outputs]
        if len(sensors[0]) < _PHASE_FROM:
            return False
        angles = 2 * math.pi * (sensors[0][:_PHASE_FROM] % self.step) / self.step
        mean = math.atan2(float(np.mean(np.sin(angles))), float(np.mean(np.cos(angles))))
        phase = round(mean / (2 * math.pi) * self.step)
        begin = max([int(sensors[0][0]), *(int(self._waiting[n][0][0]) for n in self.inputs)])
        self._first = begin + (phase - begin + self.step // 2) % self.step - self.step // 2
        return True

    def _block(self, start: int) -> Block:
        n, h = self.length, self.step
        outputs = np.full((n, len(self.outputs)), np.nan)
        end = start + n * h - h // 2
        for j, name in enumerate(self.outputs):
            stamps, values = self._waiting[name]
            cut = int(np.searchsorted(stamps, end))
            rows = (stamps[:cut] - start + h // 2) // h
            inside = rows >= 0
            outputs[rows[inside], j] = values[:cut][inside]
            self._waiting[name] = stamps[cut:], values[cut:]
            self.missing += int(np.sum(np.isnan(outputs[:, j])))
        inputs = np.empty((n + 1, len(self.inputs)))
        for j, name in enumerate(self.inputs):
            inputs[:, j] = self._commands(name, start)
        return Block(start, inputs, outputs)

    def _commands(self, name: str, start: int) -> Array:
        n, h = self.length, self.step
        stamps, values = self._waiting[name]
        held = self._held.get(name, float(values[0]) if len(values) else 0.0)
        cut = int(np.searchsorted(stamps, start + n * h - h // 2))
        many = cut > _MANY * n
        if not many:
            # A command that comes about when a sample is taken acts from that sample on.
            stamps = start + (stamps - start + h // 2) // h * h
        grid = start + h * np.arange(n + 1)
        steps = np.concatenate([[held], values])
        latest = np.searchsorted(stamps, grid, side="right")
        found = steps[latest]
        if many:
            times = np.concatenate([[start], np.maximum(stamps, start)])
            area = np.concatenate([[0.0], np.cumsum(np.diff(times) * steps[:-1])])
            edges = start + h * np.arange(n + 2)
            beyond = np.maximum(edges - times[-1], 0) * steps[-1]
            found = np.diff(np.interp(edges, times, area) + beyond) / h
        original, _ = self._waiting[name]
        self._waiting[name] = original[cut:], values[cut:]
        self._held[name] = float(steps[cut])
        return found
