"""An experiment that tells tied candidates apart, and by how much.

Each candidate in turn is taken for the truth and simulates the experiment; the others are fitted to
what it gives, parameters and initial states, and what they cannot follow is what would separate
them. Tried are motions of the record itself, smaller, larger or mirrored, which a controller that
made this one can make again, and multisines where the plant stays bounded without a controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.design.suggestion import schroeder_phases
from identification.discovery.evidence import Refit
from identification.gauss_newton import fit
from identification.linearisation import simulate
from identification.prediction import predict
from identification.problem import Matrix, Problem, Vector
from identification.windows import Window, cut

# Fewer nats than this do not decide between two candidates.
_DECISIVE = 10.0
_ITERATIONS = 8
_WINDOW = 1.0
_LONGEST = 20.0
_SINES = 12
_BOUNDED = 10.0


@dataclass(frozen=True)
class NextExperiment:
    """A proposal.

    Attributes:
        text: What to record, and what it would bring, in a sentence.
        nats: Predicted ΔlogL between the truth and the nearest rival, whichever is the truth.
        inputs: (n, nu) to apply, at the record's sample time; None for a motion of the record.
        scale: Of the record's motion; 0 where `inputs` are given.
    """

    text: str
    nats: float
    inputs: Matrix | None
    scale: float


@dataclass(frozen=True)
class _Plan:
    words: str
    inputs: Matrix
    scale: float


def propose(
    tied: Sequence[Refit], *, limits: Mapping[str, tuple[float, float]] | None = None
) -> NextExperiment:
    """Return the experiment that separates tied candidates most.

    Args:
        tied: Refits of the candidates on one record, two at least.
        limits: Input → lowest and highest value; by default what it was in the record.

    Returns:
        The proposal. Where nothing tried separates them, it says so: two candidates may be one and
        the same law (an offset of a torque, before the input and at the shaft).
    """
    first = tied[0].experiment.problem
    ranges = _ranges(first, limits or {})
    n = min(len(first.time), round(_LONGEST / first.sample_time))
    best: NextExperiment | None = None
    for plan in _plans(first, ranges, n):
        nats = _least_separation(tied, plan, n)
        if nats is not None and (best is None or nats > best.nats):
            best = NextExperiment(plan.words, nats, None if plan.scale else plan.inputs, plan.scale)
    names = ", ".join(r.addition.label for r in tied)
    if best is None or best.nats < _DECISIVE:
        nats = 0.0 if best is None else best.nats
        return NextExperiment(
            f"no motion within the limits of this record tells {names} apart (at most {nats:.1f} "
            "nats): they may be one law in two places; measure between them, or choose by design",
            nats,
            None,
            0.0,
        )
    return replace(
        best,
        text=f"record {best.text}: it should tell {names} apart by {best.nats:.0f} nats or more",
    )


def _ranges(problem: Problem, limits: Mapping[str, tuple[float, float]]) -> Matrix:
    """Return (nu, 2) lowest and highest value of every input."""
    return np.array(
        [
            limits.get(v.name, (float(np.min(u)), float(np.max(u))))
            for v, u in zip(problem.dae.inputs, problem.inputs.T, strict=True)
        ]
    ).reshape(-1, 2)


def _plans(problem: Problem, ranges: Matrix, n: int) -> list[_Plan]:
    recorded = problem.inputs[:n]
    seconds = n * problem.sample_time
    plans: list[_Plan] = []
    for scale, words in (
        (0.5, "the same motion at half the amplitude"),
        (-1.0, "the mirrored motion"),
        (2.0, "the same motion at twice the amplitude"),
    ):
        inputs = scale * recorded
        slack = 1e-9 * np.ptp(ranges, axis=1)
        if np.all(inputs >= ranges[:, 0] - slack) and np.all(inputs <= ranges[:, 1] + slack):
            plans.append(_Plan(words, inputs, scale))
    highest = 0.05 / problem.sample_time
    for low in (1 / seconds, 10 / seconds, 100 / seconds):
        high = min(10 * low, highest)
        if high > 2 * low:
            words = f"{seconds:.3g} s of a multisine from {low:.2g} to {high:.2g} Hz"
            plans.append(_Plan(words, _multisine(ranges, low, high, n, problem.sample_time), 0.0))
    return plans


def _multisine(ranges: Matrix, low: float, high: float, n: int, step: float) -> Matrix:
    """Return (n, nu) sines with Schroeder's phases, each input over its whole range."""
    time = step * np.arange(n)
    columns: list[Vector] = []
    for k, (least, most) in enumerate(ranges):
        # Inputs interleave their frequencies, so that none is a multiple of another.
        f = np.geomspace(low, high, _SINES * len(ranges))[k :: len(ranges)]
        wave = np.sum(np.sin(2 * np.pi * np.outer(time, f) + schroeder_phases(len(f))), axis=1)
        columns.append((most + least) / 2 + (most - least) / 2 * wave / np.max(np.abs(wave)))
    return np.column_stack(columns) if columns else np.zeros((n, 0))


def _least_separation(tied: Sequence[Refit], plan: _Plan, n: int) -> float | None:
    """Return what separates the nearest two [nats]; None where a simulation runs away."""
    least = np.inf
    for truth in tied:
        found = _played(truth, plan, n)
        if found is None:
            return None
        windows, outputs = found
        for rival in tied:
            if rival is truth:
                continue
            nats = _left_over(rival, plan, n, windows, outputs)
            if nats is None:
                return None
            least = min(least, nats)
    return float(least)


def _played(truth: Refit, plan: _Plan, n: int) -> tuple[tuple[Window, ...], Matrix] | None:
    """Return windows and outputs of the experiment if a candidate is the truth."""
    problem = _under(truth, plan, n)
    shooting = truth.experiment.shooting
    anywhere = shooting.begins_anywhere
    if plan.scale and anywhere:
        # Windows of the record, each from its own state: a motion that a controller kept bounded.
        kept = [k for k, w in enumerate(truth.experiment.windows) if w.end <= n]
        windows = tuple(truth.experiment.windows[k] for k in kept)
        x0 = plan.scale * truth.fit.x0[kept]
    else:
        windows, x0 = (Window(0, n),), truth.fit.x0[:1]
    if not windows:
        return None
    parts = simulate(problem, shooting, windows, x0, truth.fit.values)
    outputs = np.full((n, len(problem.output_names)), np.nan)
    for window, part in zip(windows, parts, strict=True):
        outputs[window.begin : window.end] = part
    there = outputs[windows[0].begin : windows[-1].end]
    span = np.ptp(truth.experiment.problem.outputs, axis=0)
    if not np.all(np.isfinite(there)) or np.any(np.ptp(there, axis=0) > _BOUNDED * span):
        return None
    if not plan.scale and anywhere:
        windows = cut(n, problem.sample_time, _WINDOW)
    return windows, outputs


def _left_over(
    rival: Refit, plan: _Plan, n: int, windows: Sequence[Window], outputs: Matrix
) -> float | None:
    """Return half the weighted squared error that a rival leaves when fitted to the outputs."""
    problem = replace(_under(rival, plan, n), outputs=outputs)
    started = predict(problem, rival.experiment.shooting, rival.fit.values, None, windows=windows)
    found = fit(
        problem,
        rival.experiment.shooting,
        windows,
        started.x0,
        rival.fit.values,
        fixed_sd=rival.fit.sd[: len(problem.output_names)],
        iterations=_ITERATIONS,
    )
    return 0.5 * found.at.cost if np.isfinite(found.at.cost) else None


def _under(refit: Refit, plan: _Plan, n: int) -> Problem:
    """Return a candidate's problem with the experiment's inputs."""
    problem = refit.experiment.problem.part(0, n)
    return replace(problem, inputs=plan.inputs[:n])
