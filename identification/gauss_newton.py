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
from numpy.typing import NDArray

from identification.priors import NO_PRIORS, Prior, densities
from identification.problem import Matrix, Problem, Vector
from identification.simulator import Simulator
from identification.windows import Window

NDArrayBool = NDArray[np.bool_]

# Beyond this a window is on its way out, and squares of it overflow.
_LARGEST = 1e100
_DIGITS = 1e-12  # of a channel that a misfit may have and still mean something
_DETERMINED = 1e-14  # smallest share of the largest eigenvalue that is not rounding
_PROJECTED = 1e-9  # share of a parameter's information that must survive projection


@dataclass(frozen=True)
class Part:
    """One record's share of a fit.

    Attributes:
        problem: Model and record.
        shooting: Compiled with sensitivities for (at least) the free parameters.
        windows: Over which to fit.
    """

    problem: Problem
    shooting: Simulator
    windows: Sequence[Window]


@dataclass(frozen=True)
class Linearised:
    """Weighted residuals and normal equations at one point, initial states eliminated.

    Of several records, windows and channels follow one another, record by record.

    Attributes:
        cost: Σ (residual/sd)² and the priors' share; infinite if a window left the finite numbers.
        rms: (ny,) unweighted root-mean-square residual.
        counts: (ny,) samples of each channel.
        normal: (ns, ns) projected normal matrix, priors included.
        raw: (ns,) diagonal of the normal matrix before projection.
        grams: Per window JᵀJ, (nx + ns, nx + ns), and Jᵀr.
        scores: (blocks, ns) sums of Jᵀr over short blocks, for honest covariances.
        residuals: Per window (n, ny) unweighted.
        precision: (ns,) of the priors, 0 where there is none.
        pull: (ns,) precision · (prior - value).
        penalty: The priors' share of the cost.
    """

    cost: float
    rms: Vector
    counts: NDArray[np.intp]
    normal: Matrix
    raw: Vector
    grams: tuple[tuple[Matrix, Vector], ...]
    scores: Matrix
    residuals: tuple[Matrix, ...]
    precision: Vector
    pull: Vector
    penalty: float = 0.0


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


def simulate(
    problem: Problem,
    shooting: Simulator,
    windows: Sequence[Window],
    x0: Matrix,
    values: Mapping[str, float],
) -> tuple[Matrix, ...]:
    """Return each window's simulated outputs, (n, ny); NaN after a window diverged."""
    p = shooting.parameter_vector(values)
    inputs = shooting.inputs_with_delays(problem.inputs, problem.sample_time, p)
    return tuple(
        shooting.run(
            x0[k], inputs[w.begin : w.end], p, problem.sample_time, t0=float(problem.time[w.begin])
        ).outputs
        for k, w in enumerate(windows)
    )


def linearise(
    problem: Problem,
    shooting: Simulator,
    windows: Sequence[Window],
    x0: Matrix,
    values: Mapping[str, float],
    sd: Vector,
    *,
    block: float = 0.25,
) -> Linearised:
    """Simulate all windows with sensitivities and form the projected normal equations.

    Args:
        block: Duration of the blocks over which scores are summed [s].
    """
    h, ns, nx = problem.sample_time, len(shooting.sensitive), shooting.nx
    p = shooting.parameter_vector(values)
    inputs = shooting.inputs_with_delays(problem.inputs, h, p)
    per_block = max(1, round(block / h))
    normal, raw = np.zeros((ns, ns)), np.zeros(ns)
    cost, squares, samples = 0.0, np.zeros(len(sd)), 0
    grams: list[tuple[Matrix, Vector]] = []
    scores: list[Vector] = []
    residuals: list[Matrix] = []
    for k, window in enumerate(windows):
        response = shooting.run(
            x0[k],
            inputs[window.begin : window.end],
            p,
            h,
            t0=float(problem.time[window.begin]),
            sensitivities=True,
        )
        misfit = problem.outputs[window.begin : window.end] - response.outputs
        residuals.append(misfit)
        with np.errstate(over="ignore", invalid="ignore"):
            jacobian = response.sensitivities / sd[:, None]
        if response.finite < len(window) or not np.all(np.isfinite(jacobian)):
            return _diverged(len(sd), ns)
        r = misfit / sd
        with np.errstate(over="ignore"):
            cost += float(np.sum(r * r))
            squares += np.sum(misfit**2, axis=0)
        samples += len(window)
        if np.max(np.abs(jacobian), initial=0.0) > _LARGEST:
            return _diverged(len(sd), ns)
        flat = jacobian.reshape(r.size, nx + ns)
        gram, score = flat.T @ flat, flat.T @ r.ravel()
        weight, _ = _eliminate(gram, score, nx, 0.0)
        normal += gram[nx:, nx:] - gram[nx:, :nx] @ weight
        raw += np.diag(gram[nx:, nx:])
        grams.append((gram, score))
        projected = jacobian[:, :, nx:] - jacobian[:, :, :nx] @ weight
        contributions = np.einsum("nys,ny->ns", projected, r)
        edges = np.arange(0, len(window), per_block)
        scores.extend(np.add.reduceat(contributions, edges, axis=0))
    return Linearised(
        cost,
        np.sqrt(squares / samples),
        np.full(len(sd), samples),
        normal,
        raw,
        tuple(grams),
        np.array(scores),
        tuple(residuals),
        np.zeros(ns),
        np.zeros(ns),
    )


def _linearise_all(
    parts: Sequence[Part],
    x0: Matrix,
    values: Mapping[str, float],
    sd: Vector,
    priors: Mapping[str, Prior],
) -> Linearised:
    """Linearise several records and priors as one; x0 and sd run over all records."""
    names = parts[0].shooting.sensitive
    ns, window, channel = len(names), 0, 0
    found: list[Linearised] = []
    for part in parts:
        ny, count = part.problem.outputs.shape[1], len(part.windows)
        one = linearise(
            part.problem,
            part.shooting,
            part.windows,
            x0[window : window + count],
            values,
            sd[channel : channel + ny],
        )
        if not np.isfinite(one.cost):
            return _diverged(len(sd), ns)
        found.append(one)
        window, channel = window + count, channel + ny
    wanted, precision = (np.array(numbers, float) for numbers in densities(priors, names))
    away = wanted - np.array([values[name] for name in names])
    held = precision > 0  # a parameter without a prior may be anywhere
    penalty = float(precision[held] @ away[held] ** 2)
    return Linearised(
        cost=sum(one.cost for one in found) + penalty,
        rms=np.concatenate([one.rms for one in found]),
        counts=np.concatenate([one.counts for one in found]),
        normal=np.sum([one.normal for one in found], axis=0) + np.diag(precision),
        raw=np.sum([one.raw for one in found], axis=0),
        grams=tuple(gram for one in found for gram in one.grams),
        scores=np.concatenate([one.scores for one in found]),
        residuals=tuple(residual for one in found for residual in one.residuals),
        precision=precision,
        pull=precision * away,
        penalty=penalty,
    )


def _eliminate(gram: Matrix, score: Vector, nx: int, damping: float) -> tuple[Matrix, Vector]:
    """Return (Wθ, w₀): for a parameter step Δθ the best initial state moves by w₀ - Wθ·Δθ."""
    diagonal = np.diag(gram)[:nx]
    # The small ridge only matters for a state that this window cannot see.
    states = gram[:nx, :nx] + np.diag((1e-12 + damping) * diagonal + 1e-300)
    solved = np.linalg.solve(states, np.column_stack([gram[:nx, nx:], score[:nx]]))
    return solved[:, :-1].astype(np.float64), solved[:, -1].astype(np.float64)


def _diverged(ny: int, ns: int) -> Linearised:
    nothing, zeros = np.zeros((ns, ns)), np.zeros(ns)
    rms, counts = np.full(ny, np.inf), np.zeros(ny, np.intp)
    return Linearised(np.inf, rms, counts, nothing, zeros, (), np.zeros((0, ns)), (), zeros, zeros)


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
    iterations: int = 30,
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
    iterations: int = 30,
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
    point = _Point(dict(values), x0, _linearise_all(parts, x0, values, sd, priors))
    if not np.isfinite(point.at.cost):
        return _finish(names, chosen, point, sd, converged=False)
    converged, damping = False, 1e-4
    for _ in range(iterations):
        if fixed_sd is None:
            new_sd = _weights_of_all(parts, point.at.rms)
            if np.any(np.abs(new_sd - sd) > 1e-3 * sd):
                sd = new_sd
                at = _linearise_all(parts, point.x0, point.values, sd, priors)
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


def seen(at: Linearised) -> NDArrayBool:
    """Return which parameters the data (or a prior) see, given that initial states are free."""
    diagonal = np.diag(at.normal)
    return ((diagonal > _PROJECTED * at.raw) & (at.raw > 0)) | (at.precision > 0)


def _step(
    parts: Sequence[Part],
    priors: Mapping[str, Prior],
    chosen: NDArrayBool,
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
            weight, shift = _eliminate(gram, score, nx, damping)
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
        at = _linearise_all(parts, new_x0, new_values, sd, priors)
        if at.cost < point.at.cost:
            return _Point(new_values, new_x0, at), max(damping / 10, 1e-12)
        damping = max(damping * 10, 1e-9)
    return None


def _finish(
    names: Sequence[str],
    chosen: NDArrayBool,
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


def covariance_of(at: Linearised, index: NDArray[np.intp]) -> tuple[Matrix, float]:
    """Return the covariance of some parameters, and the condition number of their Jacobian.

    The sandwich H⁻¹ S H⁻¹ (H. White, Econometrica 50 (1982) 1), so that residuals that correlate in
    time (a model error, a coloured disturbance) widen it. S comes from the windows' scores: each
    has an initial state of its own, so what correlates within a window does not reach the next. Too
    few windows for that are cut into short blocks. In no direction is the result narrower than what
    white noise of the present size would make it, and a combination that the data do not determine
    has a variance beyond all others. A prior counts as an observation of the variance it states.
    """
    normal = at.normal[np.ix_(index, index)]
    scale = np.sqrt(np.diag(normal))
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    largest = eigenvalues[-1]
    condition = float(np.sqrt(largest / max(eigenvalues[0], 1e-300)))
    root = vectors / np.sqrt(np.fmax(eigenvalues, _DETERMINED * largest))
    k, nx = len(index), len(at.grams[0][1]) - len(at.raw)
    per_window = np.array([_projected(gram, score, nx) for gram, score in at.grams])
    scores = per_window if len(per_window) > k else at.scores
    # In the coordinates of `root`, the data and the priors add up to the information I.
    # At the solution the data's scores add up to what holds against the priors' pull.
    centred = scores[:, index] + at.pull[index] / len(scores)
    whitened = (centred / scale) @ root
    spread = whitened.T @ whitened * (len(scores) / max(len(scores) - k, 1))
    freedom = int(np.sum(at.counts)) - k - nx * len(at.grams)
    white = (at.cost - at.penalty) / max(freedom, 1)
    prior = (root.T * (at.precision[index] / scale**2)) @ root
    least = white * (np.eye(k) - prior)
    sizes, directions = np.linalg.eigh(spread - least)
    more = (directions * np.fmax(sizes, 0.0)) @ directions.T
    half = root / scale[:, None]
    covariance = half @ (least + more + prior) @ half.T
    return (covariance + covariance.T) / 2, condition


def _projected(gram: Matrix, score: Vector, nx: int) -> Vector:
    """Return (ns,) a window's score with its initial state eliminated."""
    weight, _ = _eliminate(gram, score, nx, 0.0)
    return score[nx:] - weight.T @ score[:nx]
