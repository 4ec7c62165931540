"""Pieces of reports without a page around them: what the workbench shows of an answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from foundation.errors import TwinproofError
from identification.comparison import Comparison, Failure
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.shape import missing_force
from identification.estimate import Estimate
from identification.problem import Problem
from twinproof.answers import FittedRecord
from twinproof.report import ladder_plot, record_plots, shape_plot, wording
from twinproof.report.comparison import error_sentence
from twinproof.report.diagnosis import MEANS
from twinproof.report.ladder_plot import LadderPanel, Rung
from twinproof.report.numbers import percent, significant
from twinproof.report.page import render
from twinproof.report.picture import Picture, unit_of
from twinproof.report.record_plots import Run
from twinproof.report.svg import Role
from twinproof.report.tables import (
    ChannelRow,
    ParameterRow,
    SpanRow,
    candidate_rows,
    channel_rows,
    diff_rows,
    estimate_rows,
    span_rows,
)


@dataclass(frozen=True)
class _Compared:
    origin: str
    summary: str
    channels: list[ChannelRow]
    horizon_name: str
    spans: list[tuple[SpanRow, Failure]]
    over_variables: list[Picture]


def comparison_piece(records: Sequence[FittedRecord], estimate: Estimate | None = None) -> str:
    """Return errors, spans that can be looked at, and errors against what was observed.

    Args:
        records: At least one, compared with the same model.
        estimate: Its parameters, where they were fitted.
    """
    return render(
        "piece_comparison.html",
        records=[_compared(record, f"wb-over-{k}") for k, record in enumerate(records)],
        parameters=[] if estimate is None else estimate_rows(estimate, records[0].problem),
        condition_number="" if estimate is None else significant(estimate.condition_number, 2),
        warnings=() if estimate is None else estimate.warnings,
    )


def _compared(record: FittedRecord, picture: str) -> _Compared:
    problem, comparison = record.problem, record.comparison
    run = Run(problem.dae.name, Role.LAST, comparison)
    return _Compared(
        record.origin,
        error_sentence(problem, comparison),
        channel_rows(problem, comparison),
        wording.horizon_name(comparison.prediction.horizon),
        []
        if wording.at_noise(comparison)
        else list(zip(span_rows(problem, comparison), comparison.worst, strict=True)),
        record_plots.residual_over_variables(problem, [run], picture),
    )


def diagnosis_piece(diagnosis: Diagnosis, problem: Problem) -> str:
    """Return the verdict, the ranking with its evidence, and the shape of the missing force."""
    refitted, scored = candidate_rows(diagnosis)
    chosen = diagnosis.chosen
    label = "" if chosen is None else chosen.addition.label
    shape, why_not = shape_of(diagnosis)
    return render(
        "piece_diagnosis.html",
        headline=wording.diagnosis_headline(diagnosis, problem.dae.name),
        verdict=diagnosis.outcome.value,
        means=MEANS[diagnosis.outcome],
        refitted=refitted,
        scored=scored,
        skipped=dict(diagnosis.skipped),
        ties=[wording.tied(tie, label) for tie in diagnosis.ties],
        next_experiment=diagnosis.next_experiment,
        shape=shape,
        shape_of=label,
        why_not=why_not,
    )


def shape_of(diagnosis: Diagnosis) -> tuple[Picture | None, str]:
    """Return the shape of what is missing with the chosen effect over it, or why there is none."""
    chosen = diagnosis.chosen
    if chosen is None:
        return None, ""
    try:
        found = missing_force(
            chosen.model, chosen.experiment, chosen.fit.values, chosen.fit.sd, chosen.addition
        )
    except TwinproofError as error:
        # A picture that makes no sense is no reason to withhold the answer.
        return None, f"No picture: {error}."
    addition = chosen.addition
    return (
        shape_plot.missing_force(found, addition.effect.name, addition.place.unit, "wb-shape"),
        "",
    )


def change_piece(
    diff: str,
    estimate: Estimate,
    problem: Problem,
    errors: tuple[Comparison, Comparison],
    short: tuple[Comparison, Comparison] | None,
) -> str:
    """Return what an addition changes: the Modelica text, the parameters, the error.

    Args:
        diff: Unified, of the Modelica text.
        estimate: With the addition.
        problem: With the addition.
        errors: Without and with it, both refitted.
        short: Likewise over short windows, where `errors` are of the free simulation.
    """
    return render(
        "piece_change.html",
        diff=diff_rows(diff),
        parameters=estimate_rows(estimate, problem),
        condition_number=significant(estimate.condition_number, 2),
        warnings=estimate.warnings,
        falls=[
            (
                wording.horizon_name(after.prediction.horizon),
                percent(before.nrmse),
                percent(after.nrmse),
            )
            for before, after in (errors, *([] if short is None else [short]))
        ],
    )


@dataclass(frozen=True)
class Scored:
    """A step, refitted, on the fitted record and on the unseen one.

    Attributes:
        added: Effect and place; empty for the model as it was.
        problem: The fitted record with this step's model and fitted values.
        estimate: Its parameters.
        train, unseen: Errors; `unseen` is None where no unseen record is given.
    """

    added: str
    problem: Problem
    estimate: Estimate
    train: Comparison
    unseen: Comparison | None


@dataclass(frozen=True)
class _Row:
    number: int
    added: str
    fitted: str
    unseen: str
    parameters: list[ParameterRow]


def ladder_piece(steps: Sequence[Scored]) -> str:
    """Return the error falling from step to step, and every step's parameters."""
    problem = steps[0].problem
    horizon = wording.horizon_name(steps[0].train.prediction.horizon)
    labels = [
        ladder_plot.step_label(k, step.added.partition("@")[0]) for k, step in enumerate(steps)
    ]
    names = problem.output_names
    panels = [
        LadderPanel(
            f"{name}, {horizon}",
            unit_of(problem, name),
            tuple(
                Rung(
                    label,
                    step.train.channels[name].rmse,
                    None if step.unseen is None else step.unseen.channels[name].rmse,
                )
                for label, step in zip(labels, steps, strict=True)
            ),
            float(steps[-1].train.prediction.floor[k]),
        )
        for k, name in enumerate(names[:6])
    ]
    rows = [
        _Row(
            k,
            step.added,
            percent(step.train.nrmse),
            "" if step.unseen is None else percent(step.unseen.nrmse),
            estimate_rows(step.estimate, step.problem),
        )
        for k, step in enumerate(steps)
    ]
    drifts = any(np.diff([step.train.nrmse for step in steps]) > 0)
    return render(
        "piece_ladder.html",
        ladder=ladder_plot.ladder(panels, "wb-ladder"),
        rows=rows,
        horizon_name=horizon,
        drifts=drifts and steps[0].train.prediction.horizon is None,
    )
