"""The gain of an amplifier that does nothing below a threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from foundation.errors import ExcitationError
from identification.calibration.measured import Measured, Vector, pair, vector


@dataclass(frozen=True, eq=False)
class AffineGain:
    """voltage = gain · (|u| - threshold) · sign(u) beyond the threshold, zero within.

    In Modelica this is a `Twinproof.Effects.Signal.DeadZone` of half width `threshold` at the
    input, and `gain` in place of the plant's.

    Attributes:
        gain: Volts a count.
        threshold: Counts; negative if the voltage jumps instead.
        residual_sd: Scatter of the voltages, V.
        mean_ratio: Mean of voltage / command, which is what is left of a gain if the threshold is
            overlooked: it depends on the commands that were measured, V a count.
    """

    gain: Measured
    threshold: Measured
    residual_sd: float
    mean_ratio: float

    def voltage(self, u: ArrayLike) -> Vector:
        """Return the voltage of commands in counts, V."""
        command = vector(u, "commands")
        beyond = np.maximum(np.abs(command) - self.threshold.value, 0.0)
        return self.gain.value * beyond * np.sign(command)


def affine_gain(u: ArrayLike, voltage: ArrayLike) -> AffineGain:
    """Fit gain and threshold to measured voltages.

    Args:
        u: (n,) commands in counts, both signs welcome, beyond the threshold, n >= 3.
        voltage: (n,) V.

    Raises:
        InputError: Shapes do not fit.
        ExcitationError: Fewer than two sizes of command, or no voltage.

    Example:
        >>> found = affine_gain([40, -40, 60, -60], [2.0, -2.0, 4.0, -4.0])
        >>> round(found.gain.value, 6), round(found.threshold.value, 6)
        (0.1, 20.0)
    """
    command, volts = pair(u, voltage, ("commands", "voltages"))
    size, height = np.abs(command), volts * np.sign(command)
    if command.size < 3 or np.ptp(size) == 0 or not np.any(height):
        raise ExcitationError(
            f"{command.size} voltages at {np.unique(size).size} sizes of command",
            remedy="measure at two sizes or more, beyond the threshold, three times or more in all",
        )
    table = np.column_stack([size, np.ones_like(size)])
    (slope, constant), *_ = np.linalg.lstsq(table, height, rcond=None)
    residual = height - table @ [slope, constant]
    sd = float(np.sqrt(np.sum(residual**2) / (command.size - 2)))
    covariance = sd**2 * np.linalg.inv(table.T @ table)
    threshold = float(-constant / slope)
    # Of a ratio: the gradient of -c/s is (c/s², -1/s).
    gradient = np.array([constant / slope**2, -1 / slope])
    return AffineGain(
        gain=Measured(float(slope), float(np.sqrt(covariance[0, 0]))),
        threshold=Measured(threshold, float(np.sqrt(gradient @ covariance @ gradient))),
        residual_sd=sd,
        mean_ratio=float(np.mean(volts / command)),
    )
