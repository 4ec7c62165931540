"""Results as tables for people: the rows of the report, laid out for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.drift import Change, Drift
from identification.discovery.ladder import Improvement
from identification.problem import Problem
from twinproof.report.numbers import percent, quantity, significant, uncertain
from twinproof.report.picture import unit_of
from twinproof.report.tables import ParameterRow, candidate_rows, channel_rows, span_rows
from twinproof.report.wording import horizon_name

_SHOWN = 10


def channels(problem: Problem, comparison: Comparison) -> Table:
    """Return the channels' errors."""
    kind = horizon_name(comparison.prediction.horizon)
    table = Table(title=f"measured against simulated ({kind})", title_justify="left")
    rows = channel_rows(problem, comparison)
    # Over windows, whose estimated starts are correlated, nothing is said of it.
    whiteness = any(row.white for row in rows)
    for heading in ("channel", "RMSE", "NRMSE", "bias", "noise alone"):
        table.add_column(heading, justify="left" if heading == "channel" else "right")
    if whiteness:
        table.add_column("what is left is")
    for row in rows:
        shown = (row.name, row.rmse, row.nrmse, row.bias, row.floor)
        table.add_row(*shown, *([row.white] if whiteness else []))
    return table


def failures(problem: Problem, comparison: Comparison) -> Table:
    """Return where a model fails."""
    table = Table(title="where it fails", title_justify="left")
    for heading in ("when", "channel", "RMSE there", "where"):
        table.add_column(heading)
    for row in span_rows(problem, comparison):
        table.add_row(row.time, row.channel, row.rmse, ", ".join(row.where))
    return table


def parameters(rows: Sequence[ParameterRow], origin: str) -> Table:
    """Return fitted parameters.

    Args:
        rows: Of a fit or an estimate.
        origin: What they come from, in a word or two.
    """
    table = Table(title=f"parameters ({origin})", title_justify="left")
    noted = any(row.note for row in rows)
    for heading in ("parameter", "value ± sd", "unit", "was", *([""] if noted else [])):
        table.add_column(heading, overflow="fold")
    for row in rows:
        shown = (row.name, row.value, row.unit, row.start)
        table.add_row(*shown, *([row.note] if noted else []))
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
    for row in candidate_rows(diagnosis)[0][:_SHOWN]:
        check = diagnosis.checks.get(row.label)
        said = "" if check is None else ("accepted" if check.accepted else "rejected")
        table.add_row(row.label, row.evidence, row.explains, ", ".join(row.parameters), said)
    return table


def ladder(improvement: Improvement, problem: Problem) -> Table:
    """Return the ladder of errors.

    Args:
        improvement: The ladder.
        problem: The first fitted record, which knows the units.
    """
    units = {name: unit_of(problem, name) for name in improvement.noise_floor}
    kind = horizon_name(improvement.horizon)
    table = Table(title=f"the ladder: root mean square errors ({kind})", title_justify="left")
    table.add_column("step")
    table.add_column("added")
    for name in units:
        table.add_column(f"{name}\nfitted", justify="right")
        table.add_column(f"{name}\nunseen", justify="right")
    table.add_column("NRMSE\nfitted", justify="right")
    table.add_column("NRMSE\nunseen", justify="right")
    for step in improvement.steps:
        row = [str(step.number), "nothing" if step.added is None else step.added.label]
        row[1] += "".join(f"\nwithout {a.label}" for a in step.removed)
        if step.contradicted:
            row[1] += " (contradicted by the unseen record)"
        sides = (step.train, step.holdout)
        for name, unit in units.items():
            row += [
                "" if side is None else quantity(side.channels[name].rmse, unit) for side in sides
            ]
        row += ["" if side is None else percent(side.nrmse) for side in sides]
        table.add_row(*row)
    floor = ["", "noise floor"]
    for name, unit in units.items():
        floor += [quantity(improvement.noise_floor[name], unit), ""]
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
        before = ", ".join(significant(value, 4) for value, _, _ in one.values.values())
        now = ", ".join(uncertain(value, sd) for _, value, sd in one.values.values())
        table.add_row(", ".join(one.values), before, now, significant(one.merit))
    if found.effect:
        table.add_row(found.effect, "", "", significant(found.effect_merit))
    return table
