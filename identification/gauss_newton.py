"""Least squares over windows: parameters common to all, an initial state for each.

The initial states are eliminated window by window (Schur complement), so the cost of a step grows
linearly with the record. Levenberg–Marquardt damping in the parameters; weights per channel are
the larger of the sensor's noise and the present misfit, so that a precise sensor does not drown the
others while the model is still wrong (the concentrated Gaussian likelihood).

Several records are fitted at once by stacking their windows: parameters are common, and each record
keeps its own weights. Gaussian priors join as further rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.linearisation import Booleans, Linearised, Part, eliminate, linearise_all, seen
from identification.priors import NO_PRIORS, Prior
from identification.problem import Matrix, Problem, Vector
from identification.sandwich import covariance_of
from identification.simulator import Simulator
from identification.windows import Window

ITERATIONS = 30
"""Accepted steps of a fit, at most."""

_DIGITS = 1e-12  # of a channel that a misfit may have and still mean something


@dataclass(frozen=True)
class Fit:
    """A converged (or best so far) least-squares fit.

    Attributes:
        values: Every independent parameter.
        free: The fitted ones, in the order of `covariance`.
        held: Of those, the ones that the data do not see, held at their start values.
        x0: (windows, nx), of several records one after the other.
        sd: (ny,) weights used last, likewise.
        at: The linearisation at the solution.
        covariance: (k, k); rows of held parameters are infinite on the diagonal.
        condition_number: Of the scaled, projected Jacobian.
        converged: The last step was below tolerance.
    """

    values: Mapping[str, float]
    free: tuple[str, ...]
    held: frozenset[str]
    x0: Matrix
    sd: Vector
    at: Linearised
    covariance: Matrix
    condition_number: float
    converged: bool

    @property
    def log_likelihood(self) -> float:
        """Gaussian log-likelihood of the residuals at the weights used, white noise assumed."""
        data = self.at.cost - self.at.penalty
        return -0.5 * data - float(self.at.counts @ np.log(self.sd))


def weights(problem: Problem, rms: Vector) -> Vector:
    """Return (ny,) each channel's weight: its sensor's noise, or the misfit where that is larger.

    Never below a double's digits of the channel, so that squares stay finite where nothing moves.
    """
    largest = np.max(np.abs(problem.outputs), axis=0)
    return np.fmax(np.fmax(problem.noise_sd, rms), _DIGITS * np.where(largest > 0, largest, 1.0))


def _weights_of_all(parts: Sequence[Part], rms: Vector) -> Vector:
    """Return the weights of every record's channels, one record after the other."""
    edges = np.cumsum([part.problem.outputs.shape[1] for part in parts])[:-1]
    return np.concatenate(
        [weights(part.problem, own) for part, own in zip(parts, np.split(rms, edges), strict=True)]
    )


@dataclass(frozen=True)
class _Point:
    values: dict[str, float]
    x0: Matrix
    at: Linearised


def fit(
    problem: Problem,
    shooting: Simulator,
    windows: Sequence[Window],
    x0: Matrix,
    values: Mapping[str, float],
    *,
    free: Sequence[str] | None = None,
    fixed_sd: Vector | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = 1e-7,
) -> Fit:
    """Fit parameters and initial states.

    Args:
        problem: The record.
        shooting: Compiled with sensitivities for (at least) the free parameters.
        windows: Over which to fit.
        x0: (windows, nx) initial states to start from.
        values: Every independent parameter, to start from.
        free: Parameters to fit; None for all that `shooting` knows sensitivities of.
        fixed_sd: (ny,) weights; None to derive them from noise and misfit as the fit proceeds.
        iterations: At most this many accepted steps.
        tolerance: Relative decrease of the cost below which it has converged.

    Returns:
        The best point found. If even the start diverges, `at.cost` is infinite.
    """
    return fit_together(
        [Part(problem, shooting, windows)],
        x0,
        values,
        free=free,
        fixed_sd=fixed_sd,
        iterations=iterations,
        tolerance=tolerance,
    )


def fit_together(
    parts: Sequence[Part],
    x0: Matrix,
    values: Mapping[str, float],
    *,
    free: Sequence[str] | None = None,
    fixed_sd: Vector | None = None,
    priors: Mapping[str, Prior] = NO_PRIORS,
    iterations: int = ITERATIONS,
    tolerance: float = 1e-7,
) -> Fit:
    """Fit parameters common to several records, and every window's initial state.

    Args:
        parts: One for each record; of the same model, with the same channels.
        x0: (windows of all records, nx) initial states to start from.
        values: As in `fit`, like the other arguments.
        free: Parameters to fit.
        fixed_sd: (channels of all records,) weights.
        priors: What is known of parameters beforehand.
        iterations: At most this many accepted steps.
        tolerance: Relative decrease of the cost below which it has converged.
    """
    names = parts[0].shooting.sensitive
    chosen = np.array([name in (free if free is not None else names) for name in names], bool)
    low, high = _bounds(parts[0].problem, names)
    spread = np.concatenate([np.std(part.problem.outputs, axis=0) for part in parts])
    sd = fixed_sd if fixed_sd is not None else _weights_of_all(parts, spread)
    point = _Point(dict(values), x0, linearise_all(parts, x0, values, sd, priors))
    if not np.isfinite(point.at.cost):
        return _finish(names, chosen, point, sd, converged=False)
    converged, damping = False, 1e-4
    for _ in range(iterations):
        if fixed_sd is None:
            new_sd = _weights_of_all(parts, point.at.rms)
            if np.any(np.abs(new_sd - sd) > 1e-3 * sd):
                sd = new_sd
                at = linearise_all(parts, point.x0, point.values, sd, priors)
                point = _Point(point.values, point.x0, at)
        step = _step(parts, priors, chosen, point, sd, damping, low, high)
        if step is None:
            converged = True
            break
        new, damping = step
        drop = (point.at.cost - new.at.cost) / max(point.at.cost, 1e-300)
        moved_sd = fixed_sd is None and bool(
            np.any(np.abs(_weights_of_all(parts, new.at.rms) - sd) > 1e-3 * sd)
        )
        point = new
        if drop < tolerance and not moved_sd:
            converged = True
            break
    return _finish(names, chosen, point, sd, converged=converged)


def _bounds(problem: Problem, names: Sequence[str]) -> tuple[Vector, Vector]:
    dae = problem.dae
    low = [dae.number(dae.variables[name].minimum, -np.inf) for name in names]
    high = [dae.number(dae.variables[name].maximum, np.inf) for name in names]
    return np.array(low, float), np.array(high, float)


def _step(
    parts: Sequence[Part],
    priors: Mapping[str, Prior],
    chosen: Booleans,
    point: _Point,
    sd: Vector,
    damping: float,
    low: Vector,
    high: Vector,
) -> tuple[_Point, float] | None:
    """Take one damped step that lowers the cost; None if there is none."""
    names, nx = parts[0].shooting.sensitive, parts[0].shooting.nx
    theta = np.array([point.values[name] for name in names])
    active = chosen & seen(point.at)
    for _ in range(14):
        # Damping holds back the initial states too: friction at rest is as nonlinear in them.
        normal, gradient = np.diag(point.at.precision), point.at.pull.copy()
        back: list[tuple[Matrix, Vector]] = []
        for gram, score in point.at.grams:
            weight, shift = eliminate(gram, score, nx, damping)
            normal += gram[nx:, nx:] - gram[nx:, :nx] @ weight
            gradient += score[nx:] - gram[nx:, :nx] @ shift
            back.append((weight, shift))
        # At a bound, only moves back inside are free.
        inside = ~((theta <= low) & (gradient < 0)) & ~((theta >= high) & (gradient > 0))
        index = np.flatnonzero(active & inside)
        delta = np.zeros(len(names))
        if len(index):
            block = normal[np.ix_(index, index)]
            scale = np.sqrt(np.diag(block))
            damped = block / np.outer(scale, scale) + damping * np.eye(len(index))
            delta[index] = np.linalg.lstsq(damped, gradient[index] / scale, rcond=1e-13)[0] / scale
        new_theta = np.clip(theta + delta, low, high)
        delta = new_theta - theta
        new_x0 = np.array([x + w0 - w @ delta for x, (w, w0) in zip(point.x0, back, strict=True)])
        new_values = {**point.values, **dict(zip(names, new_theta.tolist(), strict=True))}
        at = linearise_all(parts, new_x0, new_values, sd, priors)
        if at.cost < point.at.cost:
            return _Point(new_values, new_x0, at), max(damping / 10, 1e-12)
        damping = max(damping * 10, 1e-9)
    return None


def _finish(
    names: Sequence[str],
    chosen: Booleans,
    point: _Point,
    sd: Vector,
    *,
    converged: bool,
) -> Fit:
    free = tuple(name for name, c in zip(names, chosen, strict=True) if c)
    index = np.flatnonzero(chosen)
    covariance = np.full((len(free), len(free)), np.nan)
    condition = np.inf
    held: frozenset[str] = frozenset(free)
    if np.isfinite(point.at.cost) and len(index):
        visible = seen(point.at)[index]
        held = frozenset(name for name, v in zip(free, visible, strict=True) if not v)
        keep = index[visible]
        if len(keep):
            block, condition = covariance_of(point.at, keep)
            where = np.flatnonzero(visible)
            covariance[np.ix_(where, where)] = block
        np.fill_diagonal(covariance, np.where(visible, np.diag(covariance), np.inf))
    return Fit(
        point.values, free, held, point.x0, sd, point.at, covariance, float(condition), converged
    )
