"""The report of `compare`: how well a model predicts a record, and where it fails."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from identification.comparison import Comparison
from identification.prediction import noise_estimate
from identification.problem import Problem
from twinproof.report import record_plots, wording
from twinproof.report.numbers import quantity, significant
from twinproof.report.page import provenance, write_page
from twinproof.report.picture import Picture
from twinproof.report.record_plots import Run
from twinproof.report.svg import Role
from twinproof.report.tables import ChannelRow, SpanRow, channel_rows, span_rows


def record_context(problem: Problem, comparison: Comparison) -> dict[str, object]:
    """Return what the template `record.html` draws: errors, traces, residuals, spans."""
    runs = [Run(problem.dae.name, Role.LAST, comparison, mark=not wording.at_noise(comparison))]
    noise = dict(zip(problem.output_names, noise_estimate(problem).tolist(), strict=True))
    channels: list[ChannelRow] = channel_rows(problem, comparison)
    spans: list[SpanRow] = [] if wording.at_noise(comparison) else span_rows(problem, comparison)
    traces: list[tuple[str, Picture]] = [("", record_plots.traces(problem, runs, "traces"))]
    return {
        "channels": channels,
        "spans": spans,
        "traces": traces,
        "over_time": record_plots.residual_over_time(problem, runs, noise, "over-time"),
        "over_variables": record_plots.residual_over_variables(problem, runs, "over-variables"),
        "horizon_name": wording.horizon_name(comparison.prediction.horizon),
    }


def error_sentence(problem: Problem, comparison: Comparison) -> str:
    """Return the error in one sentence, and whether it could be noise."""
    horizon = comparison.prediction.horizon
    wild = np.flatnonzero(~np.all(np.isfinite(comparison.prediction.simulated), axis=1))
    if len(wild):
        return (
            "The simulation leaves the finite numbers "
            f"{quantity(float(problem.time[wild[0]]), 's')} after the start of the record. Check "
            "units and signs of the inputs, or give other parameter values."
        )
    sentence = (
        f"The {wording.error_measure(problem, horizon)} is {wording.error_of(problem, comparison)}."
    )
    ratio = wording.noise_ratio(comparison)
    if ratio <= wording.AT_NOISE:
        return f"{sentence} Sensor noise alone would leave as much."
    if not math.isfinite(ratio) or ratio > wording.FAR:
        return f"{sentence} That is far above the sensors’ noise."
    return (
        f"{sentence} That is up to {significant(ratio)} times what sensor noise alone would leave."
    )


def write_comparison(
    comparison: Comparison,
    problem: Problem,
    path: Path,
    *,
    command: str,
    notes: Sequence[str] = (),
) -> None:
    """Write the report of a comparison as one self-contained HTML file.

    Args:
        comparison: Errors, and where the model fails.
        problem: Model and record.
        path: File to write.
        command: That repeats the run.
        notes: What a reader should know of the data.

    Raises:
        OSError: The file cannot be written.
    """
    rule = wording.horizon_rule(comparison.prediction.horizon, float(problem.time[-1]))
    write_page(
        path,
        "comparison.html",
        headline=f"{problem.dae.name} against measurement",
        summary=error_sentence(problem, comparison),
        provenance=provenance(command, rule, {"Record": problem}, notes),
        **record_context(problem, comparison),
    )
