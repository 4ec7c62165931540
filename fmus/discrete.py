"""Discrete variables and events of the front end's dictionary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from fmus import arrays
from fmus.arena import Arena, Refuse
from fmus.dae import (
    Assertion,
    Dae,
    DiscreteEquation,
    Position,
    Reinit,
    Role,
    ScalarType,
    Termination,
    Variable,
    WhenEquation,
)
from fmus.expressions import (
    Expression,
    Literal,
    Operation,
    Previous,
    Relation,
    Symbol,
    children,
    names,
    walk,
)


class Discrete:
    """Reads everything that happens at events.

    Attributes:
        reinits, when_equations, equations, assertions, terminations: As in `Dae`.
    """

    def __init__(
        self,
        store: Mapping[str, Any],
        arena: Arena,
        place: Callable[[Mapping[str, Any] | None], Position | None],
        refuse: Refuse,
    ) -> None:
        self._store = store
        self._arena = arena
        self._place = place
        self._refuse = refuse
        self.reinits: list[Reinit] = []
        self.when_equations: list[WhenEquation] = []
        self.equations: list[DiscreteEquation] = []
        self.assertions: list[Assertion] = []
        self.terminations: list[Termination] = []

    def read(self) -> dict[str, Variable]:
        """Read all; return the variables that stand for floors and counts of samples."""
        for row in self._store["event_actions"]:
            self._action(row)
        for row in self._store["discrete_real_equations"]:
            residuals = arrays.flat(self._arena.value(int(row["residual"]), events=False))
            for residual in residuals:
                self._real(residual, row)
        for row in self._store.get("discrete_value_owners") or ():
            self._owner(row)
        for row in self._store.get("initial_discrete_values") or ():
            for target, value in self._pairs(row["target"], row["value"]):
                residual = Operation("subtract", (target, value))
                self.when_equations.append(WhenEquation(residual, Operation("initial", ())))
        return self._hidden()

    def _pairs(
        self, target: int, value: int, *, events: bool = False
    ) -> list[tuple[Symbol, Expression]]:
        left = [s for s in arrays.flat(self._arena.variable(int(target))) if isinstance(s, Symbol)]
        right = arrays.flat(self._arena.value(int(value), events=events))
        return list(zip(left, right, strict=True))

    def _hidden(self) -> dict[str, Variable]:
        found: dict[str, Variable] = {}
        for name, relation in self._arena.stepwise.ticks.items():
            step = Operation("add", (Previous(name), Literal(1)))
            self.when_equations.append(
                WhenEquation(Operation("subtract", (Symbol(name), step)), relation)
            )
            found[name] = _counter(name, "Samples taken")
        for floor in self._arena.stepwise.floors:
            self.equations.append(
                DiscreteEquation(floor.name, self._arena.stepwise.floor_value(floor))
            )
            found[floor.name] = _counter(floor.name, "Whole number below an expression")
        return found

    def _action(self, row: Mapping[str, Any]) -> None:
        ((kind, body),) = row["kind"].items()
        match kind:
            case "reinitialize":
                state = self._arena.variable(int(body["state"]))
                if not isinstance(state, Symbol):
                    raise self._refuse("reinit of a whole array", self._place(row["provenance"]))
                value = self._arena.scalar(int(body["value"]), events=False)
                trigger, guard = self._activation(row)
                if guard is not None:
                    value = Operation("if", (guard, value, state))
                self.reinits.append(Reinit(state.name, value, trigger))
            case "assert":
                trigger = self._arena.guard(int(row["trigger"]))
                guard = self._arena.guard(int(row["guard"]))
                failed = guard
                if not isinstance(trigger, Literal):
                    failed = Operation("and", (trigger, guard))
                condition = Operation("not", (failed,))
                self.assertions.append(Assertion(condition, self._message(body)))
            case "terminate":
                trigger, guard = self._activation(row)
                if guard is not None:
                    trigger = Operation("and", (trigger, guard))
                self.terminations.append(Termination(trigger, self._message(body)))
            case "warning":
                raise self._refuse(
                    "assert with AssertionLevel.warning", self._place(row["provenance"])
                )
            case _:
                raise self._refuse(f"the event action '{kind}'", self._place(row["provenance"]))

    def _message(self, body: Mapping[str, Any]) -> str:
        text = self._arena.text(int(body["message"]))
        return text or "a condition of the model does not hold"

    def _activation(self, row: Mapping[str, Any]) -> tuple[Expression, Expression | None]:
        """Return the trigger, and what must hold beside it."""
        trigger = self._arena.condition(int(row["trigger"]))
        if _hides_initial(trigger):
            node = self._store["conditions"][int(row["trigger"])]
            raise self._refuse(
                "initial() within a longer condition, other than {initial(), …},",
                self._place(node["provenance"]),
            )
        if row["guard"] == row["trigger"]:
            return trigger, None
        guard = self._arena.guard(int(row["guard"]), events=False)
        return trigger, None if isinstance(guard, Literal) and guard.value else guard

    def _real(self, residual: Expression, row: Mapping[str, Any]) -> None:
        match residual:
            case Operation(operator="subtract", operands=(Symbol() as target, value)):
                self._assign(target, value, row["activation"])
            case _:
                raise self._refuse(
                    "an equation in a when-clause that is not of the form 'variable = …'",
                    self._place(row["provenance"]),
                )

    def _assign(self, target: Symbol, value: Expression, activation: Any) -> None:
        if activation == "always":
            self.equations.append(DiscreteEquation(target.name, value))
            return
        trigger, guard = self._activation(activation["when"])
        if guard is not None:
            value = Operation("if", (guard, value, Previous(target.name)))
        self.when_equations.append(WhenEquation(Operation("subtract", (target, value)), trigger))

    def _owner(self, row: Mapping[str, Any]) -> None:
        position = self._place(row["provenance"])
        if row["structure"] is not None:
            raise self._refuse("an array of Integer or Boolean variables at events", position)
        branches = row["branches"]
        if len(branches) > 1 and any(b["activation"] == "always" for b in branches):
            raise self._refuse("a variable with equations inside and outside when", position)
        for branch in branches:
            activation = branch["activation"]
            if activation != "always" and set(activation) != {"when"}:
                raise self._refuse(
                    f"a discrete equation of the kind '{'/'.join(activation)}'", position
                )
            for target, value in zip(row["targets"], branch["values"], strict=True):
                events = activation == "always"
                for symbol, scalar in self._pairs(target, value["value"], events=events):
                    self._assign(symbol, scalar, activation)


def _hides_initial(trigger: Expression) -> bool:
    if isinstance(trigger, Operation) and trigger.operator == "any_rise":
        return any(_hides_initial(operand) for operand in trigger.operands)
    return any(
        isinstance(node, Operation) and node.operator == "initial" and node is not trigger
        for node in walk(trigger)
    )


def _counter(name: str, description: str) -> Variable:
    return Variable(
        name,
        Role.DISCRETE,
        ScalarType.REAL,
        description=description,
        start=Literal(0.0),
        fixed=True,
    )


def simplified(dae: Dae) -> Dae:
    """Make discrete variables without memory algebraic, and derived free parameters too.

    A Boolean like `b = x > 1`, of which nobody asks for `pre(b)`, follows from the relations, which
    change at events only.
    """
    remembered = {n.name for e in dae.expressions() for n in walk(e) if isinstance(n, Previous)}
    variables = dict(dae.variables)
    residuals, positions = list(dae.residuals), list(dae.residual_positions)
    kept: list[DiscreteEquation] = []
    for equation in dae.discrete_equations:
        if _has_memory(equation.value) or equation.name in remembered:
            kept.append(equation)
            continue
        variable = variables[equation.name]
        variables[equation.name] = replace(variable, role=Role.ALGEBRAIC, fixed=False)
        residuals.append(Operation("subtract", (Symbol(equation.name), equation.value)))
        positions.append(variable.position)
    for name in _derived_from_free(dae):
        variable = variables[name]
        assert variable.binding is not None
        variables[name] = replace(variable, role=Role.ALGEBRAIC, binding=None)
        residuals.append(Operation("subtract", (Symbol(name), variable.binding)))
        positions.append(variable.position)
    return replace(
        dae,
        variables=variables,
        residuals=tuple(residuals),
        residual_positions=tuple(positions),
        discrete_equations=tuple(kept),
    )


def _has_memory(value: Expression) -> bool:
    """Whether `pre(…)` occurs, other than in relations: these are frozen between events."""
    if isinstance(value, Relation):
        return False
    return isinstance(value, Previous) or any(_has_memory(part) for part in children(value))


def _derived_from_free(dae: Dae) -> list[str]:
    """Parameters that depend on one with `fixed = false`, in order of declaration."""
    parameters = {v.name: v for v in dae.parameters}
    free = {n for n, v in dae.variables.items() if v.role in (Role.DISCRETE, Role.STATE)}
    found: dict[str, None] = {}
    changed = True
    while changed:
        changed = False
        for name, variable in parameters.items():
            if name in found or variable.binding is None:
                continue
            if names(variable.binding) & (free | found.keys()):
                found[name] = None
                changed = True
    return list(found)
