# ruff: noqa: ARG005 -- every law is called alike
"""What the baselines are given: a case's record, the user's model, and the library's laws in NumPy.

The laws are the textbook shapes of `Twinproof.Effects`, so a baseline searches among the same names
as the product does. Left out are laws with a memory (lags, delays) and laws of sensors, which a
missing force cannot be, and periodic laws with two coefficients: fewer names to confuse.
"""

from __future__ import annotations

import re
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.cases import Case, right_labels
from benchmarks.hidden_effects.detectability import log_likelihood_ratio
from benchmarks.hidden_effects.plants import PLANTS, Plant
from benchmarks.hidden_effects.simulation import FellOverError, Run, simulate

Array = NDArray[np.float64]
Values = Mapping[str, Any]
_MODELS = Path(__file__).parent / "models"
_PARAMETER = re.compile(r"parameter Real (\w+)\(.*?\)\s*=\s*([-+.\deE]+)")
_TRANSLATIONAL = ("positioner", "oscillator")
_BIAS = "bias of the input"


@dataclass(frozen=True)
class Given:
    """What a method gets of a case, and nothing of what is hidden in it.

    Attributes:
        plant: The machine's equations, sensors and flanges.
        parameters: Of the user's model, as it stands in the file.
        scales: How much each may be off (one standard deviation).
        time: (n,) [s].
        command: (n,).
        measured: (n, ny).
        sd: (ny,) of the sensors, their digits included.
    """

    plant: Plant
    parameters: Mapping[str, float]
    scales: Mapping[str, float]
    time: Array
    command: Array
    measured: Array
    sd: Array

    def rates(self, x: Array, u: Array, p: Values, force: Values) -> Array:
        """Return the equations of motion, with the input's bias if the user's model has one."""
        return self.plant.rates(x, u + p[_BIAS] if _BIAS in p else u, p, force)

    @property
    def accelerations(self) -> list[int]:
        """The rates' rows that are accelerations, in the order of the flanges."""
        return [f.speed for f in self.plant.flanges.values()]


def given(case: Case, run: Run) -> Given:
    """Return what a method gets of a case: the product's user has the same."""
    plant = PLANTS[case.plant]
    parameters = dict(plant.parameters)
    source = _MODELS / f"{plant.model}.mo"
    if source.exists():
        found = dict(_PARAMETER.findall(source.read_text()))
        parameters = {k: float(found[k]) for k in parameters}
    scales = {k: 0.3 * abs(v) for k, v in parameters.items()}
    if case.group == "known bias":
        parameters[_BIAS], scales[_BIAS] = 0.0, 0.3 * plant.command_scale
    sensors = plant.sensors.values()
    sd = np.array([np.hypot(case.noise * s.sd, s.resolution / np.sqrt(12)) for s in sensors])
    return Given(plant, parameters, scales, run.time, run.command, run.measured, sd)


def work(case: Case, method: Callable[[Given], str]) -> dict[str, object]:
    """Simulate a case, ask a method what is missing, and say whether it was right.

    Returns:
        name, group, plant, nats, first, point (1 for a right name), seconds, trouble.
    """
    row: dict[str, object] = {"name": case.name, "group": case.group, "plant": case.plant}
    row |= {"nats": float("nan"), "first": "", "point": 0.0, "seconds": 0.0, "trouble": ""}
    plant, parameters = PLANTS[case.plant], case.parameters()
    try:
        run = simulate(
            plant,
            parameters,
            case.hidden,
            excitation=case.excitation,
            noise=case.noise,
            disturbance=case.disturbance,
            seed=case.seed,
        )
    except FellOverError as fell:
        return row | {"trouble": str(fell)}
    nats = log_likelihood_ratio(plant, parameters, run, case.noise) if case.hidden else 0.0
    began = clock.perf_counter()
    try:
        first = method(given(case, run))
    except np.linalg.LinAlgError as error:
        return row | {"nats": nats, "trouble": str(error)}
    seconds = clock.perf_counter() - began
    right = case.group == "one" and first in right_labels(case.plant, case.hidden[0])
    return row | {"nats": nats, "first": first, "point": float(right), "seconds": seconds}


# --- The library's laws --------------------------------------------------------------------------

_ForceLaw = Callable[[Array, Array, Array, float, float], Array]
"""(position, speed, time, width of the sign, shape) → force on the flange for coefficient 1."""
_InputLaw = Callable[[Array, Array, float], Array]
"""(command, time, shape) → what is added to the command."""

_FORCES: Mapping[str, tuple[_ForceLaw, bool]] = {
    "CoulombFriction": (lambda z, v, t, w, s: -np.tanh(v / w), True),
    "AsymmetricCoulombFriction": (lambda z, v, t, w, s: -(np.tanh(v / w) ** 2), False),
    "StribeckFriction": (lambda z, v, t, w, s: -np.exp(-((v / s) ** 2)) * np.tanh(v / w), True),
    "ViscousFriction": (lambda z, v, t, w, s: -v, True),
    "AsymmetricViscousFriction": (lambda z, v, t, w, s: -np.abs(v), False),
    "QuadraticDrag": (lambda z, v, t, w, s: -v * np.abs(v), True),
    "RollingResistance": (lambda z, v, t, w, s: -v * (v * v + w * w) ** (-1 / 6), True),
    "WarmUpFriction": (lambda z, v, t, w, s: -np.exp(-t / s) * v, True),
    "HystereticDamping": (lambda z, v, t, w, s: -np.abs(z) * np.tanh(v / w), True),
    "LoadDependentFriction": (lambda z, v, t, w, s: -np.abs(np.sin(z)) * np.tanh(v / w), True),
    "Constant": (lambda z, v, t, w, s: np.ones_like(z), False),
    "LinearSpring": (lambda z, v, t, w, s: -z, False),
    "CubicSpring": (lambda z, v, t, w, s: -(z**3), False),
    "Imbalance": (lambda z, v, t, w, s: -np.sin(z), False),
    "EndStop": (lambda z, v, t, w, s: -(z - np.clip(z, -s, s)), True),
}
"""Law, and whether the library allows no negative coefficient."""
_ROTATIONAL_ONLY = ("LoadDependentFriction", "Imbalance")

_INPUTS: Mapping[str, tuple[_InputLaw, bool]] = {
    "Offset": (lambda u, t, s: np.ones_like(u), False),
    "Gain": (lambda u, t, s: u, False),
    "Drift": (lambda u, t, s: t, False),
    "GainDrift": (lambda u, t, s: t * u, False),
    "AsymmetricGain": (lambda u, t, s: np.abs(u), False),
    "AffineAmplifier": (lambda u, t, s: np.tanh(u / 0.01), True),
    "DeadZone": (lambda u, t, s: -np.clip(u, -s, s), True),
    "Saturation": (lambda u, t, s: np.clip(u, -s, s) - u, True),
}


@dataclass(frozen=True)
class Candidate:
    """A law at a place.

    Attributes:
        label: As the product writes it.
        place: A flange or the input.
        positive: Whether a negative coefficient is outside the library's range.
        variants: (n,) force, or addition to the input, for every shape that is tried.
    """

    label: str
    place: str
    positive: bool
    variants: Sequence[Array]


def candidates(g: Given, x: Array, u: Array, t: Array) -> list[Candidate]:
    """Return every law at every place along a motion.

    Args:
        x: (nx, n) states.
        u: (n,) command.
        t: (n,) [s].
    """
    translational = g.plant.name in _TRANSLATIONAL
    width, stribeck = (1e-3, (4e-3, 0.01, 0.03)) if translational else (0.05, (0.2, 0.5, 1.0))
    found: list[Candidate] = []
    for place, flange in g.plant.flanges.items():
        z, v = x[flange.position], x[flange.speed]
        shapes = {
            "StribeckFriction": stribeck,
            "WarmUpFriction": (5.0, 30.0),
            "EndStop": tuple(np.quantile(np.abs(z), (0.5, 0.7, 0.85, 0.95))),
        }
        for effect, (law, positive) in _FORCES.items():
            if translational and effect in _ROTATIONAL_ONLY:
                continue
            name = effect
            if effect == "Constant":
                name = "ConstantForce" if translational else "ConstantTorque"
            variants = [law(z, v, t, width, s) for s in shapes.get(effect, (1.0,))]
            found.append(Candidate(f"{name}@{place}", place, positive, variants))
    size = np.abs(u)
    shapes = {
        "DeadZone": tuple(np.quantile(size, (0.03, 0.1, 0.2))),
        "Saturation": tuple(np.quantile(size, (0.7, 0.85, 0.95, 0.99))),
    }
    command = g.plant.command[0]
    for effect, (law, positive) in _INPUTS.items():
        variants = [law(u, t, s) for s in shapes.get(effect, (1.0,))]
        found.append(Candidate(f"{effect}@{command}", command, positive, variants))
    return found


def caused(g: Given, x: Array, u: Array, p: Values, place: str, law: Array) -> Array:
    """Return the accelerations (number of flanges, n) that a law at a place causes."""
    if place in g.plant.flanges:
        changed = g.rates(x, u, p, {place: law})
    else:
        changed = g.rates(x, u + law, p, {})
    return (changed - g.rates(x, u, p, {}))[g.accelerations]


def sensitivities(g: Given, x: Array, u: Array, p: Mapping[str, float]) -> Array:
    """Return the accelerations (parameters, flanges, n) per scale of each parameter."""
    step = 1e-3
    columns = []
    for name, value in p.items():
        up, down = (
            g.rates(x, u, {**p, name: value + s * g.scales[name]}, {}) for s in (step, -step)
        )
        columns.append((up - down)[g.accelerations] / (2 * step))
    return np.array(columns)


def without(columns: Array, *, nuisance: Array) -> Array:
    """Return columns (n, k) less their projection on the span of others (n, m)."""
    size = np.linalg.norm(nuisance, axis=0)
    used = nuisance[:, size > 0] / size[size > 0]
    left, values, _ = np.linalg.svd(used, full_matrices=False)
    left = left[:, values > 1e-6 * values[0]]
    return columns - left @ (left.T @ columns)
