"""Relations, when-clauses and reinit as CasADi functions of the frozen situation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca

from fmus.blocks import solve_blocks
from fmus.casadi_expressions import SX
from fmus.dae import Dae, Role, WhenEquation
from fmus.explicit import ExplicitModel
from fmus.expressions import Expression, Literal, Operation, Relation, Symbol, substitute
from foundation.errors import UnsupportedModelError


@dataclass(frozen=True)
class EventSystem:
    """What happens at events.

    Attributes:
        indicators: Column; positive where the relation of that index holds.
        strict: For each relation, whether it is false where its indicator is zero.
        triggers: Column of when-conditions, 0 or 1; a clause fires when one rises.
        at_start: For each trigger, whether it is `initial()`.
        terminates: For each trigger, the message with which it ends the simulation, or nothing.
        fired: Column symbol: which triggers have risen.
        after: Column of states and discrete variables after the event.
        assertions: Column; zero where the assertion of that index fails.
    """

    indicators: SX
    strict: tuple[bool, ...]
    triggers: SX
    at_start: tuple[bool, ...]
    terminates: tuple[str, ...]
    fired: SX
    after: SX
    assertions: SX


def event_system(model: ExplicitModel) -> EventSystem:
    """Collect the events of a model whose relations are frozen.

    Raises:
        UnsupportedModelError: A when-clause has no translation.
    """
    triggers: list[Expression] = []

    def number(trigger: Expression) -> list[int]:
        found: list[int] = []
        for condition in _conditions(trigger):
            if condition not in triggers:  # by identity: equal text makes equal clauses anyway
                triggers.append(condition)
            found.append(triggers.index(condition))
        return found

    when = [(equation, number(equation.trigger)) for equation in model.dae.when_equations]
    reinits = [(reinit, number(reinit.trigger)) for reinit in model.dae.reinits]
    ends = {i: t.message for t in model.dae.terminations for i in number(t.trigger)}
    fired = ca.SX.sym("fired", len(triggers))

    def rises(numbers: list[int]) -> SX:
        result = ca.SX(0)
        for i in numbers:
            result = ca.logic_or(result, fired[i])
        return result

    discrete = _discrete_after(model, [(e, rises(numbers)) for e, numbers in when])
    states = [model.x[i] for i in range(len(model.state_names))]
    for reinit, numbers in reinits:
        i = model.state_names.index(reinit.state)
        value = _with_new(model, reinit.value, discrete)
        states[i] = ca.if_else(rises(numbers), value, states[i])
    return EventSystem(
        indicators=_column([_indicator(model, r) for r in model.dae.relations]),
        strict=tuple(r.comparison.operator in ("greater", "less") for r in model.dae.relations),
        triggers=_triggers(model, triggers),
        at_start=tuple(_is_initial(t) for t in triggers),
        terminates=tuple(ends.get(i, "") for i in range(len(triggers))),
        fired=fired,
        after=_column([*states, discrete]),
        assertions=_column([model.fold(a.condition) for a in model.dae.assertions]),
    )


def signs_as_relations(dae: Dae) -> Dae:
    """Return the model with each sign(a) written as two relations, so that its jump is an event.

    The integrator could not step over the jump otherwise, let alone stay on it, as a mass does
    that dry friction holds.
    """
    relations = list(dae.relations)

    def holds(operator: str, operand: Expression) -> Operation:
        relation = Relation(len(relations), Operation(operator, (operand, Literal(0.0))))
        relations.append(relation)
        return Operation("if", (relation, Literal(1.0), Literal(0.0)))

    def replace_sign(node: Expression) -> Expression | None:
        match node:
            case Operation(operator="no_event" | "smooth"):
                return node
            case Operation(operator="sign", operands=(operand,)):
                inner = substitute(operand, replace_sign, memo)
                positive, negative = holds("greater", inner), holds("less", inner)
                return Operation("subtract", (positive, negative))
            case _:
                return None

    memo: dict[int, Expression] = {}
    residuals = tuple(substitute(r, replace_sign, memo) for r in dae.residuals)
    return replace(dae, residuals=residuals, relations=tuple(relations))


def _column(parts: Sequence[SX]) -> SX:
    return ca.vertcat(*parts) if parts else ca.SX(0, 1)


def _conditions(trigger: Expression) -> list[Expression]:
    """`when {a, b}` fires when any of them rises."""
    if isinstance(trigger, Operation) and trigger.operator == "any_rise":
        return [c for operand in trigger.operands for c in _conditions(operand)]
    return [trigger]


def _is_initial(trigger: Expression) -> bool:
    return isinstance(trigger, Operation) and trigger.operator == "initial"


def _triggers(model: ExplicitModel, triggers: Sequence[Expression]) -> SX:
    """Conditions at an event: variables that follow at once are new, pre(…) is old."""
    parts: list[SX] = []
    now = _discrete_after(model, [])
    for trigger in triggers:
        if _is_initial(trigger):
            parts.append(ca.SX(0))  # applied once, at the start
        else:
            parts.append(_with_new(model, trigger, now))
    return _column(parts)


def _indicator(model: ExplicitModel, relation: Relation) -> SX:
    left, right = (model.fold(operand) for operand in relation.comparison.operands)
    greater = relation.comparison.operator in ("greater", "greater_equal")
    return left - right if greater else right - left


def _before(model: ExplicitModel) -> SX:
    """What pre(…) stands for: values as the event began."""

    def value(name: str) -> SX:
        if name in model.discrete_names:
            return model.discrete[model.discrete_names.index(name)]
        return model.value(name)

    return _column([value(name) for name in model.previous_names])


def _discrete_after(model: ExplicitModel, when: Sequence[tuple[WhenEquation, SX]]) -> SX:
    """New values of the discrete variables; equations at one event may use each other's."""
    new = ca.SX.sym("new", len(model.discrete_names))
    values = [model.discrete[i] for i in range(len(model.discrete_names))]
    # The first clause wins where `elsewhen` gives several for one variable.
    for equation, rises in reversed(when):
        target, expression = _assignment(model, equation)
        i = model.discrete_names.index(target)
        values[i] = ca.if_else(rises, _with_new(model, expression, new), values[i])
    for equation in model.dae.discrete_equations:
        i = model.discrete_names.index(equation.name)
        values[i] = _with_new(model, equation.value, new)
    unknowns = [new[i] for i in range(len(values))]
    residuals = [unknown - value for unknown, value in zip(unknowns, values, strict=True)]
    return _column(solve_blocks(residuals, unknowns, where=model.dae.name))


def _with_new(model: ExplicitModel, expression: Expression, discrete: SX) -> SX:
    """Fold an expression of a when-clause: discrete variables are new, pre(…) is old."""
    value = ca.substitute(model.fold(expression), model.discrete, discrete)
    return ca.substitute(value, model.previous, _before(model))


def _assignment(model: ExplicitModel, equation: WhenEquation) -> tuple[str, Expression]:
    match equation.residual:
        case Operation(operator="subtract", operands=(Symbol(name=name), value)) if (
            model.dae.variables[name].role is Role.DISCRETE
        ):
            return name, value
        case _:
            raise UnsupportedModelError(
                f"{model.dae.name}: an equation in a when-clause is not of the form 'variable = …'",
                remedy="solve it for its discrete variable in the model",
            )
