"""A record as figures: measured against simulated, and errors against time and variables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from identification.comparison import Comparison
from identification.problem import Problem, Vector
from twinproof.report.envelope import envelope, profile
from twinproof.report.numbers import Scale, scale_for
from twinproof.report.picture import Picture, in_scale, legend, limits, time_axis, unit_of
from twinproof.report.svg import Role, figure, inline

_ROW = 1.45
_MOST_CHANNELS = 6
_MOST_VARIABLES = 6
# Errors this much apart are drawn on scales of their own.
_APART = 4.0
# The closer look spans at least and at most twice these shares of the record.
_ZOOM = (0.04, 0.1)
# A simulation that runs away is followed this many spans of the measurement, no further.
_FOLLOWED = 0.8
_TINY = 1e-200


@dataclass(frozen=True)
class Run:
    """One model's prediction of a record, as it is drawn.

    Attributes:
        label: In words.
        role: Its colour; `FIRST` is dashed as well.
        comparison: The prediction with its errors.
        mark: Shade the spans in which it is at its worst.
    """

    label: str
    role: Role
    comparison: Comparison
    mark: bool = True


def traces(problem: Problem, runs: Sequence[Run], name: str) -> Picture:
    """Draw measured against simulated: the whole record, and a closer look at where it fails.

    Args:
        problem: The record.
        runs: Models, the one to look at closely first.
        name: Unique in the page.
    """
    channels = problem.output_names[:_MOST_CHANNELS]
    begin, end = _closer(problem, runs[0].comparison)
    with figure(_ROW * len(channels) + 0.45) as drawn:
        grid = drawn.subplots(
            len(channels),
            2,
            squeeze=False,
            sharex="col",
            gridspec_kw={"width_ratios": [2.0, 1.0]},
        )
        for c, channel in enumerate(channels):
            unit = unit_of(problem, channel)
            scale = scale_for(unit, float(np.max(np.abs(problem.outputs[:, c]))))
            for ax, lo, hi in ((grid[c, 0], 0, len(problem.time)), (grid[c, 1], begin, end)):
                _traces(ax, problem, runs, c, slice(lo, hi), scale)
            grid[c, 0].set_ylabel(f"{channel} [{scale.unit}]")
            _mark_spans(grid[c, 0], [(problem.time[begin], problem.time[end - 1])], Role.MUTED)
        for ax, word in ((grid[-1, 0], "time [s]"), (grid[-1, 1], "time [s], closer")):
            ax.set_xlabel(word)
        legend(drawn, grid[0, 0])
        svg = inline(drawn, name)
    names = ", ".join(run.label for run in runs)
    return Picture(
        svg,
        f"Measured {', '.join(channels)} against time with simulations: {names}",
        f"Left the whole record, right the shaded span. {_left_out(problem)}".rstrip(),
    )


def _traces(
    ax: Axes, problem: Problem, runs: Sequence[Run], c: int, part: slice, scale: Scale
) -> None:
    time = problem.time[part]
    measured = problem.outputs[part, c]
    t, y = envelope(time, measured)
    ax.plot(t, y / scale.size, color=Role.MEASURED.value, lw=2.4, alpha=0.45, label="measured")
    low, high = float(np.min(measured)), float(np.max(measured))
    beyond = _FOLLOWED * (high - low)
    reach = [measured]
    for run in runs:
        simulated = run.comparison.prediction.simulated[part, c]
        reach.append(np.clip(simulated, low - beyond, high + beyond))
        t, y = envelope(time, simulated)
        ax.plot(t, y / scale.size, color=run.role.value, ls=_dash(run), lw=1.2, label=run.label)
    limits(ax, np.concatenate(reach) / scale.size, room=0.1)
    time_axis(ax, time)


def residual_over_time(
    problem: Problem, runs: Sequence[Run], noise: Mapping[str, float], name: str
) -> Picture:
    """Draw measured minus simulated against time, the worst spans shaded.

    Args:
        problem: The record.
        runs: One or two models; errors of very different size get scales of their own.
        noise: Channel → standard deviation of its sensor's noise, where it is known.
        name: Unique in the page.
    """
    channels = problem.output_names[:_MOST_CHANNELS]
    with figure(_ROW * len(channels) + 0.45) as drawn:
        grid = drawn.subplots(len(channels), len(runs), squeeze=False, sharex=True)
        for c, channel in enumerate(channels):
            unit = unit_of(problem, channel)
            sizes = [_size(run.comparison.prediction.error[:, c]) for run in runs]
            shared = max(sizes) < _APART * min(sizes)
            for ax, run, size in zip(grid[c], runs, sizes, strict=True):
                reach = max(sizes) if shared else size
                scale = scale_for(unit, reach)
                _residual(ax, problem, run, c, scale, noise.get(channel, np.nan))
                ax.set_ylim(-1.15 * reach / scale.size, 1.15 * reach / scale.size)
                ax.set_ylabel(f"{channel} [{scale.unit}]")
                spans = [(f.begin, f.end) for f in run.comparison.worst if run.mark]
                _mark_spans(ax, spans, run.role, number=c == 0)
        for ax, run in zip(grid[0], runs, strict=True):
            ax.set_title(run.label, color=run.role.value, loc="left", pad=12)
        for ax in grid[-1]:
            ax.set_xlabel("time [s]")
        svg = inline(drawn, name)
    return Picture(
        svg,
        f"Error of {', '.join(channels)} against time, {' beside '.join(r.label for r in runs)}",
        "Measured minus simulated. Shaded and numbered: where each model is at its worst. "
        "Dotted: two standard deviations of the sensor’s noise, where they are in sight. "
        f"Mind the scales: they differ where the errors do. {_left_out(problem)}".rstrip(),
    )


def _residual(ax: Axes, problem: Problem, run: Run, c: int, scale: Scale, noise: float) -> None:
    prediction = run.comparison.prediction
    scored = np.where(prediction.scored, prediction.error[:, c], np.nan)
    t, y = envelope(problem.time, scored)
    ax.plot(t, y / scale.size, color=run.role.value, lw=0.9)
    ax.axhline(0.0, color=Role.MUTED.value, lw=0.6)
    if np.isfinite(noise) and noise > 0.02 * _size(scored):
        for sign in (-2.0, 2.0):
            ax.axhline(sign * noise / scale.size, color=Role.FLOOR.value, lw=1.2, ls=":", zorder=3)
    time_axis(ax, problem.time)


def residual_over_variables(problem: Problem, runs: Sequence[Run], name: str) -> list[Picture]:
    """Draw measured minus simulated against every observed variable, as median and inner 80 %.

    Returns:
        One picture with all models, or one for each where their errors are of different size; none
        if nothing moved.
    """
    states = runs[-1].comparison.states
    variables = [v for v in states if np.ptp(states[v]) > 0]
    if not variables:
        return []
    sizes = np.array(
        [
            [_size(run.comparison.prediction.error[:, c]) for c in range(len(problem.output_names))]
            for run in runs
        ]
    )
    if np.any(np.max(sizes, axis=0) > _APART * np.min(sizes, axis=0)):
        return [
            _over_variables(problem, [run], variables, f"{name}-{k}") for k, run in enumerate(runs)
        ]
    return [_over_variables(problem, runs, variables, name)]


def _over_variables(
    problem: Problem, runs: Sequence[Run], moving: Sequence[str], name: str
) -> Picture:
    channels = problem.output_names[:_MOST_CHANNELS]
    states = runs[-1].comparison.states
    variables = moving[:_MOST_VARIABLES]
    with figure(1.15 * len(channels) + 0.8) as drawn:
        grid = drawn.subplots(
            len(channels), len(variables), squeeze=False, sharex="col", sharey="row"
        )
        for c, channel in enumerate(channels):
            reach = max(
                max(_profiles(grid[c, v], runs, c, variable))
                for v, variable in enumerate(variables)
            )
            scale = scale_for(unit_of(problem, channel), reach)
            reach = reach if reach > _TINY else 1.0
            ax = grid[c, 0]
            ax.set_ylim(-1.1 * reach, 1.1 * reach)
            ax.yaxis.set_major_formatter(in_scale(scale))
            ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            ax.set_ylabel(f"{channel} [{scale.unit}]")
        for ax, variable in zip(grid[-1], variables, strict=True):
            scale = scale_for(unit_of(problem, variable), float(np.max(np.abs(states[variable]))))
            ax.xaxis.set_major_formatter(in_scale(scale))
            ax.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
            ax.set_xlabel(f"{variable} [{scale.unit}]")
        legend(drawn, grid[0, 0])
        svg = inline(drawn, name)
    labels = " and ".join(run.label for run in runs)
    return Picture(
        svg,
        f"Error of {', '.join(channels)} against {', '.join(variables)}, {labels}",
        _left_out(problem, moving),
    )


def _left_out(problem: Problem, moving: Sequence[str] = ()) -> str:
    """Return a sentence that says what a figure had no room for; empty if it had."""
    out = [*problem.output_names[_MOST_CHANNELS:], *moving[_MOST_VARIABLES:]]
    return f"Not drawn for want of room: {', '.join(out)}." if out else ""


def _profiles(ax: Axes, runs: Sequence[Run], c: int, variable: str) -> list[float]:
    """Draw one panel; return how far its bands reach."""
    reach = [_TINY]
    for run in runs:
        prediction = run.comparison.prediction
        scored = prediction.scored
        shown = profile(run.comparison.states[variable][scored], prediction.error[scored, c])
        if len(shown.x) == 0:
            continue
        colour = run.role.value
        ax.fill_between(shown.x, shown.low, shown.high, color=colour, alpha=0.22, lw=0)
        ax.plot(shown.x, shown.middle, color=colour, ls=_dash(run), label=run.label)
        reach += [float(np.max(np.abs(shown.low))), float(np.max(np.abs(shown.high)))]
    ax.axhline(0.0, color=Role.MUTED.value, lw=0.6)
    return reach


def _closer(problem: Problem, comparison: Comparison) -> tuple[int, int]:
    """Return the samples of the span to look at closely: around the worst failure."""
    n = len(problem.time)
    duration = float(problem.time[-1])
    half, middle = _ZOOM[0] * duration, 0.5 * duration
    if comparison.worst:
        worst = comparison.worst[0]
        middle = 0.5 * (worst.begin + worst.end)
        half = float(np.clip(0.75 * (worst.end - worst.begin), half, _ZOOM[1] * duration))
    begin = int(np.clip(np.searchsorted(problem.time, middle - half), 0, n - 2))
    end = int(np.clip(np.searchsorted(problem.time, middle + half), begin + 2, n))
    return begin, end


def _mark_spans(
    ax: Axes, spans: Sequence[tuple[float, float]], role: Role, *, number: bool = False
) -> None:
    for k, (begin, end) in enumerate(spans):
        ax.axvspan(begin, end, color=role.value, alpha=0.15, lw=0)
        if number:
            ax.annotate(
                str(k + 1),
                (0.5 * (begin + end), 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 1),
                textcoords="offset points",
                ha="center",
                va="bottom",
                color=role.value,
            )


def _dash(run: Run) -> str:
    return "--" if run.role is Role.FIRST else "-"


def _size(error: Vector) -> float:
    finite = np.abs(error[np.isfinite(error)])
    size = float(np.quantile(finite, 0.998)) if len(finite) else 1.0
    # An error of exactly zero is drawn as a line in the middle.
    return size if size > _TINY else 1.0
