"""The report of `whatif`: pass rates with their intervals, comparisons, worst runs."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from hil.whatif import Rate, StudyResult
from twinproof.report.numbers import significant
from twinproof.report.page import Provenance, versions, write_page
from twinproof.report.picture import Picture
from twinproof.report.svg import Role, figure, inline

_MOST = 8
_RULE = (
    "Time-domain criteria are judged on the plant's own signals; margins on its linear model at "
    "the operating point, sampled with the controller's period and one cycle of delay. Intervals "
    "of rates are exact (Clopper and Pearson); p is that of the exact McNemar test."
)


def write_whatif(result: StudyResult, path: Path, *, command: str) -> None:
    """Write the report of a study as one self-contained HTML file.

    Args:
        result: From `hil.whatif.run_study`.
        path: File to write.
        command: That repeats the study.

    Raises:
        OSError: The file cannot be written.
    """
    study = result.study
    total = result.rate()
    names = list(dict.fromkeys(v.name for r in result.runs for v in r.verdicts))
    rows = [(name, result.rate(name)) for name in study.controllers]
    rows += [(name, result.rate(criterion=name)) for name in names]
    write_page(
        path,
        "whatif.html",
        headline=f"{study.name}: {total.passed} of {total.runs} runs passed",
        summary=f"With {100 * study.run.confidence:g} % confidence between {100 * total.low:.1f} % "
        f"and {100 * total.high:.1f} % of such plants pass.",
        rates=[_rate_row(name, r) for name, r in rows],
        pairs=[
            f"{p.first} against {p.second}: {p.only_first} runs only the first passes, "
            f"{p.only_second} only the second (p = {p.p:.2g})"
            for p in result.pairs()
        ],
        pictures=[_spread(result, names[:_MOST])],
        worst=[
            {
                "number": str(r.case.number),
                "controller": r.case.controller,
                "plant": f"{r.case.variant}, draw {r.case.draw}",
                "meets": f"{r.case.reference}, {r.case.disturbance}",
                "failed": "; ".join(f"{v.name}: {v.detail}" for v in r.verdicts if not v.passed),
            }
            for r in result.worst()
        ],
        provenance=Provenance(
            command,
            _RULE,
            {
                "Study": (
                    f"plant: {study.plant.model}",
                    f"{len(study.controllers)} controllers, "
                    f"{len(study.variants)} plants by effect, {study.draws} draws, "
                    f"{len(study.references)} references, "
                    f"{len(study.disturbances)} disturbances",
                    f"{study.run.duration:g} s in cycles of {1e3 * study.run.step:g} ms, "
                    f"seed {study.run.seed}",
                )
            },
            result.notes,
            versions(),
            datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        ),
    )


def _rate_row(name: str, rate: Rate) -> dict[str, str]:
    share = rate.passed / rate.runs if rate.runs else 0.0
    return {
        "name": name,
        "passed": f"{rate.passed} of {rate.runs}",
        "share": f"{100 * share:.1f} %",
        "interval": f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %",
    }


def _spread(result: StudyResult, names: list[str]) -> Picture:
    controllers = list(result.study.controllers)
    with figure(1.3 * len(names) + 0.3) as drawn:
        axes: list[Axes] = list(np.atleast_1d(drawn.subplots(len(names), 1)))
        for ax, name in zip(axes, names, strict=True):
            limit = float("nan")
            for k, controller in enumerate(controllers):
                found = [
                    v
                    for r in result.runs
                    if r.case.controller == controller
                    for v in r.verdicts
                    if v.name == name and np.isfinite(v.value)
                ]
                values = [v.value for v in found]
                limit = found[0].limit if found else limit
                color = (Role.FIRST, Role.LAST, Role.FITTED)[k % 3].value
                ax.plot(values, np.full(len(values), k), "|", color=color, markersize=9)
            if np.isfinite(limit):
                ax.axvline(limit, color=Role.INK.value, linestyle="--")
            ax.set_yticks(range(len(controllers)), controllers)
            ax.set_ylim(-0.6, len(controllers) - 0.4)
            ax.set_title(f"{name}, limit {significant(limit)}")
        svg = inline(drawn, "spread")
    return Picture(
        svg, "What each criterion found in each run", "Each mark is a run; dashed: the limit."
    )
