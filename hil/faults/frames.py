"""Faults of the bus: frames lost, late, doubled, swapped or damaged; a node bus-off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import can

from hil.faults.base import Delivery, FrameFault
from hil.settings import unit


@dataclass(kw_only=True)
class Drop(FrameFault):
    """Frames get lost."""

    kind: ClassVar[str] = "drop"

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return nothing if it strikes."""
        return [] if self.strikes(now) else [(now, frame)]


@dataclass(kw_only=True)
class Delay(FrameFault):
    """Frames come later.

    Attributes:
        by: How much [s].
        jitter: Half width of what is uniformly added or taken away [s].
    """

    kind: ClassVar[str] = "delay"

    by: float = unit("s")
    jitter: float = unit("s", 0.0)

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return the frame, later if it strikes."""
        if not self.strikes(now):
            return [(now, frame)]
        extra = self._rng.uniform(-self.jitter, self.jitter) if self.jitter else 0.0
        return [(now + max(self.by + extra, 0.0), frame)]


@dataclass(kw_only=True)
class Duplicate(FrameFault):
    """Frames come twice."""

    kind: ClassVar[str] = "duplicate"

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return the frame, and again if it strikes."""
        return [(now, frame)] * (2 if self.strikes(now) else 1)


@dataclass(kw_only=True)
class Reorder(FrameFault):
    """A frame comes after its successor."""

    kind: ClassVar[str] = "reorder"

    def reset(self) -> None:
        """Begin anew."""
        super().reset()
        self._held: dict[int, can.Message] = {}

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Hold the frame back until the next of its identifier if it strikes."""
        held = self._held.pop(frame.arbitration_id, None)
        if held is not None:
            return [(now, frame), (now, held)]
        if self.strikes(now):
            self._held[frame.arbitration_id] = frame
            return []
        return [(now, frame)]


@dataclass(kw_only=True)
class Corrupt(FrameFault):
    """A bit of the payload is turned over, unseen by the controller's hardware.

    Attributes:
        bits: How many, at random places.
    """

    kind: ClassVar[str] = "corrupt"

    bits: int = 1

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return the frame, damaged if it strikes."""
        if not self.strikes(now) or not frame.data:
            return [(now, frame)]
        data = bytearray(frame.data)
        for place in self._rng.choice(8 * len(data), min(self.bits, 8 * len(data)), False).tolist():
            data[place // 8] ^= 1 << place % 8
        damaged = can.Message(
            timestamp=frame.timestamp,
            arbitration_id=frame.arbitration_id,
            is_extended_id=frame.is_extended_id,
            is_fd=frame.is_fd,
            data=data,
        )
        return [(now, damaged)]


@dataclass(kw_only=True)
class BusOff(FrameFault):
    """The plant's node is off the bus: nothing goes out, nothing comes in."""

    kind: ClassVar[str] = "bus-off"

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return nothing."""
        return [] if self.strikes(now) else [(now, frame)]


@dataclass(kw_only=True)
class DeadController(FrameFault):
    """The controller stops sending."""

    kind: ClassVar[str] = "dead-controller"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.on = "actuators"

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return nothing."""
        return [] if self.strikes(now) else [(now, frame)]


@dataclass(kw_only=True)
class LateController(FrameFault):
    """The controller answers late, as if it were overloaded.

    Attributes:
        by: How much [s].
    """

    kind: ClassVar[str] = "late-controller"

    by: float = unit("s")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.on = "actuators"

    def deliver(self, frame: can.Message, now: float) -> list[Delivery]:
        """Return the frame, later."""
        return [(now + self.by if self.strikes(now) else now, frame)]
