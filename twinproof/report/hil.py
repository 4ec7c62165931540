"""The report of `hil run`: verdicts, signals over time, frames and deadlines."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from hil.criteria import Verdict
from hil.rig import HilResult
from twinproof.report.envelope import envelope
from twinproof.report.numbers import scale_for, significant
from twinproof.report.page import Provenance, versions, write_page
from twinproof.report.picture import Picture, in_scale, legend, limits, time_axis
from twinproof.report.svg import Role, figure, inline

_ROW = 1.45
_RULE = (
    "Criteria are judged on the plant's own signals, one sample a cycle, not on what its sensors "
    "said of them."
)


def write_hil(result: HilResult, path: Path, *, command: str) -> None:
    """Write the report of a run as one self-contained HTML file.

    Args:
        result: From `hil.rig.run_scenario`.
        path: File to write.
        command: That repeats the run.

    Raises:
        OSError: The file cannot be written.
    """
    scenario, loop = result.scenario, result.loop
    failed = [v for v in result.verdicts if not v.passed]
    met = len(result.verdicts) - len(failed)
    pictures = [_signals(result)]
    if loop.jitter.count:
        pictures.append(_jitter(result))
    write_page(
        path,
        "hil.html",
        headline=f"{scenario.name}: {'passed' if not failed else 'failed'}",
        summary=f"{met} of {len(result.verdicts)} criteria are met"
        + (f"; not met: {', '.join(v.name for v in failed)}." if failed else "."),
        verdicts=[_row(v) for v in result.verdicts],
        pictures=pictures,
        counts=_counts(result),
        faults=[(kind, str(n)) for kind, n in result.faults],
        safe=[f"{a:.4g} s to {'the end' if np.isinf(b) else f'{b:.4g} s'}" for a, b in result.safe],
        provenance=Provenance(
            command,
            _RULE,
            {"Run": _facts(result)},
            tuple(loop.notes),
            versions(),
            datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        ),
    )


def _row(verdict: Verdict) -> dict[str, str]:
    return {
        "name": verdict.name,
        "detail": verdict.detail,
        "limit": significant(verdict.limit) if np.isfinite(verdict.limit) else "none",
        "mark": "met" if verdict.passed else "not met",
    }


def _facts(result: HilResult) -> tuple[str, ...]:
    run, loop = result.scenario.run, result.loop
    facts = [
        f"{loop.trace.count} cycles of {1e3 * run.step:g} ms, {run.clock} clock, seed {run.seed}",
        f"plant: {result.scenario.plant.model}",
        f"messages: {result.scenario.messages.origin}",
        f"recording: {result.recording}",
    ]
    if loop.jitter.count:
        facts.append(
            f"{loop.missed} deadlines missed; woken up late by "
            f"{1e6 * loop.jitter.percentile(50):.0f} µs (median), "
            f"{1e6 * loop.jitter.percentile(99):.0f} µs (99 %), "
            f"{1e6 * loop.jitter.longest:.0f} µs (most)"
        )
        facts.append(
            f"answer after {1e6 * loop.latency.percentile(50):.0f} µs (median), "
            f"{1e6 * loop.latency.percentile(99):.0f} µs (99 %)"
        )
    return tuple(facts)


def _counts(result: HilResult) -> list[tuple[str, str, str]]:
    plant = result.plant.counts()
    other = {} if result.controller is None else result.controller.counts()
    return [
        (name.replace("_", " "), str(count), str(other.get(name, "")))
        for name, count in plant.items()
        if count or other.get(name)
    ]


def _signals(result: HilResult) -> Picture:
    trace, plant = result.trace, result.scenario.plant
    outputs, inputs = [p.name for p in plant.outputs], [p.name for p in plant.inputs]
    with figure(_ROW * (len(outputs) + len(inputs)) + 0.45) as drawn:
        axes: list[Axes] = list(
            np.atleast_1d(drawn.subplots(len(outputs) + len(inputs), 1, sharex=True))
        )
        for ax, name in zip(axes, [*outputs, *inputs], strict=True):
            if name in outputs:
                _line(ax, result, f"measured.{name}", "as measured", Role.MUTED)
            _line(ax, result, name, "plant", Role.LAST)
            if f"reference.{name}" in trace.columns:
                _line(ax, result, f"reference.{name}", "reference", Role.FIRST)
            largest = float(np.nanmax(np.abs(trace.columns[name]), initial=0.0))
            scale = scale_for(plant.unit(name), largest)
            ax.yaxis.set_major_formatter(in_scale(scale))
            ax.set_title(f"{name}{f' [{scale.unit}]' if scale.unit else ''}")
            limits(ax, trace.columns[name])
            time_axis(ax, trace.time)
            for start, stop in result.safe:
                ax.axvspan(start, min(stop, float(trace.time[-1])), color=Role.GRID.value)
        axes[-1].set_xlabel("time [s]")
        legend(drawn, *axes)
        svg = inline(drawn, "signals")
    shaded = " Shaded: the plant was in its safe state." if result.safe else ""
    return Picture(
        svg,
        f"Signals of {result.scenario.name} over time",
        f"Outputs and inputs of the plant.{shaded}",
    )


def _line(ax: Axes, result: HilResult, name: str, label: str, role: Role) -> None:
    time, values = envelope(result.trace.time, result.trace.columns[name])
    style = "--" if role is Role.FIRST else "-"
    ax.plot(time, values, style, color=role.value, label=label)


def _jitter(result: HilResult) -> Picture:
    counts = result.loop.jitter.counts
    last = int(np.flatnonzero(counts)[-1]) + 1
    with figure(1.9) as drawn:
        ax = drawn.subplots()
        ax.step(np.arange(last), np.maximum(counts[:last], 0.5), color=Role.LAST.value)
        ax.set_xscale("symlog")
        ax.set_yscale("log")
        ax.set_xlabel("woken up late [µs]")
        ax.set_ylabel("cycles")
        svg = inline(drawn, "jitter")
    return Picture(svg, "Histogram of the wake-up jitter", "How late the loop was woken up.")
