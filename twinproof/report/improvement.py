"""The report of `improve`: what was missing, step by step, and how it fared on unseen data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from foundation.errors import TwinproofError
from identification.comparison import Comparison
from identification.discovery.effects import unit_at
from identification.discovery.extension import text_diff
from identification.discovery.ladder import Improvement, Step
from identification.discovery.shape import missing_force
from identification.discovery.transfer import transfer_problem
from identification.problem import Problem
from twinproof.report import ladder_plot, record_plots, shape_plot, wording
from twinproof.report.ladder_plot import LadderPanel, Rung
from twinproof.report.numbers import percent, quantity, significant, typeset, typeset_powers
from twinproof.report.page import provenance, write_page
from twinproof.report.picture import Picture, unit_of
from twinproof.report.record_plots import Run
from twinproof.report.svg import Role
from twinproof.report.tables import (
    CandidateRow,
    candidate_rows,
    channel_rows,
    diff_rows,
    fit_rows,
    span_rows,
)

_MOST_PANELS = 6


@dataclass(frozen=True)
class StepRow:
    """One row of the ladder's table."""

    number: int
    added: str
    description: str
    parameters: str
    fitted: tuple[str, ...]
    unseen: tuple[str, ...]
    short: tuple[str, str]
    status: str
    reason: str
    contradicted: bool


@dataclass(frozen=True)
class Lacks:
    """What one step still lacks, ranked."""

    number: int
    name: str
    verdict: str
    refitted: list[CandidateRow]
    scored: list[CandidateRow]
    skipped: dict[str, str]
    ties: list[str]
    next_experiment: str


@dataclass(frozen=True)
class Shape:
    """The shape of what one step added, or why there is none to show."""

    number: int
    label: str
    picture: Picture | None
    why_not: str


@dataclass(frozen=True)
class _Short:
    """Errors over one-second windows, by which steps are judged."""

    fitted: float
    unseen: float | None


def write_improvement(
    improvement: Improvement,
    problem: Problem,
    holdout: Problem | None,
    path: Path,
    *,
    command: str,
    notes: Sequence[str] = (),
) -> None:
    """Write the report of a finished ladder as one self-contained HTML file.

    Args:
        improvement: From `identification.discovery.ladder.improve`.
        problem: The fitted record with the user's model.
        holdout: The unseen record with the user's model, if there is one.
        path: File to write.
        command: That repeats the run.
        notes: What a reader should know of the data.

    Raises:
        OSError: The file cannot be written.
    """
    first, last = improvement.steps[0], improvement.steps[-1]
    horizon = improvement.horizon
    short = [_short(step, improvement, holdout) for step in improvement.steps]
    records = {"Fitted record": problem}
    if holdout is not None:
        records["Unseen record"] = holdout
    unseen_runs = _runs(first, last, unseen=True) if holdout is not None else []
    fitted_runs = _runs(first, last, unseen=False)
    duration = float(problem.time[-1])
    write_page(
        path,
        "improvement.html",
        headline=wording.improvement_headline(improvement),
        fall=wording.improvement_fall(improvement, problem),
        remaining=wording.remaining(improvement),
        certainty=[s for s in wording.certainty(improvement) if s],
        contradicted=[wording.contradiction(s) for s in improvement.steps if s.contradicted],
        next_experiment=last.diagnosis.next_experiment,
        verdict=improvement.outcome.value,
        model_name=first.model.base.short_name,
        rows=[
            _row(s, e, problem, windows=_over_windows(improvement))
            for s, e in zip(improvement.steps, short, strict=True)
        ],
        horizon_name=wording.horizon_name(horizon),
        drifts=_drifts(improvement, short),
        ladder=ladder_plot.ladder(_panels(improvement, problem, short), "ladder"),
        traces=[
            ("Fitted record", record_plots.traces(problem, fitted_runs, "fitted")),
            *(
                [("Unseen record", record_plots.traces(holdout, unseen_runs, "unseen"))]
                if holdout is not None
                else []
            ),
        ],
        over_time=record_plots.residual_over_time(
            problem, fitted_runs, improvement.sensor_noise, "over-time"
        ),
        over_variables=record_plots.residual_over_variables(problem, fitted_runs, "over-variables"),
        spans=[] if wording.at_noise(last.train) else span_rows(problem, last.train),
        channels=channel_rows(problem, last.train, improvement.noise_floor),
        unseen_channels=(
            channel_rows(holdout, last.holdout)
            if holdout is not None and last.holdout is not None
            else []
        ),
        lacks=[_lacks(step) for step in improvement.steps],
        shapes=[_shape(step) for step in improvement.steps[1:]],
        diff=diff_rows(text_diff(first.model.base, last.model)),
        class_text=last.model.class_text,
        class_name=last.model.name,
        base_text=first.model.base.origin,
        parameters=fit_rows(last.model, last.fit, problem),
        condition_number=significant(last.fit.condition_number, 2),
        warnings=_warnings(last),
        provenance=provenance(command, wording.horizon_rule(horizon, duration), records, notes),
    )


def ladder_picture(improvement: Improvement, problem: Problem, holdout: Problem | None) -> Picture:
    """Draw how the errors fall from step to step."""
    short = [_short(step, improvement, holdout) for step in improvement.steps]
    return ladder_plot.ladder(_panels(improvement, problem, short), "ladder")


def shapes_of(improvement: Improvement) -> list[Picture]:
    """Draw the shape of every force that was added, where it makes sense."""
    found = [_shape(step).picture for step in improvement.steps[1:]]
    return [picture for picture in found if picture is not None]


def _short(step: Step, improvement: Improvement, holdout: Problem | None) -> _Short:
    values, sd = step.fit.values, step.fit.sd
    fitted = step.experiment.predict(values, step.experiment.short, sd=sd).total_nrmse
    if holdout is None:
        return _Short(fitted, None)
    free = improvement.steps[0].experiment.problem.free
    record = transfer_problem(replace(holdout, free=free), step.model, values, step.model)
    unseen = step.experiment.on(record)
    return _Short(fitted, unseen.predict(values, unseen.short, sd=sd).total_nrmse)


def _over_windows(improvement: Improvement) -> bool:
    """Errors over short windows are another thing than those at the horizon, and can be had."""
    return improvement.horizon is None and improvement.steps[0].experiment.short is not None


def _row(step: Step, short: _Short, problem: Problem, *, windows: bool) -> StepRow:
    addition = step.model.additions[-1] if step.added is not None else None
    status = "the model as it was, refitted"
    if step.added is not None:
        status = "contradicted by the unseen record" if step.contradicted else "accepted"
        if step.holdout is not None and not step.contradicted:
            status = "accepted, supported by the unseen record"
    return StepRow(
        number=step.number,
        added="" if addition is None else addition.label,
        description="" if addition is None else addition.effect.description,
        parameters=(
            "" if addition is None else ", ".join(_value(step, name) for name in addition.values)
        ),
        fitted=_errors(problem, step.train),
        unseen=() if step.holdout is None else _errors(problem, step.holdout),
        short=(
            (percent(short.fitted), "" if short.unseen is None else percent(short.unseen))
            if windows
            else ("", "")
        ),
        status=status,
        reason="" if step.verdict is None else typeset_powers(step.verdict.reason),
        contradicted=step.contradicted,
    )


def _value(step: Step, name: str) -> str:
    addition = step.model.additions[-1]
    parameter = next(p for p in addition.effect.parameters if p.name == name)
    shown = unit_at(parameter, addition.place)
    number = significant(addition.values[name], 4)
    return f"{name} = {number} {typeset(shown)}" if shown not in ("", "1") else f"{name} = {number}"


def _errors(problem: Problem, comparison: Comparison) -> tuple[str, ...]:
    """Return the overall error, then each channel's."""
    return (
        percent(comparison.nrmse),
        *(
            f"{name} {quantity(channel.rmse, unit_of(problem, name))}"
            for name, channel in comparison.channels.items()
        ),
    )


def _drifts(improvement: Improvement, short: Sequence[_Short]) -> bool:
    """A step that is better over short windows is worse in free simulation."""
    if not _over_windows(improvement):
        return False
    scored = [
        s.holdout.nrmse if s.holdout is not None else s.train.nrmse for s in improvement.steps
    ]
    judged = [e.unseen if e.unseen is not None else e.fitted for e in short]
    return any(
        free[1] > free[0] and near[1] < near[0]
        for free, near in zip(itertools.pairwise(scored), itertools.pairwise(judged), strict=True)
    )


def _panels(
    improvement: Improvement, problem: Problem, short: Sequence[_Short]
) -> list[LadderPanel]:
    steps = improvement.steps
    labels = [
        ladder_plot.step_label(s.number, "" if s.added is None else s.added.effect.name)
        for s in steps
    ]
    name = wording.horizon_name(improvement.horizon)
    panels: list[LadderPanel] = []
    if len(problem.output_names) > 1:
        rungs = tuple(
            Rung(
                label,
                100 * s.train.nrmse,
                None if s.holdout is None else 100 * s.holdout.nrmse,
            )
            for label, s in zip(labels, steps, strict=True)
        )
        floor = 100 * wording.floor_share(steps[-1].train)
        panels.append(LadderPanel(f"all channels, {name}", "%", rungs, floor))
    if _over_windows(improvement):
        rungs = tuple(
            Rung(label, 100 * e.fitted, None if e.unseen is None else 100 * e.unseen)
            for label, e in zip(labels, short, strict=True)
        )
        panels.append(LadderPanel("windows of 1 s, by which steps are judged", "%", rungs))
    for channel in problem.output_names:
        rungs = tuple(
            Rung(
                label,
                s.train.channels[channel].rmse,
                None if s.holdout is None else s.holdout.channels[channel].rmse,
            )
            for label, s in zip(labels, steps, strict=True)
        )
        floor = improvement.noise_floor.get(channel, math.nan)
        panels.append(LadderPanel(f"{channel}, {name}", unit_of(problem, channel), rungs, floor))
    return panels[:_MOST_PANELS]


def _runs(first: Step, last: Step, *, unseen: bool) -> list[Run]:
    pairs = [
        (step, step.holdout if unseen else step.train)
        for step in ((first,) if first is last else (first, last))
    ]
    return [
        Run(
            "step 0: as it was, refitted"
            if step is first
            else f"step {step.number}: {_effects(step)}",
            Role.FIRST if step is first and first is not last else Role.LAST,
            comparison,
            mark=not wording.at_noise(comparison),
        )
        for step, comparison in pairs
        if comparison is not None
    ]


def _effects(step: Step) -> str:
    return "with " + ", ".join(a.effect.name for a in step.model.additions)


def _lacks(step: Step) -> Lacks:
    refitted, scored = candidate_rows(step.diagnosis)
    chosen = step.diagnosis.chosen
    return Lacks(
        step.number,
        step.model.name,
        step.diagnosis.outcome.value,
        refitted,
        scored,
        dict(step.diagnosis.skipped),
        [
            wording.tied(tie, "" if chosen is None else chosen.addition.label)
            for tie in step.diagnosis.ties
        ],
        step.diagnosis.next_experiment,
    )


def _shape(step: Step) -> Shape:
    addition = step.model.additions[-1]
    try:
        found = missing_force(step.model, step.experiment, step.fit.values, step.fit.sd, addition)
    except TwinproofError as error:
        # A picture that makes no sense is no reason to withhold the report.
        return Shape(step.number, addition.label, None, f"No picture: {error}.")
    picture = shape_plot.missing_force(
        found, addition.effect.name, addition.place.unit, f"shape-{step.number}"
    )
    return Shape(step.number, addition.label, picture, "")


def _warnings(last: Step) -> list[str]:
    fit = last.fit
    values = [
        (last.model.user_name(name), fit.values[name], math.sqrt(fit.covariance[k, k]))
        for k, name in enumerate(fit.free)
        if name not in fit.held
    ]
    held = sorted(last.model.user_name(name) for name in fit.held)
    return wording.fit_warnings(values, held, fit.condition_number)
