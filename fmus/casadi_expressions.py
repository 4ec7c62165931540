"""Expressions folded into CasADi's scalar symbols (SX)."""

from __future__ import annotations

import operator
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


def _smooth(_order: SX, value: SX) -> SX:
    return value


def _no_event(value: SX) -> SX:
    return value


def _homotopy(actual: SX, _simplified: SX) -> SX:
    return actual


def _modulo(a: SX, b: SX) -> SX:
    return a - ca.floor(a / b) * b


_FUNCTIONS = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
    *("exp", "log", "log10", "sqrt", "sign", "floor", "ceil"),
)

OPERATORS: Mapping[str, Callable[..., SX]] = {
    "negate": operator.neg,
    "not": ca.logic_not,
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "element_multiply": operator.mul,
    "divide": operator.truediv,
    "element_divide": operator.truediv,
    "power": operator.pow,
    "element_power": operator.pow,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "less": operator.lt,
    "less_equal": operator.le,
    "greater": operator.gt,
    "greater_equal": operator.ge,
    "equal": operator.eq,
    "not_equal": operator.ne,
    "if": ca.if_else,
    "abs": ca.fabs,
    "min": ca.fmin,
    "max": ca.fmax,
    "smooth": _smooth,
    "no_event": _no_event,
    "mod": _modulo,
    "homotopy": _homotopy,
} | {name: getattr(ca, name) for name in _FUNCTIONS}


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
            case Operation(operator=name, operands=operands):
                if name not in OPERATORS:
                    raise UnsupportedModelError(
                        f"the operator '{name}' has no translation yet",
                        remedy="rewrite the equation without it",
                    )
                return OPERATORS[name](*(self(operand) for operand in operands))
            case Relation(comparison=comparison):
                return self(comparison) if self.relation is None else self.relation(expression)
            case Symbol() | Derivative() | Previous() | Delayed() | Time():
                return self.leaf(expression)


def evaluate(expression: Expression, values: Mapping[str, float]) -> float:
    """Evaluate an expression of parameters and literals in floating point.

    Raises:
        KeyError: A name has no value.

    Example:
        >>> evaluate(Operation("multiply", (Literal(2), Symbol("k"))), {"k": 3.0})
        6.0
    """
    return float(CasadiFold.of_numbers(values)(expression))
