"""Many balancing pendulums at once under the aggressive reference, integrated with NumPy.

The equations are written here a second time on purpose: the twin is to be tested on a plant that
its own tool has not made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES = ("X1", "X2", "X3", "X4", "X5", "X6", "X7")
NOMINAL = np.array([0.0436, 0.0178, 0.1149, 0.8719, 4.6701, 0.7268, 0.7256])
ALPHA = 165.418
DEGREE = math.pi / 180
ENCODER = 2 * math.pi / 60_000
SENSORS = {"theta_w": ENCODER / math.sqrt(12), "theta_p": 0.5 * DEGREE, "omega_p": 0.5 * DEGREE}
STEP = 1e-3
DISTURBANCE, RATE = 0.02, 3.0
"""Standard deviation [V] and bandwidth [1/s] of the unknown voltage."""
ROBOT = """
[[twin]]
name = "robot"
rate = 1000
[twin.plant]
model = "Twinproof.Plants.WheeledPendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta_w = {resolution = 1.0471975511965977e-4}
theta_p = {sd = "0.5 deg"}
omega_p = {sd = "0.5 deg/s"}
"""
"""Settings of a plant's twin, to be gone on with."""
_SECOND = 1000
_SHARP = 0.01
"""Speed over which Coulomb friction turns [rad/s]."""


def aggressive(time: Array) -> Array:
    """Return the pitch reference of the paper [rad]."""
    fast = 10 * np.cos(3 * time) * np.sin(5 * time) ** 2
    slow = 6 * (np.cos(4 * time) - np.sin(time))
    return (3 * np.sin(7 * time) + slow + fast) * DEGREE


@dataclass
class Fleet:
    """n plants, each with its PID, noise and place in the reference.

    Attributes:
        count: n.
        seed: Of everything random.
        parameters: Time [s] → X1 … X7, each a number or (n,).
        friction: Time [s] → Coulomb friction at the wheel [N.m].
    """

    count: int
    seed: int
    parameters: Callable[[float], Array] = field(default=lambda _: NOMINAL)
    friction: Callable[[float], float] = field(default=lambda _: 0.0)

    def seconds(self, count: int) -> Iterator[tuple[Array, Array]]:
        """Yield, second by second, V (1001, n) and theta_w, theta_p, omega_p (1000, n, 3).

        The last row of V is that of the next second's first sample.
        """
        rng, n = np.random.default_rng(self.seed), self.count
        phase = rng.uniform(0, 100, n)
        x = np.zeros((4, n))
        integral, slow, voltage = np.zeros(n), None, np.zeros(n)
        push = DISTURBANCE * rng.standard_normal(n)
        decay = math.exp(-RATE * STEP)
        fresh = DISTURBANCE * math.sqrt(1 - decay**2)
        for second in range(count):
            noise = rng.standard_normal((_SECOND, 3, n))
            wanted = aggressive(phase + second + STEP * np.arange(_SECOND)[:, None])
            volts, seen = np.empty((_SECOND + 1, n)), np.empty((_SECOND, n, 3))
            for k in range(_SECOND):
                time = second + k * STEP
                volts[k] = voltage
                seen[k, :, 0] = ENCODER * np.round(x[0] / ENCODER)
                seen[k, :, 1] = x[1] + SENSORS["theta_p"] * noise[k, 0]
                seen[k, :, 2] = x[3] + SENSORS["omega_p"] * noise[k, 1]
                error = wanted[k] - seen[k, :, 1]
                slow = error.copy() if slow is None else slow
                derived = 100.0 * (error - slow)
                slow = slow + STEP * derived
                x = self._moved(x, voltage + push, time)
                push = decay * push + fresh * noise[k, 2]
                # What is computed now acts from the next cycle on.
                voltage = -168.0 * error - 800.0 * integral - 8.8 * derived
                integral = integral + STEP * error
            volts[_SECOND] = voltage
            yield volts, seen

    def _moved(self, x: Array, volts: Array, time: float) -> Array:
        p, rub, h = self.parameters(time), self.friction(time) / ALPHA, STEP
        k1 = _slope(x, volts, p, rub)
        k2 = _slope(x + h / 2 * k1, volts, p, rub)
        k3 = _slope(x + h / 2 * k2, volts, p, rub)
        k4 = _slope(x + h * k3, volts, p, rub)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _slope(x: Array, volts: Array, p: Array, rub: float) -> Array:
    """Equations (19) and (20) of the paper, corrected, solved for the accelerations."""
    _, pitch, wheel, rate = x
    x1, x2, x3, x4, x5, x6, x7 = p
    coupling = x3 * np.cos(pitch) - x2
    drive = volts - x6 * wheel + x7 * rate
    top = drive + x3 * rate**2 * np.sin(pitch)
    if rub:
        top = top - rub * np.tanh(wheel / _SHARP)
    bottom = drive - x5 * np.sin(pitch)
    a, d = x1 + x2, x4 + x2
    det = coupling**2 - a * d
    return np.array(
        [wheel, rate, -(d * top + coupling * bottom) / det, (a * bottom + coupling * top) / det]
    )
