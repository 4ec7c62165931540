"""Blocked cross-validation inside the fitted record: is a term worth having on data it has not seen?

The record's windows are dealt into contiguous blocks. Each block in turn is left out, both models
are fitted to the rest, and both predict the left-out windows. The comparison is paired window by
window, on the logarithm of the error, so that a few wild windows do not decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from identification.discovery.evidence import carry_states
from identification.experiment import Experiment
from identification.gauss_newton import Fit, fit
from identification.prediction import WINDOW
from identification.problem import Matrix, Vector

FOLDS = 5
_LARGEST_CHANCE = 0.01
_SMALLEST_SHARE = 0.05


@dataclass(frozen=True)
class Verdict:
    """The outcome of a comparison.

    Attributes:
        accepted: The larger model predicts unseen windows better than chance allows, and by enough.
        chance: One-sided p-value of the paired test, corrected for the candidates tried.
        removed: Share of the error above the noise floor that it removes on unseen windows.
        before, after: (ny,) root-mean-square error on unseen windows.
        reason: One sentence.
    """

    accepted: bool
    chance: float
    removed: float
    before: Vector
    after: Vector
    reason: str


def crossvalidate(
    smaller: Experiment, base: Fit, larger: Experiment, extended: Fit, floor: Vector, *,
    tried: int = 1,
) -> Verdict:
    """Compare a model with its extension on windows that neither fit has seen.

    Args:
        smaller, base: The model and its fit to the whole record, the start of every fold's fit.
        larger, extended: The extension likewise.
        floor: (ny,) error of a perfect model.
        tried: How many candidates were tried, for the correction (Bonferroni).
    """
    count = len(smaller.windows)
    folds = [f for f in np.array_split(np.arange(count), min(FOLDS, count)) if len(f)]
    if len(folds) < 2:
        nothing = np.full(len(floor), np.nan)
        return Verdict(False, 1.0, 0.0, nothing, nothing, "too short a record to leave blocks out")
    x0_small, x0_large = base.x0, extended.x0
    if len(x0_large) != len(x0_small):
        x0_large = carry_states(larger, smaller, x0_small)
    before, after = np.zeros((count, len(floor))), np.zeros((count, len(floor)))
    for fold in folds:
        rest = np.setdiff1d(np.arange(count), fold)
        before[fold] = _unseen(smaller, base, x0_small, rest, fold)
        after[fold] = _unseen(larger, extended, x0_large, rest, fold)
    return _judge(before, after, floor, tried)


def _unseen(
    experiment: Experiment, whole: Fit, x0: Matrix, rest: np.ndarray, fold: np.ndarray
) -> Matrix:
    """Return (windows, ny) mean squared errors of a fold's windows after fitting the rest."""
    windows = experiment.windows
    found = fit(
        experiment.problem, experiment.shooting, [windows[i] for i in rest], x0[rest],
        whole.values, free=whole.free, fixed_sd=whole.sd, iterations=8,
    )
    prediction = experiment.predict(
        found.values, WINDOW, windows=[windows[i] for i in fold], sd=whole.sd
    )
    errors = prediction.window_errors()
    return np.where(np.isfinite(errors), errors, 1e12 * whole.sd**2)


def _judge(before: Matrix, after: Matrix, floor: Vector, tried: int) -> Verdict:
    rms_before, rms_after = np.sqrt(np.mean(before, axis=0)), np.sqrt(np.mean(after, axis=0))
    # Channels count alike, each by the logarithm of its error.
    difference = np.mean(0.5 * np.log(before / after), axis=1)
    mean, spread = float(np.mean(difference)), float(np.std(difference, ddof=1))
    t = mean / max(spread / np.sqrt(len(difference)), 1e-300)
    chance = min(1.0, float(stats.t.sf(t, len(difference) - 1)) * tried)
    scale = np.fmax(np.mean(before, axis=0), 1e-300)
    # What is left above the floor, in units of the present error.
    excess = np.sum(np.fmax(np.mean(before, axis=0) - floor**2, 0.0) / scale)
    gained = np.sum((np.mean(before, axis=0) - np.mean(after, axis=0)) / scale)
    removed = float(gained / excess) if excess > 1e-3 * len(floor) else 0.0
    if mean <= 0 or chance > _LARGEST_CHANCE:
        reason = f"on unseen windows the gain may be chance (p = {chance:.2g})"
    elif removed < _SMALLEST_SHARE:
        reason = f"it removes only {100 * max(removed, 0):.1f} % of the error above the noise"
    else:
        reason = f"it removes {100 * removed:.0f} % of the error above the noise on unseen windows"
    accepted = mean > 0 and chance <= _LARGEST_CHANCE and removed >= _SMALLEST_SHARE
    return Verdict(accepted, chance, removed, rms_before, rms_after, reason)
