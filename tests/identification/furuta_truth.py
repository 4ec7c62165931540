"""The rotary pendulum of the report with true stiction; shares nothing with the product.

M. B. Arnolds, report DCT 2003.100 (2003), equation (2.23) with its misprints corrected. Stiction is
Karnopp's: an arm slower than `SLOW` rests while the torque on it is below the breakaway torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp

G = 9.81
ALPHA_STEP, BETA_STEP = math.radians(1 / 18.17), math.radians(90 / 256)
SLOW = 0.02
STEP = 0.01


@dataclass(frozen=True)
class Setup:
    """Parameters in SI units; `motor` is torque a count, `stiction` torque (0: none)."""

    J: float = 0.0035
    Jr: float = 0.79e-3
    m: float = 0.0276
    l0: float = 0.1505
    l1: float = 0.145
    d: float = 0.0169 + 0.0706 * 0.0707 / 0.9
    C1: float = 1e-4
    Kf: float = 0.0351
    motor: float = 0.0706 * 0.0618 / 0.9
    stiction: float = 0.0
    asymmetry: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """Factors of Coulomb friction and of viscous friction, each forwards and backwards."""

    def sticky(self, counts: float = 45) -> Setup:
        """The same with a breakaway torque of so many counts."""
        return replace(self, stiction=counts * self.motor)


SETUP_1 = Setup()
SETUP_2 = Setup(
    J=0.0059,
    Jr=0.77e-3,
    d=0.0140 + 0.0706 * 0.0707 / 0.9,
    C1=1.2e-4,
    Kf=0.0665,
    motor=0.0706 * 0.0682 / 0.9,
)


def rates(x, u, p: Setup):
    """Time derivative of (alpha, beta, their rates)."""
    _, beta, wa, wb = x
    s, c = math.sin(beta), math.cos(beta)
    torque = p.motor * u
    rod = -p.C1 * wb - p.m * G * p.l1 * s
    if p.stiction and abs(wa) < SLOW:
        free = rod / p.Jr
        load = torque + p.m * p.l0 * p.l1 * (s * wb**2 - c * free)
        if abs(load) < p.stiction:
            return (wa, wb, -wa / 2e-3, free)
        friction = math.copysign(p.Kf, load) + p.d * wa
    else:
        dry, viscous = (p.asymmetry[::2], p.asymmetry[1::2])[int(wa <= 0)]
        friction = p.Kf * dry * math.tanh(15 * wa) + p.d * viscous * wa
    m11 = p.J + p.m * p.l0**2 + p.m * p.l1**2 * s * s
    m12 = p.m * p.l0 * p.l1 * c
    r1 = torque - friction - 2 * p.m * p.l1**2 * s * c * wa * wb + p.m * p.l0 * p.l1 * s * wb**2
    r2 = rod + p.m * p.l1**2 * s * c * wa**2
    det = m11 * p.Jr - m12**2
    return (wa, wb, (p.Jr * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det)


def step(x, u, p: Setup, h: float = STEP, parts: int = 10):
    """Runge–Kutta over one sample with the input held."""
    d = h / parts
    for _ in range(parts):
        k1 = rates(x, u, p)
        k2 = rates([a + d / 2 * b for a, b in zip(x, k1, strict=True)], u, p)
        k3 = rates([a + d / 2 * b for a, b in zip(x, k2, strict=True)], u, p)
        k4 = rates([a + d * b for a, b in zip(x, k3, strict=True)], u, p)
        x = [
            a + d / 6 * (b + 2 * c + 2 * e + f)
            for a, b, c, e, f in zip(x, k1, k2, k3, k4, strict=True)
        ]
    return x


@dataclass(frozen=True)
class Record:
    """Time (n,), command (n,), angles as counted (n, 2), true states (n, 4)."""

    time: np.ndarray
    u: np.ndarray
    angles: np.ndarray
    states: np.ndarray


def pulses(duration: float, *each: tuple[float, float, float]) -> np.ndarray:
    """Commands at 100 Hz: (from, to, counts) each."""
    time = np.arange(round(duration / STEP)) * STEP
    return sum((u * ((time >= a) & (time < b)) for a, b, u in each), np.zeros_like(time))


def record(p: Setup, u: np.ndarray, seed: int = 0, *, x0=(0.0, 0.0, 0.0, 0.0)) -> Record:
    """Run from rest; both sensors count, each from an unknown fraction of a count."""
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
    x, states = list(x0), np.empty((len(u), 4))
    for k, command in enumerate(u.tolist()):
        states[k] = x
        x = step(x, command, p)
    resolution = np.array([ALPHA_STEP, BETA_STEP])
    angles = np.round(states[:, :2] / resolution + shift) * resolution
    return Record(np.arange(len(u)) * STEP, np.asarray(u, float), angles, states)


def rod(p: Setup, beta: float, duration: float = 10.0, *, dry=0.0, sharp=50.0):
    """Time (n,) and true angle (n,) of the rod let go from `beta`, the arm held.

    Its pivot may have dry friction `dry` [N.m], smoothed within 1/`sharp` [rad/s].
    """

    def rate(_, x):
        friction = p.C1 * x[1] + dry * math.tanh(sharp * x[1])
        return [x[1], -(friction + p.m * G * p.l1 * math.sin(x[0])) / p.Jr]

    time = np.arange(round(duration / STEP)) * STEP
    method = "LSODA" if dry else "DOP853"
    found = solve_ivp(rate, (0, duration), [beta, 0.0], method, time, rtol=1e-9, atol=1e-11)
    return time, found.y[0]


def counted(angle: np.ndarray, resolution: float, seed: int) -> np.ndarray:
    """An angle as a sensor counts it, from an unknown fraction of a count."""
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5)
    return np.round(angle / resolution + shift) * resolution
