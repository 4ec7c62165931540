"""Expressions folded into CasADi's scalar symbols (SX)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import casadi as ca

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
from foundation.errors import UnsupportedModelError

SX: TypeAlias = Any
"""casadi.SX; the package ships no type information."""


def _if(condition: SX, yes: SX, no: SX) -> SX:
    return ca.if_else(condition, yes, no)


def _not_equal(a: SX, b: SX) -> SX:
    return a != b


OPERATORS: Mapping[str, Callable[..., SX]] = {
    "negate": lambda a: -a,
    "not": ca.logic_not,
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "element_multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "power": lambda a, b: a**b,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "greater": lambda a, b: a > b,
    "greater_equal": lambda a, b: a >= b,
    "equal": lambda a, b: a == b,
    "not_equal": _not_equal,
    "if": _if,
    "abs": ca.fabs,
    "min": ca.fmin,
    "max": ca.fmax,
    "smooth": lambda _, a: a,
    "no_event": lambda a: a,
    "mod": lambda a, b: a - ca.floor(a / b) * b,
    "homotopy": lambda actual, _: actual,
} | {
    name: getattr(ca, name)
    for name in (
        "sin cos tan asin acos atan atan2 sinh cosh tanh exp log log10 sqrt sign floor ceil".split()
    )
}


@dataclass
class CasadiFold:
    """Turns expressions into CasADi, given the symbol that stands for each leaf.

    Args:
        leaf: Maps a leaf (`Symbol`, `Derivative`, `Previous`, `Delayed`, `Time`) to its SX.
        relation: Maps a relation to its SX, or None to evaluate comparisons in place.
    """

    leaf: Callable[[Expression], SX]
    relation: Callable[[Relation], SX] | None = None
    _memo: dict[int, tuple[Expression, SX]] = field(default_factory=dict[int, Any])

    @classmethod
    def of_numbers(cls, values: Mapping[str, float]) -> CasadiFold:
        """Return a fold in which every variable has a number."""

        def leaf(node: Expression) -> SX:
            if isinstance(node, Symbol):
                return ca.SX(values[node.name])
            raise KeyError(str(node))

        return cls(leaf)

    def __call__(self, expression: Expression) -> SX:
        """Return the SX of an expression.

        Raises:
            UnsupportedModelError: An operator has no translation.
        """
        known = self._memo.get(id(expression))
        if known is not None:
            return known[1]
        result = self._fold(expression)
        # The node is kept beside its value, so that its id stays its own.
        self._memo[id(expression)] = (expression, result)
        return result

    def _fold(self, expression: Expression) -> SX:
        match expression:
            case Literal(value=value):
                return ca.SX(float(value))
            case Operation(operator=operator, operands=operands):
                if operator not in OPERATORS:
                    raise UnsupportedModelError(
                        f"the operator '{operator}' has no translation yet",
                        remedy="rewrite the equation without it",
                    )
                return OPERATORS[operator](*(self(operand) for operand in operands))
            case Relation(comparison=comparison):
                return self(comparison) if self.relation is None else self.relation(expression)
            case Symbol() | Derivative() | Previous() | Delayed() | Time():
                return self.leaf(expression)
