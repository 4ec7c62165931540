"""Answers in a notebook: tables as HTML, pictures as SVG that stand by themselves."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

from foundation.errors import InputError
from foundation.files import write_text
from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.ladder import Improvement
from identification.estimate import Estimate
from identification.prediction import noise_estimate
from identification.problem import Problem
from twinproof.report import record_plots, wording
from twinproof.report.comparison import error_sentence
from twinproof.report.improvement import ladder_picture, shapes_of
from twinproof.report.page import STYLE_SHEET, render
from twinproof.report.picture import Picture
from twinproof.report.pieces import shape_of
from twinproof.report.record_plots import Run
from twinproof.report.svg import Role
from twinproof.report.tables import candidate_rows, channel_rows, estimate_rows, fit_rows

_COLOUR = re.compile(r"--([a-z]+):\s*(#[0-9a-fA-F]{6})")


@dataclass(frozen=True)
class Plot:
    """Pictures of an answer: shown by a notebook, or saved.

    Attributes:
        pictures: In the order in which they are shown.
    """

    pictures: tuple[Picture, ...]

    def _repr_html_(self) -> str:
        return "".join(
            f'<figure role="img" aria-label="{escape(p.description)}" style="margin:0 0 1em;'
            f'background:#fff;color:#1c2128;max-width:62em">{standalone(p)}'
            f'<figcaption style="font-size:.85em">{escape(p.caption)}</figcaption></figure>'
            for p in self.pictures
        )

    def save(self, path: Path | str) -> None:
        """Write the first picture as SVG.

        Args:
            path: Its name ends in `.svg`.

        Raises:
            InputError: It ends in something else.
            OSError: It cannot be written.

        Example:
            >>> import tempfile, twinproof
            >>> model, record, _ = twinproof.example()
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     twinproof.compare(model, record).plot().save(f"{folder}/curves.svg")
        """
        target = Path(path)
        if target.suffix.lower() != ".svg":
            raise InputError(
                f"'{target.name}' is no SVG file",
                where="Plot.save",
                remedy="end it in .svg; programs such as Inkscape turn that into others",
            )
        write_text(target, standalone(self.pictures[0]) + "\n")


@cache
def _light() -> dict[str, str]:
    """Return the style sheet's colours on a light page."""
    text = STYLE_SHEET.read_text(encoding="utf-8")
    return dict(_COLOUR.findall(text[: text.index("@media")]))


def standalone(picture: Picture) -> str:
    """Return a picture's SVG with colours of its own, for places that have no style sheet."""
    text = picture.svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    for role in Role:
        text = text.replace(role.css, _light()[role.name.lower()])
    return text


def comparison_html(
    problem: Problem, comparison: Comparison, estimate: Estimate | None = None
) -> str:
    """Return the errors as a table; with an estimate, the parameters as well."""
    return render(
        "notebook.html",
        title="",
        summary=error_sentence(problem, comparison),
        channels=channel_rows(problem, comparison),
        parameters=[] if estimate is None else estimate_rows(estimate, problem),
        warnings=() if estimate is None else estimate.warnings,
        candidates=[],
        ladder=[],
    )


def comparison_plot(problem: Problem, comparison: Comparison) -> Plot:
    """Return measured against simulated, and the error over time."""
    run = Run(problem.dae.name, Role.LAST, comparison, mark=not wording.at_noise(comparison))
    noise = dict(zip(problem.output_names, noise_estimate(problem).tolist(), strict=True))
    return Plot(
        (
            record_plots.traces(problem, [run], "nb-traces"),
            record_plots.residual_over_time(problem, [run], noise, "nb-error"),
        )
    )


def diagnosis_html(diagnosis: Diagnosis, problem: Problem) -> str:
    """Return the verdict and the ranking."""
    return render(
        "notebook.html",
        title=wording.diagnosis_headline(diagnosis, problem.dae.name),
        summary=diagnosis.next_experiment,
        channels=[],
        parameters=[],
        warnings=(),
        candidates=candidate_rows(diagnosis)[0],
        ladder=[],
    )


def diagnosis_plot(diagnosis: Diagnosis, problem: Problem, comparison: Comparison) -> Plot:
    """Return the shape of what is missing, and where the model fails."""
    shape, _ = shape_of(diagnosis)
    pictures = comparison_plot(problem, comparison).pictures
    return Plot((shape, *pictures) if shape is not None else pictures)


def improvement_html(improvement: Improvement, problem: Problem) -> str:
    """Return the ladder and the last step's parameters."""
    last = improvement.steps[-1]
    return render(
        "notebook.html",
        title=wording.improvement_headline(improvement),
        summary=wording.remaining(improvement),
        channels=[],
        parameters=fit_rows(last.model, last.fit, problem),
        warnings=(),
        candidates=[],
        ladder=_ladder(improvement),
    )


def _ladder(improvement: Improvement) -> Sequence[tuple[str, ...]]:
    return [
        (
            str(step.number),
            "nothing" if step.added is None else step.added.label,
            f"{100 * step.train.nrmse:.3g} %",
            "" if step.holdout is None else f"{100 * step.holdout.nrmse:.3g} %",
        )
        for step in improvement.steps
    ]


def improvement_plot(improvement: Improvement, problem: Problem, holdout: Problem | None) -> Plot:
    """Return the ladder, and the shape of every force that was added."""
    return Plot((ladder_picture(improvement, problem, holdout), *shapes_of(improvement)))
