"""How well a model predicts a record: one rule for fitted and for unseen data.

Free simulation: the first tenth of the record estimates the initial state, all of it is scored.
Windows: each window's first tenth estimates its initial state and is not scored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from identification.problem import Matrix, Problem, Vector
from identification.simulator import Simulator
from identification.windows import (
    Window,
    cut,
    fitting_length,
    guess_states,
    settle,
    settling_samples,
)

NDArrayBool = NDArray[np.bool_]

WINDOW = 1.0
"""Length of the windows where a free simulation does not stay bounded [s]."""

# A free simulation further off than this many spans of the measurement has run away.
_BOUNDED = 10.0


@dataclass(frozen=True)
class Prediction:
    """A model's prediction of a record.

    Attributes:
        horizon: Window length [s], or None for the free simulation.
        windows: What was predicted in one go.
        simulated: (n, ny), NaN where a window diverged.
        scored: (n,) True where the error counts.
        x0: (windows, nx) initial states used.
        error: (n, ny) measured minus simulated.
        floor: (ny,) root-mean-square error that a perfect model would show here: sensor noise and
            the initial states' share of it.
        deviation: (ny,) standard deviation of the measurement over the record; 0 for a channel that
            is constant.
    """

    horizon: float | None
    windows: tuple[Window, ...]
    simulated: Matrix
    scored: NDArrayBool
    x0: Matrix
    error: Matrix
    floor: Vector
    deviation: Vector

    @property
    def bounded(self) -> bool:
        """No window left the finite numbers, nor strayed far beyond the measurement."""
        error = self.error[:, self.moves]
        strayed = np.abs(error) >= _BOUNDED * self.deviation[self.moves]
        return bool(np.all(np.isfinite(self.error)) and not np.any(strayed))

    @property
    def moves(self) -> NDArrayBool:
        """(ny,) False for a channel that is constant over the record."""
        return self.deviation > 0

    @cached_property
    def rmse(self) -> Vector:
        """(ny,) root-mean-square error over the scored samples."""
        return np.sqrt(np.mean(self.error[self.scored] ** 2, axis=0))

    @cached_property
    def nrmse(self) -> Vector:
        """(ny,) RMSE over the standard deviation of the measurement; NaN where nothing moves."""
        return np.where(self.moves, self.rmse / np.where(self.moves, self.deviation, 1.0), np.nan)

    @property
    def total_nrmse(self) -> float:
        """Root mean square of the channels' NRMSE, over those that move."""
        if not np.any(self.moves):
            return float("nan")
        return float(np.sqrt(np.mean(self.nrmse[self.moves] ** 2)))

    def window_errors(self) -> Matrix:
        """Return (windows, ny): the mean squared error of each window's scored samples."""
        rows = [
            np.mean(self.error[w.begin : w.end][self.scored[w.begin : w.end]] ** 2, axis=0)
            for w in self.windows
        ]
        return np.array(rows)


def predict(
    problem: Problem,
    shooting: Simulator,
    values: Mapping[str, float],
    horizon: float | None,
    *,
    windows: Sequence[Window] | None = None,
    sd: Vector | None = None,
) -> Prediction:
    """Predict a record window by window.

    Args:
        problem: The record.
        shooting: The model, compiled.
        values: Every independent parameter.
        horizon: Window length [s]; None for the free simulation.
        windows: Use these instead of cutting the whole record (horizon must not be None).
        sd: (ny,) relative weights of the channels while initial states are estimated; by default
            the sensors' noise, but a thousandth of the signal at least, so that one very precise
            sensor does not decide alone.
    """
    h, n = problem.sample_time, len(problem.time)
    chosen = tuple(windows) if windows is not None else cut(n, h, horizon)
    noise = noise_estimate(problem)
    # The standard deviation of equal numbers is not exactly zero.
    moves = np.ptp(problem.outputs, axis=0) > 0
    deviation = np.where(moves, np.std(problem.outputs, axis=0), 0.0)
    weight = sd if sd is not None else np.fmax(noise, 1e-3 * deviation)
    p = shooting.parameter_vector(values)
    inputs = shooting.inputs_with_delays(problem.inputs, h, p)
    guesses = guess_states(problem, shooting, chosen)
    full = None if horizon is None else round(horizon / h)
    simulated = np.full(problem.outputs.shape, np.nan)
    scored = np.zeros(n, dtype=bool)
    x0 = np.zeros_like(guesses)
    floor = np.zeros(len(problem.output_names))
    for k, window in enumerate(chosen):
        settling = settling_samples(window, full)
        x0[k] = settle(problem, shooting, window, settling, guesses[k], inputs, p, weight)
        response = shooting.run(
            x0[k],
            inputs[window.begin : window.end],
            p,
            h,
            t0=float(problem.time[window.begin]),
            sensitivities=True,
        )
        simulated[window.begin : window.end] = response.outputs
        first = window.begin if horizon is None else window.begin + settling
        scored[first : window.end] = True
        if response.finite == len(window):
            to_x0 = response.sensitivities[:, :, : shooting.nx]
            floor += _floor(to_x0, settling, noise, weight, first - window.begin)
    count = max(int(np.sum(scored)), 1)
    return Prediction(
        horizon,
        chosen,
        simulated,
        scored,
        x0,
        problem.outputs - simulated,
        np.sqrt(floor / count),
        deviation,
    )


def _floor(to_x0: Matrix, settling: int, noise: Vector, weight: Vector, first: int) -> Vector:
    """Return (ny,) the sum of squares that noise alone would leave over a window's scored samples.

    The initial state is a weighted sum of the first samples; its error is carried along by the
    sensitivities. Samples that are scored and have helped to estimate it are closer than others.
    """
    ny, nx = to_x0.shape[1:]
    weighted = (to_x0[:settling] / weight[:, None]).reshape(settling * ny, nx)
    information = weighted.T @ weighted
    # The number keeps a state that follows from a signal, which no sample tells, from overflowing.
    ridge = np.diag(1e-12 * np.diag(information) + 1e-200)
    # (nx, settling, ny): by how much a sample moves the estimate.
    gain = np.linalg.pinv(information + ridge, hermitian=True) @ weighted.T
    gain = gain.reshape(nx, settling, ny) / weight
    covariance = np.einsum("isy,jsy,y->ij", gain, gain, noise**2)
    total = len(to_x0[first:]) * noise**2
    total += np.einsum("nyi,ij,nyj->y", to_x0[first:], covariance, to_x0[first:], optimize=True)
    total -= 2 * noise**2 * np.einsum("syi,isy->y", to_x0[first:settling], gain[:, first:])
    return total


def noise_estimate(problem: Problem) -> Vector:
    """Return (ny,) each channel's noise: what is known of its sensor, else an estimate.

    The estimate is the spread of third differences, which a smooth signal sampled densely does not
    reach: sd(Δ³y) = √20·sd(noise) for white noise.
    """
    third = np.diff(problem.outputs, n=3, axis=0)
    scale = 1.4826 / np.sqrt(20.0)
    estimate = scale * np.median(np.abs(third), axis=0)
    largest = np.max(np.abs(problem.outputs), axis=0)
    smallest = np.fmax(
        1e-9 * np.std(problem.outputs, axis=0), 1e-12 * np.where(largest > 0, largest, 1.0)
    )
    return np.where(np.isnan(problem.noise_sd), np.fmax(estimate, smallest), problem.noise_sd)


def choose_horizon(
    problem: Problem, shooting: Simulator, values: Mapping[str, float]
) -> float | None:
    """Return None (free simulation) where that stays bounded, else `WINDOW` (20 samples at least).

    A record shorter than one and a half windows is always simulated freely, and so is a model of
    which no state can be set.
    """
    if not shooting.begins_anywhere or predict(problem, shooting, values, None).bounded:
        return None
    duration = float(problem.time[-1] - problem.time[0])
    window = fitting_length(WINDOW, problem.sample_time)
    return window if duration > 1.5 * window else None
