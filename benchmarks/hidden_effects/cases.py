"""The benchmark's list of cases, made once and for all from a fixed seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.hidden_effects.laws import (
    FORCE_SIZES,
    FORCES,
    INPUTS,
    MEMORIES,
    SENSORS,
    UNKNOWN_FORCES,
)
from benchmarks.hidden_effects.plants import PLANTS, Plant
from benchmarks.hidden_effects.simulation import Hidden

_NOISES = (0.5, 2.0)
_RICH = ("rich", "lively")
_NULLS_A_PLANT = {"noise": 18, "disturbance": 9, "poor excitation": 9, "known bias": 7}
# Cases with seeds from 0, 100 000 and so on up to 600 000 on were looked at while the search
# was developed; of these none before the run in the documentation.
_SEEDS = 700_000
_TWOS_A_PLANT = 5
_UNKNOWN_SIZE = 0.2

# A constant force at the flange that the input drives is an offset of that input, in any units, and
# a dead band that the input jumps over is dry friction of its own sign: names of one law.
_DRIVEN = {
    "positioner": "carriage",
    "pendulum": "joint",
    "balancing robot": "motor",
    "rotary pendulum": "arm",
    "oscillator": "mass",
    "two-mass drive": "motor",
}

# Laws for which the machine's model has a parameter of its own. It takes them up, and only how far
# they are bent stays hidden, which has no name.
_OWN = {
    "positioner": ("ViscousFriction@carriage",),
    "pendulum": ("ViscousFriction@joint",),
    "balancing robot": ("ViscousFriction@motor",),
    "rotary pendulum": ("ViscousFriction@arm", "ViscousFriction@rod", "CoulombFriction@arm"),
    "oscillator": ("ViscousFriction@mass", "LinearSpring@mass"),
    "two-mass drive": ("ViscousFriction@motor", "ViscousFriction@load"),
}


@dataclass(frozen=True)
class Case:
    """One blind case.

    Attributes:
        name: Unique.
        group: `one`, `two`, `unknown`, or what kind of nothing.
        plant: Name of the machine.
        hidden: What is hidden.
        excitation: Of the plant's.
        noise: Factor on the sensors' noise.
        disturbance: In usual commands.
        seed: Of noise, reference and parameters.
    """

    name: str
    group: str
    plant: str
    hidden: tuple[Hidden, ...]
    excitation: str
    noise: float
    disturbance: float
    seed: int

    @property
    def nameless(self) -> bool:
        """What is hidden, or a part of it, is taken up by a parameter that the model has."""
        return any(e.label in _OWN.get(self.plant, ()) for e in self.hidden)

    def parameters(self) -> dict[str, float]:
        """Return the machine's own true parameters, up to 15 % off the model's defaults."""
        rng = np.random.default_rng(self.seed + 7)
        return {
            k: v * (1 + 0.15 * rng.uniform(-1, 1)) for k, v in PLANTS[self.plant].parameters.items()
        }


def right_labels(plant: str, hidden: Hidden) -> tuple[str, ...]:
    """Return the product's names of a hidden effect: more than one where they are the same law."""
    effect = _constant(plant) if hidden.effect == "Constant" else hidden.effect
    return names_of_one_law(plant, f"{effect}@{hidden.place}")


def names_of_one_law(plant: str, label: str) -> tuple[str, ...]:
    """Return all of the product's names for what one of its names stands for, that one first."""
    names = (f"Offset@{PLANTS[plant].command[0]}",)
    if plant in _DRIVEN:
        names = (*names, f"{_constant(plant)}@{_DRIVEN[plant]}")
    if plant == "oscillator":
        # A spring that is not at its rest position when the sensor says so.
        names = (*names, "Offset@s")
    # Two inertias joined by a spring alone: only the difference of their angles acts.
    same = (names, ("Offset@phi_1", "Offset@phi_2")) if plant == "two-mass drive" else (names,)
    for law in same:
        if label in law:
            return (label, *(name for name in law if name != label))
    return (label,)


def _constant(plant: str) -> str:
    return "ConstantForce" if plant in ("positioner", "oscillator") else "ConstantTorque"


def cases() -> tuple[Case, ...]:
    """Return all cases, in an order in which the first few are of every kind."""
    every = [*_ones(), *_nulls(), *_twos(), *_unknowns()]
    order = np.random.default_rng(20261122).permutation(len(every))
    return tuple(every[i] for i in order)


def _single(plant: Plant) -> Iterator[tuple[str, str, tuple[float, float]]]:
    for place in plant.flanges:
        for effect in FORCES:
            yield effect, place, FORCE_SIZES
    for effect, (_, sizes) in INPUTS.items():
        yield effect, plant.command[0], sizes
    for effect, sizes in MEMORIES.items():
        yield effect, plant.command[0], sizes
    for name, sensor in plant.sensors.items():
        # Of positions only: the law's sizes are in usual positions.
        if any(f.position == sensor.state for f in plant.flanges.values()):
            for effect, (_, sizes) in SENSORS.items():
                yield effect, name, sizes


def _ones() -> Iterator[Case]:
    for plant in PLANTS.values():
        for k, (effect, place, sizes) in enumerate(_single(plant)):
            for m, size in enumerate(sizes):
                # Signal laws in turn, now small, now large: the whole stays within an hour.
                if place not in plant.flanges and (k + m) % 2:
                    continue
                yield Case(
                    f"{plant.name}: {effect}@{place} {'large' if m else 'small'}",
                    "one",
                    plant.name,
                    (Hidden(effect, place, size),),
                    _RICH[(k + m) % 2],
                    _NOISES[(k // 2 + m) % 2],
                    0.0,
                    _SEEDS + 1000 + 10 * k + m,
                )


def _nulls() -> Iterator[Case]:
    for plant in PLANTS.values():
        for kind, count in _NULLS_A_PLANT.items():
            for k in range(count):
                base = Case(
                    f"{plant.name}: nothing, {kind} {k}",
                    kind,
                    plant.name,
                    (),
                    _RICH[k % 2],
                    _NOISES[(k // 2) % 2],
                    0.0,
                    _SEEDS + 5000 + k,
                )
                if kind == "disturbance":
                    base = replace(base, disturbance=(0.005, 0.02)[(k // 4) % 2])
                elif kind == "poor excitation":
                    base = replace(base, excitation="poor")
                elif kind == "known bias":
                    place = plant.command[0]
                    base = replace(base, hidden=(Hidden("Offset", place, 0.1),))
                yield base


def _twos() -> Iterator[Case]:
    pairs = (
        ("CoulombFriction", "QuadraticDrag"),
        ("CoulombFriction", "CubicSpring"),
        ("CoulombFriction", "DeadZone"),
        ("Constant", "CoulombFriction"),
        ("QuadraticDrag", "AsymmetricGain"),
    )
    for plant in PLANTS.values():
        first = next(iter(plant.flanges))
        last = list(plant.flanges)[-1]
        for k, (one, other) in enumerate(pairs[:_TWOS_A_PLANT]):
            place = plant.command[0] if other in INPUTS else last
            size = INPUTS[other][1][1] if other in INPUTS else FORCE_SIZES[1]
            yield Case(
                f"{plant.name}: {one} and {other}",
                "two",
                plant.name,
                (Hidden(one, first, FORCE_SIZES[1]), Hidden(other, place, size)),
                "rich",
                _NOISES[k % 2],
                0.0,
                _SEEDS + 7000 + k,
            )


def _unknowns() -> Iterator[Case]:
    for plant in PLANTS.values():
        for k, effect in enumerate(UNKNOWN_FORCES):
            places = list(plant.flanges)
            yield Case(
                f"{plant.name}: {effect}",
                "unknown",
                plant.name,
                (Hidden(effect, places[k % len(places)], _UNKNOWN_SIZE),),
                "rich",
                0.5,
                0.0,
                _SEEDS + 9000 + k,
            )
