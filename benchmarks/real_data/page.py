"""The pages of the measured benchmarks: ladder, parameters, one picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from benchmarks.real_data.journey import Stretch, Walked
from docs.reproduce.page import Page, curve

FOLDER = Path(__file__).parents[2] / "docs" / "benchmarks"


def write(walked: Walked, *, whole: bool = False, folder: Path = FOLDER) -> Path:
    """Write a journey's page and return its path.

    Args:
        walked: The journey.
        whole: Its limit is for both stretches together.
        folder: Where the page goes.
    """
    journey, found = walked.journey, walked.found
    page = Page(folder, journey.name)
    given = walked.given.channels[journey.output]
    fitted = " and ".join(_words(stretch) for stretch in (journey.fitted, *journey.also))
    page.text(
        f"# {journey.title}",
        journey.source,
        f"`python -m benchmarks {journey.name}` measures it, `make pages` writes this page. "
        f"Fitted: {fitted}. Unseen: {_words(journey.unseen)}. Errors are those of "
        f"`{journey.output}` in {_horizon(found.horizon)}, over the standard deviation of its "
        "measurement.",
        "## Ladder",
        f"With its declared parameters the model is {100 * given.nrmse:.3g} % off. Fitted, and "
        "with what was found added step by step:",
    )
    heads = ["step", "fitted", "unseen", *(["both"] if whole else []), "cross-validation"]
    rows: list[list[str]] = []
    for step, both in zip(found.steps, walked.both, strict=True):
        assert step.holdout is not None
        errors = [c.channels[journey.output].nrmse for c in (step.train, step.holdout)]
        errors += [both] if whole else []
        rows.append(
            [
                "as given, fitted" if step.added is None else f"+ `{step.added.label}`",
                *(f"{100 * e:.3g} %" for e in errors),
                "" if step.verdict is None else step.verdict.reason,
            ]
        )
    page.table(heads, rows)
    for step in found.steps:
        for tie in step.diagnosis.ties:
            page.text("This record does not tell apart: " + ", ".join(f"`{t}`" for t in tie) + ".")
    page.text(f"What remains: `{found.outcome.value}`.", "## Parameters")
    last = found.steps[-1]
    values = last.model.dae.parameter_values
    page.table(
        ["parameter", "value", "sd"],
        [
            [f"`{last.model.user_name(name)}`", f"{values[name]:.4g}", f"{np.sqrt(variance):.1g}"]
            for name, variance in zip(last.fit.free, np.diag(last.fit.covariance), strict=True)
            if name in values
        ],
    )
    page.text("## Picture")

    def draw(axes: list[Axes]) -> None:
        first = found.steps[0]
        assert first.holdout is not None
        assert last.holdout is not None
        for column, (title, stretch, before, after) in enumerate(
            (
                ("fitted", journey.fitted, first.train, last.train),
                ("unseen", journey.unseen, first.holdout, last.holdout),
            )
        ):
            top, below = axes[column], axes[2 + column]
            top.set_title(title)
            time = journey.record(stretch).uniform().time
            k = list(after.channels).index(journey.output)
            curve(top, time, (after.prediction.error + after.prediction.simulated)[:, k], color="k")
            curve(below, time, before.prediction.error[:, k], color="0.7", label="as given, fitted")
            curve(below, time, after.prediction.error[:, k], color="C0", label="last step")
            below.set_xlabel("time [s]")
        axes[0].set_ylabel(journey.output)
        axes[2].set_ylabel("error")
        axes[2].legend(fontsize=7)

    page.picture("errors", "Measured signal, and what the model leaves over.", 2, 2, draw)
    return page.write()


def _words(stretch: Stretch) -> str:
    return f"`{stretch.data}`, {stretch.begin:.4g} to {stretch.end:.4g} s"


def _horizon(seconds: float | None) -> str:
    return "the free simulation" if seconds is None else f"windows of {seconds:g} s"
