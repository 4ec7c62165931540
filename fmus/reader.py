"""The front end's dictionaries, read into the typed flat model."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from fmus.dae import (
    Connector,
    Dae,
    Position,
    Reinit,
    Role,
    ScalarType,
    Variable,
    WhenEquation,
)
from fmus.declarations import declaration_annotation
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
    walk,
)
from foundation.errors import UnsupportedModelError

_ROLES = {
    "parameter": Role.PARAMETER,
    "constant": Role.CONSTANT,
    "input": Role.INPUT,
    "state": Role.STATE,
    "algebraic": Role.ALGEBRAIC,
    "output": Role.ALGEBRAIC,
    "discrete": Role.DISCRETE,
    "discrete_real": Role.DISCRETE,
    "discrete_value": Role.DISCRETE,
}

# Parts of the front end's dictionary that carry meaning not translated yet: refused, never skipped.
# `time_events` is not among them: comparisons with time are read as relations.
_UNTRANSLATED = {
    "functions": "functions",
    "discrete_value_owners": "discrete Integer or Boolean variables",
    "model_event_transactions": "assert or terminate at events",
    "structured_roots": "events inside for-equations",
    "clocks": "sampled events and clocks",
    "clock_ownerships": "clocks",
    "previous_values": "clocked previous()",
    "initial_discrete_values": "initial equations of discrete variables",
    "initial_parameter_values": "parameters computed by initial equations",
}

_COMPARISONS = {"less", "less_equal", "greater", "greater_equal"}
_WITHOUT_EVENTS = {"no_event", "smooth"}


class Reader:
    """Reads the `dae` and `flat` dictionaries of one compiled model.

    Args:
        name: Short name of the model.
        file_name: Named where the front end gives no position.
        dae: The front end's `dae` dictionary.
        flat: The front end's `flat` dictionary.
    """

    def __init__(
        self, name: str, file_name: str, dae: Mapping[str, Any], flat: Mapping[str, Any]
    ) -> None:
        self._name = name
        self._file_name = file_name
        self._flat = flat
        self._store: Mapping[str, Any] = dae["storage"]
        self._files: dict[int, tuple[str, str]] = {
            int(row[0]): (str(row[1]), str(row[2])) for row in dae["source_map"]["files"]
        }
        arena = self._store["expressions"]
        self._nodes: Sequence[Mapping[str, Any]] = arena["nodes"]
        self._operands: Sequence[int] = arena["operands"]
        self._spans: Sequence[Mapping[str, Any]] = arena["provenance"]
        self._offsets = self._operand_offsets()
        self._names: list[str] = [str(v["name"]) for v in self._store["variables"]]
        self._roles = {str(v["name"]): _ROLES.get(str(v["role"])) for v in self._store["variables"]}
        self._relations: list[Relation] = []
        self._delays: dict[int, Delayed] = {}
        self._memo: dict[tuple[int, bool], Expression] = {}

    def read(self) -> Dae:
        """Return the flat model, aliases included.

        Raises:
            UnsupportedModelError: A construct has no translation; the message says which and where.
        """
        for key, what in _UNTRANSLATED.items():
            if self._store.get(key):
                raise self._unsupported(what, None)
        for row in self._store["relations"]:
            if "relation" not in row:
                # The front end numbers expressions in a way of its own then.
                raise self._unsupported("mod, rem, div or integer of a changing quantity", None)
        variables = {v.name: v for v in (self._variable(row) for row in self._store["variables"])}
        residuals: list[Expression] = []
        positions: list[Position | None] = []
        for row in self._store["continuous_equation_operations"]:
            residuals.append(self._residual(row))
            positions.append(self._position(row["residual"]["provenance"]))
        initial_residuals = tuple(
            self._residual(row) for row in self._store["initialization_equation_operations"]
        )
        reinits = tuple(self._reinit(row) for row in self._store["event_actions"])
        when_equations = tuple(
            self._when_equation(row) for row in self._store["discrete_real_equations"]
        )
        return Dae(
            name=self._name,
            variables=variables,
            residuals=tuple(residuals),
            residual_positions=tuple(positions),
            initial_residuals=initial_residuals,
            relations=tuple(self._relations),
            delays=tuple(self._delays.values()),
            reinits=reinits,
            when_equations=when_equations,
            connectors=tuple(self._connectors()),
            description=str(self._flat.get("model_description") or ""),
        )

    def _operand_offsets(self) -> list[int]:
        offsets: list[int] = []
        offset = 0
        for node in self._nodes:
            offsets.append(offset)
            (body,) = node.values()
            if isinstance(body, dict):
                offset += int(body.get("operand_count", 0))
        return offsets

    def _unsupported(self, what: str, position: Position | None) -> UnsupportedModelError:
        return UnsupportedModelError(
            f"{position or f'{self._file_name}:1:1'}: {what} cannot be translated yet",
            remedy="rewrite the model without them",
        )

    def _position(self, provenance: Mapping[str, Any] | None) -> Position | None:
        span = (provenance or {}).get("span")
        if not span or int(span["source"]) not in self._files:
            return None
        path, text = self._files[int(span["source"])]
        before = text.encode()[: int(span["start"])].decode(errors="replace")
        return Position(path, before.count("\n") + 1, len(before) - before.rfind("\n"))

    # Variables and connectors

    def _variable(self, row: Mapping[str, Any]) -> Variable:
        attributes: Mapping[str, Any] = row["attributes"]
        position = self._position(row["declaration"])
        value_type: Mapping[str, Any] = self._store["value_types"][row["value_type"]]
        name = str(row["name"])
        if value_type["dimensions"] or value_type["scalar"] not in ("real", "integer", "boolean"):
            raise self._unsupported(f"the array or record variable '{name}'", position)
        role = _ROLES.get(str(row["role"]))
        if role is None:
            raise self._unsupported(f"the {row['role']} variable '{name}'", position)
        fixed = attributes["fixed"]
        if role is Role.PARAMETER and fixed and not all(fixed):
            raise self._unsupported(f"the parameter '{name}' with fixed=false", position)
        flat: Mapping[str, Any] = self._flat["variables"].get(name, {})
        return Variable(
            name=name,
            role=role,
            type=ScalarType(value_type["scalar"]),
            output=attributes["causality"] == "output",
            unit=_string(attributes["unit"]),
            display_unit=_string(flat.get("display_unit")),
            description=str(attributes["description"] or ""),
            start=self._optional(attributes["start"]),
            fixed=bool(fixed) and all(fixed),
            minimum=self._optional(attributes["min"]),
            maximum=self._optional(attributes["max"]),
            nominal=self._optional(attributes["nominal"]),
            binding=self._optional(attributes["binding"]),
            tunable=bool(attributes["is_tunable"]) and not flat.get("is_protected", False),
            known=re.search(r"\bknown\s*=\s*true\b", self._annotation(row["declaration"]))
            is not None,
            flow=bool(flat.get("flow")),
            position=position,
        )

    def _annotation(self, declaration: Mapping[str, Any]) -> str:
        span = declaration.get("span")
        if not span or int(span["source"]) not in self._files:
            return ""
        _, text = self._files[int(span["source"])]
        return declaration_annotation(text.encode()[int(span["start"]) :].decode(errors="replace"))

    def _connectors(self) -> list[Connector]:
        """Collect connectors of one potential and one flow variable, whatever their class."""
        members: dict[str, list[Mapping[str, Any]]] = {}
        for name, row in self._flat["variables"].items():
            path, _, _ = name.rpartition(".")
            members.setdefault(path, []).append(row)
        found: list[Connector] = []
        for path, rows in members.items():
            flows = [row for row in rows if row["flow"]]
            potentials = [row for row in rows if not row["flow"]]
            if path and len(flows) == 1 and len(potentials) == 1:
                found.append(
                    Connector(
                        path,
                        potential=str(potentials[0]["name"]),
                        flow=str(flows[0]["name"]),
                        potential_unit=_string(potentials[0]["unit"]),
                        flow_unit=_string(flows[0]["unit"]),
                        connected=bool(flows[0]["connected"]),
                        top_level=path in self._flat["top_level_connectors"],
                        description=self._component_description(path.partition(".")[0]),
                    )
                )
        return found

    def _component_description(self, component: str) -> str:
        """Return what is written behind the declaration of a component, the model's text first."""
        declaration = re.compile(
            rf'\b[A-Z][\w.]*\s+{component}\s*(?:\([^;"]*\)\s*)?"((?:[^"\\]|\\.)*)"'
        )
        texts = sorted(self._files.values(), key=lambda file: file[0] != self._file_name)
        found = (declaration.search(text) for _, text in texts)
        return next((match[1] for match in found if match), "")

    # Equations and events

    def _optional(self, node: int | None) -> Expression | None:
        return None if node is None else self._expression(node, events=False)

    def _residual(self, row: Mapping[str, Any]) -> Expression:
        if set(row) != {"residual"}:
            ((kind, body),) = row.items()
            raise self._unsupported(f"a {kind} equation", self._position(body.get("provenance")))
        return self._expression(int(row["residual"]["residual"]))

    def _reinit(self, row: Mapping[str, Any]) -> Reinit:
        kind: Mapping[str, Any] = row["kind"]
        if set(kind) != {"reinitialize"}:
            raise self._unsupported(
                f"the event action '{'/'.join(kind)}'", self._position(row["provenance"])
            )
        action = kind["reinitialize"]
        return Reinit(
            self._names[int(action["state"])],
            self._expression(int(action["value"]), events=False),
            self._condition(int(row["trigger"])),
        )

    def _when_equation(self, row: Mapping[str, Any]) -> WhenEquation:
        activation: Mapping[str, Any] = row["activation"]
        if set(activation) != {"when"}:
            raise self._unsupported(
                f"a discrete equation of the kind '{'/'.join(activation)}'",
                self._position(row["provenance"]),
            )
        return WhenEquation(
            self._expression(int(row["residual"]), events=False),
            self._condition(int(activation["when"]["trigger"])),
        )

    def _condition(self, index: int) -> Expression:
        row = self._store["conditions"][index]
        node = row["node"]
        if isinstance(node, dict):
            ((kind, body),) = node.items()
            if kind == "relation":
                return self._expression(
                    int(self._store["relations"][int(body)]["relation"]["expression"])
                )
            if kind == "expression":
                return self._expression(int(body))
            if kind == "not":
                return Operation("not", (self._condition(int(body)),))
            if kind in ("and", "or", "any_rise"):
                return Operation(
                    kind, (self._condition(int(body["lhs"])), self._condition(int(body["rhs"])))
                )
            node = kind
        raise self._unsupported(
            f"a when-condition of the kind '{node}'", self._position(row["provenance"])
        )

    # Expressions

    def _expression(self, index: int, *, events: bool = True) -> Expression:
        """Read a node; with `events`, comparisons of changing quantities become relations."""
        known = self._memo.get((index, events))
        if known is not None:
            return known
        expression = self._read_node(index, events)
        if events and self._makes_event(expression):
            assert isinstance(expression, Operation)
            expression = Relation(len(self._relations), expression)
            self._relations.append(expression)
        self._memo[index, events] = expression
        return expression

    def _makes_event(self, expression: Expression) -> bool:
        if not isinstance(expression, Operation) or expression.operator not in _COMPARISONS:
            return False
        return any(
            isinstance(node, Time | Derivative | Delayed)
            or (
                isinstance(node, Symbol | Previous)
                and self._roles[node.name] not in (Role.PARAMETER, Role.CONSTANT)
            )
            for node in walk(expression)
        )

    def _read_node(self, index: int, events: bool) -> Expression:
        ((kind, body),) = self._nodes[index].items()
        match kind:
            case "literal":
                (value,) = body.values()
                if isinstance(value, int | float):  # bool is an int
                    return Literal(value)
            case "coordinate":
                return self._coordinate(body, index)
            case "unary":
                operand = self._expression(body["operand"], events=events)
                return Operation(str(body["operator"]), (operand,))
            case "binary":
                operands = (
                    self._expression(body["lhs"], events=events),
                    self._expression(body["rhs"], events=events),
                )
                return Operation(str(body["operator"]), operands)
            case "builtin":
                name = str(body["builtin"])
                inside = events and name not in _WITHOUT_EVENTS
                return Operation(name, self._operands_of(index, body, inside))
            case "conditional":
                operands = self._operands_of(index, body, events)
                result = operands[-1]
                for k in range(len(operands) - 3, -1, -2):
                    result = Operation("if", (operands[k], operands[k + 1], result))
                return result
            case _:
                pass
        raise self._unsupported(f"the expression '{kind}'", self._position(self._spans[index]))

    def _operands_of(
        self, index: int, body: Mapping[str, Any], events: bool
    ) -> tuple[Expression, ...]:
        first = self._offsets[index]
        return tuple(
            self._expression(node, events=events)
            for node in self._operands[first : first + int(body["operand_count"])]
        )

    def _coordinate(self, body: Any, index: int) -> Expression:
        if body == "time":
            return Time()
        ((kind, number),) = body.items()
        if kind == "delay":
            return self._delay(int(number))
        if kind == "derivative":
            return Derivative(self._names[number])
        if str(kind).startswith("pre"):
            return Previous(self._names[number])
        if kind in _ROLES:
            return Symbol(self._names[number])
        raise self._unsupported(f"the coordinate '{kind}'", self._position(self._spans[index]))

    def _delay(self, number: int) -> Delayed:
        if number not in self._delays:
            row = self._store["delays"][number]
            ((kind, body),) = row["kind"].items()
            if "delay_time" not in body:
                raise self._unsupported(f"the delay '{kind}'", self._position(row["provenance"]))
            duration = body["delay_time"]
            node = int(duration["expression"] if isinstance(duration, dict) else duration)
            source = self._expression(int(row["source"]))
            self._delays[number] = Delayed(
                len(self._delays), source, self._expression(node, events=False)
            )
        return self._delays[number]


def _string(value: Any) -> str:
    if isinstance(value, dict):
        # {"Literal": {"value": {"String": "rad"}}} in the flat stage.
        found = re.search(r'"String": "((?:[^"\\]|\\.)*)"', json.dumps(value))
        return json.loads(f'"{found[1]}"') if found else ""
    return str(value) if value else ""
