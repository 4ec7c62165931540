"""PID with filtered derivative, as in the paper on the wheeled pendulum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foundation.errors import InputError
from hil.controllers.base import Controller, Transfer


@dataclass(kw_only=True)
class PID(Controller):
    """u = P e + I ∫e dt + D N s/(s + N) e with e = r − y, both integrators by forward Euler.

    While the command is at its limit the integral does not grow further.

    Attributes:
        proportional, integral, derivative: P, I, D, in the command's unit per unit of y, s.
        bandwidth: N, corner of the derivative's filter [rad/s].

    Raises:
        InputError: Not one output and one input; a filter too fast for the period.

    Reference:
        C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12 (2023) 4569: P = -168, I = -800,
        D = -8.8 V per rad, N = 100, on the pitch.

    Example:
        >>> pid = PID(measured=("theta_p",), commanded=("V",), period=1e-3, proportional=-168.0)
        >>> pid.start()
        >>> pid.step(0.0, [0.1], [0.0])
        (16.8,)
    """

    kind: ClassVar[str] = "pid"

    proportional: float
    integral: float = 0.0
    derivative: float = 0.0
    bandwidth: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.measured) != 1 or len(self.commanded) != 1:
            raise InputError(
                "a PID has one measured and one commanded variable",
                where="controller",
                remedy="name one each, or use state-feedback",
            )
        if not 0 < self.bandwidth * self.period < 2:
            raise InputError(
                f"a derivative filter of {self.bandwidth:g} rad/s at a period of {self.period:g} s",
                where="controller.bandwidth",
                remedy=f"keep it below {2 / self.period:g} rad/s, or it is unstable",
            )
        self.start()

    def start(self) -> None:
        """Empty the integral; the derivative starts from an error of zero, as in the paper."""
        self._integral = 0.0
        self._smooth = 0.0

    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> tuple[float]:
        """Return the command."""
        error = r[0] - y[0]
        slope = self.bandwidth * (error - self._smooth)
        wanted = (
            self.proportional * error + self.integral * self._integral + self.derivative * slope
        )
        u = self.limited(wanted)
        if u == wanted or (wanted - u) * self.integral * error < 0:
            self._integral += self.period * error
        self._smooth += self.period * slope
        return (u,)

    def transfer(self, z: Transfer) -> Transfer:
        """K(z)."""
        T, N = self.period, self.bandwidth
        K = (
            self.proportional
            + self.integral * T / (z - 1)
            + self.derivative * N * (z - 1) / (z - 1 + N * T)
        )
        return -K[:, np.newaxis, np.newaxis]
