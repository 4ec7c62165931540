"""A second opinion that an unknown disturbance does not mislead.

Windowed output error takes whatever pushes the plant for an effect, or hides an effect behind it.
Here every input has an unknown first-order Gauss–Markov disturbance beside the effect, found by
likelihood, and candidates are judged by the innovations, which are white if model and disturbance
are right. With 0.02 V rms on a motor voltage of 5 V, output error finds none of the hidden effects
of the reference experiment; this test ranks the right one first, and gains 2 nats on a plant that
lacks nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from identification.discovery.crossvalidation import LARGEST_CHANCE, Verdict
from identification.discovery.evidence import Refit
from identification.discovery.extension import Addition, ExtendedModel, extend
from identification.discovery.scan import candidates, groups
from identification.discovery.transfer import flat_name, transfer_problem
from identification.estimators.kalman import most_likely
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.gauss_newton import fit as fit_windows
from identification.innovations import disturbed_values, with_input_disturbances
from identification.likelihood import Likelihood, Maximum, expand, left_out, maximise
from identification.problem import Problem, Vector

_DIFFERENCE = 1e-5
_SHARE_OF_NOMINAL = 1e-4
_DISTINCT = 1e-7
_BLOCKS = 10
_TURNS = 8
_REFITTED = 3
# The best of n useless candidates gains about log n; this much more is asked for [nats].
_BEYOND_CHANCE = 5.0


@dataclass(frozen=True)
class Second:
    """A candidate judged by innovations.

    Attributes:
        addition: Effect and place, with its parameters at the maximum.
        model: The extended model.
        maximum: Of its likelihood.
        evidence: ΔlogL over the model without it [nats].
        unseen: (blocks,) ΔlogL on blocks left out of the fit [nats].
        tried: How many candidates there were.
    """

    addition: Addition
    model: ExtendedModel
    maximum: Maximum
    evidence: float
    unseen: Vector
    tried: int

    @property
    def merit(self) -> float:
        """Evidence less the price of the parameters (½ log n each) [nats]."""
        samples = self.maximum.innovations.innovations.size
        return self.evidence - 0.5 * len(self.addition.values) * float(np.log(samples))

    @property
    def accepted(self) -> bool:
        """It predicts blocks that it was not fitted to better, by more than chance.

        Every one of them, or by so much on average that the best of all candidates would hardly
        do so by chance: a disturbance that is no Gauss–Markov process leaves likelihoods too sure.
        """
        mean = float(np.mean(self.unseen))
        error = float(np.std(self.unseen, ddof=1)) / np.sqrt(len(self.unseen))
        chance = self.tried * float(stats.t.sf(mean / max(error, 1e-300), len(self.unseen) - 1))
        return mean > 0 and (chance < LARGEST_CHANCE or float(np.min(self.unseen)) > 0)


@dataclass(frozen=True)
class Opinion:
    """What the innovations say.

    Attributes:
        base: The present model's maximum.
        ranking: (label, predicted ΔlogL) of every candidate, best first.
        best: The best candidate, if it is worth having.
        white: The base's innovations are as large as predicted: model and disturbance explain all.
        inputs: Name and unit of every input.
    """

    base: Maximum
    ranking: tuple[tuple[str, float], ...]
    best: Second | None
    white: bool
    inputs: tuple[tuple[str, str], ...]

    @property
    def disturbance(self) -> str:
        """The disturbances found, in words; empty if there are none."""
        final = self.base if self.best is None else self.best.maximum
        return ", ".join(
            f"{d.sd:.2g} {unit} rms, {d.rate:.2g} 1/s wide, at {name}"
            for (name, unit), d in zip(self.inputs, final.disturbances, strict=True)
            if d.sd > 0
        )


def second_opinion(model: ExtendedModel, problem: Problem, values: Mapping[str, float]) -> Opinion:
    """Score all candidates on the innovations, refit the best, and try it on unseen blocks.

    Args:
        model: The present model.
        problem: The record.
        values: Of the model's parameters, to start from.

    Raises:
        DivergenceError: The filter leaves the finite numbers.
    """
    base = most_likely(problem, values)
    scored = _scan(model, problem, base)
    ranking = tuple((a.label, gain) for a, gain, _ in scored)
    squares = np.mean(base.innovations.normalised**2, axis=0)
    white = bool(np.all((squares > 0.8) & (squares < 1.2)))
    price = _BEYOND_CHANCE + np.log(max(len(scored), 1))
    worth = [s for s in scored[:_REFITTED] if s[1] > price]
    refits = [
        _refit(model, problem, base, addition, step, len(scored)) for addition, _, step in worth
    ]
    refits.sort(key=lambda s: -s.merit)
    best = next((r for r in refits if r.evidence > price), None)
    if best is not None:
        best = replace(best, unseen=_unseen(model, problem, base, best))
        if not best.accepted:
            best = None
    inputs = tuple((v.name, v.unit) for v in problem.dae.inputs)
    return Opinion(base, ranking, best, white, inputs)


def curve_in_disturbance(
    model: ExtendedModel, problem: Problem, base: Maximum, curves: Sequence[Addition]
) -> Second | None:
    """Return the curve over speed, position or signal that a disturbance in truth is, if it is one.

    A disturbance explains anything, a law without a name too; but it knows nothing of the motion.
    On plants that lack nothing but have one, curves gain what chance gives them (half a nat a
    bump, on 9 records 2 to 11 nats); a force that peaks at one speed gains 178 where it passed for
    a disturbance of 1.2 % of the command.

    Args:
        model: The present model.
        problem: The record.
        base: The maximum of its likelihood, beside a disturbance.
        curves: Candidates, each over the range of the record.

    Returns:
        The curve refitted; None if none gains more than its parameters cost (½ log n each).
    """
    samples = base.innovations.innovations.size
    best: tuple[float, Addition, dict[str, float]] | None = None
    for addition, gain, step in _score_group(model, problem, base, curves):
        merit = gain - 0.5 * len(step) * float(np.log(samples))
        if merit > (0.0 if best is None else best[0]):
            best = merit, addition, step
    if best is None:
        return None
    _, addition, step = best
    found = _refit(model, problem, base, addition, step, len(curves))
    # What a record does fastest it does once: in one piece, that block would be extrapolated to.
    return replace(found, unseen=_unseen(model, problem, base, found, turns=_TURNS))


def _scan(
    model: ExtendedModel, problem: Problem, base: Maximum
) -> list[tuple[Addition, float, dict[str, float]]]:
    """Return (candidate, predicted ΔlogL, predicted main parameters), best first."""
    have = {a.label for a in model.additions}
    wanted = [
        a
        for a in candidates(model.base, problem.output_names)
        # A filter or delay at a sensor has a state of its own whose start the data must tell.
        if a.label not in have and not (a.place.kind == "output" and a.effect.has_memory)
    ]
    scored = (_score_group(model, problem, base, group) for group in groups(wanted))
    return sorted((row for rows in scored for row in rows), key=lambda row: -row[1])


def _score_group(
    model: ExtendedModel, problem: Problem, base: Maximum, wanted: Sequence[Addition]
) -> list[tuple[Addition, float, dict[str, float]]]:
    """Attach a group of candidates, absent, and score each."""
    whole = extend(
        model.base,
        [*model.additions, *wanted],
        values=model.values,
        name=f"{model.base.short_name}_all",
    )
    mine = {k: v for k, v in base.values.items() if k in problem.values}
    record = transfer_problem(problem, whole, mine, model)
    dae, names = with_input_disturbances(record.dae)
    values = disturbed_values(record.values, names)
    likelihood = Likelihood.of(replace(record, dae=dae, values=values), names)
    base_names = [flat_name(whole, model, name) for name in base.free]
    steps = {n: _DIFFERENCE * max(abs(values[n]), 1e-3) for n in base_names}
    mains = {a.label: [whole.parameter_of(a, p) for p in a.effect.main_parameters] for a in wanted}
    for flat in (n for group in mains.values() for n in group):
        nominal = abs(dae.number(dae.variables[flat].nominal, 1.0))
        steps[flat] = _SHARE_OF_NOMINAL * nominal
    shape = any(d.sd > 0 for d in base.disturbances)
    expansion = expand(likelihood, values, base.disturbances, steps, shape=shape)
    order = [*steps, *([""] * (len(expansion.score) - len(steps)))]
    known = [i for i, name in enumerate(order) if name in base_names or not name]
    inverse = np.linalg.pinv(
        expansion.information[np.ix_(known, known)], rcond=1e-13, hermitian=True
    )
    found: list[tuple[Addition, float, dict[str, float]]] = []
    for addition in wanted:
        index = [order.index(name) for name in mains[addition.label]]
        cross = expansion.information[np.ix_(index, known)]
        raw = expansion.information[np.ix_(index, index)]
        information = raw - cross @ inverse @ cross.T
        if np.any(np.diag(information) <= _DISTINCT * np.diag(raw)):
            continue
        score = expansion.score[index] - cross @ inverse @ expansion.score[known]
        step = np.linalg.lstsq(information, score, rcond=1e-10)[0]
        low = [dae.number(dae.variables[order[i]].minimum, -np.inf) for i in index]
        inside = np.maximum(step, low)
        gain = float(inside @ score - 0.5 * inside @ information @ inside)
        predicted = dict(zip(addition.effect.main_parameters, inside.tolist(), strict=True))
        found.append((addition, gain, predicted))
    return found


def _refit(
    model: ExtendedModel,
    problem: Problem,
    base: Maximum,
    addition: Addition,
    step: Mapping[str, float],
    tried: int,
) -> Second:
    bigger = extend(model.base, [*model.additions, addition], values=model.values)
    likelihood, values = _likelihood(bigger, model, problem, base, addition, step)
    maximum = maximise(likelihood, values, base.disturbances)
    effect = addition.effect
    fitted = {
        p: maximum.values[bigger.parameter_of(addition, p)]
        for p in (*effect.main_parameters, *effect.shape_parameters)
    }
    return Second(
        replace(addition, values=fitted),
        bigger,
        maximum,
        maximum.log_likelihood - base.log_likelihood,
        np.zeros(0),
        tried,
    )


def _likelihood(
    bigger: ExtendedModel,
    model: ExtendedModel,
    problem: Problem,
    base: Maximum,
    addition: Addition,
    step: Mapping[str, float],
) -> tuple[Likelihood, dict[str, float]]:
    mine = {k: v for k, v in base.values.items() if k in problem.values}
    added = {bigger.parameter_of(addition, p): v for p, v in step.items()}
    record = transfer_problem(problem, bigger, mine, model, added=added)
    dae, names = with_input_disturbances(record.dae)
    values = disturbed_values(record.values, names)
    return Likelihood.of(replace(record, dae=dae, values=values), names), values


def _unseen(
    model: ExtendedModel, problem: Problem, base: Maximum, second: Second, *, turns: int = 1
) -> Vector:
    """Return ΔlogL of each block when parameters come from the others.

    Args:
        turns: In how many pieces each block is, dealt out in turn.
    """
    dae, names = with_input_disturbances(problem.dae)
    small = Likelihood.of(
        replace(problem, dae=dae, values=disturbed_values(problem.values, names)), names
    )
    large, _ = _likelihood(
        second.model, model, problem, base, second.addition, second.addition.values
    )
    samples = np.arange(len(problem.time))
    owner = samples * _BLOCKS * turns // len(samples) % _BLOCKS
    blocks = [np.flatnonzero(owner == k) for k in range(_BLOCKS)]
    at = second.maximum
    return left_out(large, at.values, at.disturbances, blocks) - left_out(
        small, base.values, base.disturbances, blocks
    )


def adopt(
    second: Second, model: ExtendedModel, experiment: Experiment, base: Maximum, fit: Fit
) -> tuple[Refit, Verdict]:
    """Return an accepted candidate in the form in which output error's are handed on.

    Its parameters and their covariance are those of the likelihood; only the windows' initial
    states are fitted.

    Args:
        second: The accepted candidate.
        model, experiment, fit: Of the model without it.
        base: That model's maximum.
    """
    mine = {k: v for k, v in base.values.items() if k in experiment.problem.values}
    problem = transfer_problem(experiment.problem, second.model, mine, model)
    values = {name: second.maximum.values[name] for name in problem.values}
    problem = problem.with_values(values)
    larger = Experiment.of(problem).lasting(experiment.window)
    windows = experiment.windows
    at = fit_windows(
        problem, larger.shooting, windows, larger.guess(windows), values, free=(), fixed_sd=fit.sd
    )
    at = replace(at, free=second.maximum.free, covariance=second.maximum.covariance)
    before = np.mean(base.innovations.innovations**2, axis=0)
    after = np.mean(second.maximum.innovations.innovations**2, axis=0)
    removed = 1.0 - float(np.mean(after / before))
    blocks = second.unseen
    t = float(np.mean(blocks) / (np.std(blocks, ddof=1) / np.sqrt(len(blocks))))
    refit = Refit(
        addition=second.addition,
        model=second.model,
        experiment=larger,
        fit=at,
        evidence=second.evidence,
        explains=removed,
        merit=second.merit,
        at_bound=(),
        gain=0.5 * np.log(before / after),
        independent=np.full(len(before), float(len(experiment.problem.time))),
    )
    reason = (
        f"beside an unknown disturbance at the inputs it gains {second.evidence:.0f} nats, and "
        f"{np.mean(blocks):.0f} on average on a block left out of the fit"
    )
    chance = float(stats.t.sf(t, len(blocks) - 1))
    return refit, Verdict(True, chance, removed, np.sqrt(before), np.sqrt(after), reason)
