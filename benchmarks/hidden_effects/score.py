"""One case through the product, and what it said."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import twinproof
from benchmarks.hidden_effects.cases import Case, names_of_one_law, right_labels
from benchmarks.hidden_effects.detectability import log_likelihood_ratio
from benchmarks.hidden_effects.floor import noise_floor
from benchmarks.hidden_effects.plants import PLANTS, Plant
from benchmarks.hidden_effects.simulation import FellOverError, Run, simulate

_MODELS = Path(__file__).parent / "models"
_HORIZON = 1.0  # [s]
_LARGEST_TIE = 3


@dataclass(frozen=True)
class Score:
    """A worked case.

    Attributes:
        name, group, plant: Of the case.
        nats: What the record shows of what is hidden, from the truth.
        verdict: Of the whole ladder for what remains; of the diagnosis where nothing is hidden.
        first: What was named first; empty for nothing.
        tie: What the first diagnosis could not tell apart.
        added: What the ladder added.
        found: How many of the hidden effects are among what was added or tied with it.
        point: 1 if the first name is right, 1/k if it is among a tie of k ≤ 3, else 0.
        over_floor: Held-out error over what the machine itself would leave there, root mean square
            over channels.
        seconds: Of the whole.
        trouble: The message of an error, or why there is no record.
    """

    name: str
    group: str
    plant: str
    nats: float = float("nan")
    verdict: str = ""
    first: str = ""
    tie: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    found: int = 0
    point: float = 0.0
    over_floor: float = float("nan")
    seconds: float = float("nan")
    trouble: str = ""

    def row(self) -> dict[str, object]:
        """Return what is kept of it."""
        return asdict(self)


def recording(plant: Plant, run: Run, noise: float) -> twinproof.Recording:
    """Return a run as a logger's file would give it, with what a data sheet says of its sensors."""
    channels = {
        plant.command[0]: twinproof.Channel(
            plant.command[0], run.command, plant.command[1], twinproof.Sensor(None, None, 0.0)
        )
    }
    for k, (name, s) in enumerate(plant.sensors.items()):
        sensor = twinproof.Sensor(noise * s.sd or None, s.resolution or None, 0.0)
        channels[name] = twinproof.Channel(name, run.measured[:, k], s.unit, sensor)
    return twinproof.Recording(run.time, channels, plant.name, ())


def model_of(plant: Plant) -> twinproof.Model:
    """Return what the user has."""
    if plant.model.startswith("Twinproof."):
        return twinproof.Model.of(plant.model)
    return twinproof.Model.of(f"{_MODELS / plant.model}.mo:{plant.model}")


def score(case: Case) -> Score:
    """Work one case."""
    plant = PLANTS[case.plant]
    blank = Score(case.name, case.group, case.plant)
    parameters = case.parameters()
    try:
        run, unseen = (
            simulate(
                plant,
                parameters,
                case.hidden,
                excitation=case.excitation,
                noise=case.noise,
                disturbance=case.disturbance,
                seed=case.seed + shift,
            )
            for shift in (0, 100_000)
        )
    except FellOverError as fell:
        return Score(case.name, case.group, case.plant, trouble=str(fell))
    nats = _nats(case, plant, parameters, run)
    model = model_of(plant)
    began = time.perf_counter()
    try:
        if case.group in ("one", "two", "unknown"):
            floor = noise_floor(plant, parameters, case.hidden, unseen, case.noise)
            return _improved(case, nats, model, plant, run, unseen, floor, began)
        return _diagnosed(case, nats, model, plant, run, began)
    except twinproof.TwinproofError as error:
        return Score(case.name, case.group, case.plant, nats, trouble=str(error) or blank.name)


def _nats(case: Case, plant: Plant, parameters: Mapping[str, float], run: Run) -> float:
    """Return what the record shows of what is hidden; of two, of the one that shows less."""
    if not case.hidden:
        return 0.0
    return min(
        log_likelihood_ratio(
            plant, parameters, run, case.noise, [e for e in case.hidden if e is not one]
        )
        for one in case.hidden
    )


def _diagnosed(
    case: Case, nats: float, model: twinproof.Model, plant: Plant, run: Run, began: float
) -> Score:
    if case.group == "known bias":
        source = twinproof.extend(model, [e.label for e in case.hidden]).source
        model = twinproof.Model(case.name, source)
    found = twinproof.diagnose(model, recording(plant, run, case.noise)).diagnosis
    first = found.chosen.addition.label if found.chosen else ""
    return Score(
        case.name,
        case.group,
        case.plant,
        nats,
        found.outcome.value,
        first,
        found.ties[0] if found.ties else (),
        (first,) if first else (),
        seconds=time.perf_counter() - began,
    )


def _improved(
    case: Case,
    nats: float,
    model: twinproof.Model,
    plant: Plant,
    run: Run,
    unseen: Run,
    floor: Mapping[str, float],
    began: float,
) -> Score:
    train, other = (recording(plant, r, case.noise) for r in (run, unseen))
    found = twinproof.improve(model, train, other, max_effects=3, horizon=_HORIZON).improvement
    seconds = time.perf_counter() - began
    diagnosis = found.steps[0].diagnosis
    first = diagnosis.chosen.addition.label if diagnosis.chosen else ""
    tie = diagnosis.ties[0] if diagnosis.ties else ()
    last = found.steps[-1].holdout
    assert last is not None
    ratios = [channel.rmse / floor[name] for name, channel in last.channels.items()]
    named = {label for step in found.steps for group in step.diagnosis.ties for label in group}
    named |= {a.label for a in found.added}
    rights = [right_labels(case.plant, e) for e in case.hidden]
    return Score(
        case.name,
        case.group,
        case.plant,
        nats,
        found.outcome.value,
        first,
        tie,
        tuple(a.label for a in found.added),
        sum(any(label in named for label in right) for right in rights),
        _point(case.plant, first, tie, rights[0]) if case.group == "one" else 0.0,
        float(np.sqrt(np.mean(np.square(ratios)))),
        seconds,
    )


def _point(plant: str, first: str, tie: tuple[str, ...], right: tuple[str, ...]) -> float:
    """Return the score of a naming, ties shared out; names of one law count as one."""
    others = {frozenset(names_of_one_law(plant, label)) for label in tie if label not in right}
    if first in right and not others:
        return 1.0
    size = len(others) + 1
    if any(label in right for label in (first, *tie)) and size <= _LARGEST_TIE:
        return 1.0 / size
    return 0.0
