"""The search, step by step, and the detour where a law may stand for two simpler ones.

A law with several parameters bends to whatever it is shown. Dry friction and drag at one joint look
like a Stribeck curve as wide as the speed range, which explains a little more than either alone and
is taken first; what is left then fits neither. Where a law with fewer parameters explained nearly
as much, the climb is therefore tried again from there, and the model at the top decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.discovery.crossvalidation import Verdict, crossvalidate
from identification.discovery.diagnosis import TIE, Diagnosis, diagnose
from identification.discovery.evidence import Refit, independent_of_all, log_gain
from identification.discovery.extension import Addition, ExtendedModel
from identification.discovery.superfluous import without_superfluous
from identification.experiment import Experiment
from identification.gauss_newton import Fit

Progress = Callable[[str], None]

# A simpler law with less than this share of the chosen one's evidence is no rival.
_NEARLY = 0.5


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
    progress: Progress = lambda _: None,
) -> list[Rung]:
    """Add effect after effect until nothing is missing, or nothing can be named.

    Args:
        model, experiment, fit: Of the user.
        max_effects: At most this many effects.
        progress: Told what is being done.
    """
    diagnosis = diagnose(model, experiment, fit, progress=progress)
    rungs = [Rung(model, experiment, fit, None, (), None, diagnosis)]
    while (chosen := rungs[-1].diagnosis.chosen) is not None and _has_room(rungs, max_effects):
        rungs.append(_up(rungs[-1], chosen, progress))
    for k in range(len(rungs) - 1):
        other = _detour(rungs[: k + 1], max_effects, progress)
        if other and _is_better(other[-1], rungs[-1]):
            return other
    return rungs


def _has_room(rungs: Sequence[Rung], max_effects: int) -> bool:
    # What goes may come again: the number of steps is bounded too.
    return len(rungs[-1].model.additions) < max_effects and len(rungs) <= 2 * max_effects


def _up(below: Rung, chosen: Refit, progress: Progress) -> Rung:
    """Add a candidate, test the earlier ones again, and ask what is still missing."""
    progress(f"adding {chosen.addition.label}")
    verdict = below.diagnosis.checks[chosen.addition.label]
    progress("testing again what was added before")
    noise = below.experiment.noise()
    slim = without_superfluous(chosen.model, chosen.experiment, chosen.fit, noise)
    diagnosis = diagnose(slim.model, slim.experiment, slim.fit, progress=progress)
    return Rung(
        slim.model, slim.experiment, slim.fit, chosen.addition, slim.removed, verdict, diagnosis
    )


def _detour(rungs: Sequence[Rung], max_effects: int, progress: Progress) -> list[Rung]:
    """Climb from a rung by a simpler law than the one that was chosen there; empty if none is."""
    below = rungs[-1]
    chosen = below.diagnosis.chosen
    assert chosen is not None
    rival = _simpler(below.diagnosis, chosen)
    if rival is None:
        return []
    label = rival.addition.label
    progress(f"trying {label} instead of {chosen.addition.label}")
    found = below.diagnosis
    verdict = found.checks.get(label) or crossvalidate(
        below.experiment,
        below.fit,
        rival.experiment,
        rival.fit,
        below.experiment.noise(),
        independent=rival.independent,
        tried=len(found.refits),
    )
    if not verdict.accepted:
        return []
    below = replace(below, diagnosis=replace(found, checks={**found.checks, label: verdict}))
    other = [*rungs[:-1], below, _up(below, rival, progress)]
    while (then := other[-1].diagnosis.chosen) is not None and _has_room(other, max_effects):
        if then.addition.label == chosen.addition.label:
            # Back on the way from which this one left.
            return []
        other.append(_up(other[-1], then, progress))
    return other


def _simpler(diagnosis: Diagnosis, chosen: Refit) -> Refit | None:
    """Return the best candidate with fewer parameters that explains nearly as much."""
    size, evidence = len(chosen.addition.values), chosen.evidence
    rivals = (
        r
        for r in diagnosis.refits
        if len(r.addition.values) < size and r.evidence >= _NEARLY * evidence
    )
    return next(rivals, None)


def _is_better(other: Rung, one: Rung) -> bool:
    """Whether a model has the larger merit by more than chance (Bayesian criterion)."""
    gain = log_gain(one.fit, other.fit)[0]
    independent = independent_of_all(other.experiment, other.fit)
    ny = len(other.experiment.problem.output_names)
    samples = float(np.max(np.sum(independent.reshape(-1, ny), axis=0)))
    more = _size(other.model) - _size(one.model)
    return float(np.sum(independent * gain)) - 0.5 * more * np.log(samples) > TIE


def _size(model: ExtendedModel) -> int:
    return sum(len(addition.values) for addition in model.additions)
