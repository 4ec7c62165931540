"""Noise-free records from right-hand sides written here, integrated by DOP853, inputs held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import ode

from fmus.dae import Dae
from fmus.frontend import load
from fmus.sources import ModelicaSource, library_class
from identification.problem import Problem, fitted_by_default

STEP = 1e-3
X = {"X1": 0.0436, "X2": 0.0178, "X3": 0.1149, "X4": 0.8719, "X5": 4.6701, "X6": 0.7268}
X |= {"X7": 0.7256}
ALPHA = 165.418


def run(
    rates: Callable[[Sequence[float], float], Sequence[float]],
    control: Callable[[float, Sequence[float]], float],
    start: Sequence[float],
    duration: float = 20.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, input and states; the input is held from each sample to the next."""
    n = round(duration / STEP) + 1
    states, inputs = np.empty((n, len(start))), np.empty(n)
    solver = ode(lambda _, x, u: rates(x, u)).set_integrator("dop853", rtol=1e-11, atol=1e-12)
    solver.set_initial_value(list(start), 0.0)
    for k in range(n):
        states[k] = solver.y
        inputs[k] = control(k * STEP, solver.y)
        solver.set_f_params(inputs[k])
        if k < n - 1:
            solver.integrate((k + 1) * STEP)
    return np.arange(n) * STEP, inputs, states


def wheeled_pendulum(coulomb: float = 0.0, cubic: float = 0.0, duration: float = 20.0) -> Any:
    """Balance under the paper's PID and aggressive reference; torques in N.m."""
    x1, x2, x3, x4, x5, x6, x7 = X.values()
    memory = {"integral": 0.0, "smooth": 0.0}

    def rates(x: Sequence[float], volts: float) -> list[float]:
        _, p, ww, wp = x
        s, c = np.sin(p), np.cos(p)
        right1 = volts - coulomb * np.tanh(ww / 0.05) / ALPHA + x3 * wp**2 * s - x6 * ww + x7 * wp
        right2 = volts + cubic * p**3 / ALPHA - x5 * s - x6 * ww + x7 * wp
        m11, m12, m21, m22 = x1 + x2, x3 * c - x2, -(x3 * c - x2), -(x4 + x2)
        det = m11 * m22 - m12 * m21
        return [ww, wp, (m22 * right1 - m12 * right2) / det, (m11 * right2 - m21 * right1) / det]

    def control(t: float, x: Sequence[float]) -> float:
        wanted = 3 * np.sin(7 * t) + 6 * (np.cos(4 * t) - np.sin(t))
        wanted += 10 * np.cos(3 * t) * np.sin(5 * t) ** 2
        error = np.radians(wanted) - x[1]
        slope = 100 * (error - memory["smooth"])
        volts = -168 * error - 800 * memory["integral"] - 8.8 * slope
        memory["integral"] += STEP * error
        memory["smooth"] += STEP * slope
        return float(volts)

    return run(rates, control, [0, 0, 0, 0], duration)


def positioner(coulomb: float = 0.0, offset: float = 0.0, duration: float = 20.0) -> Any:
    """Position control along two sines; forces in N."""

    def rates(x: Sequence[float], volts: float) -> list[float]:
        force = 35.1507 * volts - 203.5034 * x[1] - coulomb * np.tanh(x[1] / 1e-3) + offset
        return [x[1], force / 95.1089]

    def control(t: float, x: Sequence[float]) -> float:
        wanted = 0.1 * np.sin(2 * t) + 0.03 * np.sin(7 * t)
        return float(np.clip(400 * (wanted - x[0]) - 40 * x[1], -10, 10))

    return run(rates, control, [0, 0], duration)


def pendulum(duration: float = 20.0) -> Any:
    """Damped tracking about the hanging position, from a swing at the start."""

    def rates(x: Sequence[float], torque: float) -> list[float]:
        return [x[1], (torque - 3.61 * np.sin(x[0]) - 0.006 * x[1]) / 0.185]

    def control(t: float, x: Sequence[float]) -> float:
        return float(2 * np.sin(3 * t) + 0.5 * np.sin(8 * t) - 0.3 * x[1])

    return run(rates, control, [0.7, -1.0], duration)


def library(name: str) -> Dae:
    return load(library_class(f"Twinproof.Plants.{name}"))


def text(source: str) -> Dae:
    return load(ModelicaSource(source, "A", "A.mo", "A"))


def problem(
    dae: Dae, record: Any, columns: dict[str, int], free: Sequence[str] | None = None
) -> Problem:
    """A problem whose starting values are wrong by a third; `columns` maps outputs to states."""
    time, inputs, states = record
    names = tuple(columns)
    chosen = fitted_by_default(dae) if free is None else tuple(free)
    return Problem(
        dae=dae,
        time=time,
        inputs=inputs[:, None],
        outputs=states[:, list(columns.values())],
        output_names=names,
        noise_sd=np.full(len(names), np.nan),
        free=chosen,
        values={
            name: value * (4 / 3 if name in chosen else 1)
            for name, value in dae.parameter_values.items()
            if name not in dae.dependent_parameters
        },
    )
