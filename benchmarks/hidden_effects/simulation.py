"""The benchmark's truth: a machine with what is hidden in it, and its logger. Not the product."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.laws import FORCES, INPUTS, MEMORIES, SENSORS, UNKNOWN_FORCES
from benchmarks.hidden_effects.plants import Plant

Array = NDArray[np.float64]
SAMPLE = 2e-3  # [s]
_SUBSTEPS = 3
_LONGEST_MEMORY = 0.1  # [s]


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: the library's name, the place, and the size in usual units."""

    effect: str
    place: str
    size: float

    @property
    def label(self) -> str:
        """As the product writes it."""
        return f"{self.effect}@{self.place}"


@dataclass(frozen=True)
class Run:
    """What the logger saw and what was.

    Attributes:
        time: (n,) [s].
        command: (n,) as sent, held from each sample to the next.
        measured: (n, ny) with noise and digits.
        exact: (n, ny) as ideal sensors, but with hidden sensor effects, would have shown.
        states: (n, nx).
    """

    time: Array
    command: Array
    measured: Array
    exact: Array
    states: Array


class FellOverError(RuntimeError):
    """The machine left the region in which it works."""


def simulate(
    plant: Plant,
    parameters: Mapping[str, float],
    hidden: Sequence[Hidden],
    *,
    excitation: str,
    noise: float,
    disturbance: float = 0.0,
    seed: int,
    duration: float = 10.0,
) -> Run:
    """Run a machine in its loop and log it.

    Args:
        parameters: True values.
        hidden: What is hidden in it.
        excitation: Name of one of the plant's.
        noise: Factor on the sensors' standard deviations.
        disturbance: Standard deviation of a first-order force at the input, in usual commands.

    Raises:
        FellOverError: It did.
    """
    rng = np.random.default_rng(seed)
    n = round(duration / SAMPLE) + 1
    controller = plant.excitations[excitation](seed)
    sensors = list(plant.sensors.values())
    white = rng.standard_normal((n, len(sensors)))
    pushes = _low_pass(rng, n) * disturbance * plant.command_scale
    command = np.zeros(n)
    measured, exact = np.zeros((n, len(sensors))), np.zeros((n, len(sensors)))
    states = np.zeros((n, plant.states))
    x = np.zeros((plant.states, 1))
    lagged = np.zeros(2)
    # The command at every substep, for a delay that is no multiple of the sample time.
    memory = np.zeros(round(_LONGEST_MEMORY / SAMPLE) * _SUBSTEPS)
    h = SAMPLE / _SUBSTEPS
    at_input = [e for e in hidden if e.place == plant.command[0]]
    delays = any(e.effect == "Delay" for e in hidden)
    at_flange = [e for e in hidden if e.place in plant.flanges]
    for k in range(n):
        states[k] = x[:, 0]
        for j, (name, sensor) in enumerate(plant.sensors.items()):
            exact[k, j] = _sensed(plant, name, states[k, sensor.state], hidden)
            shown = exact[k, j] + noise * sensor.sd * white[k, j]
            step = sensor.resolution
            measured[k, j] = step * np.round(shown / step) if step else shown
        t = k * SAMPLE
        command[k] = controller(t, measured[k])
        for i in range(_SUBSTEPS):
            if delays:
                memory = np.roll(memory, 1)
                memory[0] = command[k]
            u = command[k]
            for e in at_input:
                u = _driven(plant, e, u, memory, lagged, h)
            drive = np.array([u + pushes[k]])
            x = _step(plant, parameters, at_flange, x, drive, t + i * h, h)
        if not np.all(np.abs(x) < 1e3):
            raise FellOverError(f"{plant.name} with {[e.label for e in hidden]} at {t:.2f} s")
    if plant.name in ("wheeled pendulum", "balancing robot"):
        tilt = states[:, 1] if plant.name == "wheeled pendulum" else states[:, 0]
        if np.max(np.abs(tilt)) > 1.2:
            raise FellOverError(f"{plant.name} with {[e.label for e in hidden]}")
    return Run(np.arange(n) * SAMPLE, command, measured, exact, states)


def _low_pass(rng: np.random.Generator, n: int, rate: float = 3.0) -> Array:
    decay = np.exp(-rate * SAMPLE)
    white = rng.standard_normal(n) * np.sqrt(1 - decay**2)
    out = np.zeros(n)
    out[0] = white[0] / np.sqrt(1 - decay**2)
    for k in range(1, n):
        out[k] = decay * out[k - 1] + white[k]
    return out


def _sensed(plant: Plant, name: str, value: float, hidden: Sequence[Hidden]) -> float:
    for e in hidden:
        if e.place == name:
            law = SENSORS[e.effect][0]
            flange = next(
                f for f in plant.flanges.values() if f.position == plant.sensors[name].state
            )
            size = e.size * (flange.position_scale if e.effect == "Offset" else 1.0)
            value = float(law(np.array(value), size))
    return value


def _driven(plant: Plant, e: Hidden, u: float, memory: Array, lagged: Array, h: float) -> float:
    if e.effect == "Delay":
        return float(memory[min(round(e.size / h), len(memory) - 1)])
    if e.effect == "FirstOrderLag":
        # Two lags in a row that add up to the time: not the library's single one.
        rate = 1 - np.exp(-h / (0.5 * e.size))
        lagged[0] += rate * (u - lagged[0])
        lagged[1] += rate * (lagged[0] - lagged[1])
        return float(lagged[1])
    law = INPUTS[e.effect][0]
    return float(law(np.array(u / plant.command_scale), e.size)) * plant.command_scale


def _step(
    plant: Plant,
    parameters: Mapping[str, float],
    at_flange: Sequence[Hidden],
    x: Array,
    u: Array,
    t: float,
    h: float,
) -> Array:
    sizes = [np.array([e.size]) for e in at_flange]

    def rates(t: float, x: Array) -> Array:
        return plant.rates(x, u, parameters, _forces(plant, at_flange, sizes, x, t))

    return _runge_kutta(rates, t, x, h)


def _forces(
    plant: Plant, at_flange: Sequence[Hidden], sizes: Sequence[Array], x: Array, t: float
) -> dict[str, Array]:
    force: dict[str, Array] = {}
    for e, size in zip(at_flange, sizes, strict=True):
        f = plant.flanges[e.place]
        law = FORCES.get(e.effect) or UNKNOWN_FORCES[e.effect]
        z, v = x[f.position] / f.position_scale, x[f.speed] / f.speed_scale
        added = size * f.force_scale * law(z, v, np.full_like(z, t), f.reversal / f.speed_scale)
        force[e.place] = force.get(e.place, 0.0) + added
    return force


def _runge_kutta(rates, t: float, x: Array, h: float) -> Array:
    k1 = rates(t, x)
    k2 = rates(t + h / 2, x + h / 2 * k1)
    k3 = rates(t + h / 2, x + h / 2 * k2)
    k4 = rates(t + h, x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def windows(
    plant: Plant,
    parameters: Mapping[str, Array],
    x0: Array,
    commands: Array,
    known: Mapping[Hidden, Array] | None = None,
) -> Array:
    """Simulate many windows at once.

    Args:
        parameters: (lanes,) each.
        x0: (nx, lanes).
        commands: (n, lanes), held over each sample.
        known: Effects without a memory that the machine has, at flanges or at the input, and their
            (lanes,) sizes.

    Returns:
        (n, nx, lanes).
    """
    there = known or {}
    at_flange = [e for e in there if e.place in plant.flanges]
    sizes = [there[e] for e in at_flange]
    at_input = [e for e in there if e.place not in plant.flanges]
    x, out = x0.copy(), np.zeros((len(commands), *x0.shape))
    h = SAMPLE / _SUBSTEPS
    for k, sent in enumerate(commands):
        out[k] = x
        u = sent
        for e in at_input:
            law = INPUTS[e.effect][0]
            u = law(u / plant.command_scale, there[e]) * plant.command_scale

        def rates(t: float, s: Array, u: Array = u) -> Array:
            return plant.rates(s, u, parameters, _forces(plant, at_flange, sizes, s, t))

        for i in range(_SUBSTEPS):
            x = _runge_kutta(rates, k * SAMPLE + i * h, x, h)
    return out


__all__ = ["MEMORIES", "SAMPLE", "FellOverError", "Hidden", "Run", "simulate", "windows"]
