"""What a report says in sentences. Pure functions of the results."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis, Outcome, Ranked
from identification.discovery.ladder import Improvement, Step
from identification.problem import Problem
from twinproof.report.numbers import chance, percent, quantity, significant, typeset_powers
from twinproof.report.picture import unit_of

CHANCE_OF_WHITE = 0.01
"""Residuals less probable than this, were they white, are called correlated."""
_ILL_CONDITIONED = 1e4
_POORLY_KNOWN = 0.5
# An error up to this many times its noise floor is called noise, beyond the other far above it.
AT_NOISE = 1.2
FAR = 100.0

REMAINS = {
    Outcome.COMPLETE: "Nothing that these data could show: what is left is the sensors’ noise.",
    Outcome.EFFECT: "At least one more effect; the search stopped at the number asked for.",
    Outcome.UNDETERMINED: "At least one more effect, of several that these data do not tell apart; "
    "the search stopped at the number asked for.",
    Outcome.UNKNOWN_SHAPE: "An error above the sensors’ noise that no effect of the library "
    "explains beyond chance.",
    Outcome.SENSOR: "A sensor is wrong, not the dynamics.",
}
"""What a diagnosis of the last model means."""


def horizon_rule(horizon: float | None, duration: float) -> str:
    """Return how errors were computed."""
    if horizon is None:
        return (
            f"Free simulation: one run over the whole record ({significant(duration)} s for the "
            "fitted one). Its first tenth estimates the initial state; all of it is scored."
        )
    return (
        f"Windows of {horizon:g} s: in each, the model runs freely from an initial "
        "state that is estimated from the window’s first tenth, which is not scored."
    )


def horizon_name(horizon: float | None) -> str:
    """Return a horizon in a few words."""
    return "free simulation" if horizon is None else f"windows of {horizon:g} s"


def spoken(label: str) -> str:
    """Return `EFFECT@PLACE` as people say it.

    Example:
        >>> spoken("CoulombFriction@wheel")
        'CoulombFriction at wheel'
    """
    return label.replace("@", " at ")


def together(labels: Sequence[str]) -> str:
    """Return several `EFFECT@PLACE`, a common place named once.

    Example:
        >>> together(["CoulombFriction@wheel", "QuadraticDrag@wheel"])
        'CoulombFriction and QuadraticDrag at wheel'
    """
    places = {label.partition("@")[2] for label in labels}
    if len(places) > 1:
        return listed([spoken(label) for label in labels])
    return f"{listed([label.partition('@')[0] for label in labels])} at {places.pop()}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """Return words in a row.

    Example:
        >>> listed(["a", "b", "c"])
        'a, b and c'
    """
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def error_of(problem: Problem, comparison: Comparison) -> str:
    """Return one number for an error: in the unit of the only channel, else as a share."""
    if len(comparison.channels) == 1:
        ((name, channel),) = comparison.channels.items()
        return quantity(channel.rmse, unit_of(problem, name))
    return percent(comparison.nrmse)


def error_measure(problem: Problem, horizon: float | None) -> str:
    """Return what `error_of` measures."""
    where = "in free simulation" if horizon is None else f"over {horizon_name(horizon)}"
    if len(problem.output_names) == 1:
        return f"RMS error of {problem.output_names[0]} {where}"
    return f"RMS error {where}, as a share of the signals’ standard deviations"


def improvement_headline(improvement: Improvement) -> str:
    """Return the answer in one line."""
    name = improvement.steps[0].model.base.short_name
    added = [a.label for a in improvement.added if not a.effect.empirical]
    if added:
        verb = "is" if len(added) == 1 else "are"
        return f"{together(added)} {verb} missing from {name}"
    if improvement.outcome is Outcome.COMPLETE:
        return f"Nothing is missing from {name}"
    return f"Something is missing from {name}, but no known effect explains it"


@dataclass(frozen=True)
class Fall:
    """By how much the error fell: a sentence around two numbers, and what noise alone leaves."""

    record: str
    measure: str
    before: str
    after: str
    floor: str


def improvement_fall(improvement: Improvement, problem: Problem) -> Fall:
    """Return by how much the error fell on the record that counts."""
    first, last = improvement.steps[0], improvement.steps[-1]
    return Fall(
        record=(
            "a record that the fit has not seen"
            if last.holdout is not None
            else "the fitted record (no unseen one was given)"
        ),
        measure=error_measure(problem, improvement.horizon),
        before="" if first is last else error_of(problem, _scored(first)),
        after=error_of(problem, _scored(last)),
        floor=_floor_of(problem, _scored(last)),
    )


def _floor_of(problem: Problem, comparison: Comparison) -> str:
    """Return `error_of` a perfect model; empty where that is unknown or far out of sight."""
    share = floor_share(comparison)
    if not math.isfinite(share) or FAR * share < comparison.nrmse:
        return ""
    if len(comparison.channels) == 1:
        return quantity(
            float(comparison.prediction.floor[0]), unit_of(problem, problem.output_names[0])
        )
    return percent(share)


def floor_share(comparison: Comparison) -> float:
    """Return the overall NRMSE that sensor noise alone would leave; NaN where it is unknown."""
    prediction = comparison.prediction
    moves = prediction.moves
    if not np.any(moves):
        return math.nan
    shares = prediction.floor[moves] / prediction.deviation[moves]
    return float(np.sqrt(np.mean(shares**2)))


def noise_ratio(comparison: Comparison) -> float:
    """Return the largest of the channels' errors over what noise alone would leave there."""
    prediction = comparison.prediction
    ratios = [
        channel.rmse / floor if floor > 0 else math.inf
        for channel, floor in zip(
            comparison.channels.values(), prediction.floor.tolist(), strict=True
        )
    ]
    return max(ratios) if all(math.isfinite(r) for r in ratios) else math.inf


def at_noise(comparison: Comparison) -> bool:
    """Return whether every channel's error is what sensor noise alone would leave, or nearly so."""
    return noise_ratio(comparison) <= AT_NOISE


def remaining(improvement: Improvement) -> str:
    """Return what the last model still lacks, and how far it is from the noise."""
    ratio = noise_ratio(_scored(improvement.steps[-1]))
    curves = [spoken(a.label) for a in improvement.added if a.effect.empirical]
    sentence = _curves_sentence(curves) if curves else REMAINS[improvement.outcome]
    if ratio > FAR:
        return f"{sentence} The error is far above the noise: better sensors would not lower it."
    return (
        f"{sentence} Every channel’s error is at most {significant(ratio)} times what sensor noise "
        "alone would leave."
    )


def _curves_sentence(curves: Sequence[str]) -> str:
    return (
        f"What the shapes of the library’s laws leave over was taken up by {listed(curves)}: a "
        "curve drawn from these data, which describes what acts there and does not explain it."
    )


def certainty(improvement: Improvement) -> list[str]:
    """Return what speaks for and against the added effects."""
    sentences: list[str] = []
    steps = improvement.steps
    for before, step in itertools.pairwise(steps):
        if step.added is None or step.verdict is None:
            continue
        sentence = f"{spoken(step.added.label)}: {typeset_powers(step.verdict.reason)}"
        rival = next(
            (r for r in before.diagnosis.ranking if r.refitted and r.label != step.added.label),
            None,
        )
        mine = next((r for r in before.diagnosis.ranking if r.label == step.added.label), None)
        if rival is not None and mine is not None:
            sentence += (
                f"; evidence {significant(mine.evidence)} nats, against "
                f"{significant(rival.evidence)} for the runner-up, {spoken(rival.label)}"
            )
        sentences.append(sentence + ".")
        sentences += [f"With it {spoken(a.label)} is needless, and went." for a in step.removed]
        sentences += [tied(tie, step.added.label) for tie in before.diagnosis.ties]
    against = [step for step in steps if step.contradicted]
    if against:
        sentences += [contradiction(step) for step in against]
    elif len(steps) > 1 and steps[-1].holdout is not None:
        sentences.append("The unseen record supports every step.")
    if len(steps) == 1:
        sentences += [_nothing_added(steps[0].diagnosis)]
    return sentences


def contradiction(step: Step) -> str:
    """Return what is to be thought of a step that the unseen record contradicts."""
    label = spoken(step.added.label) if step.added is not None else f"step {step.number}"
    return (
        f"The unseen record contradicts {label}: over windows of 1 s its error is larger with it. "
        "Do not rely on it without a further recording."
    )


def _nothing_added(diagnosis: Diagnosis) -> str:
    if not diagnosis.checks:
        return "No candidate promises more than the best of so many would by chance."
    tried = [
        f"{spoken(label)}, {typeset_powers(verdict.reason)}"
        for label, verdict in diagnosis.checks.items()
    ]
    return f"No candidate passed: {'; '.join(tried)}."


def tied(tie: Sequence[str], chosen: str = "") -> str:
    """Return a tie as a sentence."""
    names = [spoken(label) for label in tie if label != chosen]
    if not names:
        return ""
    if chosen in tie:
        return (
            f"These data do not tell {spoken(chosen)} from {listed(names, 'or')}: treat the "
            "choice among them as open."
        )
    return f"These data do not tell {listed(names)} apart."


def diagnosis_headline(diagnosis: Diagnosis, name: str) -> str:
    """Return a diagnosis in one line."""
    match diagnosis.outcome:
        case Outcome.COMPLETE:
            return f"Nothing is missing from {name}"
        case Outcome.SENSOR:
            return f"A sensor is wrong, not the dynamics of {name}"
        case Outcome.UNKNOWN_SHAPE:
            return f"Something is missing from {name}, but no known effect explains it"
        case Outcome.UNDETERMINED:
            names = [spoken(label) for label in (diagnosis.ties[0] if diagnosis.ties else ())]
            return f"{listed(names, 'or') if names else 'An effect'} is missing from {name}"
        case Outcome.EFFECT:
            chosen = diagnosis.chosen
            what = spoken(chosen.addition.label) if chosen is not None else "An effect"
            return f"{what} is missing from {name}"


def fate(row: Ranked, diagnosis: Diagnosis) -> tuple[str, str]:
    """Return what became of a candidate and why: (`added`, `rejected` or `not tried`, reason)."""
    check = diagnosis.checks.get(row.label)
    if check is not None:
        return ("added" if check.accepted else "rejected"), typeset_powers(check.reason)
    if diagnosis.chosen is not None:
        return "not tried", "a better candidate had passed already"
    return "not tried", "it promises no more than the best of so many would by chance"


def white(probability: float) -> str:
    """Return whether residuals look like noise."""
    if math.isnan(probability):
        return "unknown"
    word = "correlated" if probability < CHANCE_OF_WHITE else "like noise"
    return f"{word} ({chance(probability)})"


def fit_warnings(
    values: Sequence[tuple[str, float, float]], held: Sequence[str], condition: float
) -> list[str]:
    """Return what is doubtful about a fit.

    Args:
        values: (name, value, standard deviation) of the fitted parameters.
        held: Names of those that the data do not see.
        condition: Of the scaled Jacobian.
    """
    warnings: list[str] = []
    if held:
        warnings.append(
            f"The data do not see {listed(list(held))}: held at the start value. Record a motion "
            "that depends on it, or give its value with --param."
        )
    loose = [n for n, value, sd in values if math.isfinite(sd) and sd > _POORLY_KNOWN * abs(value)]
    if loose:
        warnings.append(
            f"Poorly known (standard deviation above half the value): {listed(loose)}. More motion "
            "at other speeds and amplitudes would tell."
        )
    if condition > _ILL_CONDITIONED:
        warnings.append(
            f"The condition number is {significant(condition, 2)}: some parameters can hardly be "
            "told apart. Hold one of them with --param, or record a richer motion."
        )
    return warnings


def _scored(step: Step) -> Comparison:
    """Return the comparison that counts: on unseen data if there are any."""
    return step.holdout if step.holdout is not None else step.train
