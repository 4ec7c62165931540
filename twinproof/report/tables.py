"""The rows of a report's tables, as text that templates only have to place."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis, Ranked
from identification.discovery.extension import ExtendedModel
from identification.estimate import Estimate
from identification.gauss_newton import Fit
from identification.problem import Problem
from twinproof.report.numbers import (
    percent,
    quantity,
    scale_for,
    significant,
    typeset,
    uncertain,
    with_unit,
)
from twinproof.report.picture import unit_of
from twinproof.report.wording import fate, white


@dataclass(frozen=True)
class ChannelRow:
    """One channel's error; `white` is empty over windows, whose estimated starts are correlated."""

    name: str
    rmse: str
    nrmse: str
    bias: str
    white: str
    floor: str


@dataclass(frozen=True)
class ParameterRow:
    """One fitted parameter."""

    name: str
    description: str
    value: str
    unit: str
    start: str
    note: str


@dataclass(frozen=True)
class CandidateRow:
    """One candidate of a ranking; `bar` is its evidence as a share of the best one's, in per cent.

    `evidence` and `parameters` are empty for a candidate that only the score test has looked at.
    """

    label: str
    evidence: str
    bar: float
    explains: str
    parameters: tuple[str, ...]
    fate: str
    reason: str


@dataclass(frozen=True)
class SpanRow:
    """One span in which a model fails."""

    number: int
    time: str
    channel: str
    rmse: str
    where: tuple[str, ...]


def channel_rows(
    problem: Problem, comparison: Comparison, floor: Mapping[str, float] | None = None
) -> list[ChannelRow]:
    """Return each channel's errors, with the error that noise alone would leave."""
    floors = floor if floor is not None else _floors(comparison)
    rows: list[ChannelRow] = []
    for name, channel in comparison.channels.items():
        unit = unit_of(problem, name)
        least = floors.get(name, math.nan)
        rows.append(
            ChannelRow(
                name,
                quantity(channel.rmse, unit),
                percent(channel.nrmse),
                quantity(channel.bias, unit, 2),
                white(channel.white_p) if comparison.prediction.horizon is None else "",
                quantity(least, unit, 2) if math.isfinite(least) else "unknown",
            )
        )
    return rows


def _floors(comparison: Comparison) -> dict[str, float]:
    return dict(zip(comparison.channels, comparison.prediction.floor.tolist(), strict=True))


def span_rows(problem: Problem, comparison: Comparison) -> list[SpanRow]:
    """Return where a model fails, worst first."""
    return [
        SpanRow(
            k,
            f"{significant(f.begin, 4)} to {significant(f.end, 4)} s",
            f.channel,
            quantity(f.rmse, unit_of(problem, f.channel)),
            tuple(_range(problem, name, *span) for name, span in f.where.items()),
        )
        for k, f in enumerate(comparison.worst, 1)
    ]


def _range(problem: Problem, name: str, low: float, high: float) -> str:
    scale = scale_for(unit_of(problem, name), max(abs(low), abs(high)))
    text = f"{name} {significant(low / scale.size)} to {significant(high / scale.size)}"
    return text if scale.unit == "1" else f"{text} {scale.unit}"


def fit_rows(model: ExtendedModel, fit: Fit, problem: Problem) -> list[ParameterRow]:
    """Return a fit's parameters under the names of the user's model.

    Args:
        model: The fitted model.
        fit: Its fit.
        problem: Of the user's own model: where its values started.
    """
    dae = model.dae
    rows: list[ParameterRow] = []
    for k, flat in enumerate(fit.free):
        name = model.user_name(flat)
        variable = dae.variables.get(flat) or dae.variables[name]
        sd = math.sqrt(fit.covariance[k, k]) if flat not in fit.held else math.inf
        start = problem.values.get(name)
        rows.append(
            ParameterRow(
                name,
                variable.description,
                uncertain(fit.values[flat], sd),
                typeset(variable.unit),
                "new" if start is None else significant(start, 4),
                "held: the data do not see it" if flat in fit.held else "",
            )
        )
    return rows


def estimate_rows(estimate: Estimate, problem: Problem) -> list[ParameterRow]:
    """Return an estimate's parameters."""
    declared = problem.dae.parameter_values
    return [
        ParameterRow(
            name,
            problem.dae.variables[name].description if name in problem.dae.variables else "",
            uncertain(p.value, p.sd if p.identifiable else math.inf),
            typeset(p.unit),
            significant(declared[name], 4) if name in declared else "–",
            "" if p.identifiable else "held: the data do not see it",
        )
        for name, p in estimate.parameters.items()
    ]


def candidate_rows(diagnosis: Diagnosis) -> tuple[list[CandidateRow], list[CandidateRow]]:
    """Return the candidates that were refitted, and those that only the score test looked at."""
    best = max((r.evidence for r in diagnosis.ranking if r.refitted), default=0.0)
    refitted = [_candidate(r, diagnosis, best) for r in diagnosis.ranking if r.refitted]
    scored = [_candidate(r, diagnosis, best) for r in diagnosis.ranking if not r.refitted]
    return refitted, scored


def _candidate(row: Ranked, diagnosis: Diagnosis, best: float) -> CandidateRow:
    share = row.evidence / best if best > 0 and math.isfinite(row.evidence) else 0.0
    what, reason = fate(row, diagnosis)
    return CandidateRow(
        row.label,
        _not_less(row.evidence, 0.01, significant) if row.refitted else "",
        100.0 * min(max(share, 0.0), 1.0),
        _not_less(max(row.explains, 0.0), 1e-4, percent, "0 %"),
        tuple(
            with_unit(f"{name} = {uncertain(value, sd)}", unit)
            for name, (value, sd, unit) in row.parameters.items()
        ),
        what,
        reason,
    )


def _not_less(value: float, least: float, shown: Callable[[float], str], nothing: str = "0") -> str:
    """Return a number, or nothing where its size means nothing."""
    return nothing if abs(value) < least else shown(value)


def diff_rows(text: str) -> list[tuple[str, str]]:
    """Return a unified diff's lines with their kind: `add`, `del`, `file`, `at` or `same`."""
    return [(_kind(line), line) for line in text.splitlines()]


def _kind(line: str) -> str:
    prefixes: Sequence[tuple[str, str]] = (
        ("+++", "file"),
        ("---", "file"),
        ("@@", "at"),
        ("+", "add"),
        ("-", "del"),
    )
    return next((kind for prefix, kind in prefixes if line.startswith(prefix)), "same")
