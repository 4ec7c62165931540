"""The search, step by step, and the detours where a step may have been a wrong one.

A law with several parameters bends to whatever it is shown. Dry friction and drag at one joint look
like a Stribeck curve as wide as the speed range, which explains a little more than either alone and
is taken first; what is left then fits neither. And what one step does not tell apart, the next ones
may. Where a law with fewer parameters explained nearly as much, or where a tie led nowhere, the
climb is therefore tried again from there, and the model at the top decides.

Two effects may hide each other: where a fit has grown its own viscous friction for dry friction and
drag, neither predicts unseen windows better alone. Where no first step is let in and something is
left, two are tried as one; so they are where the first step has a simpler rival that is not let in
alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from foundation.progress import Progress, silent
from identification.discovery.crossvalidation import (
    NO_DOUBT,
    Verdict,
    crossvalidate,
    crossvalidate_candidate,
)
from identification.discovery.diagnosis import (
    TIE,
    Diagnosis,
    Outcome,
    by_output_error,
    diagnose,
)
from identification.discovery.empirical import propose
from identification.discovery.evidence import Refit, independent_of_all, log_gain, price
from identification.discovery.extension import Addition, ExtendedModel
from identification.discovery.superfluous import without_superfluous
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.prediction import WINDOW

# A simpler law with less than this share of the chosen one's evidence is no rival.
_NEARLY = 0.5
# A curve that takes up less than this share of what is left is not what is left of a law's shape.
_MOST = 0.2
# It is looked for where predictions are further off than this many times what noise would leave.
_AT_FLOOR = 1.1
# Two effects that are let in together, neither of which is let in alone, are to leave no doubt.
_FIRSTS = 3
_NEARLY_ALL = 0.9


@dataclass(frozen=True)
class Rung:
    """A model on the way up.

    Attributes:
        model, experiment, fit: With all that was found so far.
        added: What this step added; None at the first.
        removed: Earlier effects that it made needless.
        verdict: The cross-validation that let it in.
        diagnosis: What this model still lacks.
    """

    model: ExtendedModel
    experiment: Experiment
    fit: Fit
    added: Addition | None
    removed: tuple[Addition, ...]
    verdict: Verdict | None
    diagnosis: Diagnosis


def climb(
    model: ExtendedModel,
    experiment: Experiment,
    fit: Fit,
    *,
    max_effects: int,
    progress: Progress = silent,
) -> list[Rung]:
    """Add effect after effect until nothing is missing, or nothing can be named.

    Args:
        model, experiment, fit: Of the user.
        max_effects: At most this many effects.
        progress: Told what is being done.
    """
    diagnosis = diagnose(model, experiment, fit, progress=progress)
    rungs = _straight(
        [Rung(model, experiment, fit, None, (), None, diagnosis)], max_effects, progress
    )
    rungs = _by_two(_with_detours(rungs, max_effects, progress), max_effects, progress)
    return _with_curve(rungs, max_effects, progress)


def _with_detours(rungs: list[Rung], max_effects: int, progress: Progress) -> list[Rung]:
    """Return the rungs of a better way up, if there is one."""
    for below in [rungs[: k + 1] for k in range(len(rungs) - 1)]:
        for rival in _rivals(below[-1].diagnosis, rungs[-1].diagnosis.outcome):
            other = _detour(below, rival, max_effects, progress)
            if other:
                other = _as_taken(other, len(below) - 1, rival)
            elif len(below) == 1 and max_effects > 1:
                other = _pair(below[-1], rival, progress) or []
            if other and _is_better(other[-1], rungs[-1]):
                return _straight(other, max_effects, progress)
    return rungs


def _by_two(rungs: list[Rung], max_effects: int, progress: Progress) -> list[Rung]:
    """Begin with two effects at once, where no single one is let in.

    Beside one that was added, what is left is mostly what its law's shape is off by.
    """
    below = rungs[-1]
    found = below.diagnosis
    if len(rungs) > 1 or found.outcome is not Outcome.UNKNOWN_SHAPE or max_effects < 2:
        return rungs
    promising = [r for r in found.refits if r.merit > 0]
    for first in promising[:_FIRSTS]:
        other = _pair(below, first, progress)
        if other is None:
            continue
        size, place = len(first.addition.values), first.addition.place
        for simpler in found.refits:
            if simpler.addition.place == place and len(simpler.addition.values) < size:
                slimmer = _pair(below, simpler, progress)
                if slimmer is not None and _is_better(slimmer[-1], other[-1]):
                    other = slimmer
        return _straight(other, max_effects, progress)
    return rungs


def _pair(below: Rung, first: Refit, progress: Progress) -> list[Rung] | None:
    """Return rungs with a candidate and what it lets in, if both together leave no doubt."""
    found, label = below.diagnosis, first.addition.label
    progress(f"trying {label} with a second effect")
    # Whether the pair holds is asked below; here a disturbance or a curve need not be thought of.
    middle = _up(below, first, None, progress, ask=by_output_error)
    second = middle.diagnosis.chosen
    if second is None:
        return None
    verdict = crossvalidate(
        below.experiment,
        below.fit,
        second.experiment,
        second.fit,
        below.experiment.noise(),
        independent=second.independent,
        tried=len(found.refits) * len(middle.diagnosis.refits),
    )
    if verdict.chance > NO_DOUBT or verdict.removed < _NEARLY_ALL:
        return None
    top = _up(middle, second, middle.diagnosis.checks[second.addition.label], progress)
    if label not in {a.label for a in top.model.additions}:
        return None
    verdict = replace(verdict, reason=f"with {second.addition.label}, {verdict.reason}")
    named = replace(
        found,
        outcome=Outcome.EFFECT,
        chosen=first,
        checks={**found.checks, label: verdict},
        proposal=None,
    )
    return [replace(below, diagnosis=named), replace(middle, verdict=verdict), top]


def _with_curve(rungs: list[Rung], max_effects: int, progress: Progress) -> list[Rung]:
    """Take up by a curve what the shapes of the laws that were added leave over.

    A machine's friction is only nearly the textbook's, and where the noise is a thousandth of it,
    that shows. A curve is the last step: it bends to what another effect does as well, so that
    beside it no law can be judged (on the EMPS record a rolling resistance came next, which the
    unseen record contradicts). Nor is anything complete with one: what acts is drawn, not named.
    """
    top = rungs[-1]
    at = {a.place.name for a in top.model.additions if not a.effect.has_memory}
    if not at or not _has_room(rungs, max_effects):
        return rungs
    if _predicts_to_the_floor(top.experiment, top.fit):
        return rungs
    curve = top.diagnosis.proposal
    if curve is None or curve.refit.addition.place.name not in at:
        progress("looking for a curve where effects were added")
        curve = propose(top.model, top.experiment, top.fit, top.diagnosis.refits, at=at)
    if curve is None or curve.verdict.removed < _MOST:
        return rungs
    found, checks = curve.refit, {**top.diagnosis.checks, curve.refit.addition.label: curve.verdict}
    asked = replace(top, diagnosis=replace(top.diagnosis, checks=checks))
    nothing_asked = Diagnosis(Outcome.UNKNOWN_SHAPE, (), (), None, {}, {}, "")
    last = Rung(
        found.model, found.experiment, found.fit, found.addition, (), curve.verdict, nothing_asked
    )
    return [*rungs[:-1], asked, last]


def _predicts_to_the_floor(experiment: Experiment, fit: Fit) -> bool:
    """Whether errors over one-second windows are what sensor noise alone would leave.

    What a fit leaves over says less: its windows' initial states follow a law that is a little off.
    """
    ny = len(experiment.problem.output_names)
    for k, record in enumerate(experiment.records):
        found = record.predict(fit.values, record.short, sd=fit.sd[k * ny :])
        if not np.all(found.rmse[found.moves] <= _AT_FLOOR * found.floor[found.moves]):
            return False
    return True


def _straight(rungs: Sequence[Rung], max_effects: int, progress: Progress) -> list[Rung]:
    """Go on with what each diagnosis chooses."""
    up = list(rungs)
    while (chosen := up[-1].diagnosis.chosen) is not None and _has_room(up, max_effects):
        verdict = up[-1].diagnosis.checks[chosen.addition.label]
        up.append(_up(up[-1], chosen, verdict, progress))
    return up


def _has_room(rungs: Sequence[Rung], max_effects: int) -> bool:
    # What goes may come again: the number of steps is bounded too.
    return len(rungs[-1].model.additions) < max_effects and len(rungs) <= 2 * max_effects


def _up(
    below: Rung,
    chosen: Refit,
    verdict: Verdict | None,
    progress: Progress,
    ask: Callable[..., Diagnosis] = diagnose,
) -> Rung:
    """Add a candidate, test the earlier ones again, and ask what is still missing.

    Args:
        verdict: What let it in; None where that is only known with what comes next.
        ask: What asks.
    """
    progress(f"adding {chosen.addition.label}")
    progress("testing again what was added before")
    noise = below.experiment.noise()
    slim = without_superfluous(chosen.model, chosen.experiment, chosen.fit, noise)
    experiment, fit = slim.experiment, slim.fit
    if experiment.window < WINDOW:
        # A better model may follow longer windows, which show more.
        experiment, fit = experiment.followed(fit.values)
    diagnosis = ask(slim.model, experiment, fit, progress=progress)
    return Rung(slim.model, experiment, fit, chosen.addition, slim.removed, verdict, diagnosis)


def _detour(
    rungs: Sequence[Rung], rival: Refit, max_effects: int, progress: Progress
) -> list[Rung]:
    """Climb from a rung by a rival of what was chosen there, and without that.

    Returns:
        All rungs from the first; none if nothing on the way is let in.
    """
    other = list(rungs)
    chosen = rungs[-1].diagnosis.chosen
    assert chosen is not None
    shunned = chosen.addition.label
    progress(f"trying {rival.addition.label} instead of {shunned}")
    then: Refit | None = rival
    while then is not None and _has_room(other, max_effects):
        below = _letting_in(other[-1], then)
        if below is None:
            break
        other[-1] = below
        verdict = below.diagnosis.checks[then.addition.label]
        other.append(_up(below, then, verdict, progress))
        then = other[-1].diagnosis.chosen
        if then is not None and then.addition.label == shunned:
            near = _NEARLY * then.evidence
            refits = other[-1].diagnosis.refits
            then = next((r for r in refits if r is not then and r.evidence >= near), None)
    return other if len(other) > len(rungs) else []


def _as_taken(rungs: Sequence[Rung], at: int, rival: Refit) -> list[Rung]:
    """Return a detour with its first step as what was chosen there, and why."""
    below, above = rungs[at], rungs[at + 1]
    chosen, verdict = below.diagnosis.chosen, above.verdict
    assert chosen is not None
    assert verdict is not None
    reason = f"{verdict.reason}; with what came after it, better than {chosen.addition.label}"
    below = replace(below, diagnosis=replace(below.diagnosis, chosen=rival))
    above = replace(above, verdict=replace(verdict, reason=reason))
    return [*rungs[:at], below, above, *rungs[at + 2 :]]


def _letting_in(rung: Rung, candidate: Refit) -> Rung | None:
    """Return the rung with a candidate's cross-validation among its checks; None if it fails."""
    found, label = rung.diagnosis, candidate.addition.label
    verdict = found.checks.get(label) or crossvalidate_candidate(
        rung.experiment, rung.fit, candidate, tried=len(found.refits)
    )
    checks = {**found.checks, label: verdict}
    return replace(rung, diagnosis=replace(found, checks=checks)) if verdict.accepted else None


def _rivals(diagnosis: Diagnosis, end: Outcome) -> Iterator[Refit]:
    """Yield what may have been the better step.

    Args:
        diagnosis: Of the rung from which the step went.
        end: Where the steps led.
    """
    chosen = diagnosis.chosen
    assert chosen is not None
    size = len(chosen.addition.values)
    simpler = (
        r
        for r in diagnosis.refits
        if len(r.addition.values) < size and r.evidence >= _NEARLY * chosen.evidence
    )
    yield from islice(simpler, 1)
    if end is not Outcome.COMPLETE:
        tied = {label for tie in diagnosis.ties for label in tie}
        yield from (
            r
            for r in diagnosis.refits
            if r is not chosen and r.addition.label in tied and len(r.addition.values) == size
        )


def _is_better(other: Rung, one: Rung) -> bool:
    """Whether a model follows longer windows, or has the larger merit by more than chance."""
    if other.experiment.window != one.experiment.window:
        return other.experiment.window > one.experiment.window
    independent = independent_of_all(other.experiment, other.fit)
    gain = float(np.sum(independent * log_gain(one.fit, other.fit)[0]))
    prices = [price(r.model.additions, r.experiment, r.fit, independent) for r in (other, one)]
    return gain - (prices[0] - prices[1]) > TIE
