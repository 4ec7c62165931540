"""Alias elimination: variables that equal another one (or its negative, or a number) are removed.

Connections produce mostly such equations. Removing them here matters for more than size: an effect
that writes `der(flange.phi)` makes its flange angle a state, equal to a state of the plant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fmus.dae import Alias, ConstantValue, Dae, Role, Variable
from fmus.expressions import (
    Derivative,
    Expression,
    Literal,
    Operation,
    Previous,
    Symbol,
    linear_form,
    substitute,
    walk,
)


@dataclass(frozen=True)
class _Link:
    """`removed` equals `sign` · `kept`."""

    removed: str
    kept: str
    sign: float


def without_aliases(dae: Dae) -> Dae:
    """Return the model without equations of the form a = ±b and a = number.

    Derivatives follow: where a state is removed, the variable that stays becomes the state.
    """
    aliases: dict[str, Alias] = {}
    constant_values: dict[str, ConstantValue] = {}
    while True:
        step = _find(dae)
        if step is None:
            return replace(dae, aliases=aliases, constant_values=constant_values)
        index, link, value = step
        dae = _drop_equation(dae, index)
        if link is None:
            assert value is not None
            name, number = value
            constant_values[name] = ConstantValue(dae.variables[name], number)
            for alias in [a for a in aliases.values() if a.of == name]:
                constant_values[alias.name] = ConstantValue(alias.declared, alias.sign * number)
                del aliases[alias.name]
            dae = _replace_all(dae, {name: (Literal(number), Literal(0.0))}, name)
            continue
        declared = dae.variables[link.removed]
        dae = _merge(dae, link)
        aliases = {
            name: replace(alias, of=link.kept, sign=alias.sign * link.sign)
            if alias.of == link.removed
            else alias
            for name, alias in aliases.items()
        }
        aliases[link.removed] = Alias(link.removed, link.kept, link.sign, declared)


def _find(dae: Dae) -> tuple[int, _Link | None, tuple[str, float] | None] | None:
    for index, residual in enumerate(dae.residuals):
        form = linear_form(residual)
        if form is None or len(form[0]) not in (1, 2):
            continue
        terms, constant = form
        if any(isinstance(term, Derivative) for term in terms):
            continue
        symbols = [(term.name, k) for term, k in terms.items() if isinstance(term, Symbol)]
        if len(symbols) == 1:
            name, k = symbols[0]
            variable = dae.variables[name]
            if variable.role is Role.ALGEBRAIC and not variable.output:
                return index, None, (name, -constant / k + 0.0)  # no minus zero
            continue
        (a, ka), (b, kb) = symbols
        if constant != 0.0 or abs(ka) != abs(kb):
            continue
        sign = -kb / ka  # a = sign·b
        removed, kept = _choose(dae.variables[a], dae.variables[b])
        if removed is not None and kept is not None:
            return index, _Link(removed.name, kept.name, sign), None
    return None


def _choose(a: Variable, b: Variable) -> tuple[Variable | None, Variable | None]:
    """Return (removed, kept): what the user declared at the top stays, inner copies go."""
    removable = [v for v in (a, b) if v.role in (Role.ALGEBRAIC, Role.STATE)]
    if not removable:
        return None, None
    if len(removable) == 1:
        removed = removable[0]
        kept = b if removed is a else a
        # A state cannot follow an input or a parameter; an output keeps a name of its own.
        if removed.role is Role.STATE or removed.output or kept.role is Role.DISCRETE:
            return None, None
        return removed, kept
    if a.output and b.output:
        return None, None

    def rank(v: Variable) -> tuple[bool, int, bool, bool, int]:
        is_state = v.role is Role.STATE
        return (not v.output, v.name.count("."), not v.fixed, not is_state, len(v.name))

    kept, removed = sorted((a, b), key=rank)
    return removed, kept


def _drop_equation(dae: Dae, index: int) -> Dae:
    residuals = dae.residuals[:index] + dae.residuals[index + 1 :]
    positions = dae.residual_positions[:index] + dae.residual_positions[index + 1 :]
    return replace(dae, residuals=residuals, residual_positions=positions)


def _merge(dae: Dae, link: _Link) -> Dae:
    removed, kept = dae.variables[link.removed], dae.variables[link.kept]
    variables = dict(dae.variables)
    start, fixed = kept.start, kept.fixed
    # The start that is binding wins; of two equals, that of the variable that stays.
    if (removed.fixed and not fixed) or (start is None and fixed == removed.fixed):
        start, fixed = removed.start, removed.fixed
        if start is not None and link.sign < 0:
            start = Operation("negate", (start,))
    role = Role.STATE if Role.STATE in (removed.role, kept.role) else kept.role
    if kept.role in (Role.STATE, Role.ALGEBRAIC):
        variables[link.kept] = replace(kept, role=role, start=start, fixed=fixed)
    dae = replace(dae, variables=variables)
    value, derivative = Symbol(link.kept), Derivative(link.kept)
    if link.sign < 0:
        new = (Operation("negate", (value,)), Operation("negate", (derivative,)))
    else:
        new = (value, derivative)
    return _replace_all(dae, {link.removed: new}, link.removed)


def _replace_all(dae: Dae, new: Mapping[str, tuple[Expression, Expression]], removed: str) -> Dae:
    """Put (value, derivative) in the place of a variable everywhere, and forget the variable."""

    def swap(node: Expression) -> Expression | None:
        match node:
            case Symbol(name=name) | Previous(name=name) if name in new:
                return new[name][0]
            case Derivative(name=name) if name in new:
                return new[name][1]
            case _:
                return None

    memo: dict[int, Expression] = {}

    def go(expression: Expression) -> Expression:
        return substitute(expression, swap, memo)

    dae = replace(
        dae,
        variables={name: v for name, v in dae.variables.items() if name != removed},
        reinits=tuple(
            replace(r, state=_target(new[removed][0])) if r.state == removed else r
            for r in dae.reinits
        ),
    )
    return dae.mapped(go)


def _target(expression: Expression) -> str:
    return next(node.name for node in walk(expression) if isinstance(node, Symbol))
