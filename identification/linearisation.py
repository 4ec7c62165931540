"""Windows of records simulated with sensitivities: residuals and projected normal equations.

Initial states are eliminated window by window (Schur complement), so that parameters common to all
windows are left, and the cost grows linearly with the record.
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

Booleans = NDArray[np.bool_]

# Beyond this a window is on its way out, and squares of it overflow.
_LARGEST = 1e100
# Share of a parameter's information that must be left once initial states have had theirs: above
# what rounding and the ridge leave of nothing. On an unstable machine's window a constant torque
# looks like another initial tilt but for a ten-thousandth of its response, and that is well seen.
_PROJECTED = 1e-11
_RIDGE = 1e-12


@dataclass(frozen=True)
class Part:
    """One record's share of a fit.

    Attributes:
        problem: Model and record.
        shooting: Compiled with sensitivities for (at least) the free parameters.
        windows: Over which to fit.
        counted: (n,) samples of the record that count; None: all.
    """

    problem: Problem
    shooting: Simulator
    windows: Sequence[Window]
    counted: Booleans | None = None


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
    counted: Booleans | None = None,
) -> Linearised:
    """Simulate all windows with sensitivities and form the projected normal equations.

    Args:
        block: Duration of the blocks over which scores are summed [s].
        counted: (n,) samples of the record that count; None: all. Residuals are of all.
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
        size = len(window)
        if counted is not None:
            here = counted[window.begin : window.end]
            misfit, jacobian = misfit * here[:, None], jacobian * here[:, None, None]
            size = int(np.sum(here))
        r = misfit / sd
        with np.errstate(over="ignore"):
            cost += float(np.sum(r * r))
            squares += np.sum(misfit**2, axis=0)
        samples += size
        if np.max(np.abs(jacobian), initial=0.0) > _LARGEST:
            return _diverged(len(sd), ns)
        flat = jacobian.reshape(r.size, nx + ns)
        gram, score = flat.T @ flat, flat.T @ r.ravel()
        weight, _ = eliminate(gram, score, nx, 0.0)
        normal += gram[nx:, nx:] - gram[nx:, :nx] @ weight
        raw += np.diag(gram[nx:, nx:])
        grams.append((gram, score))
        projected = jacobian[:, :, nx:] - jacobian[:, :, :nx] @ weight
        contributions = np.einsum("nys,ny->ns", projected, r)
        edges = np.arange(0, len(window), per_block)
        scores.extend(np.add.reduceat(contributions, edges, axis=0))
    return Linearised(
        cost,
        np.sqrt(squares / max(samples, 1)),
        np.full(len(sd), samples),
        normal,
        raw,
        tuple(grams),
        np.array(scores).reshape(len(scores), ns),
        tuple(residuals),
        np.zeros(ns),
        np.zeros(ns),
    )


def linearise_all(
    parts: Sequence[Part],
    x0: Matrix,
    values: Mapping[str, float],
    sd: Vector,
    priors: Mapping[str, Prior] = NO_PRIORS,
) -> Linearised:
    """Linearise several records and priors as one; x0 and sd run over all records.

    Priors are added to those that the problem has.
    """
    names = parts[0].shooting.sensitive
    priors = {**parts[0].problem.priors, **priors}
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
            counted=part.counted,
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


def eliminate(gram: Matrix, score: Vector, nx: int, damping: float) -> tuple[Matrix, Vector]:
    """Return (Wθ, w₀): for a parameter step Δθ the best initial state moves by w₀ - Wθ·Δθ."""
    diagonal = np.diag(gram)[:nx]
    # The small ridge only matters for a state that this window cannot see.
    states = gram[:nx, :nx] + np.diag((_RIDGE + damping) * diagonal + 1e-300)
    solved = np.linalg.solve(states, np.column_stack([gram[:nx, nx:], score[:nx]]))
    return solved[:, :-1].astype(np.float64), solved[:, -1].astype(np.float64)


def _diverged(ny: int, ns: int) -> Linearised:
    nothing, zeros = np.zeros((ns, ns)), np.zeros(ns)
    rms, counts = np.full(ny, np.inf), np.zeros(ny, np.intp)
    return Linearised(np.inf, rms, counts, nothing, zeros, (), np.zeros((0, ns)), (), zeros, zeros)


def seen(at: Linearised) -> Booleans:
    """Return which parameters the data (or a prior) see, given that initial states are free."""
    diagonal = np.diag(at.normal)
    return ((diagonal > _PROJECTED * at.raw) & (at.raw > 0)) | (at.precision > 0)
