"""Results as tables for people."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rich.table import Table

from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.drift import Change, Drift
from identification.discovery.ladder import Improvement
from identification.estimate import Estimate
from twinproof.documents import horizon_word

_SHOWN = 10


def number(value: float, digits: int = 4) -> str:
    """Return a number with sensible digits.

    Example:
        >>> number(0.00123456), number(float("inf"))
        ('0.001235', '∞')
    """
    if math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:.{digits}g}"


def with_sd(value: float, sd: float) -> str:
    """Return `value ± sd`, the value to the digit where the doubt begins.

    Example:
        >>> with_sd(95.1089, 0.203)
        '95.11 ± 0.20'
    """
    if not math.isfinite(sd) or sd <= 0:
        return f"{number(value, 6)} ± {number(sd)}"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    if decimals > 8 or abs(value) >= 1e7:
        return f"{value:.6g} ± {sd:.2g}"
    return f"{value:.{decimals}f} ± {sd:.{decimals}f}"


def channels(comparison: Comparison, units: Mapping[str, str], horizon: float | None) -> Table:
    """Return the channels' errors, RMSE and bias in the channel's unit."""
    kind = "free simulation" if horizon is None else f"windows of {horizon:g} s"
    table = Table(title=f"measured against simulated ({kind})", title_justify="left")
    for heading in ("channel", "unit", "RMSE", "NRMSE", "bias", "white p"):
        table.add_column(heading, justify="left" if heading in ("channel", "unit") else "right")
    for name, c in comparison.channels.items():
        errors = number(c.rmse), f"{100 * c.nrmse:.2f} %", number(c.bias), number(c.white_p, 2)
        table.add_row(name, units[name], *errors)
    return table


def failures(comparison: Comparison, units: Mapping[str, str]) -> Table:
    """Return where a model fails."""
    table = Table(title="where it fails", title_justify="left")
    for heading in ("from … to in s", "channel", "RMSE there", "where"):
        table.add_column(heading)
    for f in comparison.worst:
        where = ", ".join(
            f"{name} in {number(low, 3)} … {number(high, 3)}"
            for name, (low, high) in f.where.items()
        )
        error = f"{number(f.rmse)} {units[f.channel]}"
        table.add_row(f"{f.begin:.2f} … {f.end:.2f}", f.channel, error, where)
    return table


def parameters(estimate: Estimate) -> Table:
    """Return fitted parameters."""
    table = Table(title=f"parameters ({estimate.method})", title_justify="left")
    for heading in ("parameter", "value ± sd", "unit", ""):
        table.add_column(heading, overflow="fold")
    for name, p in estimate.parameters.items():
        table.add_row(
            name, with_sd(p.value, p.sd), p.unit, "" if p.identifiable else "not identifiable"
        )
    return table


def ranking(diagnosis: Diagnosis) -> Table:
    """Return the ranked effects."""
    table = Table(title="what may be missing", title_justify="left")
    for heading in (
        "effect @ place",
        "evidence [nats]",
        "explains",
        "parameters",
        "unseen windows",
    ):
        table.add_column(heading)
    for row in [r for r in diagnosis.ranking if r.refitted][:_SHOWN]:
        values = ", ".join(
            f"{name} = {with_sd(v, sd)} {unit}".rstrip()
            for name, (v, sd, unit) in row.parameters.items()
        )
        check = diagnosis.checks.get(row.label)
        said = "" if check is None else ("accepted" if check.accepted else "rejected")
        table.add_row(row.label, f"{row.evidence:.1f}", f"{100 * row.explains:.1f} %", values, said)
    return table


def ladder(improvement: Improvement) -> Table:
    """Return the ladder of errors."""
    names = list(improvement.noise_floor)
    kind = horizon_word(improvement.horizon)
    title = f"the ladder (horizon: {kind if kind == 'free' else f'{kind:g} s windows'})"
    table = Table(title=title, title_justify="left")
    table.add_column("step")
    table.add_column("added")
    for name in names:
        table.add_column(f"{name}\nfitted", justify="right")
        table.add_column(f"{name}\nunseen", justify="right")
    table.add_column("NRMSE\nfitted", justify="right")
    table.add_column("NRMSE\nunseen", justify="right")
    for step in improvement.steps:
        row = [str(step.number), "" if step.added is None else step.added.label]
        row[1] += "".join(f"\nwithout {a.label}" for a in step.removed)
        if step.contradicted:
            row[1] += " (contradicted by the unseen record)"
        for name in names:
            row.append(number(step.train.channels[name].rmse))
            row.append("" if step.holdout is None else number(step.holdout.channels[name].rmse))
        row.append(f"{100 * step.train.nrmse:.2f} %")
        row.append("" if step.holdout is None else f"{100 * step.holdout.nrmse:.2f} %")
        table.add_row(*row)
    floor = ["", "noise floor"]
    for name in names:
        floor += [number(improvement.noise_floor[name]), ""]
    table.add_row(*floor, "", "", style="dim")
    return table


_CHANGED = {
    Change.NOTHING: "nothing has changed since the parameters were verified",
    Change.DRIFTED: "parameters have moved; no effect explains it as well",
    Change.MISSING: "something has appeared that moved parameters do not explain",
    Change.EITHER: "parameters have moved, or an effect that acts like them has appeared",
}


def drift(found: Drift) -> Table:
    """Return what explains a record beside verified parameters."""
    title = f"{found.change.value}: {_CHANGED[found.change]}"
    table = Table(title=title, title_justify="left")
    for heading in ("let go", "verified", "now", "merit [nats]"):
        table.add_column(heading, justify="left" if heading == "let go" else "right")
    for one in found.moved:
        before = ", ".join(number(value) for value, _, _ in one.values.values())
        now = ", ".join(with_sd(value, sd) for _, value, sd in one.values.values())
        table.add_row(", ".join(one.values), before, now, number(one.merit, 3))
    if found.effect:
        table.add_row(found.effect, "", "", number(found.effect_merit, 3))
    return table
