"""How well an experiment would tell a model's parameters, before it is made.

The Cramér–Rao bound of a planned experiment: the sensitivities of the simulated outputs, weighted
by the sensors' noise, initial state unknown. No unbiased estimator has smaller standard deviations,
and those of this package come close to it (G. C. Goodwin, R. L. Payne, Dynamic System
Identification: Experiment Design and Data Analysis, 1977).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from fmus.dae import Dae
from foundation.errors import ExcitationError, UnknownNameError
from identification.linearisation import linearise, seen
from identification.problem import Matrix, Problem, Vector, fitted_by_default
from identification.shooting import Shooting
from identification.windows import Window, cut, guess_states, settle, settling_samples

Criterion: TypeAlias = Literal["D", "A"]

_HARDLY = 1e4  # condition number beyond which the faintest disturbance decides
_CORRELATED = 0.9999
_ASSUMED = 0.01  # noise of a sensor of which nothing is known, as a share of what it measures
_VAGUE = 1e6  # a relative standard deviation that no design is rewarded for exceeding


@dataclass(frozen=True)
class Bound:
    """What an experiment can tell.

    Attributes:
        values: The parameters at which this holds.
        sd: Name → smallest standard deviation of an unbiased estimate; infinite if not seen.
        unseen: Parameters that the experiment does not show at all.
        condition_number: Of the scaled sensitivities; 1 is best.
        weakest: Those in the combination that is told worst, beginning with the most involved.
        correlated: Pairs whose estimates move together, with their correlation.
        score: Mean of the logarithms of relative standard deviations (D), as a number to compare.
        spread: Root mean square of the relative standard deviations (A).
        notes: What was assumed.
    """

    values: Mapping[str, float]
    sd: Mapping[str, float]
    unseen: tuple[str, ...]
    condition_number: float
    weakest: tuple[str, ...]
    correlated: tuple[tuple[str, str, float], ...]
    score: float
    spread: float
    notes: tuple[str, ...] = ()

    @property
    def advice(self) -> tuple[str, ...]:
        """What to do about what the experiment does not tell."""
        said = [
            f"{name} has no effect on what is measured: excite what it acts on, measure it, or "
            "leave it out of --free"
            for name in self.unseen
        ]
        said += [
            f"{a} and {b} can hardly be told apart (correlation {value:+.4f}): excite them at "
            "other frequencies or amplitudes, measure one more quantity, or hold one of them"
            for a, b, value in self.correlated
        ]
        if self.condition_number > _HARDLY:
            said.append(
                f"the condition number is {self.condition_number:.1e}: the combination of "
                f"{', '.join(self.weakest)} is told by the faintest of differences; widen the "
                "band, or hold one of them at a value known from elsewhere"
            )
        return tuple(said)

    def cost(self, criterion: Criterion) -> float:
        """Return what a design makes small: see `score` and `spread`."""
        return self.score if criterion == "D" else self.spread


def plan(
    dae: Dae,
    time: Vector,
    inputs: Matrix,
    *,
    noise_sd: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
    free: Sequence[str] | None = None,
    values: Mapping[str, float] | None = None,
) -> Problem:
    """Return an experiment that has not been made: its record is the simulation.

    Args:
        dae: The model.
        time: (n,) uniform [s].
        inputs: (n, nu) in the model's order and units, held between samples.
        noise_sd: Output → standard deviation of its sensor; where missing, a hundredth of what the
            sensor sees.
        outputs: What is measured; None: every output.
        free: What is to be found; None: the default choice.
        values: Parameters' values where they are not the declared ones.

    Raises:
        UnknownNameError: No such output or parameter.
        ExcitationError: The simulation runs away: the plant is unstable and needs its controller.
    """
    names = [v.name for v in dae.outputs]
    chosen = tuple(outputs) if outputs is not None else tuple(names)
    for name in (*chosen, *(noise_sd or {})):
        if name not in names:
            raise UnknownNameError("output", name, names, where=dae.name)
    declared = {n: v for n, v in dae.parameter_values.items() if n not in dae.dependent_parameters}
    for name in (*(free or ()), *(values or {})):
        if name not in declared:
            raise UnknownNameError("parameter", name, declared, where=dae.name)
    problem = Problem(
        dae=dae,
        time=time - time[0],
        inputs=inputs,
        outputs=np.zeros((len(time), len(chosen))),
        output_names=chosen,
        noise_sd=np.array([(noise_sd or {}).get(name, np.nan) for name in chosen]),
        free=tuple(free) if free is not None else fitted_by_default(dae),
        values={**declared, **(values or {})},
    )
    return simulated(problem, Shooting(dae, chosen, problem.free))


def simulated(problem: Problem, shooting: Shooting) -> Problem:
    """Return an experiment with the outputs that its inputs would have.

    Raises:
        ExcitationError: The simulation runs away.
    """
    p = shooting.parameter_vector(problem.values)
    inputs = shooting.inputs_with_delays(problem.inputs, problem.sample_time, p)
    run = shooting.run(start_of(problem, shooting), inputs, p, problem.sample_time)
    if run.finite < len(problem.time):
        raise ExcitationError(
            f"{problem.dae.name} runs away under this input within "
            f"{run.finite * problem.sample_time:.3g} s",
            remedy="an unstable plant is excited through its controller's reference: give a record "
            "of the closed loop instead, or a smaller or shorter input",
        )
    return replace(problem, outputs=run.outputs)


def start_of(problem: Problem, shooting: Shooting) -> Vector:
    """Return (nx,) the states' start values."""
    start = {v.name: problem.dae.number(v.start, 0.0) for v in problem.dae.states}
    for parameter, state in problem.dae.start_parameters.items():
        start[state] = problem.values.get(parameter, start[state])
    return np.array([start[name] for name in shooting.state_names], dtype=np.float64)


def bound_of_plan(problem: Problem, shooting: Shooting | None = None) -> Bound:
    """Return the Cramér–Rao bound of an experiment made by `plan`.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> dae = load(library_class("Twinproof.Plants.Pendulum"))
        >>> time = np.arange(0, 5, 0.01)
        >>> push = np.sin(5 * time)[:, None]
        >>> bound = bound_of_plan(plan(dae, time, push, noise_sd={"theta": 1e-3, "omega": 1e-2}))
        >>> bound.sd["J"] < 0.01 * bound.values["J"]
        True
    """
    compiled = shooting or Shooting.of(problem)
    window = Window(0, len(problem.time))
    return _bound(problem, compiled, (window,), start_of(problem, compiled)[None, :])


def bound_of_record(problem: Problem, horizon: float | None = 1.0) -> Bound:
    """Return the bound of an experiment that has been made, at given parameter values.

    Args:
        problem: The record. Its values are taken as true.
        horizon: Length [s] of windows with an unknown initial state each, so that an unstable plant
            can be simulated; None: one initial state for the whole record.
    """
    shooting = Shooting.of(problem)
    windows = cut(len(problem.time), problem.sample_time, horizon)
    p = shooting.parameter_vector(problem.values)
    inputs = shooting.inputs_with_delays(problem.inputs, problem.sample_time, p)
    guesses = guess_states(problem, shooting, windows)
    sd, _ = _noise(problem)
    x0 = np.array(
        [
            settle(problem, shooting, w, settling_samples(w), guess, inputs, p, sd)
            for w, guess in zip(windows, guesses, strict=True)
        ]
    )
    return _bound(problem, shooting, windows, x0)


def _noise(problem: Problem) -> tuple[Vector, tuple[str, ...]]:
    spread = np.std(problem.outputs, axis=0)
    spread = np.where(spread > 0, spread, np.max(spread, initial=0.0) or 1.0)
    unknown = ~(problem.noise_sd > 0)
    notes = tuple(
        f"nothing is known of the sensor of {name}: a noise of {_ASSUMED * size:.3g} is assumed"
        for name, size, u in zip(problem.output_names, spread, unknown, strict=True)
        if u
    )
    return np.asarray(np.where(unknown, _ASSUMED * spread, problem.noise_sd), np.float64), notes


def _bound(problem: Problem, shooting: Shooting, windows: Sequence[Window], x0: Matrix) -> Bound:
    sd, notes = _noise(problem)
    at = linearise(problem, shooting, windows, x0, problem.values, sd)
    if not np.isfinite(at.cost):
        raise ExcitationError(
            f"{problem.dae.name} runs away within a window",
            remedy="give shorter windows, or parameter values nearer to the truth",
        )
    names = shooting.sensitive
    visible = seen(at)
    normal = at.normal[np.ix_(visible, visible)]
    kept = [n for n, v in zip(names, visible, strict=True) if v]
    scale = np.sqrt(np.diag(normal))
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    eigenvalues = np.maximum(eigenvalues, 1e-16 * np.max(eigenvalues, initial=1.0))
    half = vectors / np.sqrt(eigenvalues) / scale[:, None]
    covariance = np.asarray(half @ half.T, dtype=np.float64)
    deviations = np.sqrt(np.diag(covariance))
    found = dict.fromkeys(names, np.inf) | dict(zip(kept, deviations.tolist(), strict=True))
    size = np.array([abs(problem.values[n]) or 1.0 for n in names])
    relative = np.minimum(np.array([found[n] for n in names]) / size, _VAGUE)
    involved = np.argsort(-np.abs(vectors[:, 0])) if kept else np.zeros(0, dtype=int)
    correlation = covariance / np.outer(deviations, deviations)
    hidden = len(names) - len(kept)
    half_log_det = -0.5 * float(np.sum(np.log(eigenvalues))) - float(np.sum(np.log(scale)))
    sizes = size[visible]
    volume = half_log_det - float(np.sum(np.log(sizes))) + hidden * np.log(_VAGUE)
    return Bound(
        values={n: problem.values[n] for n in names},
        sd=found,
        unseen=tuple(n for n, v in zip(names, visible, strict=True) if not v),
        condition_number=float(np.sqrt(eigenvalues[-1] / eigenvalues[0])) if kept else np.inf,
        weakest=tuple(kept[i] for i in involved if abs(vectors[i, 0]) > 0.3),
        correlated=tuple(
            (kept[j], kept[i], float(correlation[i, j]))
            for i in range(len(kept))
            for j in range(i)
            if abs(correlation[i, j]) > _CORRELATED
        ),
        score=volume / max(len(names), 1),
        spread=float(np.sqrt(np.mean(relative**2))),
        notes=(*problem.notes, *notes),
    )
