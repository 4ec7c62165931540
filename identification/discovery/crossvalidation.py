"""Blocked cross-validation inside the fitted record: does a term predict what it has not seen?

The record is cut into short windows, dealt into contiguous blocks. Each block in turn is left out,
both models are fitted to the rest, and both simulate the left-out windows with the parameters so
found; the initial state of a window is its own in either model. The comparison is paired window by
window.

Short windows, because a wrong force shows as an acceleration before it shows as a drift, and there
are more of them: on the EMPS record the paired t of Coulomb friction is 7.4 with windows of 0.25 s
and 3.3 with windows of 1 s; a spring that is not there stays below 1 in both. A small steady force
removes little in so short a window, however surely: its share is looked at over 1 s as well. A
small friction may even show nothing in 0.25 s, where its initial state takes that up, and 23 nats
over 1 s. That is asked too, as a second try, but only for the first effect (beside a law of nearly
the right shape, a second one would be let in for the rest) and for a curve without a name (which is
there for that rest), and where nothing slow is left over: beside a slow disturbance, ten windows of
1 s would let in a spring that is not there. A second try has to convince more: on a robot that
lacks nothing, 10.5 unseen nats spoke for a cubic spring.

Two tests, either suffices. The paired t-test over windows holds whatever the residuals are like. An
effect that acts only now and then (friction near standstill) gains much in few windows, which that
test takes for outliers; there the likelihood of the unseen windows decides, counted in independent
samples. A ratio of likelihoods of unseen data exceeds c with a probability of at most 1/c; with
variances estimated from the same windows this holds approximately.

An FMU of which no state can be set cannot begin a window. It runs through the whole record instead,
and the samples of a block are left out of what is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from identification.discovery.evidence import Refit, chance_of_nothing
from identification.experiment import Experiment
from identification.gauss_newton import Fit, fit_together
from identification.linearisation import Part
from identification.prediction import WINDOW
from identification.problem import Matrix, Vector
from identification.windows import Window, cut, fitting_length

FOLDS = 5
CV_WINDOW = 0.25 * WINDOW
LARGEST_CHANCE = 0.01
_LARGEST_SECOND_CHANCE = 1e-4
_LARGEST_CHANCE_OF_NOTHING = 1e-3
NO_DOUBT = 1e-8
# An effect that removes less than this share of what a model missed may stand for another one.
MOST_REMOVED = 0.5
_SMALLEST_SHARE = 0.05
_FEWEST_WINDOWS = 10
# What is left over is white with this share of its samples independent.
_WHITE = 0.2
_BLOCKS = 20  # of a record that is run through as a whole
# No block may speak against an effect by more than this [nats], or this share of what all say.
_AGAINST = 1.0
_SHARE_AGAINST = 0.1


@dataclass(frozen=True)
class Verdict:
    """The outcome of a comparison.

    Attributes:
        accepted: The larger model predicts unseen windows better than chance allows, and by enough.
        chance: That useless candidates do as well: the smaller of the paired test's p-value and the
            inverse ratio of likelihoods, corrected for the candidates tried.
        removed: Share of the squared error above the noise that it removes on unseen windows.
        before, after: (channels of all records,) root-mean-square error on unseen windows.
        reason: One sentence.
    """

    accepted: bool
    chance: float
    removed: float
    before: Vector
    after: Vector
    reason: str


def crossvalidate(
    smaller: Experiment,
    base: Fit,
    larger: Experiment,
    extended: Fit,
    noise: Vector,
    *,
    independent: Vector | None = None,
    evidence: float = np.inf,
    tried: int = 1,
    patient: bool = False,
) -> Verdict:
    """Compare a model with its extension on windows that neither fit has seen.

    Args:
        smaller, base: The model and its fit to the whole record, the start of every fold's fit.
        larger, extended: The extension likewise.
        noise: (channels of all records,) standard deviation of the sensors' noise.
        independent: (channels of all records,) independent samples in what the extension leaves
            over; None: ask the paired test only.
        evidence: What the extension gains on the whole record [nats]. Unseen windows cannot say
            more: on a robot that lacks nothing, one of ten that was not fitted spoke for a lag by
            6798 nats, where the record knew of 13.
        tried: How many candidates were tried, for the correction (Bonferroni).
        patient: Ask over the windows of the fit as well, where short ones say no.
    """
    count = sum(len(_windows(record, CV_WINDOW)) for record in smaller.records)
    if count < _FEWEST_WINDOWS:
        nothing = np.full(len(noise), np.nan)
        needed = _FEWEST_WINDOWS * fitting_length(CV_WINDOW, smaller.problem.sample_time)
        reason = f"the record is too short to leave blocks out: record {needed:g} s"
        return Verdict(False, 1.0, 0.0, nothing, nothing, reason)

    def judge(length: float, tries: int) -> Verdict:
        # Each with the weights of its own fit: a channel of which the smaller model makes nothing
        # (a sensor's scale) would tell the larger one nothing of where a window begins.
        before = _unseen(smaller, base, length)
        after = _unseen(larger, extended, length)
        # A window that a model cannot simulate counts as a very wrong one, not as a missing one.
        before, after = (np.where(np.isinf(e), 1e6 * base.sd**2, e) for e in (before, after))
        nats = -np.inf
        if independent is not None:
            nats = min(_unseen_nats(before, after, independent), evidence)
        return _judge(before, after, noise, tries, nats)

    tries = max(tried, 1)
    verdict = judge(CV_WINDOW, tries)
    is_small = verdict.chance <= LARGEST_CHANCE and 0 < verdict.removed < _SMALLEST_SHARE
    may_be_small = patient and not verdict.accepted and is_white(independent, smaller)
    if not (is_small or may_be_small):
        return verdict
    longer = judge(smaller.window, tries if is_small else 2 * tries)
    accepted = longer.accepted and (is_small or longer.chance <= _LARGEST_SECOND_CHANCE)
    return longer if accepted else verdict


def is_white(independent: Vector | None, experiment: Experiment) -> bool:
    """Whether what is left over is the sensors' noise, and nothing slow.

    Args:
        independent: (channels of all records,) independent samples in it; None: nobody knows.
        experiment: Whose records they are.
    """
    if independent is None:
        return False
    ny = len(experiment.problem.output_names)
    samples = np.repeat([len(problem.time) for problem in experiment.problems], ny)
    return bool(np.all(independent >= _WHITE * samples))


def crossvalidate_candidate(
    experiment: Experiment, base: Fit, candidate: Refit, *, tried: int
) -> Verdict:
    """Compare a model with the one that has a candidate too (see `crossvalidate`).

    Its parameters must also be told from nothing by their covariance: beside a slow disturbance,
    forty short windows preferred a spring of -0.0009 ± 0.0009 N.m/rad at p = 2e-5. Where nothing
    slow is left, most of what was missing is explained and unseen windows leave no doubt, that is
    not asked: height and width of a friction near standstill go together, and 4.0 ± 1.2 N.m gained
    535 nats. (A slow disturbance below a robot's noise gave a quarter to an imbalance, p = 1e-21.)

    Args:
        experiment, base: The model and its fit.
        candidate: Refitted beside it.
        tried: How many candidates were tried.
    """
    verdict = crossvalidate(
        experiment,
        base,
        candidate.experiment,
        candidate.fit,
        experiment.noise(),
        independent=candidate.independent,
        evidence=candidate.evidence,
        tried=tried,
        patient=len(candidate.model.additions) == 1 or candidate.addition.effect.empirical,
    )
    chance = min(1.0, tried * chance_of_nothing(candidate))
    no_doubt = (
        verdict.chance <= NO_DOUBT
        and verdict.removed >= MOST_REMOVED
        and is_white(candidate.independent, experiment)
    )
    if not verdict.accepted or chance <= _LARGEST_CHANCE_OF_NOTHING or no_doubt:
        return verdict
    reason = f"its parameters are not told from nothing ({_in_words(chance)})"
    return replace(verdict, accepted=False, reason=reason)


def _windows(record: Experiment, length: float) -> tuple[Window, ...]:
    """Return what errors are compared over: windows, or blocks of a record run as a whole.

    What such a record leaves over has a memory as long as the plant's: its blocks are longer.
    """
    if record.shooting.begins_anywhere:
        return record.cut(length)
    n, h = len(record.problem.time), record.problem.sample_time
    return cut(n, h, max(fitting_length(length, h), n * h / _BLOCKS))


def _unseen(experiment: Experiment, whole: Fit, length: float) -> Matrix:
    """Return mean squared errors of windows, each with parameters from elsewhere.

    Returns:
        (windows of all records, channels of all records); NaN in the channels of other records,
        infinite where a window cannot be simulated.
    """
    if experiment.shooting.begins_anywhere:
        return _unseen_windows(experiment, whole, length)
    return _unseen_blocks(experiment, whole, length)


def _unseen_blocks(experiment: Experiment, whole: Fit, length: float) -> Matrix:
    """As `_unseen`, of records that are run through as a whole."""
    ny = len(experiment.problem.output_names)
    blocks = [(k, w) for k, e in enumerate(experiment.records) for w in _windows(e, length)]
    errors = np.full((len(blocks), len(whole.sd)), np.nan)
    for fold in folds_of(len(blocks)):
        parts: list[Part] = []
        for k, part in enumerate(experiment.parts(length)):
            counted = np.ones(len(part.problem.time), dtype=bool)
            for record, window in (blocks[i] for i in fold):
                if record == k:
                    counted[window.begin : window.end] = False
            parts.append(replace(part, counted=counted))
        fitted = _fit(parts, whole, whole.x0, whole.sd, free=whole.free)
        for i in fold:
            record, window = blocks[i]
            # None where a record could not be simulated.
            left = fitted.at.residuals
            seen = left[record][window.begin : window.end] if left else np.full((1, ny), np.inf)
            errors[i, record * ny : (record + 1) * ny] = np.mean(np.square(seen), axis=0)
    return errors


def _unseen_windows(experiment: Experiment, whole: Fit, length: float) -> Matrix:
    """As `_unseen`, of windows that each begin in a state of their own."""
    sd = whole.sd
    parts = experiment.parts(length)
    owner = np.repeat(np.arange(len(parts)), [len(part.windows) for part in parts])
    count, ny = len(owner), len(experiment.problem.output_names)
    errors = np.full((count, len(sd)), np.nan)
    for window, record in enumerate(owner):
        errors[window, record * ny : (record + 1) * ny] = np.inf
    # Initial states of all windows at the parameters of the whole record: a start, nothing more.
    if length == experiment.window and len(whole.x0) == count:
        start = whole.x0
    else:
        guesses = [e.guess(p.windows) for e, p in zip(experiment.records, parts, strict=True)]
        start = _fit(parts, whole, np.concatenate(guesses), sd, free=()).x0
    for fold in folds_of(count):
        rest = np.setdiff1d(np.arange(count), fold)
        fitted = _fit(_pick(parts, rest), whole, start[rest], sd, free=whole.free)
        seen = _fit(_pick(parts, fold), fitted, start[fold], sd, free=())
        for window, residual in zip(fold, seen.at.residuals, strict=False):
            # A window's own initial state takes a part of the noise up, in the larger model more.
            # (A sensor's filter has no start of its own.)
            free = experiment.shooting.nx - len(experiment.problem.following)
            left = residual.size - free
            mine = slice(owner[window] * ny, (owner[window] + 1) * ny)
            errors[window, mine] = np.mean(residual**2, axis=0) * residual.size / max(left, 1)
    return errors


def folds_of(count: int) -> list[NDArray[np.intp]]:
    """Deal windows out to the folds, blocks of four in turn.

    A fold in one piece may hold all of a record's fast driving; then what acts there is fitted to
    nothing and extrapolated.
    """
    block = max(1, min(4, count // FOLDS))
    turn = np.arange(count) // block % FOLDS
    return [np.flatnonzero(turn == k) for k in range(FOLDS)]


def _pick(parts: Sequence[Part], index: NDArray[np.intp]) -> list[Part]:
    """Keep some windows, numbered through all records in rising order."""
    kept: list[Part] = []
    first = 0
    for part in parts:
        mine = index[(index >= first) & (index < first + len(part.windows))] - first
        kept.append(replace(part, windows=[part.windows[i] for i in mine]))
        first += len(part.windows)
    return kept


def _fit(parts: Sequence[Part], start: Fit, x0: Matrix, sd: Vector, *, free: Sequence[str]) -> Fit:
    return fit_together(parts, x0, start.values, free=free, fixed_sd=sd, iterations=20)


def _in_words(chance: float) -> str:
    # Further out, the distribution's tail is the approximation's, not the data's.
    return "p < 1e-15" if chance < 1e-15 else f"p = {chance:.1g}"


def _above_zero(squares: Vector) -> Vector:
    """Without noise a right model leaves nothing, whose logarithm means nothing."""
    return np.fmax(squares, 1e-300)


def _unseen_nats(before: Matrix, after: Matrix, independent: Vector) -> float:
    """Return ΔlogL of the unseen windows; minus infinity if a block speaks against the effect."""
    nats: list[float] = []
    for fold in folds_of(len(before)):
        here = ~np.isnan(before[fold])
        # A block may hold no window of a short record.
        share = np.sum(here, axis=0) / np.sum(~np.isnan(before), axis=0)
        was, left = (_above_zero(np.nansum(e[fold], axis=0)) for e in (before, after))
        nats.append(0.5 * float(np.sum(independent * share * np.log(was / left))))
    total = sum(nats)
    return -np.inf if min(nats) < -max(_AGAINST, _SHARE_AGAINST * total) else total


def _judge(before: Matrix, after: Matrix, noise: Vector, tried: int, nats: float) -> Verdict:
    mean_before, mean_after = np.nanmean(before, axis=0), np.nanmean(after, axis=0)
    # Each channel in units of its present error, so that all count alike.
    unit = _above_zero(mean_before)
    difference = np.nansum((before - after) / unit, axis=1)
    spread = float(np.std(difference, ddof=1)) / np.sqrt(len(difference))
    gained = float(np.mean(difference))
    t = gained / max(spread, 1e-300)
    chance = float(stats.t.sf(t, len(difference) - 1))
    chance = min(1.0, tried * chance, tried * float(np.exp(-nats)))
    # What was above the noise is what was gained and what is left. (Each window's initial state
    # takes a part of the noise up, so an error may also lie below it.)
    share = np.mean(~np.isnan(before), axis=0)
    above_noise = gained + float(np.sum(share * np.fmax(mean_after - noise**2, 0.0) / unit))
    removed = gained / above_noise if above_noise > 0 else 0.0
    if gained <= 0 or chance > LARGEST_CHANCE:
        accepted, reason = False, f"on unseen windows its gain may be chance (p = {chance:.2g})"
    elif removed < _SMALLEST_SHARE:
        accepted = False
        reason = f"it removes only {100 * removed:.1f} % of the squared error above the noise"
    else:
        accepted = True
        reason = (
            f"it removes {100 * removed:.0f} % of the squared error above the noise on "
            f"unseen windows ({_in_words(chance)})"
        )
    return Verdict(accepted, chance, removed, np.sqrt(mean_before), np.sqrt(mean_after), reason)
