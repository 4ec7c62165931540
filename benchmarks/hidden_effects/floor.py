"""What a perfect model would leave over on a record: its own noise, and what that does to a start.

Errors are scored over windows of one second, whose first tenth estimates the initial state. The
noise of that tenth is in the estimate, and an unstable machine carries it off. Here that is worked
out from the truth's own noise and the truth's own machine, linearised about what it really did, so
that a record that happens to be easy or hard is no merit or fault of a model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.hidden_effects.laws import MEMORIES
from benchmarks.hidden_effects.plants import Plant
from benchmarks.hidden_effects.simulation import SAMPLE, Hidden, Run, windows

_WINDOW = 1.0  # [s]
_SETTLING = 0.1  # of a window
_STEP = 1e-6


def noise_floor(
    plant: Plant,
    parameters: Mapping[str, float],
    hidden: Sequence[Hidden],
    run: Run,
    noise: float,
) -> dict[str, float]:
    """Return sensor → root-mean-square error of the machine itself over windows of one second.

    Args:
        parameters, hidden: The machine.
        run: What it did and what was logged of it.
        noise: Factor on the sensors' standard deviations.
    """
    length = round(_WINDOW / SAMPLE)
    first = round(_SETTLING * length)
    count = (len(run.time) - 1) // length
    index = np.arange(count)[None, :] * length + np.arange(length)[:, None]
    sensors = list(plant.sensors.values())
    sd = np.array([np.hypot(noise * s.sd, s.resolution / np.sqrt(12)) for s in sensors])
    white = (run.measured - run.exact)[index]  # (n, windows, ny)
    moved = _by_initial_state(plant, parameters, hidden, run, index)
    squares = np.zeros(len(sensors))
    for w in range(count):
        seen = moved[:first, :, :, w] / sd[:, None]
        start = np.linalg.lstsq(
            seen.reshape(-1, plant.states), (white[:first, w] / sd).ravel(), rcond=1e-10
        )[0]
        error = white[first:, w] - moved[first:, :, :, w] @ start
        squares += np.sum(error**2, axis=0)
    rms = np.sqrt(squares / (count * (length - first)))
    return dict(zip(plant.sensors, rms.tolist(), strict=True))


def _by_initial_state(
    plant: Plant,
    parameters: Mapping[str, float],
    hidden: Sequence[Hidden],
    run: Run,
    index: np.ndarray,
) -> np.ndarray:
    """Return (n, ny, nx, windows) how outputs follow a window's initial state."""
    length, count = index.shape
    nx, lanes = plant.states, 1 + plant.states
    start = np.repeat(run.states[index[0]].T[:, None, :], lanes, axis=1)
    for i in range(nx):
        start[i, 1 + i] += _STEP
    # Neither a memory at the input nor a fault of a sensor changes how a motion goes on.
    there = [e for e in hidden if e.place not in plant.sensors and e.effect not in MEMORIES]
    known = {e: np.full(lanes * count, e.size) for e in there}
    flat = {name: np.full(lanes * count, value) for name, value in parameters.items()}
    commands = np.tile(run.command[index], (1, lanes))
    x = windows(plant, flat, start.reshape(nx, -1), commands, known)
    shown = [s.state for s in plant.sensors.values()]
    y = x[:, shown].reshape(length, len(shown), lanes, count)
    return (y[:, :, 1:] - y[:, :, :1]) / _STEP
