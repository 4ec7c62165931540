"""What a monitor needs of a pipeline; a test's script is one too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from recordings.readers.can_frames import Frames
from twin.estimate import Estimate
from twin.events import JSON, Event
from twin.store.documents import ParameterSet

Array: TypeAlias = npt.NDArray[np.float64]


class Samples(Protocol):
    """Outputs over the last while, as columns."""

    @property
    def time(self) -> Array:
        """(n,) [s]."""
        ...

    @property
    def inputs(self) -> Array:
        """(n, nu)."""
        ...

    @property
    def output_names(self) -> tuple[str, ...]:
        """Of the columns."""
        ...

    @property
    def measured(self) -> Array:
        """(n, ny); NaN where missing."""
        ...

    @property
    def predicted(self) -> Array:
        """(n, ny)."""
        ...


class Health(Protocol):
    """How the data are."""

    @property
    def counts(self) -> Mapping[str, int]:
        """What was received, lost, refused, by reason."""
        ...


class Plant(Protocol):
    """The plant as a pipeline sees it."""

    @property
    def noise_sd(self) -> Array:
        """(ny,) of the sensors."""
        ...

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that are followed."""
        ...


class Follower(Protocol):
    """What a monitor needs of a pipeline."""

    @property
    def plant(self) -> Plant:
        """Its model."""
        ...

    @property
    def estimate(self) -> Estimate | None:
        """The newest one."""
        ...

    @property
    def newest(self) -> float | None:
        """Time of the newest good data [s]."""
        ...

    @property
    def drift(self) -> Mapping[str, JSON]:
        """The tests as they stand: `statistics`, `threshold`, …"""
        ...

    @property
    def health(self) -> Health:
        """How the data are."""
        ...

    @property
    def predictions(self) -> Samples:
        """Measured and predicted, of the last while."""
        ...

    def feed(self, frames: Frames) -> list[Event]:
        """Take frames and say what happened."""
        ...

    def idle(self, now: float) -> list[Event]:
        """Say what happened because nothing came."""
        ...

    def verify(self, parameters: ParameterSet) -> None:
        """Compare with these parameters from now on."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """Return what it knows."""
        ...

    def resume(self, found: dict[str, Any]) -> None:
        """Know what another one of the same twin knew."""
        ...
