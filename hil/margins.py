"""Robustness margins of a sampled loop: gain, phase, disk; from the plant's linear model.

The loop is broken at each of the plant's inputs in turn, the others stay closed. With u = K y and
y = G u, L_i = det(I − M)/det(I − M without i) − 1 where M = K G.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hil.controllers.base import Controller
from hil.linear import Linear, Matrix

Complex: TypeAlias = npt.NDArray[np.complex128]

_POINTS = 1200
_OUTSIDE = 1e-7


@dataclass(frozen=True)
class Margins:
    """How far a loop is from instability; the smallest of all its inputs.

    Attributes:
        is_stable: The loop as it is. If it is not, all margins are zero.
        gain: Factor ≥ 1 by which the gain may rise, and may fall, at least.
        phase: Lag that may be added at least [rad].
        disk: Largest α for which all simultaneous changes of gain and phase by
            (1 + δ/2)/(1 − δ/2), |δ| < α, are borne.
        frequency: Where the disk margin is [rad/s].

    Reference:
        P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems
        Magazine 40 (2020) 78–95: α = 1/max|S − 1/2|, S = 1/(1 + L).
    """

    is_stable: bool
    gain: float
    phase: float
    disk: float
    frequency: float


UNSTABLE = Margins(False, 1.0, 0.0, 0.0, 0.0)


def delayed(linear: Linear, period: float, delay: float) -> tuple[Matrix, Matrix, Matrix]:
    """Return A, B_0, B_1 of x(k+1) = A x(k) + B_0 u(k) + B_1 u(k−1).

    Args:
        linear: Of the plant.
        period: Of the controller [s].
        delay: Between a sample and the command that answers it [s], 0 to one period.
    """
    A, late = linear.sampled(period)
    if delay <= 0:
        return A, late, np.zeros_like(late)
    n = A.shape[0]
    _, fresh = linear.sampled(max(period - delay, 1e-12))
    if period - delay <= 1e-12:
        fresh = np.zeros((n, linear.B.shape[1]))
    return A, fresh, late - fresh


def margins(linear: Linear, controller: Controller, delay: float) -> Margins | None:
    """Return the margins of a plant under a controller; None: it has no linear part.

    Args:
        linear: Of the plant, with all that is measured and commanded.
        controller: Of the loop.
        delay: Between a sample and its answer [s].
    """
    if controller.transfer(np.array([1.5 + 0j])) is None:
        return None
    rows = [linear.outputs.index(name) for name in controller.measured]
    columns = [linear.inputs.index(name) for name in controller.commanded]
    T = controller.period
    A, B0, B1 = delayed(linear, T, min(delay, T))
    C, D = linear.C[rows], linear.D[np.ix_(rows, columns)]

    def loop(z: Complex) -> Complex:
        K = controller.transfer(z)
        assert K is not None
        back = 1 / z[:, np.newaxis, np.newaxis]
        inner = np.linalg.solve(
            z[:, np.newaxis, np.newaxis] * np.eye(len(A)) - A,
            B0[:, columns] + B1[:, columns] * back,
        )
        return np.asarray(K @ (C @ inner + D * (back if delay > 0 else 1)), np.complex128)

    if not _is_stable(loop, A):
        return UNSTABLE
    return _smallest(loop, np.geomspace(1e-4, np.pi, _POINTS), T, len(columns))


def _is_stable(loop: Callable[[Complex], Complex], A: Matrix) -> bool:
    """Count closed-loop poles outside the unit circle by the argument principle."""
    radius = 1 + _OUTSIDE
    angles = np.concatenate([[0.0], np.geomspace(1e-9, np.pi, 2 * _POINTS)])
    circle = np.asarray(radius * np.exp(1j * angles), np.complex128)
    values = _return_difference(loop(circle))
    if not np.all(np.isfinite(values)):
        return False
    # The lower half of the circle is the mirror image of the upper.
    turned = np.unwrap(np.angle(values))
    winding = 2 * (turned[-1] - turned[0]) / (2 * np.pi)
    outside = int(np.count_nonzero(np.abs(np.linalg.eigvals(A)) > radius))
    return round(outside - winding) == 0


def _return_difference(M: Complex) -> Complex:
    return np.asarray(np.linalg.det(np.eye(M.shape[-1]) - M), np.complex128)


def _smallest(
    loop: Callable[[Complex], Complex], angles: npt.NDArray[np.float64], T: float, inputs: int
) -> Margins:
    M = loop(np.asarray(np.exp(1j * angles), np.complex128))
    whole = _return_difference(M)
    found: list[tuple[float, float, float, float]] = []
    for i in range(inputs):
        rest = np.delete(np.delete(M, i, 1), i, 2)
        found.append(_of_one(whole / _return_difference(rest) - 1, angles / T))
    gain, phase = min(f[0] for f in found), min(f[1] for f in found)
    disk, frequency = min((f[2], f[3]) for f in found)
    return Margins(True, gain, phase, disk, frequency)


def _of_one(L: Complex, frequencies: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return gain, phase, disk margin and its frequency of one scalar loop."""
    size = np.abs(0.5 * (1 - L) / (1 + L))  # S − 1/2
    worst = int(np.argmax(size))
    # At both ends of the range of frequencies L is real, and does not cross the axis there.
    ends = [end for end in (L[0], L[-1]) if abs(end.imag) < 1e-3 * abs(end.real)]
    gains = [1 / abs(value) for value in (*_crossings(L, L.imag), *ends) if value.real < 0]
    gain = min((max(g, 1 / g) for g in gains), default=float("inf"))
    around = np.log(np.abs(L))
    lags = [abs(np.angle(-value)) for value in _crossings(L, around)]
    return gain, float(min(lags, default=np.pi)), float(1 / size[worst]), float(frequencies[worst])


def _crossings(L: Complex, of: npt.NDArray[np.float64]) -> Sequence[complex]:
    """Return L where `of` changes its sign, on straight lines between the points."""
    places = np.flatnonzero(of[:-1] * of[1:] < 0)
    share = of[places] / (of[places] - of[places + 1])
    return (L[places] + share * (L[places + 1] - L[places])).tolist()
