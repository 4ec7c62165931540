"""The front end's expression arena: nodes read as scalars, or as nested tuples for arrays.

Arrays are taken apart while they are read and functions are inlined; what comes out has scalar
operators only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, TypeAlias

from fmus import arrays, tables
from fmus.arrays import Value
from fmus.dae import Position, Role
from fmus.expressions import (
    Delayed,
    Derivative,
    Expression,
    Literal,
    Operation,
    Previous,
    Relation,
    Symbol,
    Time,
    substitute,
    walk,
)
from fmus.stepwise import Stepwise
from foundation.errors import UnsupportedModelError

_COMPARISONS = {"less", "less_equal", "greater", "greater_equal"}
_WITHOUT_EVENTS = {"no_event", "smooth"}
_QUOTIENT_SLOTS = 7  # the front end counts a mod, rem or div as so many nodes
_DEEPEST_CALL = 50

Refuse: TypeAlias = Callable[[str, Position | None], UnsupportedModelError]


@dataclass
class _Scope:
    """What binders and function parameters stand for while a body is read."""

    binders: Mapping[tuple[int, int], int] = field(default_factory=dict[tuple[int, int], int])
    arguments: Sequence[Value] = ()
    depth: int = 0
    memo: dict[tuple[int, bool], Value] = field(default_factory=dict[tuple[int, bool], Any])


class Arena:
    """Reads expressions of the `dae` dictionary's storage.

    Args:
        store: The dictionary's `storage`.
        external_tables: Numbers of the library's tables.
        roles: Role of each variable by name.
        place: Position of a provenance record.
        refuse: Makes the error for a construct at a position.

    Attributes:
        stepwise: What steps at events, as far as it has been met.
        tables: Parameters that stand for tables, likewise.
    """

    def __init__(
        self,
        store: Mapping[str, Any],
        external_tables: Sequence[Mapping[str, Any]],
        roles: Mapping[str, Role | None],
        place: Callable[[Mapping[str, Any] | None], Position | None],
        refuse: Refuse,
    ) -> None:
        self._store = store
        self._external_tables = external_tables
        self._roles = roles
        self._place = place
        self._refuse = refuse
        self._operands: Sequence[int] = store["expressions"]["operands"]
        self._subscripts: Sequence[Mapping[str, Any]] = store["expressions"]["subscripts"]
        self._records: dict[int, tuple[str, Any, int, int, int]] = {}
        self._number_records()
        self._names = [str(v["name"]) for v in store["variables"]]
        self._shapes: list[tuple[int, ...]] = [
            tuple(store["value_types"][v["value_type"]]["dimensions"]) for v in store["variables"]
        ]
        self._delay_numbers: dict[int, Delayed] = {}
        self._outside = _Scope()
        self._texts = {
            str(v["name"])
            for v in store["variables"]
            if store["value_types"][v["value_type"]]["scalar"] == "string"
        }
        self.stepwise = Stepwise(self._changes)
        self.tables: list[str] = []

    @property
    def delays(self) -> tuple[Delayed, ...]:
        """The delay operators in order of their index."""
        return tuple(self._delay_numbers.values())

    def _number_records(self) -> None:
        """Give each node its number; operands and subscripts are consumed in node order."""
        slot = operand = subscript = 0
        for record, node in enumerate(self._store["expressions"]["nodes"]):
            ((kind, body),) = node.items()
            self._records[slot] = (kind, body, operand, subscript, record)
            if isinstance(body, dict):
                operand += int(body.get("operand_count", 0))
                subscript += int(body.get("subscript_count", 0))
            slot += _QUOTIENT_SLOTS if kind == "runtime_quotient_owner" else 1

    def position(self, index: int) -> Position | None:
        """Where a node stands in the source."""
        spans = self._store["expressions"]["provenance"]
        record = self._records[index][4]
        return self._place(spans[record]) if record < len(spans) else None

    def text(self, index: int) -> str:
        """Return a string literal, or nothing."""
        kind, body, *_ = self._records[index]
        return str(body["string"]) if kind == "literal" and "string" in body else ""

    def scalar(self, index: int, *, events: bool = True) -> Expression:
        """Read a node that is no array."""
        value = self.value(index, events=events)
        if isinstance(value, tuple):
            raise self._refuse("an array in the place of a number", self.position(index))
        return value

    def value(self, index: int, *, events: bool = True) -> Value:
        """Read a node; with `events`, comparisons of changing quantities become relations."""
        return self._value(index, events, self._outside)

    def loop(self, domain: int, bodies: Sequence[int]) -> Iterator[Expression]:
        """Yield the residuals of each round of a for-equation."""
        for binders in self._rounds(domain):
            scope = _Scope(binders)
            for body in bodies:
                yield from arrays.flat(self._value(body, True, scope))

    def variable(self, number: int, leaf: Callable[[str], Expression] = Symbol) -> Value:
        """Return a leaf for a variable, or for each element of an array variable."""
        return arrays.of_names(self._names[number], self._shapes[number], leaf)

    def condition(self, index: int, *, events: bool = True) -> Expression:  # noqa: PLR0911 - one return a kind
        """Read a condition of a when-clause; `initial()` stays an operation."""
        row = self._store["conditions"][index]
        node = row["node"]
        if node == "always":
            return Literal(True)
        if node == "initial":
            return Operation("initial", ())
        if isinstance(node, dict):
            ((kind, body),) = node.items()
            if kind == "relation":
                number = self._store["relations"][int(body)]["relation"]["expression"]
                return self.scalar(int(number), events=events)
            if kind in ("expression", "discrete"):
                return self.scalar(int(body), events=events)
            if kind == "not":
                return Operation("not", (self.condition(int(body), events=events),))
            if kind in ("and", "or", "any_rise"):
                sides = (self.condition(int(body[s]), events=events) for s in ("lhs", "rhs"))
                return Operation(kind, tuple(sides))
            if kind == "clock":
                return self._clock(int(body))
            node = kind
        raise self._refuse(f"a when-condition of the kind '{node}'", self._place(row["provenance"]))

    def guard(self, index: int, *, events: bool = True) -> Expression:
        """Read a condition that is asked for its value: initial() holds during initialisation."""

        def initially(node: Expression) -> Expression | None:
            is_initial = isinstance(node, Operation) and node.operator == "initial"
            return self.stepwise.initially() if is_initial else None

        return substitute(self.condition(index, events=events), initially)

    def _clock(self, number: int) -> Relation:
        row = self._store["clocks"][number]
        kind = row["kind"]
        lattice = kind.get("periodic", {}).get("lattice") if isinstance(kind, dict) else None
        if lattice is None:
            raise self._refuse("a clock", self._place(row.get("provenance")))
        period, phase = (v["num"] / v["den"] for v in (lattice["period"], lattice["phase"]))
        return self.stepwise.clock(number, phase, period)

    # Nodes

    def _value(self, index: int, events: bool, scope: _Scope) -> Value:
        known = scope.memo.get((index, events))
        if known is not None:
            return known
        value = self._read(index, events, scope)
        if events and isinstance(value, Operation) and self._makes_event(value):
            value = self.stepwise.relation(value)
        scope.memo[index, events] = value
        return value

    def _makes_event(self, expression: Operation) -> bool:
        return expression.operator in _COMPARISONS and self._changes(expression)

    def _changes(self, expression: Expression) -> bool:
        return any(
            isinstance(node, Time | Derivative | Delayed)
            or (
                isinstance(node, Symbol | Previous)
                and self._roles.get(node.name) not in (Role.PARAMETER, Role.CONSTANT)
            )
            for node in walk(expression)
        )

    def _read(self, index: int, events: bool, scope: _Scope) -> Value:  # noqa: PLR0911, PLR0912 - one case a kind
        kind, body, *_ = self._records[index]
        match kind:
            case "literal":
                (value,) = body.values()
                if isinstance(value, int | float):  # bool is an int
                    return Literal(value)
            case "coordinate":
                return self._coordinate(body, index, events, scope)
            case "unary":
                operand = self._value(body["operand"], events, scope)
                operator = str(body["operator"])
                return operand if operator == "plus" else self._apply(index, operator, (operand,))
            case "binary":
                sides = tuple(self._value(body[s], events, scope) for s in ("lhs", "rhs"))
                return self._apply(index, str(body["operator"]), sides)
            case "builtin":
                return self._builtin(index, str(body["builtin"]), events, scope)
            case "conditional":
                return self._conditional(index, events, scope)
            case "array":
                return tuple(self._value(node, events, scope) for node in self._inputs(index))
            case "range":
                return self._range(body, index, scope)
            case "index":
                return self._element(index, events, scope)
            case "comprehension":
                return self._comprehension(body, events, scope)
            case "call":
                return self._call(index, events, scope)
            case "function_value":
                return self._local(body, index, scope)
            case "runtime_quotient_owner":
                a, b = (self._value(body[s], events, scope) for s in ("lhs", "rhs"))
                if not isinstance(a, tuple) and not isinstance(b, tuple):
                    return self.stepwise.quotient(str(body["builtin"]), a, b, events)
            case _:
                pass
        raise self._refuse(f"the expression '{kind}'", self.position(index))

    def _inputs(self, index: int) -> Sequence[int]:
        _, body, first, *_ = self._records[index]
        return self._operands[first : first + int(body["operand_count"])]

    def _apply(self, index: int, operator: str, operands: Sequence[Value]) -> Value:
        try:
            return arrays.apply(operator, operands)
        except ValueError as error:
            raise self._refuse(str(error), self.position(index)) from error

    def _builtin(self, index: int, name: str, events: bool, scope: _Scope) -> Value:
        if name == "initial":
            return self.stepwise.initially()
        if name == "terminal":
            raise self._refuse("terminal()", self.position(index))
        inside = events and name not in _WITHOUT_EVENTS
        operands = [self._value(node, inside, scope) for node in self._inputs(index)]
        if name in ("floor", "ceil", "integer", "mod", "div", "rem"):
            scalars = [o for o in operands if not isinstance(o, tuple)]
            if len(scalars) == len(operands):
                return self.stepwise.rounded(name, scalars, events)
        return self._apply(index, name, operands)

    def _conditional(self, index: int, events: bool, scope: _Scope) -> Value:
        inputs = list(self._inputs(index))
        chosen: list[tuple[Expression, Value]] = []
        for condition, branch in zip(inputs[:-1:2], inputs[1::2], strict=True):
            holds = self._value(condition, events, scope)
            if isinstance(holds, tuple):
                raise self._refuse("an array as a condition", self.position(index))
            known = arrays.number(holds)
            # A branch that cannot be reached may index beyond its array.
            if known is not None and not known:
                continue
            value = self._value(branch, events, scope)
            if known is not None:
                result = value
                break
            chosen.append((holds, value))
        else:
            result = self._value(inputs[-1], events, scope)
        for holds, value in reversed(chosen):
            result = arrays.choose(holds, value, result)
        return result

    def _element(self, index: int, events: bool, scope: _Scope) -> Value:
        _, body, _, first, _ = self._records[index]
        value = self._value(body["base"], events, scope)
        subscripts: list[Expression | tuple[Value, ...] | None] = []
        for row in self._subscripts[first : first + int(body["subscript_count"])]:
            kind = row["kind"]
            if not isinstance(kind, dict):
                subscripts.append(None)  # a colon
                continue
            ((_, node),) = kind.items()  # an index, or a slice that is read as an array
            subscripts.append(self._value(int(node), False, scope))
        try:
            return arrays.element(value, subscripts)
        except (ValueError, IndexError) as error:
            raise self._refuse(str(error), self.position(index)) from error

    def _range(self, body: Mapping[str, Any], index: int, scope: _Scope) -> Value:
        ends: list[int] = []
        for key, default in (("start", None), ("explicit_step", 1), ("stop", None)):
            node = body[f"{key}_expression"]
            value = default if node is None else arrays.number(self._value(node, False, scope))
            if value is None or value != int(value):
                raise self._refuse("a range that is not constant", self.position(index))
            ends.append(int(value))
        start, step, stop = ends
        return tuple(Literal(k) for k in range(start, stop + (1 if step > 0 else -1), step))

    def _rounds(self, domain: int) -> Iterator[dict[tuple[int, int], int]]:
        row = self._store["domains"][domain]
        outer: Iterator[dict[tuple[int, int], int]] = (
            iter([{}]) if row["parent"] is None else self._rounds(int(row["parent"]))
        )
        binders = row["domain"]["binders"]
        ranges = [_range(binder) for binder in binders]
        for above in outer:
            for values in product(*ranges):
                yield above | {(domain, k): value for k, value in enumerate(values)}

    def _comprehension(self, body: Mapping[str, Any], events: bool, scope: _Scope) -> Value:
        domain = int(body["domain"])
        ranges = [_range(b) for b in self._store["domains"][domain]["domain"]["binders"]]

        def build(values: tuple[int, ...]) -> Value:
            if len(values) < len(ranges):
                return tuple(build((*values, k)) for k in ranges[len(values)])
            binders = dict(scope.binders) | {(domain, k): v for k, v in enumerate(values)}
            inner = _Scope(binders, scope.arguments, scope.depth)
            return self._value(int(body["body"]), events, inner)

        return build(())

    # Functions

    def _call(self, index: int, events: bool, scope: _Scope) -> Value:
        _, body, *_ = self._records[index]
        function = self._store["functions"][int(body["function"])]
        external = function["external"]
        if external is not None and str(external["symbol"]).startswith(tables.PREFIX):
            return self._table(str(external["symbol"]), body, index, events, scope)
        if external is not None and external["language"] != "builtin":
            raise self._refuse(f"the external function '{function['name']}'", self.position(index))
        if scope.depth == _DEEPEST_CALL:
            raise self._refuse(f"the recursive function '{function['name']}'", self.position(index))
        operands = self._inputs(int(body["owner"]))
        arguments = [self._value(node, events, scope) for node in operands]
        if external is not None:  # another name of an operator, such as Modelica.Math.sin
            return self._apply(index, str(external["symbol"]), arguments)
        inner = _Scope({}, arguments, scope.depth + 1)
        last = self._definitions(function, int(body["output"]), index)
        return self._value(last[-1], False, inner)

    def _table(
        self, symbol: str, body: Mapping[str, Any], index: int, events: bool, scope: _Scope
    ) -> Expression:
        """Return what a table of the Modelica Standard Library gives; `tableID` is its number."""
        operands = self._inputs(int(body["owner"]))
        arguments = [self._value(node, events, scope) for node in operands]
        plain = [a for a in arguments if not isinstance(a, tuple)]
        number = plain[0]
        if isinstance(number, Symbol):
            self.tables.append(number.name)
            binding = self._store["variables"][self._names.index(number.name)]["attributes"]
            number = self._value(int(binding["binding"]), False, self._outside)
        known = {int(table["id"]): table for table in self._external_tables}
        makes_events = events and self._changes(plain[min(2, len(plain) - 1)])
        try:
            assert isinstance(number, Literal)
            return tables.table_value(
                symbol,
                known[int(number.value)],
                plain,
                self.stepwise.relation if makes_events else None,
            )
        except ValueError as error:
            raise self._refuse(str(error), self.position(index)) from error

    def _local(self, body: Mapping[str, Any], index: int, scope: _Scope) -> Value:
        function = self._store["functions"][int(body["function"])]
        definitions = self._definitions(function, int(body["value"]), index)
        ordinal = int(body["definition_ordinal"])
        if ordinal >= len(definitions):
            name = str(function["name"])
            raise self._refuse(
                f"the function '{name}', which assigns in loops,", self.position(index)
            )
        return self._value(definitions[ordinal], False, scope)

    def _definitions(self, function: Mapping[str, Any], target: int, index: int) -> list[int]:
        """Return the right-hand sides assigned to an output or local variable, in order."""
        found: list[int] = []
        for statement in function["statements"]:
            ((kind, body),) = statement.items()
            match kind:
                case "assignment":
                    assignments = [body]
                case "assignment_group":
                    assignments = body["assignments"]
                case _:
                    raise self._refuse(
                        f"the statement '{kind}' of the function '{function['name']}'",
                        self._place(body.get("provenance")),
                    )
            found += [int(a["rhs"]) for a in assignments if int(a["target"]) == target]
        if not found:
            raise self._refuse(
                f"the function '{function['name']}' that leaves an output without a value",
                self.position(index),
            )
        return found

    # Leaves

    def _coordinate(  # noqa: PLR0911 - one return a kind
        self, body: Any, index: int, events: bool, scope: _Scope
    ) -> Value:
        if body == "time":
            return Time()
        ((kind, number),) = body.items()
        match str(kind):
            case "delay":
                return self._delay(int(number))
            case "derivative":
                return self.variable(number, Derivative)
            case "binder":
                return Literal(scope.binders[int(number["domain"]), int(number["ordinal"])])
            case "function_parameter":
                return scope.arguments[int(number["ordinal"])]
            case "condition":
                return self.guard(int(number), events=events)
            case name if isinstance(number, int) and self._names[number] in self._texts:
                text = self._names[number]
                raise self._refuse(f"the text '{text}' in an equation", self.position(index))
            case name if name.startswith("pre"):
                return self.variable(number, Previous)
            case name if isinstance(number, int) and name in _VARIABLES:
                return self.variable(number)
            case _:
                raise self._refuse(f"the coordinate '{kind}'", self.position(index))

    def _delay(self, number: int) -> Delayed:
        if number not in self._delay_numbers:
            row = self._store["delays"][number]
            ((kind, body),) = row["kind"].items()
            if "delay_time" not in body:
                raise self._refuse(f"the delay '{kind}'", self._place(row["provenance"]))
            duration = body["delay_time"]
            node = int(duration["expression"] if isinstance(duration, dict) else duration)
            operand = self.scalar(int(row["source"]))
            self._delay_numbers[number] = Delayed(
                len(self._delay_numbers), operand, self.scalar(node, events=False)
            )
        return self._delay_numbers[number]


_VARIABLES = frozenset(
    (
        *("parameter", "constant", "input", "state", "algebraic", "output"),
        *("discrete", "discrete_real", "discrete_value"),
    )
)


def _range(binder: Mapping[str, Any]) -> range:
    lower, upper, step = (int(binder[key]) for key in ("lower", "upper", "step"))
    return range(lower, upper + (1 if step > 0 else -1), step)
