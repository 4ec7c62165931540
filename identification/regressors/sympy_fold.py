"""Expressions folded into sympy, which can integrate and factor what CasADi can only evaluate."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

import sympy as sp

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

Sym: TypeAlias = Any
"""A sympy expression or condition; sympy's own annotations do not carry through arithmetic."""


def exact(value: float) -> Sym:
    """Return the rational that a number's shortest decimal form denotes.

    Rationals cancel exactly; binary fractions leave dust that hides that a term vanished.

    Example:
        >>> exact(0.1)
        1/10
    """
    return sp.Rational(Fraction(repr(float(value))))


def symbols_of(*expressions: Sym) -> frozenset[Sym]:
    """Return the symbols that occur in any of the expressions."""
    found: set[Sym] = set()
    for expression in expressions:
        found |= expression.free_symbols
    return frozenset(found)


def names_of(*expressions: Sym) -> frozenset[str]:
    """Return the names of the symbols that occur in any of the expressions."""
    return frozenset(symbol.name for symbol in symbols_of(*expressions))


def _if(condition: Sym, yes: Sym, no: Sym) -> Sym:
    return sp.Piecewise((yes, condition), (no, True))


def _first(a: Sym, _: Sym) -> Sym:
    return a


def _second(_: Sym, b: Sym) -> Sym:
    return b


def _same(a: Sym) -> Sym:
    return a


def _mod(a: Sym, b: Sym) -> Sym:
    return a - sp.floor(a / b) * b


def _log10(a: Sym) -> Sym:
    return sp.log(a) / sp.log(10)


_BY_HAND: Mapping[str, Callable[..., Sym]] = {
    "negate": operator.neg,
    "not": sp.Not,
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "element_multiply": operator.mul,
    "divide": operator.truediv,
    "element_divide": operator.truediv,
    "power": operator.pow,
    "element_power": operator.pow,
    "and": sp.And,
    "or": sp.Or,
    "less": sp.Lt,
    "less_equal": sp.Le,
    "greater": sp.Gt,
    "greater_equal": sp.Ge,
    "equal": sp.Eq,
    "not_equal": sp.Ne,
    "if": _if,
    "abs": sp.Abs,
    "min": sp.Min,
    "max": sp.Max,
    "smooth": _second,
    "no_event": _same,
    "mod": _mod,
    "homotopy": _first,
    "ceil": sp.ceiling,
    "log10": _log10,
}

_TRIGONOMETRIC = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")
_BY_NAME = (*_TRIGONOMETRIC, "exp", "log", "sqrt", "sign", "floor")

OPERATORS: Mapping[str, Callable[..., Sym]] = {
    **_BY_HAND,
    **{name: getattr(sp, name) for name in _BY_NAME},
}


@dataclass
class SympyFold:
    """Turns expressions into sympy, given the symbol that stands for each leaf.

    Args:
        leaf: Maps a leaf (`Symbol`, `Derivative`, `Previous`, `Delayed`, `Time`) to sympy.

    Example:
        >>> fold = SympyFold(lambda leaf: sp.Symbol(leaf.name, real=True))
        >>> fold(Operation("multiply", (Literal(0.5), Symbol("k"))))
        k/2
    """

    leaf: Callable[[Expression], Sym]
    _memo: dict[int, tuple[Expression, Sym]] = field(default_factory=dict[int, Any])

    def __call__(self, expression: Expression) -> Sym:
        """Return the sympy form of an expression; relations are evaluated in place.

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

    def _fold(self, expression: Expression) -> Sym:
        match expression:
            case Literal(value=bool() as value):
                return sp.true if value else sp.false
            case Literal(value=value):
                return exact(value)
            case Operation(operator=name, operands=operands):
                if name not in OPERATORS:
                    raise UnsupportedModelError(
                        f"the operator '{name}' has no symbolic form",
                        remedy="use --method output-error, or rewrite the equation without it",
                    )
                return OPERATORS[name](*(self(operand) for operand in operands))
            case Relation(comparison=comparison):
                return self(comparison)
            case Symbol() | Derivative() | Previous() | Delayed() | Time():
                return self.leaf(expression)
