"""What sensors make of the plant's outputs: noise, bias, resolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foundation.errors import InputError
from hil.settings import OWN, unit

_BLOCK = 1000


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """A sensor of one output, in its unit.

    Attributes:
        sd: Standard deviation of white noise, added before the resolution.
        resolution: Step of its values; 0: none.
        bias: Added: a wrong zero.

    Raises:
        InputError: A negative one.
    """

    sd: float = unit(OWN, 0.0)
    resolution: float = unit(OWN, 0.0)
    bias: float = unit(OWN, 0.0)

    def __post_init__(self) -> None:
        if self.sd < 0 or self.resolution < 0:
            raise InputError(
                "sd or resolution is negative", where="sensors", remedy="give 0 or more"
            )


class Sensors:
    """All sensors of a plant.

    Example:
        >>> sensors = Sensors(["q"], {"q": SensorSettings(resolution=0.1, bias=0.04)}, seed=1)
        >>> round(sensors.read([0.02])[0], 9)
        0.1
    """

    def __init__(
        self, names: Sequence[str], settings: Mapping[str, SensorSettings], *, seed: int
    ) -> None:
        chosen = [settings.get(name, SensorSettings()) for name in names]
        self._sd = np.array([s.sd for s in chosen])
        self._bias = [s.bias for s in chosen]
        self._steps = [s.resolution for s in chosen]
        self._rng = np.random.default_rng(seed)
        self._noise: list[list[float]] = []
        self._next = 0

    def read(self, values: Sequence[float]) -> list[float]:
        """Return what the sensors say of the outputs' values."""
        if self._next == len(self._noise):
            # Drawn in blocks: one draw a sample would cost more than the plant.
            self._noise = (self._rng.standard_normal((_BLOCK, self._sd.size)) * self._sd).tolist()
            self._next = 0
        noise = self._noise[self._next]
        self._next += 1
        read: list[float] = []
        for value, n, bias, step in zip(values, noise, self._bias, self._steps, strict=True):
            seen = value + n + bias
            read.append(step * round(seen / step) if step else seen)
        return read
