# ruff: noqa: ARG005 -- every law is called alike
"""What the benchmark hides: laws whose shapes differ from the library's. No import of the product.

A force law gets position and speed in units of what is usual at its place and answers in units of
the force that is usual there; a size multiplies it. Signal laws get the signal in its usual units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ForceLaw = Callable[[Array, Array, Array, float], Array]
"""(position, speed, time, speed below which dry friction turns round) → force."""
SignalLaw = Callable[[Array, Any], Array]
"""(signal, size, a number or one a lane) → signal."""


def _sign(v: Array, width: float) -> Array:
    """Sign with rounded corners; the library's is a hyperbolic tangent."""
    return v / np.sqrt(v * v + width * width)


def _beyond(z: Array, free: float) -> Array:
    """How far a position is beyond a free range, with rounded corners."""
    over = np.abs(z) - free
    return np.sign(z) * 0.5 * (over + np.sqrt(over * over + 1e-4))


def _bent(z: Array) -> Array:
    """What a power law is off by: nothing where little moves, a tenth where much does.

    Never more, however far a machine travels: a law that is off by half has another name.
    """
    return 0.1 * z * z / (1 + z * z)


FORCES: Mapping[str, ForceLaw] = {
    "CoulombFriction": lambda z, v, t, w: -_sign(v, w),
    "AsymmetricCoulombFriction": lambda z, v, t, w: -0.6 * _sign(v, w) ** 2,
    "StribeckFriction": lambda z, v, t, w: -1.5 * _sign(v, w) / (1 + (v / (8 * w)) ** 2) ** 2,
    "ViscousFriction": lambda z, v, t, w: -v * (1 + _bent(v)),
    "AsymmetricViscousFriction": lambda z, v, t, w: -(np.sqrt(v * v + 1e-3) - 0.03),
    "QuadraticDrag": lambda z, v, t, w: -0.7 * v * np.abs(v) ** 0.9,
    "Constant": lambda z, v, t, w: 0.4 * (1 + 0.01 * np.sin(0.7 * t)),
    "LinearSpring": lambda z, v, t, w: -0.8 * z * (1 - _bent(z)),
    "CubicSpring": lambda z, v, t, w: -0.8 * z**3 * (1 - _bent(z)),
    "EndStop": lambda z, v, t, w: -4.0 * _beyond(z, 0.8),
}
"""Law by the library's name of the effect."""

UNKNOWN_FORCES: Mapping[str, ForceLaw] = {
    "damping only near the middle": lambda z, v, t, w: -1.5 * v * np.exp(-((z / 0.25) ** 2)),
    "friction that sets in": lambda z, v, t, w: -_sign(v, w) * (t > 5),
    "force of position times speed squared": lambda z, v, t, w: -1.2 * z * v * v,
    "force that peaks at one speed": lambda z, v, t, w: -2.0 * v / (1 + (v / 0.5) ** 4),
    "two ripples": lambda z, v, t, w: 0.6 * np.sin(9 * z) + 0.6 * np.sin(15.6 * z + 1),
}
"""Laws that are in no library."""


def _dead_zone(u: Array, size: Any) -> Array:
    return u - size * np.tanh(u / size)


def _saturation(u: Array, size: Any) -> Array:
    # A corner rounder than the library's.
    return u / (1 + np.abs(u / size) ** 8) ** (1 / 8)


INPUTS: Mapping[str, tuple[SignalLaw, tuple[float, float]]] = {
    "Offset": (lambda u, size: u + size, (0.03, 0.15)),
    "DeadZone": (_dead_zone, (0.03, 0.15)),
    "AsymmetricGain": (lambda u, size: u + size * np.sqrt(u * u + 1e-4), (0.02, 0.1)),
    "Saturation": (_saturation, (2.2, 1.4)),
    "AffineAmplifier": (lambda u, size: u + size * _sign(u, 0.01), (0.03, 0.15)),
}
"""Law at the input, with its small and its large size in usual commands."""

MEMORIES: Mapping[str, tuple[float, float]] = {
    "FirstOrderLag": (0.008, 0.03),
    "Delay": (0.006, 0.02),
}
"""Laws at the input with memory, and their small and large time [s]."""

SENSORS: Mapping[str, tuple[SignalLaw, tuple[float, float]]] = {
    "Offset": (lambda y, size: y + size, (0.02, 0.1)),
    "Gain": (lambda y, size: (1 + size) * y, (0.02, 0.08)),
}
"""Law at a sensor of position, with its sizes (offsets in usual positions)."""

FORCE_SIZES = (0.02, 0.1)
"""Small and large size of a force, in usual forces."""
