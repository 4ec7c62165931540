"""What a fault is.

A new one is a dataclass that subclasses one of the classes here; its fields are its keys in
TOML. Register it in `hil/faults/__init__.py`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

import can
import numpy as np

from foundation.errors import InputError
from hil.settings import unit

Direction: TypeAlias = Literal["sensors", "actuators", "both"]
Delivery: TypeAlias = tuple[float, can.Message]
"""When a frame comes out [s], and the frame."""


@dataclass(kw_only=True)
class Fault(ABC):
    """Something that goes wrong, in a span of time and with a probability.

    Attributes:
        start, stop: When it may happen [s].
        probability: That it happens, each time that it could.
        seed: Of its own random numbers.
        happened: How often it has.

    Raises:
        InputError: A span that ends before it begins; a probability outside of 0 to 1.
    """

    kind: ClassVar[str]

    start: float = unit("s", 0.0)
    stop: float = unit("s", float("inf"))
    probability: float = 1.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.start < self.stop or not 0 <= self.probability <= 1:
            raise InputError(
                f"the fault '{self.kind}' from {self.start:g} s to {self.stop:g} s with "
                f"probability {self.probability:g}",
                where="faults",
                remedy="let it end after it began, with a probability of 0 to 1",
            )
        self.reset()

    def reset(self) -> None:
        """Begin anew, with the same random numbers."""
        self.happened = 0
        self._rng = np.random.default_rng(self.seed)

    def strikes(self, now: float) -> bool:
        """Whether it happens now [s]; counts it if so."""
        if not self.start <= now < self.stop:
            return False
        if self.probability < 1 and self._rng.random() >= self.probability:
            return False
        self.happened += 1
        return True


@dataclass(kw_only=True)
class FrameFault(Fault):
    """A fault of the bus: what happens to frames.

    Attributes:
        on: Frames from the plant, from the controller, or both.
        message: Only this message of the DBC; empty: all.
    """

    on: Direction = "both"
    message: str = ""

    @abstractmethod
    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return what comes out of the bus when a frame goes in at `now` [s]."""


@dataclass(kw_only=True)
class SignalFault(Fault):
    """A fault of a sensor or an actuator: what happens to values.

    Attributes:
        signal: The plant's output or input.
    """

    signal: str

    @abstractmethod
    def value(self, value: float, now: float) -> float:
        """Return what becomes of a value at `now` [s]."""
