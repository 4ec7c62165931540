"""Which physical effect is missing: scan, refit, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from foundation.errors import DivergenceError, TwinproofError, UnsupportedModelError
from foundation.progress import Progress, silent
from identification.discovery.crossvalidation import (
    MOST_REMOVED,
    Verdict,
    crossvalidate_candidate,
    is_white,
)
from identification.discovery.effects import unit_at
from identification.discovery.empirical import Proposal, curves_at, proposal, propose
from identification.discovery.evidence import CHANCE_GAIN, Refit, refit_all
from identification.discovery.extension import ExtendedModel
from identification.discovery.innovation_scan import (
    Opinion,
    adopt,
    curve_in_disturbance,
    second_opinion,
)
from identification.discovery.next_experiment import propose as propose_experiment
from identification.discovery.scan import Scored, scan
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.likelihood import Maximum
from identification.problem import Vector

SHORTLIST = 8
# A fit whose error is this many times the noise, with a parameter that is this many times more or
# less than declared, has run away; so many candidates are then tried from the declared values.
_FAR_OFF = 3.0
_MORE = 4
_TRIALS = 3
# An experiment is looked for that tells at most this many rivals apart: each is fitted to each.
_COMPARED = 3
# Candidates this close in merit to the best are not told apart by this record [nats].
TIE = 3.0
_AT_FLOOR = 1.1
# A sensor's fault that leaves more than a tenth of the error above the noise is not all.
_ALL_BUT = 0.9
_NUMERICAL = 1e-5
# A disturbance of this share of the input may be called noise of the machine; beside one of that
# share no effect is named.
_SMALL_DISTURBANCE = 0.02
_LARGE_DISTURBANCE = 0.1


class Outcome(Enum):
    """What a diagnosis says."""

    COMPLETE = "complete"
    EFFECT = "effect"
    UNDETERMINED = "undetermined"
    UNKNOWN_SHAPE = "unknown-shape"
    SENSOR = "sensor"


@dataclass(frozen=True)
class Ranked:
    """One row of the ranking.

    Attributes:
        label: `EFFECT@PLACE`.
        effect, place: Their names.
        evidence: ΔlogL [nats]; predicted by the score test if not refitted.
        explains: Share of the squared residual removed.
        parameters: Its fitted parameters with their standard deviations.
        refitted: False if only the score test has looked at it.
    """

    label: str
    effect: str
    place: str
    evidence: float
    explains: float
    parameters: Mapping[str, tuple[float, float, str]]
    refitted: bool


@dataclass(frozen=True)
class Diagnosis:
    """The answer to "what is missing?".

    Attributes:
        outcome: The verdict.
        ranking: Candidates, best first.
        ties: Groups of labels that this record does not tell apart.
        chosen: The candidate that passed cross-validation, if any.
        checks: Label → its cross-validation.
        skipped: Label → why a candidate could not be tested.
        next_experiment: What to record to get further; empty if nothing is open.
        opinion: What the innovations say, where output error found nothing to add; None if it was
            not asked, or the sensors' noise is not known.
        proposal: A curve without a name that explains what is left; None if there is none, or no
            need of one.
        refits: The candidates that were refitted, best first, whole.
    """

    outcome: Outcome
    ranking: tuple[Ranked, ...]
    ties: tuple[tuple[str, ...], ...]
    chosen: Refit | None
    checks: Mapping[str, Verdict]
    skipped: Mapping[str, str]
    next_experiment: str
    opinion: Opinion | None = None
    proposal: Proposal | None = None
    refits: tuple[Refit, ...] = ()

    @property
    def disturbance(self) -> str:
        """What an unknown disturbance at the inputs does, in words; empty if there is none."""
        if self.opinion is None:
            return ""
        return self.opinion.disturbance


def diagnose(
    model: ExtendedModel,
    experiment: Experiment,
    fit: Fit,
    *,
    progress: Progress = silent,
) -> Diagnosis:
    """Find the effect that best explains what a fitted model leaves over.

    Args:
        model: The present model.
        experiment: That model on the record.
        fit: Its fit over the experiment's windows.
        progress: Told what is being done.
    """
    found = by_output_error(model, experiment, fit, progress=progress)
    noise_known = not np.any(np.isnan(experiment.problem.noise_sd))
    # A disturbance that differs from record to record has not been looked for yet.
    can_ask = noise_known and not experiment.also
    if can_ask and _is_doubtful(found, experiment):
        nothing = replace(found, outcome=Outcome.UNKNOWN_SHAPE, ties=(), chosen=None)
        asked = _with_disturbance(model, experiment, fit, nothing, progress)
        if asked.outcome is not Outcome.UNKNOWN_SHAPE:
            return asked
    if can_ask and found.outcome is Outcome.UNKNOWN_SHAPE:
        found = _with_disturbance(model, experiment, fit, found, progress)
    if found.outcome is Outcome.UNKNOWN_SHAPE:
        progress("looking for a curve without a name")
        # Where something was added, its law is likely to be only nearly the machine's.
        at = {a.place.name for a in model.additions if not a.effect.has_memory}
        curve = propose(model, experiment, fit, found.refits, at=at) if at else None
        curve = curve or propose(model, experiment, fit, found.refits) or found.proposal
        found = replace(found, proposal=curve)
    return found


def _is_doubtful(found: Diagnosis, experiment: Experiment) -> bool:
    """Whether more is left of what the model missed than was explained, and it is slow.

    A disturbance that comes and goes as slowly as a load turns is explained by a cogging of the
    load, in part, on unseen windows too.
    """
    chosen = found.chosen
    if chosen is None or is_white(chosen.independent, experiment):
        return False
    return found.checks[chosen.addition.label].removed < MOST_REMOVED


def _with_disturbance(
    model: ExtendedModel,
    experiment: Experiment,
    fit: Fit,
    found: Diagnosis,
    progress: Progress,
) -> Diagnosis:
    """Diagnose by the innovations, beside an unknown disturbance at every input."""
    progress("asking again, with an unknown disturbance at the inputs")
    try:
        opinion = second_opinion(model, experiment.problem, fit.values)
    except (DivergenceError, UnsupportedModelError):
        # A model that a filter cannot follow has no second opinion.
        return found
    inputs = np.sqrt(np.mean(experiment.problem.inputs**2, axis=0))
    left = opinion.base if opinion.best is None else opinion.best.maximum
    # A disturbance of an input that stands still is large, however small.
    sizes = zip(left.disturbances, np.fmax(inputs, 1e-300), strict=True)
    share = max((d.sd / size for d, size in sizes), default=0.0)
    # A disturbance explains anything: called complete is what needs little of it, and an effect is
    # only named beside one that does not do most of the work.
    if opinion.best is None or share > _LARGE_DISTURBANCE:
        complete = opinion.white and share <= _SMALL_DISTURBANCE and opinion.best is None
        found = replace(found, opinion=replace(opinion, best=None))
        if not complete:
            return replace(found, outcome=Outcome.UNKNOWN_SHAPE)
        return _complete_or_curve(model, experiment, fit, found, opinion.base)
    refit, verdict = adopt(opinion.best, model, experiment, opinion.base, fit)
    label = refit.addition.label
    ranking = (_row(refit), *(row for row in found.ranking if row.label != label))
    return replace(
        found,
        outcome=Outcome.EFFECT,
        ranking=ranking,
        chosen=refit,
        checks={**found.checks, label: verdict},
        opinion=opinion,
    )


def _complete_or_curve(
    model: ExtendedModel, experiment: Experiment, fit: Fit, found: Diagnosis, base: Maximum
) -> Diagnosis:
    """Call complete what needs a small disturbance, unless that follows the motion.

    Args:
        base: The maximum of the likelihood beside that disturbance.
    """
    curves = curves_at(model, experiment, fit)
    try:
        curve = curve_in_disturbance(model, experiment.problem, base, curves) if curves else None
    except DivergenceError:
        # A filter that cannot follow a curve says nothing against the disturbance.
        curve = None
    if curve is None:
        return replace(found, outcome=Outcome.COMPLETE)
    found = replace(found, outcome=Outcome.UNKNOWN_SHAPE)
    if not curve.accepted:
        return found
    refit, verdict = adopt(curve, model, experiment, base, fit)
    before, after = (sum(d.sd**2 for d in m.disturbances) for m in (base, curve.maximum))
    if before > 0:
        # What a disturbance took up is no error of the innovations.
        verdict = replace(verdict, removed=1.0 - after / before)
    return replace(found, proposal=proposal(model, refit, verdict, found.refits))


def by_output_error(
    model: ExtendedModel, experiment: Experiment, fit: Fit, *, progress: Progress = silent
) -> Diagnosis:
    """As `diagnose`, without asking for disturbances or curves where nothing has a name."""
    scanned = scan(model, experiment, fit, progress=progress)
    shortlist = _shortlist(scanned.scored)
    noise = experiment.noise()
    if _has_run_away(experiment, fit, noise):
        progress("scoring again at the declared values, which the fit has left far behind")
        shortlist += _shortlist_where_declared(model, experiment, fit)
    refits, failed = refit_all(model, experiment, fit, shortlist, progress=progress)
    refits = _once(refits)
    checks: dict[str, Verdict] = {}
    chosen: Refit | None = None
    # The best of n candidates gains this much by chance alone.
    worth_trying = CHANCE_GAIN + np.log(max(len(scanned.scored), 1))
    # States of its own that start anew in every window gain as much by chance.
    for candidate in [r for r in refits if r.evidence > worth_trying and r.merit > 0][:_TRIALS]:
        progress(f"cross-validating {candidate.addition.label}")
        verdict = crossvalidate_candidate(experiment, fit, candidate, tried=len(refits))
        checks[candidate.addition.label] = verdict
        if verdict.accepted:
            chosen = candidate
            break
    refitted = {r.addition.label for r in refits}
    ranking = (
        *(_row(r) for r in refits),
        *(_unrefitted(s, fit) for s in scanned.scored if s.addition.label not in refitted),
    )
    rivals = _rivals(refits, chosen)
    removed = 0.0 if chosen is None else checks[chosen.addition.label].removed
    ties = (tuple(r.addition.label for r in rivals),) if rivals else ()
    return Diagnosis(
        _outcome(chosen, removed, rivals, fit, noise, experiment),
        ranking,
        ties,
        chosen,
        checks,
        {**scanned.skipped, **failed},
        _next_experiment(rivals, progress),
        refits=refits,
    )


def _has_run_away(experiment: Experiment, fit: Fit, noise: Vector) -> bool:
    """Whether a model explains little, with values that are nothing like the declared ones."""
    if np.all(fit.at.rms <= _FAR_OFF * noise):
        return False
    declared = experiment.problem.values
    return any(
        declared[name] != 0 and not 1 / _FAR_OFF < fit.values[name] / declared[name] < _FAR_OFF
        for name in fit.free
        if name not in fit.held
    )


def _shortlist_where_declared(
    model: ExtendedModel, experiment: Experiment, fit: Fit
) -> list[Scored]:
    """Return the candidates that do most for the model as its author declared it.

    Where much is missing, the model's parameters give up what the machine is: two inertias with an
    offset between their encoders are fitted best by a shaft without stiffness. Nothing small can
    be added to that. The declared values explain less, but near them the missing effect is seen.
    """
    values = dict(experiment.problem.values)
    x0 = np.concatenate([record.guess(record.windows) for record in experiment.records])
    followed = experiment.fit(x0, values, free=())
    if not np.isfinite(followed.at.cost):
        # So far from the machine that windows run away there: nothing can be scored.
        return []
    start = replace(fit, values=values, x0=followed.x0, sd=followed.sd, at=followed.at)
    scored = scan(model, experiment, start).scored[:_MORE]
    return [replace(s, start=start) for s in scored if s.gain > 0]


def _once(refits: Sequence[Refit]) -> tuple[Refit, ...]:
    """Keep the best of each candidate's refits, which are in order."""
    best: dict[str, Refit] = {}
    for found in refits:
        best.setdefault(found.addition.label, found)
    return tuple(best.values())


def _shortlist(scored: Sequence[Scored]) -> list[Scored]:
    """Return the candidates worth a refit."""
    best, rest = [s for s in scored[:SHORTLIST] if s.gain > 0], scored[SHORTLIST:]
    # What shows only when it is large is tried from several sizes instead.
    blind = [s for s in scored if s.blind and s.addition.place.kind != "output"]
    # A lag at the input looks like one at every sensor; each of these alone may score higher.
    late = any(s.addition.effect.has_memory and s.addition.place.kind == "output" for s in best)
    inputs = [
        s
        for s in rest
        if s.addition.effect.has_memory and s.addition.place.kind == "input" and not s.blind
    ]
    return [*best, *blind, *(inputs if late else [])]


def _row(refit: Refit) -> Ranked:
    parameters: dict[str, tuple[float, float, str]] = {}
    place = refit.addition.place
    units = {v.name: unit_at(v, place) for v in refit.addition.effect.parameters}
    for name, value in refit.addition.values.items():
        flat = refit.model.parameter_of(refit.addition, name)
        sd = np.inf
        if flat in refit.fit.free:
            k = refit.fit.free.index(flat)
            sd = float(np.sqrt(refit.fit.covariance[k, k]))
        parameters[name] = (value, sd, units[name])
    addition = refit.addition
    return Ranked(
        addition.label,
        addition.effect.name,
        addition.place.name,
        refit.evidence,
        refit.explains,
        parameters,
        True,
    )


def _unrefitted(scored: Scored, fit: Fit) -> Ranked:
    share = min(scored.gain / max(fit.at.cost, 1e-300), 1.0 - 1e-12)
    addition = scored.addition
    return Ranked(
        addition.label,
        addition.effect.name,
        addition.place.name,
        # White-noise scale: only ever used to order the tail of the list.
        0.0,
        share,
        {},
        False,
    )


def _rivals(refits: tuple[Refit, ...], chosen: Refit | None) -> tuple[Refit, ...]:
    """Return the candidates that this record does not tell from the chosen one, itself included."""
    if chosen is None:
        return ()
    near = tuple(r for r in refits if abs(r.merit - chosen.merit) <= TIE)
    return near if len(near) > 1 else ()


def _outcome(
    chosen: Refit | None,
    removed: float,
    rivals: tuple[Refit, ...],
    fit: Fit,
    noise: Vector,
    experiment: Experiment,
) -> Outcome:
    if chosen is not None:
        if _is_sensor(chosen, rivals) and removed >= _ALL_BUT:
            return Outcome.SENSOR
        # A rival with more parameters loses to the simpler law; an equal one does not.
        size = len(chosen.addition.values)
        equal = any(r is not chosen and len(r.addition.values) <= size for r in rivals)
        # A shape at the end of its range stands for something else.
        return Outcome.UNDETERMINED if equal or chosen.at_bound else Outcome.EFFECT
    # Below this the integration's own error and the recording's digits begin.
    smallest = _NUMERICAL * np.concatenate(
        [np.std(problem.outputs, axis=0) for problem in experiment.problems]
    )
    if np.all(fit.at.rms <= _AT_FLOOR * np.fmax(noise, smallest)):
        return Outcome.COMPLETE
    return Outcome.UNKNOWN_SHAPE


def _is_sensor(chosen: Refit, rivals: tuple[Refit, ...]) -> bool:
    """The chosen candidate and all that are not told from it act on what was measured only.

    Which of several faults it is may be open, that it is the sensor is not.
    """
    return not chosen.at_bound and all(r.addition.place.kind == "output" for r in (chosen, *rivals))


def _next_experiment(rivals: tuple[Refit, ...], progress: Progress) -> str:
    """Return what to record to tell rivals apart, and by how much."""
    if not rivals:
        return ""
    progress("looking for an experiment that tells " + ", ".join(r.addition.label for r in rivals))
    try:
        return propose_experiment(rivals[:_COMPARED]).text
    except TwinproofError:
        labels = ", ".join(r.addition.label for r in rivals)
        return f"record the motion at half and at twice the size: {labels} may change differently"
