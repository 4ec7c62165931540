"""The shape of a missing force, estimated without assuming one.

A probe (a constant force, torque or offset) stands where the effect would. One constant for each
short window says what acts there on average. Against the window's mean speed (position, signal)
these constants draw the law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ExcitationError, UnsupportedModelError
from identification.discovery.characteristic import (
    FLOWS,
    VARIABLES,
    Characteristic,
    Quantity,
    characteristic,
    variable_of,
)
from identification.discovery.effects import find_effects, resolve
from identification.discovery.extension import Addition, ExtendedModel, extend
from identification.discovery.transfer import transfer_problem
from identification.experiment import Experiment
from identification.gauss_newton import fit
from identification.linearisation import seen
from identification.problem import Matrix, Problem, Vector
from identification.shooting import Shooting
from identification.windows import Window, cut, guess_states

BINS = 25
LENGTHS = (0.05, 0.1, 0.25, 0.5)
"""Lengths of the windows that are tried, shortest first [s]."""

_PROBES = {"rotational": "ConstantTorque", "translational": "ConstantForce", "signal": "Offset"}
_ITERATIONS = 6
_SHORTEST_SAMPLES = 20
_FEWEST_WINDOWS = 12
# The force is told from the noise if it varies by this many of a window's standard deviations.
_TOLD = 6.0
_FEWEST_IN_BIN = 3


@dataclass(frozen=True)
class MissingForce:
    """A missing force against the variable on which its candidate depends.

    Attributes:
        curve: The candidate's own characteristic over the range of the record.
        unit: Of the force, torque or signal.
        window: Length of the windows [s].
        x, y, sd: (k,) each window's mean of the variable, and the force there with its standard
            deviation. Sign as of `curve.y`. Windows in which a speed or a signal changes its sign
            are left out: their constant is an average over both directions.
        centres, law, spread: (m,) the same in bins: mean of the variable, median force, and how far
            the windows of a bin scatter (one standard deviation, from the median deviation).
    """

    curve: Characteristic
    unit: str
    window: float
    x: Vector
    y: Vector
    sd: Vector
    centres: Vector
    law: Vector
    spread: Vector


def missing_force(
    model: ExtendedModel,
    experiment: Experiment,
    values: Mapping[str, float],
    sd: Vector,
    addition: Addition,
    *,
    window: float | None = None,
) -> MissingForce:
    """Estimate what acts where an effect was added, without using the effect.

    Args:
        model: A model that has the effect.
        experiment: That model on a record.
        values: Its parameters, all of which stay but for the effect's own.
        sd: (channels of all records,) weights; the first record's are used.
        addition: The effect in question, with its fitted values.
        window: Length of the windows [s]; by default the shortest that tells the force from noise.

    Raises:
        UnsupportedModelError: The effect has a memory, or acts on a sensor, where a constant in
            each window cannot be told from its initial state.
        ExcitationError: The record does not show what acts there.
    """
    if addition.place.kind == "output":
        raise UnsupportedModelError(
            f"{addition.label} acts on a sensor: in a short window it cannot be told from where "
            "the machine was at its start",
            remedy="look at the error against time instead",
        )
    # Asked first: an effect with a memory has no shape to look for.
    variable = variable_of(addition.effect, model.base)
    probe = _Probe.of(model, experiment, values, sd, addition)
    found = _Constants((), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    for length in LENGTHS if window is None else (window,):
        found = probe.constants(length)
        if len(found.windows) >= _FEWEST_WINDOWS and found.told:
            break
    if len(found.windows) < _FEWEST_WINDOWS:
        raise ExcitationError(
            f"the record does not show what acts at {addition.place.name} window by window",
            remedy="record longer, with more motion",
        )
    tracks = probe.tracks(found, variable.name)
    every = np.concatenate(tracks)
    if not np.ptp(every) > 0:
        raise ExcitationError(
            f"nothing moves at {addition.place.name}", remedy="record a motion there"
        )
    kept = _one_way(tracks, variable)
    x = np.array([float(np.mean(track)) for track in tracks])[kept]
    force = probe.gain * (found.values - probe.held)[kept]
    force_sd = abs(probe.gain) * found.sd[kept]
    edges = np.linspace(np.min(x), np.max(x) + 1e-9 * float(np.ptp(x)), BINS + 1)
    centres, law, spread = _binned(x, force, force_sd, edges)
    flow = FLOWS.get(addition.effect.kind)
    return MissingForce(
        curve=characteristic(
            addition.effect,
            addition.values,
            float(np.min(every)),
            float(np.max(every)),
            base=model.base,
        ),
        unit=flow.unit if flow is not None else addition.place.unit,
        window=float(np.median([len(w) for w in found.windows])) * probe.problem.sample_time,
        x=x,
        y=force,
        sd=force_sd,
        centres=centres,
        law=law,
        spread=spread,
    )


@dataclass(frozen=True)
class _Constants:
    """One constant for each window: (k,) values and deviations, (k, nx) initial states."""

    windows: tuple[Window, ...]
    x0: Matrix
    values: Vector
    sd: Vector

    @property
    def told(self) -> bool:
        low, high = np.quantile(self.values, [0.1, 0.9])
        return bool(high - low > _TOLD * np.median(self.sd))


@dataclass(frozen=True)
class _Probe:
    """A model with a constant where the effect was.

    Attributes:
        parameter: The constant's name.
        held: What of it is no part of the missing force: the value of a constant effect that the
            model has there anyway.
        gain: What the machine spends on a constant of 1, in the sign of a characteristic.
    """

    problem: Problem
    shooting: Shooting
    parameter: str
    held: float
    gain: float
    sd: Vector

    @classmethod
    def of(
        cls,
        model: ExtendedModel,
        experiment: Experiment,
        values: Mapping[str, float],
        sd: Vector,
        addition: Addition,
    ) -> _Probe:
        others = [a for a in model.additions if a.label != addition.label]
        effect = resolve(_PROBES[addition.effect.kind], addition.place.kind, find_effects())
        constant = Addition(effect, addition.place)
        if constant.label not in {a.label for a in others}:
            others.append(constant)
        probed = extend(model.base, others, name=f"{model.base.short_name}_probe")
        main = effect.main_parameters[0]
        parameter = probed.parameter_of(constant, main)
        problem = transfer_problem(experiment.problem, probed, values, model)
        held = problem.values[parameter]
        if constant.label == addition.label:
            # The effect is a constant itself: all of it is what is missing.
            held = 0.0
            problem = problem.with_values({parameter: 0.0})
        shooting = Shooting.of(problem, (parameter,))
        gain = float(characteristic(effect, {main: 1.0}, -1.0, 1.0).y[0])
        return cls(problem, shooting, parameter, held, gain, sd[: len(problem.output_names)])

    def constants(self, length: float) -> _Constants:
        """Return the constant that explains each window best, where the window shows it."""
        problem, h = self.problem, self.problem.sample_time
        windows = cut(len(problem.time), h, max(length, _SHORTEST_SAMPLES * h))
        guesses = guess_states(problem, self.shooting, windows)
        kept: list[tuple[Window, Vector, float, float]] = []
        for k, window in enumerate(windows):
            found = fit(
                problem,
                self.shooting,
                [window],
                guesses[k : k + 1],
                problem.values,
                fixed_sd=self.sd,
                iterations=_ITERATIONS,
            )
            if not np.isfinite(found.at.cost) or not seen(found.at)[0]:
                continue
            freedom = max(len(window) * len(self.sd) - self.shooting.nx - 1, 1)
            sd = float(np.sqrt(found.at.cost / freedom / found.at.normal[0, 0]))
            kept.append((window, found.x0[0], found.values[self.parameter], sd))
        return _Constants(
            tuple(window for window, *_ in kept),
            np.array([x0 for _, x0, *_ in kept]),
            np.array([value for *_, value, _ in kept]),
            np.array([sd for *_, sd in kept]),
        )

    def tracks(self, found: _Constants, variable: str) -> tuple[Vector, ...]:
        """Return the probe's variable over each window, as the probed model moves."""
        name = f"{self.parameter.rpartition('.')[0]}.{variable}"
        watched = Shooting.of(self.problem, (), watched=(name,))
        h = self.problem.sample_time
        tracks: list[Vector] = []
        for window, x0, value in zip(found.windows, found.x0, found.values, strict=True):
            p = watched.parameter_vector({**self.problem.values, self.parameter: float(value)})
            inputs = watched.inputs_with_delays(self.problem.inputs, h, p)
            part = inputs[window.begin : window.end]
            t0 = float(self.problem.time[window.begin])
            tracks.append(watched.run(x0, part, p, h, t0=t0).outputs[:, 0])
        return tuple(tracks)


def _binned(x: Vector, y: Vector, sd: Vector, edges: Vector) -> tuple[Vector, Vector, Vector]:
    """Return (m,) where, median and spread of y in the bins of x that hold enough of them."""
    bins = np.digitize(x, edges) - 1
    rows: list[tuple[float, float, float]] = []
    for k in range(len(edges) - 1):
        here = bins == k
        if np.count_nonzero(here) < _FEWEST_IN_BIN:
            continue
        middle = float(np.median(y[here]))
        scatter = 1.4826 * float(np.median(np.abs(y[here] - middle)))
        rows.append((float(np.mean(x[here])), middle, max(scatter, float(np.median(sd[here])))))
    where, middle, spread = np.array(rows).reshape(-1, 3).T
    return where, middle, spread


def _one_way(tracks: Sequence[Vector], variable: Quantity) -> NDArray[np.bool_]:
    """Return which windows the variable does not change its sign in; all, if it always does.

    A position's zero is nothing special.
    """
    every = np.ones(len(tracks), dtype=bool)
    if variable in (VARIABLES["rotational"][0], VARIABLES["translational"][0]):
        return every
    found = np.array([float(np.min(track)) * float(np.max(track)) > 0 for track in tracks])
    return found if np.count_nonzero(found) >= _FEWEST_WINDOWS else every
