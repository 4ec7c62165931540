"""How much a refitted candidate explains, corrected for residuals that have memory."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import stats

from foundation.errors import DivergenceError, TwinproofError, UnsupportedModelError
from foundation.progress import Progress, counted, silent
from identification.discovery.extension import Addition, ExtendedModel, extend
from identification.discovery.scan import SHAPES, Scored
from identification.discovery.starts import starts
from identification.discovery.transfer import transfer_all_states, transfer_problems
from identification.experiment import Experiment
from identification.gauss_newton import ITERATIONS, Fit
from identification.problem import Matrix, Vector

_WORKERS = 2
_ROUNDING = 1e-9
CHANCE_GAIN = 3.0
"""What a useless candidate gains by chance, at most [nats]."""
# Of several starts, the best after so many steps goes on.
_FIRST_STEPS = 4
# A shape that ended at its bound, or whose standard deviation is larger than itself, was not found
# in the record: such a candidate has stretched into another one (a Stribeck curve as wide as the
# whole speed range is dry friction; one that fades within 781 s ± 1200 is viscous), and stands back
# behind any candidate with at least this share of its merit.
_UNFOUND_SHAPE = 0.8
# One of so many standard deviations is told.
_TOLD = 3.0


@dataclass(frozen=True)
class Refit:
    """A candidate let into the model and everything refitted.

    Attributes:
        addition: Effect and place, with its fitted parameters.
        model: The extended model.
        experiment: That model on the record.
        fit: Its fit.
        evidence: ΔlogL against the model without it [nats], for as many independent samples as the
            residuals' memory leaves.
        explains: Share of the squared residual that it removes, 0 to 1.
        merit: What candidates are ranked by: the evidence less half the logarithm of the number of
            independent samples for each fitted parameter (Bayesian information criterion).
        at_bound: Shape parameters that ended at a bound of their declared range.
        gain: (channels of all records,) logarithm of the fall of each channel's error.
        independent: (channels of all records,) independent samples in what it leaves over.
    """

    addition: Addition
    model: ExtendedModel
    experiment: Experiment
    fit: Fit
    evidence: float
    explains: float
    merit: float
    at_bound: tuple[str, ...]
    gain: Vector
    independent: Vector


def refit_all(
    model: ExtendedModel,
    experiment: Experiment,
    base: Fit,
    shortlist: Sequence[Scored],
    *,
    progress: Progress = silent,
) -> tuple[tuple[Refit, ...], dict[str, str]]:
    """Refit each candidate of a shortlist.

    Returns:
        The refits by falling merit, and the candidates that failed with the reason.
    """
    one = partial(_refit_or_reason, model, experiment, base)
    with ThreadPoolExecutor(_WORKERS) as pool:
        refitted = pool.map(one, shortlist)
        results = list(counted(progress, "refitting the best candidates", refitted, len(shortlist)))
    good = [r for r in results if isinstance(r, Refit)]
    failed = {
        s.addition.label: r for s, r in zip(shortlist, results, strict=True) if isinstance(r, str)
    }
    return tuple(sorted(_by_one_measure(good), key=lambda r: -r.merit)), failed


def _by_one_measure(refits: Sequence[Refit]) -> list[Refit]:
    """Count every candidate's evidence with the same number of independent samples.

    That of the candidate which explains most: the less it leaves over, the whiter that is. With a
    number of its own, a candidate that leaves memory behind would rank by that memory rather than
    by what it explains.
    """
    if not refits:
        return []
    reference = max(refits, key=lambda r: float(np.sum(r.gain))).independent
    return [_measured(r, reference) for r in refits]


def _measured(refit: Refit, independent: Vector) -> Refit:
    evidence = float(np.sum(independent * refit.gain))
    merit = evidence - price([refit.addition], refit.experiment, refit.fit, independent)
    if refit.at_bound or _has_untold_shape(refit):
        merit *= _UNFOUND_SHAPE
    return replace(refit, evidence=evidence, merit=merit)


def _has_untold_shape(refit: Refit) -> bool:
    shapes = refit.addition.effect.shape_parameters
    names = [refit.model.parameter_of(refit.addition, p) for p in shapes]
    fitted = [n for n in names if n in refit.fit.free and n not in refit.fit.held]
    return any(not _deviations(refit.fit, n) >= 1 for n in fitted)


def _deviations(fit: Fit, name: str) -> float:
    """Return how many of its standard deviations a fitted parameter is; 0 if it was not fitted."""
    if name in fit.held or name not in fit.free:
        return 0.0
    k = fit.free.index(name)
    return abs(fit.values[name]) / max(float(np.sqrt(fit.covariance[k, k])), 1e-300)


def price(
    additions: Sequence[Addition], experiment: Experiment, fit: Fit, independent: Vector
) -> float:
    """Return what the freedom of effects costs [nats] (Bayesian information criterion).

    Args:
        additions: The effects.
        experiment, fit: A model with these effects, and its fit.
        independent: (channels of all records,) independent samples.
    """
    ny = len(experiment.problem.output_names)
    samples = float(np.max(np.sum(independent.reshape(-1, ny), axis=0)))
    # A state of its own is free at the start of every window, but for a sensor's, which follows: as
    # many numbers more, each with the samples of its window.
    windows = len(fit.x0)
    parameters = sum(len(a.values) for a in additions)
    states = sum(a.effect.states for a in additions if a.place.kind != "output")
    each = float(np.log(max(samples / windows, 1.0)))
    return 0.5 * (parameters * float(np.log(samples)) + states * windows * each)


def _refit_or_reason(
    model: ExtendedModel, experiment: Experiment, base: Fit, scored: Scored
) -> Refit | str:
    try:
        return refit(model, experiment, base, scored)
    except TwinproofError as error:
        # One candidate's failure says nothing about the others.
        return str(error)


def refit(model: ExtendedModel, experiment: Experiment, base: Fit, scored: Scored) -> Refit:
    """Let one candidate in and refit all parameters, from the score test's prediction.

    Raises:
        UnsupportedModelError: The extended model cannot be simulated with sensitivities.
        DivergenceError: It cannot be fitted from any start.
    """
    addition, begin = scored.addition, scored.start or base
    bigger = extend(model.base, [*model.additions, addition], values=model.values)
    mains = {bigger.parameter_of(addition, p) for p in addition.effect.main_parameters}
    problems = transfer_problems(experiment, bigger, begin.values, model)
    larger = Experiment.together(problems).lasting(experiment.window)
    x0 = transfer_all_states(larger, bigger, experiment, model, begin.x0)
    tried = starts(larger, bigger, scored, x0)
    if not tried:
        raise UnsupportedModelError(f"{addition.label} would do nothing anywhere in this record")
    start = tried[0]
    if len(tried) > 1:
        first = [_fit_from(larger, x0, s, iterations=_FIRST_STEPS) for s in tried]
        start = tried[int(np.argmax([float(np.sum(log_gain(base, f)[0])) for f in first]))]
    best = _fit_from(larger, x0, start)
    if float(np.sum(log_gain(base, best)[0])) < 0:
        # The predicted step overshot (an absent effect would have done better): come from nearer.
        nearer = {k: 0.1 * v if k in mains else v for k, v in start.items()}
        best = _fit_from(larger, x0, nearer)
    if not best.converged:
        # Far from where the smaller model was, long windows of an unstable machine lead nowhere.
        best = max(
            best, _by_stages(larger, start), key=lambda f: float(np.sum(log_gain(base, f)[0]))
        )
    effect = addition.effect
    fitted = {
        p: best.values[bigger.parameter_of(addition, p)]
        for p in (*effect.main_parameters, *effect.shape_parameters)
    }
    at_bound = tuple(
        p for p in effect.shape_parameters if _at_bound(bigger, addition, p, fitted[p])
    )
    if not np.isfinite(best.at.cost):
        raise DivergenceError(f"{bigger.name} leaves the finite numbers from every start")
    gain, explains = log_gain(base, best)
    independent = independent_of_all(larger, best)
    found = Refit(
        addition=replace(addition, values={**addition.values, **fitted}),
        model=bigger,
        experiment=larger,
        fit=best,
        evidence=0.0,
        explains=explains,
        merit=0.0,
        at_bound=at_bound,
        gain=gain,
        independent=independent,
    )
    return _measured(found, independent)


def _at_bound(model: ExtendedModel, addition: Addition, parameter: str, value: float) -> bool:
    variable = model.dae.variables[model.parameter_of(addition, parameter)]
    low = model.dae.number(variable.minimum, -np.inf)
    high = model.dae.number(variable.maximum, np.inf)
    return not low + 1e-6 * abs(low) < value < high - 1e-6 * abs(high)


def _fit_from(
    larger: Experiment, x0: Matrix, start: dict[str, float], *, iterations: int = ITERATIONS
) -> Fit:
    return larger.fit(x0, {**larger.problem.values, **start}, iterations=iterations)


def _by_stages(larger: Experiment, start: dict[str, float]) -> Fit:
    return larger.fit_stages({**larger.problem.values, **start})[-1]


def log_gain(base: Fit, better: Fit) -> tuple[Vector, float]:
    """Return (ny,) the logarithm of each channel's fall of error, and the squared share removed.

    The gain times the number of independent samples is a difference of log-likelihoods [nats].
    """
    if not (np.isfinite(better.at.cost) and np.isfinite(base.at.cost)):
        return np.full(len(base.sd), -np.inf), 0.0
    # Without noise the misfit of the true model is rounding, whose logarithm means nothing.
    smallest = _ROUNDING * base.sd
    before = np.log(np.fmax(base.at.rms, smallest))
    after = np.log(np.fmax(better.at.rms, smallest))
    # Weighted as in the base fit, where every channel's misfit has unit size.
    removed = 1.0 - float(np.mean(np.exp(2 * (after - before))))
    return before - after, removed


def chance_of_nothing(candidate: Refit) -> float:
    """Return the chance of parameters as large as a candidate's, were it absent (Wald's test).

    Beside residuals with a memory it is honest, as the covariance is: scores are summed over
    blocks. Of a curve without a name nothing is asked: where the record hardly goes, its bumps are
    what their prior says.

    A shape that the record tells is held where it was found. Height and width of a friction near
    standstill go together: of 4.1 N.m ± 1.7, at a width of 0.34 rad/s ± 0.08, nothing is left to
    chance at that width. That the width was looked for is paid for by counting each one that was
    tried. (At a width of 0.1 rad/s ± 0.098, on a robot that lacks nothing, there was one, too.)
    """
    effect, fit = candidate.addition.effect, candidate.fit
    mains, shapes = (
        [candidate.model.parameter_of(candidate.addition, p) for p in names]
        for names in (effect.main_parameters, effect.shape_parameters)
    )
    if effect.empirical or any(name in fit.held or name not in fit.free for name in mains):
        return 0.0
    index = [fit.free.index(name) for name in mains]
    told = [fit.free.index(n) for n in shapes if _deviations(fit, n) >= _TOLD]
    cross = fit.covariance[np.ix_(index, told)]
    own = np.linalg.pinv(fit.covariance[np.ix_(told, told)], hermitian=True)
    covariance = fit.covariance[np.ix_(index, index)] - cross @ own @ cross.T
    scale = np.sqrt(np.diag(covariance))
    score = np.array([fit.values[name] for name in mains]) / scale
    correlation = covariance / np.outer(scale, scale)
    statistic = float(score @ np.linalg.pinv(correlation, hermitian=True) @ score)
    tried = SHAPES if told else 1
    return min(1.0, tried * float(stats.chi2.sf(statistic, len(mains))))


def independent_of_all(experiment: Experiment, fit: Fit) -> Vector:
    """Return (channels of all records,) how many independent samples a fit's residuals are."""
    found: list[Vector] = []
    first = 0
    for record in experiment.records:
        count = len(record.windows)
        found.append(independent_samples(fit.at.residuals[first : first + count]))
        first += count
    return np.concatenate(found)


def independent_samples(residuals: Sequence[Matrix]) -> Vector:
    """Return (ny,) how many independent samples residuals are worth.

    n / τ with the integrated autocorrelation time τ = 1 + 2 Σ ρ_k, summed until the correlation
    first vanishes (Sokal's initial positive sequence).
    """
    ny = residuals[0].shape[1]
    n = sum(len(r) for r in residuals)
    worth = np.zeros(ny)
    for c in range(ny):
        length = max(len(r) for r in residuals)
        covariance = np.zeros(length)
        for r in residuals:
            size = 1 << (2 * len(r) - 1).bit_length()
            spectrum = np.abs(np.fft.rfft(r[:, c], size)) ** 2
            covariance[: len(r)] += np.fft.irfft(spectrum, size)[: len(r)]
        rho = covariance / max(covariance[0], 1e-300)
        negative = np.flatnonzero(rho <= 0)
        stop = int(negative[0]) if len(negative) else length
        worth[c] = n / max(1.0, 1.0 + 2.0 * float(np.sum(rho[1:stop])))
    return worth
