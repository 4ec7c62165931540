"""A missing force without a name: a smooth curve over speed or position.

Where no law of the library explains what a model leaves over, the curve that explains it best is
proposed as an effect of its own (`EmpiricalOverSpeed`, …), marked as empirical. It is judged like
any other effect, on windows that its fit has not seen. Where nothing has a name it is never added
unasked: it says what acts, not why. Where an effect was named and its law is only nearly the
machine's, a curve at the same place takes up what the law's shape leaves over.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.places import Place, places
from identification.discovery.characteristic import variable_of
from identification.discovery.crossvalidation import Verdict, crossvalidate_candidate
from identification.discovery.effects import find_effects, kind_at
from identification.discovery.evidence import Refit, refit_all
from identification.discovery.extension import Addition, ExtendedModel, addition_at, extend
from identification.discovery.scan import Scored, score_group
from identification.discovery.transfer import transfer_all_states, transfer_problems
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.linearisation import simulate
from identification.priors import Prior
from identification.problem import Matrix
from identification.shooting import Shooting

_TRIED = 2
_LEAST_EVIDENCE = 8.0  # [nats]
# Width of the bumps' prior in their median height, and of what was found before in its deviation.
_WIDTH = 2.0
_AS_FOUND = 10.0


@dataclass(frozen=True)
class Proposal:
    """A curve that explains what is left.

    Attributes:
        refit: The curve at its place, fitted.
        over: What it is drawn over, in words.
        verdict: Of the cross-validation that it passed.
        nearest: Labels of the named effects that come nearest there, best first.
    """

    refit: Refit
    over: str
    verdict: Verdict
    nearest: tuple[str, ...]

    @property
    def addition(self) -> str:
        """What `extend --add` is told to have it."""
        addition = self.refit.addition
        values = ",".join(f"{name}={value:.4g}" for name, value in addition.values.items())
        return f"{addition.label},{values}"


def propose(
    model: ExtendedModel,
    experiment: Experiment,
    fit: Fit,
    refits: tuple[Refit, ...] = (),
    *,
    at: Collection[str] | None = None,
) -> Proposal | None:
    """Return the curve that explains best what a model leaves over, if one does.

    Of a foreign FMU none is looked for; `extend --add` takes one.

    Args:
        model: The present model.
        experiment: That model on the record.
        fit: Its fit.
        refits: Of named effects, best first, to say which come nearest.
        at: Names of the places to look at; by default every flange and input.

    Raises:
        UnsupportedModelError: The model cannot be simulated with sensitivities.
    """
    curves = curves_at(model, experiment, fit, at)
    if not curves:
        return None
    scored = sorted(score_group(model, experiment, fit, curves), key=lambda s: -s.gain)
    known = _as_found(model, fit)
    likely = [s for s in scored[:_TRIED] if s.gain > 0]
    # The corner of a limit is all in a few bumps, beside which most are nothing.
    for size in (_usual_height, _largest_height):
        tried = [_held_to_its_size(s, known, size(s)) for s in likely]
        for found in refit_all(model, experiment, fit, tried)[0]:
            if found.merit < _LEAST_EVIDENCE:
                continue
            verdict = crossvalidate_candidate(experiment, fit, found, tried=len(curves))
            if verdict.accepted:
                return proposal(model, found, verdict, refits)
    return None


def curves_at(
    model: ExtendedModel, experiment: Experiment, fit: Fit, at: Collection[str] | None = None
) -> list[Addition]:
    """Return the curves that a model does not have yet, each over what the record moves through.

    Args:
        model, experiment, fit: The present model on the record.
        at: As in `propose`.

    Returns:
        None of a foreign FMU.
    """
    if model.base.fmu is not None:
        # As many runs through the FMU's process as a curve has bumps, at every step.
        return []
    have = {a.label for a in model.additions}
    curves = [
        addition_at(model.base, effect, place)
        for place in places(model.base)
        for effect in find_effects(model.base)
        if effect.empirical and _is_asked(place, at) and effect.kind == kind_at(place.kind)
    ]
    return [_over_record(model, experiment, fit, a) for a in curves if a.label not in have]


def proposal(
    model: ExtendedModel, found: Refit, verdict: Verdict, refits: Sequence[Refit]
) -> Proposal:
    """Return a fitted curve with what is said of it."""
    place = found.addition.place.name
    near = [r.addition.label for r in refits if r.addition.place.name == place]
    over = variable_of(found.addition.effect, model.base).words
    return Proposal(found, over, verdict, tuple(near[:3]))


def _as_found(model: ExtendedModel, fit: Fit) -> dict[str, Prior]:
    """Return the fitted parameters as priors, some standard deviations wide.

    A curve over a signal can stand for a gain, which no record tells from all masses and springs
    being larger, and one over speed for viscous friction. It is to take up what is left over, not
    what has been found.
    """
    sds = _AS_FOUND * np.sqrt(np.diag(fit.covariance))
    return {
        model.user_name(name): Prior(fit.values[name], float(sd))
        for name, sd in zip(fit.free, sds, strict=True)
        if np.isfinite(sd) and sd > 0
    }


def _usual_height(scored: Scored) -> float:
    return _WIDTH * float(np.median(np.abs(list(scored.values.values()))))


def _largest_height(scored: Scored) -> float:
    return float(np.max(np.abs(list(scored.values.values()))))


def _held_to_its_size(scored: Scored, known: Mapping[str, Prior], size: float) -> Scored:
    """Return a curve whose bumps have a prior of a size [the curve's unit].

    Where the record hardly goes, nothing holds a bump, and a fit to a part of the record sends it
    anywhere.
    """
    if not size > 0:
        return scored
    heights = np.clip(list(scored.values.values()), -size, size)
    start = dict(zip(scored.values, heights.tolist(), strict=True))
    addition = scored.addition
    own = {f"{addition.instance}.{p}": Prior(0.0, size) for p in addition.effect.main_parameters}
    return replace(scored, addition=replace(addition, priors={**known, **own}), values=start)


def _is_asked(place: Place, at: Collection[str] | None) -> bool:
    # That a sensor bends what it shows has to be known: any law of the machine shows there.
    return place.kind != "output" if at is None else place.name in at


def _over_record(
    model: ExtendedModel, experiment: Experiment, fit: Fit, addition: Addition
) -> Addition:
    """Return an empirical effect whose curve spans what the record moves through."""
    bigger = extend(model.base, [*model.additions, addition], values=model.values)
    problems = transfer_problems(experiment, bigger, fit.values, model)
    problem = problems[0]
    watched = bigger.parameter_of(addition, variable_of(addition.effect, model.base).name)
    shooting = Shooting.of(problem, (), watched=(watched,), briefly=True)
    larger = Experiment(problem, shooting, window=experiment.window)
    larger = replace(larger, also=tuple(larger.on(other) for other in problems[1:]))
    x0 = transfer_all_states(larger, bigger, experiment, model, fit.x0)
    tracks: list[Matrix] = []
    for part in larger.parts():
        count = len(part.windows)
        tracks += simulate(part.problem, shooting, part.windows, x0[:count], problem.values)
        x0 = x0[count:]
    low, high = np.nanquantile(np.concatenate(tracks), [0.001, 0.999])
    span = max(float(high - low), 1e-9)
    values = {"lowest": float(low) - 0.01 * span, "highest": float(high) + 0.01 * span}
    return replace(addition, values=values)
