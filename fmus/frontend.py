"""Modelica text in, typed flat model out: rumoca as front end, every message with its position."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import rumoca

from fmus import lint
from fmus.aliases import without_aliases
from fmus.dae import Dae, Position, Reinit, Role, ScalarType, Variable, WhenEquation
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
)
from fmus.sources import ModelicaSource, library_roots
from foundation.errors import ModelicaError, UnsupportedModelError

_POSITION = re.compile(r"\[(?P<file>[^\[\]:]+):(?P<line>\d+):(?P<column>\d+)\]")
_QUOTED = re.compile(r"'([^']+)'|`([^`]+)`")

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
_UNTRANSLATED = {
    "functions": "functions",
    "discrete_value_owners": "discrete Integer or Boolean variables",
    "model_event_transactions": "assert or terminate at events",
    "structured_roots": "events inside for-equations",
    "time_events": "sampled events",
    "clocks": "clocks",
    "clock_ownerships": "clocks",
    "previous_values": "clocked previous()",
}


def load(source: ModelicaSource) -> Dae:
    """Translate Modelica to the typed flat model, free of aliases.

    Args:
        source: Text, class and libraries.

    Raises:
        ModelicaError: The text does not parse, type-check or balance, or holds a mistake that the
            front end would swallow (see `fmus.lint`); the message names file:line:column.
        UnsupportedModelError: A construct that has no translation.

    Example:
        >>> from fmus.sources import library_class
        >>> [v.name for v in load(library_class("Twinproof.Plants.Positioner")).states]
        ['q', 'v']
    """
    return _load(source)


# Discovery loads a few hundred variants of one model, and most of them twice.
@lru_cache(maxsize=512)
def _load(source: ModelicaSource) -> Dae:
    lint.check_text(source)
    dae = _Reader(source, _compile(source)).read()
    reduced = without_aliases(dae)
    lint.check_model(source, reduced)
    return reduced


@dataclass(frozen=True)
class _Compiled:
    dae: Mapping[str, Any]
    flat: Mapping[str, Any]


def _compile(source: ModelicaSource) -> _Compiled:
    # A session remembers classes and reads sibling files: a fresh one for every model.
    try:
        session = rumoca.Session(roots=library_roots(source))
        model = session.loads(source.text, model=source.class_name, filename=source.file_name)
        return _Compiled(json.loads(model.to_json("dae")), json.loads(model.to_json("flat")))
    except rumoca.RumocaError as error:
        raise ModelicaError(*_explain(source, str(error))) from error


def _explain(source: ModelicaSource, text: str) -> tuple[str]:
    """Turn the front end's message into one line that starts with file:line:column."""
    first = text.splitlines()[0].strip()
    where = _POSITION.search(text)
    if where is None:
        # Syntax errors carry a position only in the diagnostics of the whole text.
        for diagnostic in rumoca.validate_source(source.text, filename=source.file_name):
            where = _POSITION.search(str(diagnostic))
            if where is not None:
                break
    if where is not None:
        place = f"{source.file_name}:{where['line']}:{where['column']}"
    else:
        place = _search_identifier(source, first)
    message = re.sub(r"^\S+ could not be compiled: |^\w+ failed: \S+ failed in \w+: ", "", first)
    message = _POSITION.sub("", message).strip()
    return (f"{place}: {message}",)


def _search_identifier(source: ModelicaSource, message: str) -> str:
    for quoted in _QUOTED.finditer(message):
        name = (quoted[1] or quoted[2]).rpartition(".")[2]
        found = re.search(rf"\b{re.escape(name)}\b", source.text)
        if found is not None and name != source.short_name:
            line = source.text.count("\n", 0, found.start()) + 1
            column = found.start() - source.text.rfind("\n", 0, found.start())
            return f"{source.file_name}:{line}:{column}"
    return f"{source.file_name}:1:1"


class _Reader:
    """Reads one compiled model's dictionaries."""

    def __init__(self, source: ModelicaSource, compiled: _Compiled) -> None:
        self._source = source
        self._flat: Mapping[str, Any] = compiled.flat
        self._store: Mapping[str, Any] = compiled.dae["storage"]
        self._files: dict[int, tuple[str, str]] = {
            int(row[0]): (str(row[1]), str(row[2])) for row in compiled.dae["source_map"]["files"]
        }
        arena = self._store["expressions"]
        self._nodes: Sequence[Mapping[str, Any]] = arena["nodes"]
        self._operands: Sequence[int] = arena["operands"]
        self._spans: Sequence[Mapping[str, Any]] = arena["provenance"]
        self._offsets = self._operand_offsets()
        self._names: list[str] = [str(v["name"]) for v in self._store["variables"]]
        self._relation_of = {
            int(row["relation"]["expression"]): index
            for index, row in enumerate(self._store["relations"])
        }
        self._delays: dict[int, Delayed] = {}
        self._memo: dict[int, Expression] = {}

    def read(self) -> Dae:
        for key, what in _UNTRANSLATED.items():
            if self._store.get(key):
                raise self._unsupported(what, None)
        variables = {v.name: v for v in (self._variable(row) for row in self._store["variables"])}
        residuals: list[Expression] = []
        positions: list[Position | None] = []
        for row in self._store["continuous_equation_operations"]:
            residuals.append(self._residual(row))
            positions.append(self._position(row["residual"]["provenance"]))
        return Dae(
            name=self._source.short_name,
            variables=variables,
            residuals=tuple(residuals),
            residual_positions=tuple(positions),
            initial_residuals=tuple(
                self._residual(row) for row in self._store["initialization_equation_operations"]
            ),
            relations=tuple(self._relation(node) for node in self._relation_of),
            delays=tuple(self._delays[index] for index in sorted(self._delays)),
            reinits=tuple(self._reinit(row) for row in self._store["event_actions"]),
            when_equations=tuple(
                WhenEquation(
                    self._expression(int(row["residual"])),
                    self._condition(int(row["activation"]["when"]["trigger"])),
                )
                for row in self._store["discrete_real_equations"]
            ),
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
        place = str(position) if position else f"{self._source.file_name}:1:1"
        return UnsupportedModelError(
            f"{place}: {what} cannot be translated yet", remedy="rewrite the model without them"
        )

    def _position(self, provenance: Mapping[str, Any] | None) -> Position | None:
        span = (provenance or {}).get("span")
        if not span or int(span["source"]) not in self._files:
            return None
        path, text = self._files[int(span["source"])]
        before = text.encode()[: int(span["start"])].decode(errors="replace")
        return Position(path, before.count("\n") + 1, len(before) - before.rfind("\n"))

    def _variable(self, row: Mapping[str, Any]) -> Variable:
        attributes: Mapping[str, Any] = row["attributes"]
        position = self._position(row["declaration"])
        value_type: Mapping[str, Any] = self._store["value_types"][row["value_type"]]
        if value_type["dimensions"] or value_type["scalar"] not in ("real", "integer", "boolean"):
            raise self._unsupported(f"the array or record variable '{row['name']}'", position)
        name = str(row["name"])
        role = _ROLES.get(str(row["role"]))
        if role is None:
            raise self._unsupported(f"the {row['role']} variable '{name}'", position)
        flat: Mapping[str, Any] = self._flat["variables"].get(name, {})
        annotation = self._annotation(row["declaration"])
        return Variable(
            name=name,
            role=role,
            type=ScalarType(value_type["scalar"]),
            output=attributes["causality"] == "output",
            unit=_string(attributes["unit"]),
            display_unit=_string(flat.get("display_unit")),
            description=str(attributes["description"] or ""),
            start=self._optional(attributes["start"]),
            fixed=bool(attributes["fixed"]) and all(attributes["fixed"]),
            minimum=self._optional(attributes["min"]),
            maximum=self._optional(attributes["max"]),
            nominal=self._optional(attributes["nominal"]),
            binding=self._optional(attributes["binding"]),
            tunable=bool(attributes["is_tunable"]) and not flat.get("is_protected", False),
            known=re.search(r"\bknown\s*=\s*true\b", annotation) is not None,
            flow=bool(flat.get("flow")),
            position=position,
        )

    def _annotation(self, declaration: Mapping[str, Any]) -> str:
        span = declaration.get("span")
        if not span or int(span["source"]) not in self._files:
            return ""
        _, text = self._files[int(span["source"])]
        return declaration_annotation(text.encode()[int(span["start"]) :].decode(errors="replace"))

    def _optional(self, node: int | None) -> Expression | None:
        return None if node is None else self._expression(node)

    def _residual(self, row: Mapping[str, Any]) -> Expression:
        if set(row) != {"residual"}:
            raise self._unsupported(f"a {'/'.join(row)} equation", None)
        return self._expression(int(row["residual"]["residual"]))

    def _condition(self, index: int) -> Expression:
        row = self._store["conditions"][index]
        node = row["node"]
        if set(node) == {"relation"}:
            relations = list(self._relation_of)
            return self._relation(relations[int(node["relation"])])
        if set(node) == {"expression"}:
            return self._expression(int(node["expression"]))
        raise self._unsupported(
            f"a when-condition of the kind '{'/'.join(node)}'", self._position(row["provenance"])
        )

    def _reinit(self, row: Mapping[str, Any]) -> Reinit:
        kind: Mapping[str, Any] = row["kind"]
        if set(kind) != {"reinitialize"}:
            raise self._unsupported(
                f"the event action '{'/'.join(kind)}'", self._position(row["provenance"])
            )
        action = kind["reinitialize"]
        return Reinit(
            self._names[int(action["state"])],
            self._expression(int(action["value"])),
            self._condition(int(row["trigger"])),
        )

    def _relation(self, node: int) -> Relation:
        expression = self._expression(node)
        assert isinstance(expression, Relation)
        return expression

    def _expression(self, index: int) -> Expression:
        known = self._memo.get(index)
        if known is not None:
            return known
        expression = self._read_node(index)
        if index in self._relation_of:
            assert isinstance(expression, Operation)
            expression = Relation(self._relation_of[index], expression)
        self._memo[index] = expression
        return expression

    def _read_node(self, index: int) -> Expression:
        ((kind, body),) = self._nodes[index].items()
        match kind:
            case "literal":
                (value,) = body.values()
                if isinstance(value, int | float):  # bool is an int
                    return Literal(value)
            case "coordinate":
                return self._coordinate(body, index)
            case "unary":
                return Operation(str(body["operator"]), (self._expression(body["operand"]),))
            case "binary":
                operands = (self._expression(body["lhs"]), self._expression(body["rhs"]))
                return Operation(str(body["operator"]), operands)
            case "builtin":
                return Operation(str(body["builtin"]), self._operands_of(index, body))
            case "conditional":
                operands = self._operands_of(index, body)
                result = operands[-1]
                for k in range(len(operands) - 3, -1, -2):
                    result = Operation("if", (operands[k], operands[k + 1], result))
                return result
            case _:
                pass
        raise self._unsupported(f"the expression '{kind}'", self._position(self._spans[index]))

    def _operands_of(self, index: int, body: Mapping[str, Any]) -> tuple[Expression, ...]:
        first = self._offsets[index]
        return tuple(
            self._expression(node)
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
        if kind in _ROLES or kind in ("algebraic", "discrete"):
            return Symbol(self._names[number])
        raise self._unsupported(f"the coordinate '{kind}'", self._position(self._spans[index]))

    def _delay(self, index: int) -> Delayed:
        if index not in self._delays:
            row = self._store["delays"][index]
            ((kind, body),) = row["kind"].items()
            if "delay_time" not in body:
                raise self._unsupported(f"the delay '{kind}'", self._position(row["provenance"]))
            self._delays[index] = Delayed(
                index,
                self._expression(int(row["source"])),
                self._expression(int(body["delay_time"]["expression"])),
            )
        return self._delays[index]


def _string(value: Any) -> str:
    if isinstance(value, dict):
        # {"Literal": {"value": {"String": "rad"}}} in the flat stage.
        text = json.dumps(value)
        found = re.search(r'"String": "([^"]*)"', text)
        return found[1] if found else ""
    return str(value) if value else ""


def with_values(dae: Dae, values: Mapping[str, float]) -> Dae:
    """Return the model with other declared parameter values.

    Raises:
        UnsupportedModelError: A name is not an independent parameter of the model.
    """
    variables = dict(dae.variables)
    for name, value in values.items():
        variable = variables.get(name)
        if variable is None or name in dae.dependent_parameters:
            raise UnsupportedModelError(
                f"'{name}' is not a parameter that can be set",
                where=dae.name,
                remedy="set an independent parameter",
            )
        variables[name] = replace(variable, binding=Literal(value))
    return replace(dae, variables=variables)
