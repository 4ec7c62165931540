"""Parameters moved, or physics missing: what explains a record of a machine that was known before?

With every known parameter held at its verified value, each of them let go alone, and all at once,
is a candidate like any effect of the library: refitted, and ranked by the same merit (evidence less
the price of its parameters, `evidence`). What comes first by more than a tie has happened.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from fmus.sources import ModelicaSource
from foundation.errors import InputError, UnknownNameError
from foundation.progress import Progress, silent
from identification.discovery.diagnosis import TIE, Diagnosis, Outcome, diagnose
from identification.discovery.evidence import (
    CHANCE_GAIN,
    Refit,
    independent_of_all,
    log_gain,
)
from identification.discovery.extension import extend
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.priors import Prior
from identification.problem import Problem, Vector

MOVED = 3.0
"""A parameter has moved if it is this many standard deviations (of both values) away."""


class Change(Enum):
    """What has happened to a machine since it was verified.

    EITHER: some effect is as good as a moved parameter, as one and the same law is (an imbalance
    and a pendulum's weight). That a parameter moved is the simpler reading.
    """

    NOTHING = "nothing"
    DRIFTED = "drifted"
    MISSING = "missing"
    EITHER = "either"


@dataclass(frozen=True)
class Moved:
    """Parameters let go, the others held at their verified values.

    Attributes:
        values: Name → (verified value, value now, standard deviation of the latter).
        evidence: ΔlogL over the verified values [nats].
        merit: The evidence less the price of the parameters.
        deviations: How many standard deviations the farthest has moved.
    """

    values: Mapping[str, tuple[float, float, float]]
    evidence: float
    merit: float
    deviations: float


@dataclass(frozen=True)
class Drift:
    """The answer to "did parameters move, or has something appeared?".

    Attributes:
        change: The verdict.
        moved: Candidates that let parameters go, best first.
        effect: Label of the best effect beside the verified values, if one was accepted.
        effect_merit: Its merit; 0 without one.
        diagnosis: What the model lacks with the verified values held.
    """

    change: Change
    moved: tuple[Moved, ...]
    effect: str
    effect_merit: float
    diagnosis: Diagnosis

    @property
    def over_moved(self) -> float:
        """What the effect gains over the best moved parameters [nats]."""
        return self.effect_merit - max([m.merit for m in self.moved], default=0.0)


def missing_or_drifted(
    source: ModelicaSource,
    problem: Problem | Sequence[Problem],
    known: Mapping[str, Prior],
    *,
    progress: Progress = silent,
) -> Drift:
    """Say whether moved parameters explain a record as well as a missing effect does.

    Args:
        source: The model.
        problem: A new record, or several; their values are replaced by the verified ones.
        known: Verified value and standard deviation of parameters, from an earlier fit.
        progress: Told what is being done.

    Raises:
        InputError: Nothing is known.
        UnknownNameError: `known` names what is no independent parameter.
        UnsupportedModelError: The model cannot be simulated with sensitivities.
        DivergenceError: It cannot be simulated with the verified values.
    """
    problems = [problem] if isinstance(problem, Problem) else list(problem)
    first = problems[0]
    for name in known:
        if name not in first.values:
            raise UnknownNameError("parameter", name, first.values, where=first.dae.name)
    if not known:
        raise InputError(
            "no verified value is given", where="known", remedy="fit an earlier record: identify"
        )
    values = {name: prior.value for name, prior in known.items()}
    others = tuple(name for name in first.free if name not in known)
    progress("fitting with the verified values held")
    verified = [p.with_values(values) for p in problems]
    held = Experiment.together([replace(p, free=others) for p in verified])
    base = held.fit_stages()[-1]
    progress("letting verified parameters go")
    loose = Experiment.together([replace(p, free=(*others, *known)) for p in verified])
    sets: list[tuple[str, ...]] = [(name,) for name in known]
    if len(known) > 1:
        sets.append(tuple(known))
    fits = [(names, loose.fit(base.x0, base.values, free=(*others, *names))) for names in sets]
    diagnosis = diagnose(extend(source, []), held, base, progress=progress)
    chosen = diagnosis.chosen
    # What the innovations have named is measured by its likelihood, which counts for itself.
    by_error = None if diagnosis.opinion is not None else chosen
    moved, independent = _ranked(loose, base, fits, known, by_error)
    label = "" if chosen is None else chosen.addition.label
    merit = 0.0 if chosen is None else chosen.merit
    if by_error is not None:
        merit += float(np.sum(independent * by_error.gain)) - by_error.evidence
    return Drift(_change(moved, merit, diagnosis), moved, label, merit, diagnosis)


def _ranked(
    experiment: Experiment,
    base: Fit,
    fits: Sequence[tuple[tuple[str, ...], Fit]],
    known: Mapping[str, Prior],
    effect: Refit | None,
) -> tuple[tuple[Moved, ...], Vector]:
    """Return candidates, best first, and the independent samples that all are counted by.

    One measure for all, effects too: what the best of them leaves over. By their own each, the same
    fit would have another evidence.
    """
    gains = [
        (names, found, float(np.sum(log_gain(base, found)[0])))
        for names, found in fits
        if np.isfinite(found.at.cost)
    ]
    best = max(gains, key=lambda row: row[2], default=None)
    if effect is not None and (best is None or float(np.sum(effect.gain)) > best[2]):
        independent = effect.independent
    elif best is not None:
        independent = independent_of_all(experiment, best[1])
    else:
        return (), np.zeros(0)
    rows = [_moved(base, names, found, independent, known) for names, found, _ in gains]
    return tuple(sorted(rows, key=lambda m: -m.merit)), independent


def _moved(
    base: Fit,
    names: tuple[str, ...],
    found: Fit,
    independent: Vector,
    known: Mapping[str, Prior],
) -> Moved:
    evidence = float(np.sum(independent * log_gain(base, found)[0]))
    merit = evidence - 0.5 * len(names) * float(np.log(np.max(independent)))
    sd = dict(zip(found.free, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    values = {n: (known[n].value, found.values[n], sd[n]) for n in names}
    deviations = [
        abs(now - before) / np.hypot(spread, known[n].sd)
        for n, (before, now, spread) in values.items()
    ]
    return Moved(values, evidence, merit, float(np.nanmax(deviations)))


def _change(moved: tuple[Moved, ...], merit: float, diagnosis: Diagnosis) -> Change:
    best = moved[0] if moved else None
    if best is not None and best.evidence < CHANCE_GAIN + np.log(len(moved)):
        best = None
    chosen = diagnosis.chosen
    if chosen is None:
        if best is not None and best.deviations > MOVED:
            return Change.DRIFTED
        complete = diagnosis.outcome is Outcome.COMPLETE or best is not None
        return Change.NOTHING if complete else Change.MISSING
    if best is None or merit > best.merit + TIE:
        return Change.MISSING
    if merit > best.merit - TIE:
        return Change.EITHER
    # What the verified values' own uncertainty explains is no change.
    return Change.DRIFTED if best.deviations > MOVED else Change.NOTHING
