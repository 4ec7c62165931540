"""Signals over time, for references and disturbances."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from foundation.errors import InputError
from hil.settings import OWN, Table, build, unit

Array: TypeAlias = npt.NDArray[np.float64]


@dataclass(kw_only=True)
class Waveform(ABC):
    """A signal over time, in its variable's unit."""

    kind: ClassVar[str]

    @abstractmethod
    def values(self, time: Array, rng: np.random.Generator) -> Array:
        """Return the values at equal steps of time, shape (n,), [s]."""


@dataclass(kw_only=True)
class Constant(Waveform):
    """Always the same.

    Example:
        >>> Constant(value=2.0).values(np.zeros(2), np.random.default_rng()).tolist()
        [2.0, 2.0]
    """

    kind: ClassVar[str] = "constant"

    value: float = unit(OWN, 0.0)

    def values(self, time: Array, rng: np.random.Generator) -> Array:
        """Return the values."""
        del rng
        return np.full(time.shape, self.value)


@dataclass(kw_only=True)
class Step(Waveform):
    """From one value to another at a time, and back if `stop` is given.

    Attributes:
        at, stop: [s].
        before, after: Values.
    """

    kind: ClassVar[str] = "step"

    at: float = unit("s")
    after: float = unit(OWN)
    before: float = unit(OWN, 0.0)
    stop: float | None = unit("s", None)

    def values(self, time: Array, rng: np.random.Generator) -> Array:
        """Return the values."""
        del rng
        on = (time >= self.at - 1e-9) & (time < (np.inf if self.stop is None else self.stop) - 1e-9)
        return np.where(on, self.after, self.before)


@dataclass(kw_only=True)
class Points(Waveform):
    """Straight lines between points, held before and after.

    Attributes:
        times: Increasing [s].
        levels: Value at each.
    """

    kind: ClassVar[str] = "points"

    times: tuple[float, ...]
    levels: tuple[float, ...] = unit(OWN)

    def __post_init__(self) -> None:
        if len(self.times) != len(self.levels) or not np.all(np.diff(self.times) > 0):
            raise InputError(
                "the points do not fit", remedy="give increasing times and a level for each"
            )

    def values(self, time: Array, rng: np.random.Generator) -> Array:
        """Return the values."""
        del rng
        return np.interp(time, self.times, self.levels)


@dataclass(kw_only=True)
class Sines(Waveform):
    """A sum of sines.

    Attributes:
        amplitudes: In the variable's unit.
        frequencies: [rad/s].
        phases: [rad]; default 0.
        offset: Added.
    """

    kind: ClassVar[str] = "sines"

    amplitudes: tuple[float, ...] = unit(OWN)
    frequencies: tuple[float, ...]
    phases: tuple[float, ...] = ()
    offset: float = unit(OWN, 0.0)

    def __post_init__(self) -> None:
        phases = self.phases or (0.0,) * len(self.amplitudes)
        if not len(self.amplitudes) == len(self.frequencies) == len(phases):
            raise InputError("the sines do not fit", remedy="give as many of each")
        self.phases = phases

    def values(self, time: Array, rng: np.random.Generator) -> Array:
        """Return the values."""
        del rng
        total = np.full(time.shape, self.offset)
        for a, w, p in zip(self.amplitudes, self.frequencies, self.phases, strict=True):
            total += a * np.sin(w * time + p)
        return total


@dataclass(kw_only=True)
class Noise(Waveform):
    """Normal noise, white from sample to sample or through a first-order low-pass.

    Attributes:
        sd: Standard deviation.
        bandwidth: Corner of the low-pass [rad/s]; None: white.
    """

    kind: ClassVar[str] = "noise"

    sd: float = unit(OWN)
    bandwidth: float | None = None

    def values(self, time: Array, rng: np.random.Generator) -> Array:
        """Return the values."""
        white = rng.standard_normal(time.size) * self.sd
        if self.bandwidth is None or time.size < 2:
            return white
        decay = float(np.exp(-self.bandwidth * (time[1] - time[0])))
        gain = np.sqrt(1 - decay**2)
        start = [white[0] - gain * white[0]]
        return np.asarray(lfilter([gain], [1.0, -decay], white, zi=start)[0], float)


WAVEFORMS: Mapping[str, type[Waveform]] = MappingProxyType(
    {w.kind: w for w in (Constant, Step, Points, Sines, Noise)}
)
"""Every waveform by its word in TOML."""


def waveform_of(table: Table, unit_: str) -> Waveform:
    """Return the waveform that a table describes; values may be written with their unit.

    Raises:
        InputError, UnknownNameError, UnitError: See `hil.settings.build`.
    """
    kind = WAVEFORMS[table.word("kind", WAVEFORMS)]
    return build(kind, table.without("kind"), own=unit_)
