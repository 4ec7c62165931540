"""Faults of sensors and actuators: values that are stuck, off, missing or weak."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hil.faults.base import SignalFault
from hil.settings import OWN, unit


@dataclass(kw_only=True)
class Stuck(SignalFault):
    """A sensor says what it said last."""

    kind: ClassVar[str] = "stuck"

    def reset(self) -> None:
        """Begin anew."""
        super().reset()
        self._last: float | None = None

    def value(self, value: float, now: float) -> float:
        """Return the last value, if it strikes."""
        if self.strikes(now) and self._last is not None:
            return self._last
        self._last = value
        return value


@dataclass(kw_only=True)
class Bias(SignalFault):
    """A sensor is off by a constant, or more and more.

    Attributes:
        by: How much, in the signal's unit.
        drift: What is added each second, in the signal's unit.
    """

    kind: ClassVar[str] = "bias"

    by: float = unit(OWN, 0.0)
    drift: float = unit(OWN, 0.0)

    def value(self, value: float, now: float) -> float:
        """Return the value, off if it strikes."""
        return value + self.by + self.drift * (now - self.start) if self.strikes(now) else value


@dataclass(kw_only=True)
class MotorFailure(SignalFault):
    """An actuator does nothing whatever is commanded, or keeps what it had.

    Attributes:
        holds: It keeps its last value instead of falling to zero.
    """

    kind: ClassVar[str] = "motor-failure"

    holds: bool = False

    def reset(self) -> None:
        """Begin anew."""
        super().reset()
        self._last = 0.0

    def value(self, value: float, now: float) -> float:
        """Return zero or the last value, if it strikes."""
        if self.strikes(now):
            return self._last if self.holds else 0.0
        self._last = value
        return value


@dataclass(kw_only=True)
class SupplySag(SignalFault):
    """The supply is weak: the actuator reaches no more than a limit, and a part of what it should.

    Attributes:
        limit: Largest absolute value, in the signal's unit.
        gain: Part of the command that arrives.
    """

    kind: ClassVar[str] = "supply-sag"

    limit: float = unit(OWN, float("inf"))
    gain: float = 1.0

    def value(self, value: float, now: float) -> float:
        """Return what arrives."""
        if not self.strikes(now):
            return value
        return max(-self.limit, min(self.limit, self.gain * value))
