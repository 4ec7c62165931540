"""Expressions that step at events: relations, integer division, `sample` and `initial()`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fmus.expressions import Expression, Literal, Operation, Previous, Relation, Symbol, Time


@dataclass(frozen=True)
class Floor:
    """A discrete variable that is the floor of an operand, stepping at events."""

    name: str
    operand: Expression


class Stepwise:
    """Makes them while a model is read, and keeps account.

    Args:
        changes: Whether an expression may change during a simulation.

    Attributes:
        relations: In order of their index.
        floors: Variables that stand for integer divisions.
        ticks: Names of the counters of samples, and the relations that advance them.
    """

    def __init__(self, changes: Callable[[Expression], bool]) -> None:
        self._changes = changes
        self._clocks: dict[int, Relation] = {}
        self._initially: Relation | None = None
        self.relations: list[Relation] = []
        self.floors: list[Floor] = []
        self.ticks: dict[str, Relation] = {}

    @property
    def clock_relations(self) -> frozenset[int]:
        """Indices of the relations that stand for `sample(…)`."""
        return frozenset(relation.index for relation in self._clocks.values())

    @property
    def initial_relations(self) -> frozenset[int]:
        """Indices of the relations that stand for `initial()`."""
        return frozenset() if self._initially is None else frozenset((self._initially.index,))

    def relation(self, comparison: Operation) -> Relation:
        """Number a comparison that makes events."""
        relation = Relation(len(self.relations), comparison)
        self.relations.append(relation)
        return relation

    def initially(self) -> Relation:
        """Return `initial()`: a relation that never holds, but which the runtime sets at first."""
        if self._initially is None:
            self._initially = self.relation(Operation("less", (Literal(1.0), Literal(0.0))))
        return self._initially

    def clock(self, number: int, start: float, interval: float) -> Relation:
        """Return sample(start, interval): time has reached the instant after the last counted."""
        if number not in self._clocks:
            name = f"_samples_{number + 1}"
            count = Previous(name)
            # A rounding error before the instant is the instant.
            instant = _plus(Literal(start - 2e-10), _times(Literal(interval), count))
            relation = self.relation(Operation("greater_equal", (Time(), instant)))
            self._clocks[number] = relation
            self.ticks[name] = relation
        return self._clocks[number]

    def rounded(self, name: str, operands: Sequence[Expression], events: bool) -> Expression:
        """Return floor, integer, ceil, mod, div or rem of operands."""
        match name:
            case "floor" | "integer":
                return self._floor(operands[0], events)
            case "ceil":
                return _negative(self._floor(_negative(operands[0]), events))
            case _:
                return self.quotient(name, operands[0], operands[1], events)

    def quotient(self, name: str, a: Expression, b: Expression, events: bool) -> Expression:
        """Return mod, div or rem of two operands."""
        ratio = Operation("divide", (a, b))
        if name == "mod":
            return Operation("subtract", (a, _times(self._floor(ratio, events), b)))
        # Towards zero: down where the ratio is positive, up where it is negative.
        down = self._floor(ratio, events)
        up = _negative(self._floor(_negative(ratio), events))
        positive = Operation("greater_equal", (down, Literal(0)))
        quotient = Operation("if", (positive, down, up))
        if name == "div":
            return quotient
        return Operation("subtract", (a, _times(quotient, b)))

    def _floor(self, operand: Expression, events: bool) -> Expression:
        if not events or not self._changes(operand):
            return Operation("floor", (operand,))
        name = f"_floor_{len(self.floors) + 1}"
        self.floors.append(Floor(name, operand))
        return Symbol(name)

    def floor_value(self, floor: Floor) -> Expression:
        """Value of a stepping variable at every event: unchanged between two whole numbers."""
        last = Previous(floor.name)
        outside: list[Expression] = []
        for operator, bound in (("less", last), ("greater_equal", _plus(last, Literal(1)))):
            outside.append(self.relation(Operation(operator, (floor.operand, bound))))
        # The event lies a rounding error beyond the whole number, on either side.
        return Operation(
            "if",
            (Operation("or", tuple(outside)), Operation("floor", (floor.operand,)), last),
        )


def _plus(a: Expression, b: Expression) -> Expression:
    return Operation("add", (a, b))


def _times(a: Expression, b: Expression) -> Expression:
    return Operation("multiply", (a, b))


def _negative(a: Expression) -> Expression:
    return Operation("negate", (a,))
