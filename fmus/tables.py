"""Tables of the Modelica Standard Library, whose numbers the front end has read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from fmus.expressions import Expression, Literal, Operation, Relation

_LINEAR, _CONSTANT = 1, 3  # Modelica.Blocks.Types.Smoothness
_HOLD, _LAST_TWO = 1, 2  # Modelica.Blocks.Types.Extrapolation
_MOST_EVENTS = 100
_NEVER = 1e60  # Modelica.Constants.inf

PREFIX = "ModelicaStandardTables_"


def table_value(
    symbol: str,
    table: Mapping[str, Any],
    arguments: Sequence[Expression],
    event: Callable[[Operation], Relation] | None,
) -> Expression:
    """Return the value of one of the library's external functions of a table.

    Args:
        symbol: Of the C function.
        table: `data`, `columns`, `smoothness` and `extrapolation`, with numbers.
        arguments: Of the call; the first is the table.
        event: Makes a relation of a comparison; None where there shall be no events.

    Raises:
        ValueError: No translation; says of what.
    """
    rows: list[list[float]] = table["data"]
    match symbol.removeprefix(PREFIX).split("_"):
        case ["CombiTable1D" | "CombiTimeTable", "minimumAbscissa" | "minimumTime"]:
            return Literal(float(rows[0][0]))
        case ["CombiTable1D" | "CombiTimeTable", "maximumAbscissa" | "maximumTime"]:
            return Literal(float(rows[-1][0]))
        case ["CombiTimeTable", "nextTimeEvent"]:
            return Literal(_NEVER)  # comparisons with the table's times are events by themselves
        case ["CombiTable1D" | "CombiTimeTable", "getValue"]:
            column, u = arguments[1], arguments[2]
            if not isinstance(column, Literal):
                raise ValueError("a table's column that is not constant")
            place = int(table["columns"][int(column.value) - 1]) - 1
            points = [(float(row[0]), float(row[place])) for row in rows]
            kinds = int(table["smoothness"]), int(table["extrapolation"])
            return _interpolated(points, *kinds, u, event)
        case _:
            raise ValueError(f"the table function '{symbol}'")


def _interpolated(
    points: Sequence[tuple[float, float]],
    smoothness: int,
    extrapolation: int,
    u: Expression,
    event: Callable[[Operation], Relation] | None,
) -> Expression:
    if smoothness not in (_LINEAR, _CONSTANT):
        raise ValueError("a table with a smoothness other than LinearSegments, ConstantSegments")
    if extrapolation not in (_HOLD, _LAST_TWO):
        raise ValueError("a table with an extrapolation other than HoldLastPoint, LastTwoPoints")
    # Two points at one time are a jump.
    segments = [(a, b) for a, b in pairwise(points) if b[0] > a[0]]
    if not segments:
        return Literal(points[-1][1])
    pieces: list[tuple[float, Expression]] = [
        (a[0], _piece(a, b, smoothness, u)) for a, b in segments
    ]
    if extrapolation == _HOLD:
        pieces.insert(0, (-_NEVER, Literal(points[0][1])))
        pieces.append((points[-1][0], Literal(points[-1][1])))
    elif smoothness == _CONSTANT:
        pieces.append((points[-1][0], Literal(points[-1][1])))
    jumps = smoothness == _CONSTANT or len(segments) + 1 < len(points)
    wanted = event if jumps or len(pieces) <= _MOST_EVENTS else None
    return _chosen(pieces, u, wanted)


def _piece(
    a: tuple[float, float], b: tuple[float, float], smoothness: int, u: Expression
) -> Expression:
    slope = (b[1] - a[1]) / (b[0] - a[0])
    if smoothness == _CONSTANT or slope == 0.0:
        return Literal(a[1])
    beyond = Operation("subtract", (u, Literal(a[0])))
    return Operation("add", (Literal(a[1]), Operation("multiply", (Literal(slope), beyond))))


def _chosen(
    pieces: Sequence[tuple[float, Expression]],
    u: Expression,
    event: Callable[[Operation], Relation] | None,
) -> Expression:
    """Choose the last piece that begins at or before u, by halving."""
    if len(pieces) == 1:
        return pieces[0][1]
    middle = len(pieces) // 2
    comparison = Operation("less", (u, Literal(pieces[middle][0])))
    below = event(comparison) if event is not None else comparison
    sides = (_chosen(pieces[:middle], u, event), _chosen(pieces[middle:], u, event))
    return Operation("if", (below, *sides))
