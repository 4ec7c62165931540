"""Faults of the plant itself: physics that is not what it was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hil.faults.base import Fault
from hil.settings import OWN, unit


@dataclass(kw_only=True)
class ParameterChange(Fault):
    """A parameter of the plant takes another value: something wears, warms up, loses mass.

    With a parameter that is zero otherwise it is an effect that appears, such as friction.

    Attributes:
        parameter: Of the plant's model; it must be tunable.
        to: Its value meanwhile, in its own unit.
    """

    kind: ClassVar[str] = "parameter-change"

    parameter: str
    to: float = unit(OWN)

    def value(self, usual: float, now: float) -> float:
        """Return what the parameter is at `now` [s], in its own unit."""
        return self.to if self.strikes(now) else usual
