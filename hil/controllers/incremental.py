"""Incremental state feedback: the command's increment is fed back, rates by differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np

from foundation.errors import InputError
from hil.controllers.base import Controller, Transfer


@dataclass(kw_only=True)
class Incremental(Controller):
    """u(k) = (1 − K_u) u(k−1) − K x(k), x = angles and their dirty derivatives, off the reference.

    The dirty derivative of an angle is its difference over the last period. Feeding the command
    back gives an integral action that removes constant errors.

    Attributes:
        gains: K in the order angle 1, rate 1, angle 2, rate 2, …; then K_u.
        wrap: Angles that are taken between minus and plus half a turn off the reference.

    Raises:
        InputError: Not two gains an angle and one more; not one command.

    Reference:
        M. B. Arnolds, report DCT 2003.100, TU Eindhoven (2003), (5.14) to (5.18).

    Example:
        >>> law = Incremental(measured=("a",), commanded=("u",), period=0.01, gains=(2.0, 0.1, 0.5))
        >>> law.start()
        >>> [law.step(0.0, [y], [0.0]) for y in (1.0, 1.0)]
        [(-2.0,), (-3.0,)]
    """

    kind: ClassVar[str] = "incremental"

    gains: tuple[float, ...]
    wrap: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.gains) != 2 * len(self.measured) + 1 or len(self.commanded) != 1:
            raise InputError(
                f"{len(self.gains)} gains for {len(self.measured)} angles",
                where="controller.gains",
                remedy="give one for each angle and each rate in turn, and K_u; one command",
            )
        for name in self.wrap:
            if name not in self.measured:
                raise InputError(
                    f"'{name}' is not measured", where="controller.wrap", remedy="name an angle"
                )
        self._wraps = tuple(name in self.wrap for name in self.measured)
        self.start()

    def start(self) -> None:
        """Forget the last angles and command: the first rates are zero."""
        self._last: list[float] | None = None
        self._u = 0.0

    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> tuple[float]:
        """Return the command."""
        away = [
            (a - b + pi) % (2 * pi) - pi if wraps else a - b
            for a, b, wraps in zip(y, r, self._wraps, strict=True)
        ]
        last = away if self._last is None else self._last
        fed = 0.0
        for k, (now, before) in enumerate(zip(away, last, strict=True)):
            moved = now - before
            if self._wraps[k]:
                moved = (moved + pi) % (2 * pi) - pi
            fed += self.gains[2 * k] * now + self.gains[2 * k + 1] * moved / self.period
        self._last = away
        self._u = self.limited((1 - self.gains[-1]) * self._u - fed)
        return (self._u,)

    def release(self) -> None:
        """Take the last command for zero: the drive was somebody else's until now."""
        self._u = 0.0

    def transfer(self, z: Transfer) -> Transfer:
        """K(z)."""
        back = 1 / z[:, np.newaxis, np.newaxis]
        pairs = np.array(self.gains[:-1]).reshape(-1, 2)
        fed = pairs[:, 0] + (1 - back) / self.period * pairs[:, 1]
        return -fed / (1 - (1 - self.gains[-1]) * back)
