"""Every effect at every place, tested at once against a fitted model.

All candidates are attached to one model, each with its defaults, where it is absent. One simulation
with sensitivities then tells for each by how much the cost would fall if it were let in and
everything else (parameters, initial states) followed: the score test. Nothing is refitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fmus.places import Place, places
from fmus.sources import ModelicaSource
from foundation.errors import UnsupportedModelError
from foundation.progress import Progress, counted, silent
from identification.discovery.effects import Effect, find_effects
from identification.discovery.extension import Addition, ExtendedModel, addition_at, extend
from identification.discovery.transfer import flat_name, transfer_all_states, transfer_problems
from identification.experiment import Experiment, simulator_of
from identification.gauss_newton import Fit
from identification.linearisation import Linearised, linearise_all, seen
from identification.problem import Problem, Vector

# Share of a candidate's information, beside free initial states, that must be left once parameters
# have had theirs; below it the candidate is a copy of what the model already has.
_DISTINCT = 1e-7
_STATES_AT_ONCE = 4
_WORKERS = 2
# A shape has no slope while its effect is absent: so many over its range are scored, and so many of
# the best tried. The one that promises most may keep nothing of it: where windows begin to run
# away, a model that does not fit yet goes where the machine never was, and touches bumpers there.
SHAPES = 9
_BEST_SHAPES = 3


@dataclass(frozen=True)
class Scored:
    """A candidate and what the score test says of it.

    Attributes:
        addition: Effect and place.
        gain: Predicted fall of the cost Σ(residual/sd)².
        values: Predicted main parameters, by the names that they have where it was scored.
        shaped: For an effect with shapes, the best few of its main and shape parameters, the most
            promising first, by the effect's own names; empty if it gains with none.
        blind: It is not noticed until it is large, such as a limit: its slope at nothing is zero,
            and the score test cannot say anything.
        start: Where it was scored and is to be refitted from; None for the model's fit.
    """

    addition: Addition
    gain: float
    values: Mapping[str, float]
    shaped: tuple[Mapping[str, float], ...] = ()
    blind: bool = False
    start: Fit | None = None


@dataclass(frozen=True)
class Scan:
    """All candidates, the most promising first, and those that could not be tested."""

    scored: tuple[Scored, ...]
    skipped: Mapping[str, str]


def candidates(source: ModelicaSource, measured: Sequence[str]) -> tuple[Addition, ...]:
    """Return every named effect at every place where it can act and would be noticed.

    An output that is not recorded cannot show a sensor's effect. Effects whose class says that they
    are not searched are left out.
    """
    return tuple(a for a in _fitting(source, measured) if a.effect.searched)


def _fitting(source: ModelicaSource, measured: Sequence[str]) -> tuple[Addition, ...]:
    effects = find_effects(source)
    there = places(source)
    inputs = {place.name for place in there if place.kind == "input"}
    return tuple(
        addition_at(source, effect, place)
        for place in there
        for effect in effects
        if _fits(place, effect, measured) and inputs - {place.name} >= set(effect.companions)
    )


def _fits(place: Place, effect: Effect, measured: Sequence[str]) -> bool:
    if place.kind not in ("input", "output"):
        return effect.kind == place.kind
    if effect.kind != "signal" or (place.kind == "output" and place.name not in measured):
        return False
    # A law for angles alone, or for speeds alone, says so by the unit of its signal.
    return effect.unit in ("", place.unit)


def scan(
    model: ExtendedModel,
    experiment: Experiment,
    fit: Fit,
    *,
    exclude: Sequence[str] = (),
    progress: Progress = silent,
) -> Scan:
    """Score every candidate that the model does not have yet.

    Args:
        model: The present model.
        experiment: That model on the record.
        fit: Its fit.
        exclude: Labels (`EFFECT@PLACE`) not to test.
        progress: Told how many groups of candidates are scored.
    """
    measured = experiment.problem.output_names
    have = {a.label for a in model.additions} | set(exclude)
    wanted = [a for a in _fitting(model.base, measured) if a.label not in have]
    testable, skipped = _testable(wanted, model.additions)
    with ThreadPoolExecutor(_WORKERS) as pool:
        parted = groups(testable)
        scored = pool.map(partial(score_group, model, experiment, fit), parted)
        text = "scoring every effect at every place"
        every = [one for group in counted(progress, text, scored, len(parted)) for one in group]
    return Scan(tuple(sorted(every, key=lambda s: -s.gain)), skipped)


def groups(testable: Sequence[Addition]) -> list[list[Addition]]:
    """Split candidates so that no group brings many states of its own.

    A step costs the square of the states times the sensitivities, and absent candidates do not act
    on one another: apart they score the same for a tenth of the work.
    """
    # Signals that outputs delay are further outputs: these candidates are apart, too.
    late = [a for a in testable if a.effect.delays and a.place.kind == "output"]
    # Those with shapes are scored several times.
    plain = [a for a in testable if not a.effect.states and a not in late]
    shaped = [a for a in plain if a.effect.shape_parameters]
    found = [[a for a in plain if a not in shaped], shaped, late]
    states = _STATES_AT_ONCE
    for addition in (a for a in testable if a.effect.states and a not in late):
        states += addition.effect.states
        if states > _STATES_AT_ONCE:
            found.append([])
            states = addition.effect.states
        found[-1].append(addition)
    return [group for group in found if group]


def score_group(
    model: ExtendedModel, experiment: Experiment, fit: Fit, group: Sequence[Addition]
) -> list[Scored]:
    """Attach a group of candidates, absent, and score each."""
    whole = extend(
        model.base,
        [*model.additions, *group],
        values=model.values,
        name=f"{model.base.short_name}_all",
    )
    mains = [(a, [whole.parameter_of(a, p) for p in a.effect.main_parameters]) for a in group]
    base_names = [flat_name(whole, model, name) for name in fit.free if name not in fit.held]
    sensitive = [*base_names, *(name for _, names in mains for name in names)]
    problems = transfer_problems(experiment, whole, fit.values, model)
    whole_problem = problems[0]
    shapes = _shapes(whole, group)
    # What is run once is compiled fast rather than well.
    simulator = simulator_of(whole_problem, sensitive, briefly=len(shapes) == 1)
    attached = Experiment(whole_problem, simulator, window=experiment.window)
    attached = replace(attached, also=tuple(attached.beside(p) for p in problems[1:]))
    x0 = transfer_all_states(attached, whole, experiment, model, fit.x0)
    found: dict[str, list[tuple[Scored, Mapping[str, float]]]] = {a.label: [] for a in group}
    for shape in shapes:
        at = linearise_all(attached.parts(), x0, {**whole_problem.values, **shape}, fit.sd)
        for a, names in mains:
            scored = _score(whole_problem, at, len(base_names), sensitive, a, names)
            own = {p: shape.get(whole.parameter_of(a, p)) for p in a.effect.shape_parameters}
            found[a.label].append((scored, {p: v for p, v in own.items() if v is not None}))
    return [_best(every) for every in found.values()]


def _shapes(model: ExtendedModel, group: Sequence[Addition]) -> list[dict[str, float]]:
    """Return values of the group's shape parameters, over their ranges by ratio, all at once."""
    ranges: dict[str, tuple[float, float]] = {}
    for name in (model.parameter_of(a, p) for a in group for p in a.effect.shape_parameters):
        variable = model.dae.variables[name]
        low = model.dae.number(variable.minimum, np.nan)
        high = model.dae.number(variable.maximum, np.nan)
        # What has no range keeps its default.
        if 0 < low < high:
            ranges[name] = low, high
    return [
        {name: float(low * (high / low) ** share) for name, (low, high) in ranges.items()}
        for share in np.linspace(0, 1, SHAPES if ranges else 1)
    ]


def _best(every: Sequence[tuple[Scored, Mapping[str, float]]]) -> Scored:
    """Return a candidate's best score, with the starts that its shapes give."""
    ordered = sorted(every, key=lambda one: -one[0].gain)
    best = ordered[0][0]
    mains, shapes = best.addition.effect.main_parameters, best.addition.effect.shape_parameters
    if not shapes:
        return best
    starts = tuple(
        {**dict(zip(mains, scored.values.values(), strict=True)), **shape}
        for scored, shape in ordered[:_BEST_SHAPES]
        if scored.gain > 0
    )
    return replace(best, shaped=starts, blind=all(scored.blind for scored, _ in every))


def _testable(
    wanted: Sequence[Addition], present: Sequence[Addition]
) -> tuple[list[Addition], dict[str, str]]:
    """Leave out what cannot be simulated with sensitivities, with the reason."""
    testable: list[Addition] = []
    skipped: dict[str, str] = {}
    delayed = {a.place.name: a.effect.name for a in present if a.effect.delays}
    for addition in wanted:
        effect, place = addition.effect, addition.place
        if not effect.searched:
            reason = "its class says that it is not searched; `extend` adds it by name"
        elif not effect.main_parameters:
            reason = "no parameter makes it absent: give one the default 0"
        elif effect.jumps:
            reason = "an effect that changes its state at events is not tested yet"
        elif effect.delays and place.kind not in ("input", "output"):
            reason = "a delayed motion that acts back has no sensitivities"
        elif effect.delays and place.name in delayed:
            reason = f"{delayed[place.name]} is here; two delays in series are not tested"
        else:
            testable.append(addition)
            if effect.delays:
                delayed[place.name] = effect.name
            continue
        skipped[addition.label] = reason
    return testable, skipped


def _score(
    problem: Problem,
    at: Linearised,
    n_base: int,
    sensitive: Sequence[str],
    addition: Addition,
    names: Sequence[str],
) -> Scored:
    base = np.arange(n_base)
    mine = np.array([sensitive.index(name) for name in names])
    gradient = _gradient(at)
    if not np.isfinite(at.cost):
        raise UnsupportedModelError("the model with all candidates attached cannot be simulated")
    inverse = np.linalg.pinv(at.normal[np.ix_(base, base)], rcond=1e-12, hermitian=True)
    cross = at.normal[np.ix_(mine, base)]
    information = at.normal[np.ix_(mine, mine)] - cross @ inverse @ cross.T
    score = gradient[mine] - cross @ inverse @ gradient[base]
    if np.all(at.raw[mine] <= 0):
        return Scored(addition, 0.0, dict.fromkeys(names, 0.0), blind=True)
    beside_states = np.diag(at.normal)[mine]
    if not np.all(seen(at)[mine]) or np.any(np.diag(information) < _DISTINCT * beside_states):
        return Scored(addition, 0.0, dict.fromkeys(names, 0.0))
    step = np.linalg.lstsq(information, score, rcond=1e-12)[0]
    low = np.array([problem.dae.number(problem.dae.variables[n].minimum, -np.inf) for n in names])
    high = np.array([problem.dae.number(problem.dae.variables[n].maximum, np.inf) for n in names])
    inside = np.clip(step, low, high)
    gain = float(2 * inside @ score - inside @ information @ inside)
    return Scored(addition, max(gain, 0.0), dict(zip(names, inside.tolist(), strict=True)))


def _gradient(at: Linearised) -> Vector:
    """Return Jᵀr with the initial states eliminated (summed over blocks), and the priors' pull."""
    return np.sum(at.scores, axis=0) + at.pull
