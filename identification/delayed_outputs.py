"""Delays of measured signals: an output that shows what the plant did a while ago.

The plant does not feel such a delay, so it is simulated without, and the outputs are put together
afterwards: y = A + B·z(t - T), with the delayed signal z, its time T, and a weight B that depends
on parameters alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.casadi_expressions import SX
from fmus.explicit import ExplicitModel
from fmus.expressions import Delayed
from foundation.errors import UnsupportedModelError

Vector = NDArray[np.float64]

_FEWEST = 3  # samples that tell a slope and a curvature
# Apart [s]: closer, a reversal of friction at the very beginning would be taken for a curvature.
_BASE = 5e-3


@lru_cache(maxsize=256)
def at_outputs(model: ExplicitModel) -> tuple[int, ...]:
    """Return the indices of the delays whose signal is the plant's and goes to outputs only.

    Raises:
        UnsupportedModelError: The plant feels a delay of its own motion, or a duration varies.
    """
    found: list[int] = []
    for k, delay in enumerate(model.dae.delays):
        operand, own = model.fold(delay.operand), model.delayed[k]
        of_motion = ca.depends_on(operand, ca.vertcat(model.x, model.delayed))
        is_felt = bool(model.x.shape[0]) and ca.depends_on(model.derivatives, own)
        if of_motion and (is_felt or ca.depends_on(operand, model.delayed)):
            raise UnsupportedModelError(
                f"{model.dae.name} delays a signal that depends on the states, and acts on it",
                remedy="put the delay at an input or output, or use a first-order lag",
            )
        if ca.depends_on(model.fold(delay.duration), ca.vertcat(model.x, model.u, model.delayed)):
            raise UnsupportedModelError(
                f"{model.dae.name}: a delay's duration varies while it runs",
                remedy="make the duration a parameter",
            )
        if of_motion or (not is_felt and ca.depends_on(operand, model.p)):
            found.append(k)
    return tuple(found)


def at_inputs(model: ExplicitModel) -> list[Delayed]:
    """Return the delays whose signal is known before the plant is simulated."""
    late = at_outputs(model)
    return [delay for k, delay in enumerate(model.dae.delays) if k not in late]


def split(model: ExplicitModel, outputs: SX) -> tuple[SX, SX, SX, SX]:
    """Return A (ny,), B (ny, delays), z (delays,) and T (delays,) of outputs with delays.

    Raises:
        UnsupportedModelError: An output is not linear in a delayed signal.
    """
    late = at_outputs(model)
    delays = [model.dae.delays[k] for k in late]
    signals = ca.vertcat(*(model.fold(delay.operand) for delay in delays))
    durations = ca.vertcat(*(model.fold(delay.duration) for delay in delays))
    own = ca.vertcat(*(model.delayed[k] for k in late))
    weights = ca.jacobian(outputs, own)
    varying = ca.vertcat(model.time, model.x, model.u, model.delayed)
    if ca.depends_on(weights, varying):
        raise UnsupportedModelError(
            f"an output of {model.dae.name} is no linear function of a delayed signal",
            remedy="let the delay act last",
        )
    return ca.substitute(outputs, own, ca.SX.zeros(len(late))), weights, signals, durations


@dataclass(frozen=True)
class DelayedOutputs:
    """Puts the outputs of a model together.

    Attributes:
        ny: Number of outputs.
        delays: Number of delays.
        weights: p → B, ∂B/∂θ, T, ∂T/∂θ.
    """

    ny: int
    delays: int
    weights: Any

    @classmethod
    def of(cls, model: ExplicitModel, outputs: SX, theta: SX) -> DelayedOutputs:
        """Take a model's outputs (ny,), and the parameters (ns,) to differentiate by."""
        _, weights, _, durations = split(model, outputs)
        function = ca.Function(
            "weights",
            [model.p],
            [
                ca.densify(weights),
                ca.densify(ca.jacobian(ca.vec(weights), theta)),
                ca.densify(durations),
                ca.densify(ca.jacobian(durations, theta)),
            ],
        )
        return cls(outputs.shape[0], durations.shape[0], function)

    def together(self, y: Vector, dy: Vector, p: Vector, h: float) -> tuple[Vector, Vector]:
        """Return outputs (n, ny) and sensitivities (n, ny, nx + ns).

        Args:
            y: (n, ny + delays) A and z.
            dy: (n, ny + delays, nx + ns) their sensitivities, or (0, …).
            p: (np,) parameters.
            h: Sample time [s].
        """
        b, db, durations, d_durations = (np.asarray(part) for part in self.weights(p))
        outputs, changes = y[:, : self.ny].copy(), dy[:, : self.ny].copy()
        first = dy.shape[2] - d_durations.shape[1]
        db = db.reshape((self.ny, self.delays, -1), order="F")
        for k in range(self.delays):
            signal = y[:, self.ny + k]
            late, slope = _delayed(signal, float(durations[k, 0]), h)
            outputs += late[:, None] * b[:, k]
            if len(dy) == 0:
                continue
            d_late, _ = _delayed(dy[:, self.ny + k], float(durations[k, 0]), h)
            d_late[:, first:] -= slope[:, None] * d_durations[k]
            changes += b[:, k][None, :, None] * d_late[:, None, :]
            changes[:, :, first:] += late[:, None, None] * db[:, k]
        return outputs, changes


def _delayed(signal: Vector, duration: float, h: float) -> tuple[Vector, Vector]:
    """Return a signal (n, …) and its slope, a duration earlier; straight lines between samples.

    Before the first sample it runs on the parabola through three of its first: a straight line
    would be off by more than an encoder's noise after 30 ms, and a delay of a command be preferred.
    """
    n = len(signal)
    if n < _FEWEST:
        return signal.copy(), np.zeros_like(signal)
    apart = min(max(1, round(_BASE / h)), (n - 1) // 2)
    first, second, third = signal[0], signal[apart], signal[2 * apart]
    curvature = (third - 2 * second + first) / (apart * h) ** 2
    begin = (second - first) / (apart * h) - apart * h / 2 * curvature
    at = np.arange(n) - duration / h
    before = np.clip(np.floor(at).astype(int), 0, n - 2)
    away = (at - before).reshape(-1, *[1] * (signal.ndim - 1))
    share, past = np.fmax(away, 0.0), np.fmin(away, 0.0)
    slopes = np.gradient(signal, h, axis=0)
    late = signal[before] + share * (signal[before + 1] - signal[before])
    slope = slopes[before] + share * (slopes[before + 1] - slopes[before])
    late += h * past * begin + (h * past) ** 2 / 2 * curvature
    return late, np.where(past < 0, begin + h * past * curvature, slope)
