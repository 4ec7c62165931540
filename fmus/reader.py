"""The front end's dictionaries, read into the typed flat model."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

from fmus import arrays
from fmus.arena import Arena
from fmus.dae import Connector, Dae, Position, Role, ScalarType, Variable
from fmus.declarations import declaration_annotation
from fmus.discrete import Discrete, simplified
from fmus.expressions import Derivative, Expression, Operation, Symbol
from fmus.structural import without_structural
from foundation.errors import UnsupportedModelError

_Part = TypeVar("_Part")

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

# Parts of the front end's dictionary that carry meaning not translated: refused, never skipped.
# Others say again what stands elsewhere: `roots` and `time_events` are read as relations.
_UNTRANSLATED = {
    "model_event_transactions": "a chain of reinit, assert or terminate at events",
    "previous_values": "clocked previous()",
}


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
        roles: dict[str, Role | None] = {}
        for row in self._store["variables"]:
            shape = self._store["value_types"][row["value_type"]]["dimensions"]
            role = _ROLES.get(str(row["role"]))
            for leaf in arrays.flat(arrays.of_names(str(row["name"]), shape, Symbol)):
                assert isinstance(leaf, Symbol)
                roles[leaf.name] = role
        self._free: list[str] = []
        self._arena = Arena(
            self._store,
            dae.get("external_tables") or (),
            roles,
            self._position,
            self._unsupported,
        )

    def read(self) -> Dae:
        """Return the flat model, aliases included.

        Raises:
            UnsupportedModelError: A construct has no translation; the message says which and where.
        """
        for key, what in _UNTRANSLATED.items():
            if self._store.get(key):
                rows = self._store[key]
                first = rows[0] if isinstance(rows, list) else {}
                raise self._unsupported(what, self._position(first.get("provenance")))
        variables = {v.name: v for row in self._store["variables"] for v in self._variables(row)}
        residuals, positions = self._residuals("continuous_equation_operations")
        initial_residuals, _ = self._residuals("initialization_equation_operations")
        initial_residuals += [
            Operation("subtract", (symbol, value))
            for row in self._store.get("initial_parameter_values") or ()
            for symbol, value in self._pairs(row["target"], row["value"])
        ]
        for name in self._free:
            residuals.append(Derivative(name))
            positions.append(variables[name].position)
        discrete = Discrete(self._store, self._arena, self._position, self._unsupported)
        for name, kind in discrete.read().items():
            variables[name] = kind
        dae = Dae(
            name=self._name,
            variables=variables,
            residuals=tuple(residuals),
            residual_positions=tuple(positions),
            initial_residuals=tuple(initial_residuals),
            relations=tuple(self._arena.stepwise.relations),
            delays=self._arena.delays,
            reinits=tuple(discrete.reinits),
            when_equations=tuple(discrete.when_equations),
            discrete_equations=tuple(discrete.equations),
            assertions=tuple(discrete.assertions),
            terminations=tuple(discrete.terminations),
            clock_relations=self._arena.stepwise.clock_relations,
            initial_relations=self._arena.stepwise.initial_relations,
            connectors=tuple(self._connectors()),
            description=str(self._flat.get("model_description") or ""),
        )
        return simplified(without_structural(dae, self._structural()))

    def _structural(self) -> set[str]:
        """Parameters that the front end will not let change, other than final ones."""
        final: Mapping[str, bool] = self._flat["variable_final_flags"]
        # A table's numbers have been put in, with whatever stands beside them.
        owners = tuple(f"{name.rpartition('.')[0]}." for name in self._arena.tables)
        return {
            str(row["name"])
            for row in self._store["variables"]
            if str(row["name"]).startswith(owners)
            or (not row["attributes"]["is_tunable"] and not final.get(row["name"], False))
        }

    def _pairs(self, target: int, value: int) -> list[tuple[Expression, Expression]]:
        left = arrays.flat(self._arena.variable(int(target)))
        return list(zip(left, arrays.flat(self._arena.value(int(value))), strict=True))

    def _unsupported(self, what: str, position: Position | None) -> UnsupportedModelError:
        return UnsupportedModelError(
            f"{position or f'{self._file_name}:1:1'}: {what} cannot be translated",
            remedy="write it in another way",
        )

    def _position(self, provenance: Mapping[str, Any] | None) -> Position | None:
        span = (provenance or {}).get("span")
        if not span or int(span["source"]) not in self._files:
            return None
        path, text = self._files[int(span["source"])]
        before = text.encode()[: int(span["start"])].decode(errors="replace")
        return Position(path, before.count("\n") + 1, len(before) - before.rfind("\n"))

    # Variables and connectors

    def _variables(self, row: Mapping[str, Any]) -> list[Variable]:
        """Return the variable of a row, or one for each element of an array."""
        attributes: Mapping[str, Any] = row["attributes"]
        position = self._position(row["declaration"])
        value_type: Mapping[str, Any] = self._store["value_types"][row["value_type"]]
        name = str(row["name"])
        scalar = "integer" if value_type["scalar"] == "enumeration" else value_type["scalar"]
        role = _ROLES.get(str(row["role"]))
        if scalar == "string" and role in (Role.PARAMETER, Role.CONSTANT):
            return []  # a label; where an equation asks for it, that is refused
        if scalar not in ("real", "integer", "boolean"):
            raise self._unsupported(f"the {scalar} variable '{name}'", position)
        if role is None:
            raise self._unsupported(f"the {row['role']} variable '{name}'", position)
        flat: Mapping[str, Any] = self._flat["variables"].get(name, {})
        leaves = list(arrays.flat(arrays.of_names(name, value_type["dimensions"], Symbol)))
        fixed = self._spread([bool(f) for f in attributes["fixed"] or ()], len(leaves), position)
        parts = {
            key: self._spread(self._attribute(attributes[key]), len(leaves), position)
            for key in ("start", "min", "max", "nominal", "binding")
        }
        annotation = self._annotation(row["declaration"])
        of_signal = re.search(r'\bunit\s*=\s*"([^"]*)"', annotation)
        found: list[Variable] = []
        for k, leaf in enumerate(leaves):
            assert isinstance(leaf, Symbol)
            is_free = role is Role.PARAMETER and fixed[k] is False
            if is_free:
                self._free.append(leaf.name)
            found.append(
                Variable(
                    name=leaf.name,
                    # What initial equations determine is a state that does not move.
                    role=Role.STATE if is_free else role,
                    type=ScalarType(scalar),
                    output=attributes["causality"] == "output",
                    unit=_string(attributes["unit"]),
                    display_unit=_string(flat.get("display_unit")),
                    description=str(attributes["description"] or ""),
                    start=parts["start"][k],
                    fixed=bool(fixed[k]),
                    minimum=parts["min"][k],
                    maximum=parts["max"][k],
                    nominal=parts["nominal"][k],
                    binding=None if is_free else parts["binding"][k],
                    tunable=bool(attributes["is_tunable"])
                    and not flat.get("is_protected", False)
                    and name not in self._clock_parameters,
                    known=re.search(r"\bknown\s*=\s*true\b", annotation) is not None,
                    unit_in_series=of_signal[1] if of_signal else "",
                    flow=bool(flat.get("flow")),
                    position=position,
                )
            )
        return found

    @cached_property
    def _clock_parameters(self) -> set[str]:
        """Parameters that `sample` may depend on: the front end has put in their values."""
        words: set[str] = set()
        for row in self._store.get("clocks") or ():
            for place in (row.get("provenance"), *self._clock_conditions()):
                words |= set(re.findall(r"[A-Za-z_]\w*", self._source_line(place)))
        names = {str(v["name"]) for v in self._store["variables"]}
        return {name for name in names if name.rpartition(".")[2] in words}

    def _clock_conditions(self) -> list[Mapping[str, Any]]:
        rows = self._store["conditions"]
        return [
            r["provenance"] for r in rows if isinstance(r["node"], dict) and "clock" in r["node"]
        ]

    def _source_line(self, provenance: Mapping[str, Any] | None) -> str:
        """Return the statement that a record stands in."""
        span = (provenance or {}).get("span")
        if not span or int(span["source"]) not in self._files:
            return ""
        text = self._files[int(span["source"])][1].encode()
        found = text[int(span["start"]) : int(span["end"])].decode(errors="replace")
        return "".join(re.findall(r"sample\s*\([^;]*", found))

    def _attribute(self, node: int | None) -> list[Expression]:
        return [] if node is None else list(arrays.flat(self._arena.value(node, events=False)))

    def _spread(
        self, values: Sequence[_Part], count: int, position: Position | None
    ) -> list[_Part | None]:
        """Give each element its part; one part is for all."""
        if not values:
            return [None] * count
        if len(values) not in (1, count):
            raise self._unsupported("an attribute of another size than its array", position)
        return list(values) if len(values) == count else [values[0]] * count

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

    def _residuals(self, key: str) -> tuple[list[Expression], list[Position | None]]:
        residuals: list[Expression] = []
        positions: list[Position | None] = []
        for row in self._store[key]:
            ((kind, body),) = row.items()
            position = self._position(body.get("provenance"))
            if kind == "residual":
                found = list(arrays.flat(self._arena.value(int(body["residual"]))))
            elif kind == "structured" and body["scalar_view"] == "BinderSubstitution":
                found = list(self._arena.loop(int(body["domain"]), body["bodies"]))
            elif kind == "structured" and body["scalar_view"] == "RowMajorProjection":
                found = [e for b in body["bodies"] for e in arrays.flat(self._arena.value(int(b)))]
            else:
                raise self._unsupported(f"a {kind} equation", position)
            residuals += found
            positions += [position] * len(found)
        return residuals, positions


def _string(value: Any) -> str:
    if isinstance(value, dict):
        # {"Literal": {"value": {"String": "rad"}}} in the flat stage.
        found = re.search(r'"String": "((?:[^"\\]|\\.)*)"', json.dumps(value))
        return json.loads(f'"{found[1]}"') if found else ""
    return str(value) if value else ""
