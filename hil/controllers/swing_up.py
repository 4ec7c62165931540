"""Swing-up by pushes in the right zone, and balance once upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, pi, radians
from typing import ClassVar

from foundation.errors import InputError
from hil.controllers.base import Controller, Transfer
from hil.controllers.incremental import Incremental
from hil.settings import unit


@dataclass(kw_only=True)
class SwingUp(Controller):
    """Push against the rod's motion while it falls through the swing zone; near upright, balance.

    The rod's angle is zero hanging. Within the zone, and moving towards hanging, the arm is driven
    against the rod's motion, which puts energy in. Within `switch_in` of upright the incremental
    state feedback takes over, about the arm's angle at that moment; beyond `switch_out` it gives
    up and swinging begins again. A first push of `kick` seconds sets the rod moving.

    Attributes:
        measured: The arm's angle, the rod's angle.
        gains: Of the balance: arm angle and rate, rod angle and rate, K_u (see `Incremental`).
        drive: Size of a push, in the command's unit.
        zone: Where it is pushed: inner and outer angle from hanging [rad].
        switch_in, switch_out: From upright [rad].
        kick: Length of the first push [s].
        zero: What the rod's sensor says when the rod is upright, less π [rad]: a wrong zero that
            is known.

    Raises:
        InputError: Angles that make no sense; not two measured variables.

    Reference:
        M. B. Arnolds, report DCT 2003.100, TU Eindhoven (2003), sections 5.1 to 5.3. With zones
        that reach beyond 60 degrees it fails.
    """

    kind: ClassVar[str] = "swing-up"

    gains: tuple[float, ...] = (-6.0, -5.0, 137.0, 20.0, 0.15)
    drive: float = 85.0
    zone: tuple[float, float] = unit("rad", (radians(3), radians(50)))
    switch_in: float = unit("rad", radians(10))
    switch_out: float = unit("rad", radians(20))
    kick: float = unit("s", 0.12)
    zero: float = unit("rad", 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.measured) != 2 or len(self.commanded) != 1:
            raise InputError(
                "a swing-up measures arm and rod and commands one drive",
                where="controller",
                remedy='write measured = ["alpha", "beta"], commanded = ["u"]',
            )
        inner, outer = self.zone
        if not 0 <= inner < outer < pi or not 0 < self.switch_in <= self.switch_out < pi:
            raise InputError(
                "the swing zone or the switching angles make no sense",
                where="controller",
                remedy="0 ≤ inner < outer < 180 deg, and 0 < switch_in ≤ switch_out",
            )
        self._balance = Incremental(
            measured=self.measured,
            commanded=self.commanded,
            period=self.period,
            limit=self.limit,
            gains=self.gains,
            wrap=self.measured[1:],
        )
        self.start()

    def start(self) -> None:
        """Hang at rest, with the first push to come."""
        self._balancing = False
        self._rod: float | None = None
        self._arm = 0.0
        self._first: float | None = None
        self._balance.start()

    @property
    def mode(self) -> str:
        """`swing` or `balance`."""
        return "balance" if self._balancing else "swing"

    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> tuple[float]:
        """Return the command; the reference of the arm adds to its angle at the switch."""
        arm, rod = y[0], y[1] - self.zero
        if self._first is None:
            self._first = time
        moved = 0.0 if self._rod is None else _half_turn(rod - self._rod)
        self._rod = rod
        tilt = _half_turn(rod - pi)
        if not self._balancing and abs(tilt) < self.switch_in:
            self._balancing, self._arm = True, arm
            self._balance.start()
            # The rate is known from before the switch: a first rate of zero would be a jolt.
            self._balance.step(time, (arm, rod - moved), (arm, pi))
            self._balance.release()
        elif self._balancing and abs(tilt) > self.switch_out:
            self._balancing = False
        if self._balancing:
            return self._balance.step(time, (arm, rod), (self._arm + r[0], pi))
        if time - self._first < self.kick:
            return (self.limited(self.drive),)
        angle = _half_turn(rod)
        inner, outer = self.zone
        if inner < abs(angle) < outer and angle * moved < 0:
            return (self.limited(-copysign(self.drive, moved)),)
        return (0.0,)

    def transfer(self, z: Transfer) -> Transfer:
        """Of the balance."""
        return self._balance.transfer(z)


def _half_turn(angle: float) -> float:
    return (angle + pi) % (2 * pi) - pi
