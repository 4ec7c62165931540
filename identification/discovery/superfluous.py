"""Effects added earlier that a later one has made needless.

The first name given to two effects at once may be a third one's: a law that is a little like both.
Once the right ones are there, it explains nothing any more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.discovery.crossvalidation import crossvalidate
from identification.discovery.evidence import CHANCE_GAIN, independent_of_all, log_gain
from identification.discovery.extension import Addition, ExtendedModel, extend
from identification.discovery.transfer import transfer_all_states, transfer_problems
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.problem import Vector


@dataclass(frozen=True)
class Slimmer:
    """A model without what it does not need, fitted.

    Attributes:
        model, experiment, fit: Of the rest.
        removed: What went, in the order in which it went.
    """

    model: ExtendedModel
    experiment: Experiment
    fit: Fit
    removed: tuple[Addition, ...] = ()


def without_superfluous(
    model: ExtendedModel, experiment: Experiment, present: Fit, noise: Vector
) -> Slimmer:
    """Try the model without each of its effects but the newest, and leave out what is not missed.

    An effect goes if the model without it, refitted, is as good: it loses no more likelihood than
    chance would give, or unseen windows are predicted no worse.

    Args:
        model, experiment, present: With all effects.
        noise: (channels of all records,) standard deviation of the sensors' noise.
    """
    found = Slimmer(model, experiment, present)
    for addition in model.additions[:-1]:
        smaller = _without(found, addition)
        if np.isfinite(smaller.fit.at.cost) and _is_as_good(smaller, found, noise):
            found = replace(smaller, removed=(*found.removed, addition))
    return found


def _without(whole: Slimmer, addition: Addition) -> Slimmer:
    old, experiment = whole.model, whole.experiment
    rest = [a for a in old.additions if a.label != addition.label]
    model = extend(old.base, rest, values=old.values)
    problems = transfer_problems(experiment, model, whole.fit.values, old)
    smaller = Experiment.together(problems).lasting(experiment.window)
    x0 = transfer_all_states(smaller, model, experiment, old, whole.fit.x0)
    return Slimmer(model, smaller, smaller.fit(x0, smaller.problem.values))


def _is_as_good(smaller: Slimmer, larger: Slimmer, noise: Vector) -> bool:
    independent = independent_of_all(larger.experiment, larger.fit)
    evidence = float(np.sum(independent * log_gain(smaller.fit, larger.fit)[0]))
    if evidence < CHANCE_GAIN:
        return True
    verdict = crossvalidate(
        smaller.experiment,
        smaller.fit,
        larger.experiment,
        larger.fit,
        noise,
        independent=independent,
    )
    return verdict.removed <= 0.0
