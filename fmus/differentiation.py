"""Time derivatives of expressions, by the chain rule."""

from __future__ import annotations

from collections.abc import Callable

from fmus.expressions import Derivative as DerivativeLeaf
from fmus.expressions import Expression, Literal, Operation, Relation, Symbol, Time

ZERO, ONE = Literal(0.0), Literal(1.0)


class NotDifferentiableError(Exception):
    """An operator or a leaf has no time derivative in the model; holds its name."""


def time_derivative(expression: Expression, leaf: Callable[[Expression], Expression]) -> Expression:
    """Return d/dt of an expression.

    Args:
        expression: The expression. Relations and discrete variables are constant between events.
        leaf: Returns the derivative of a symbol or of a derivative.

    Raises:
        NotDifferentiableError: The expression holds something that has no derivative.

    Example:
        >>> x = Symbol("x")
        >>> time_derivative(Operation("sin", (x,)), lambda s: DerivativeLeaf("x")).operator
        'multiply'
    """

    def go(node: Expression) -> Expression:
        match node:
            case Literal() | Relation():
                return ZERO
            case Time():
                return ONE
            case Symbol() | DerivativeLeaf():
                return leaf(node)
            case Operation(operator=operator, operands=operands):
                return _operation(operator, operands, go)
            case _:
                raise NotDifferentiableError(type(node).__name__.lower())

    return go(expression)


def _operation(  # noqa: PLR0911, PLR0912 - one case an operator
    operator: str, operands: tuple[Expression, ...], go: Callable[[Expression], Expression]
) -> Expression:
    match operator, operands:
        case "add" | "subtract", (a, b):
            return _sum(operator, go(a), go(b))
        case "negate", (a,):
            return negative(go(a))
        case "multiply", (a, b):
            return _sum("add", times(go(a), b), times(a, go(b)))
        case "divide", (a, b):
            rest = _sum("subtract", go(a), times(Operation("divide", (a, b)), go(b)))
            return ZERO if rest is ZERO else Operation("divide", (rest, b))
        case "power" | "element_power", (a, b):
            return _power(a, b, go)
        case "if", (condition, a, b):
            da, db = go(a), go(b)
            return ZERO if da is ZERO and db is ZERO else Operation("if", (condition, da, db))
        case "min" | "max", (a, b):
            comparison = "less" if operator == "min" else "greater"
            return Operation("if", (Operation(comparison, (a, b)), go(a), go(b)))
        case "smooth", (order, a):
            return Operation("smooth", (order, go(a)))
        case "no_event", (a,):
            return go(a)
        case "atan2", (a, b):
            square = _sum("add", times(a, a), times(b, b))
            rest = _sum("subtract", times(b, go(a)), times(a, go(b)))
            return Operation("divide", (rest, square))
        case (("sign" | "floor" | "ceil"), _):
            return ZERO
        case _, (a,) if operator in _OUTER:
            da = go(a)
            return ZERO if da is ZERO else times(_OUTER[operator](a), da)
        case _:
            if all(go(operand) is ZERO for operand in operands):
                return ZERO
            raise NotDifferentiableError(operator)


def _power(a: Expression, b: Expression, go: Callable[[Expression], Expression]) -> Expression:
    da, db = go(a), go(b)
    below = Operation("power", (a, _sum("subtract", b, ONE)))
    part = times(times(b, below), da)
    if db is ZERO:
        return part
    return _sum("add", part, times(times(Operation("power", (a, b)), apply("log", a)), db))


def apply(operator: str, *operands: Expression) -> Expression:
    """Return an operation."""
    return Operation(operator, operands)


def times(a: Expression, b: Expression) -> Expression:
    """Return a·b, with zeros and ones left out."""
    if a is ZERO or b is ZERO:
        return ZERO
    if a is ONE:
        return b
    return a if b is ONE else Operation("multiply", (a, b))


def negative(a: Expression) -> Expression:
    """Return -a."""
    return ZERO if a is ZERO else Operation("negate", (a,))


def _sum(operator: str, a: Expression, b: Expression) -> Expression:
    if b is ZERO:
        return a
    if a is ZERO:
        return negative(b) if operator == "subtract" else b
    return Operation(operator, (a, b))


def _square(a: Expression) -> Expression:
    return Operation("multiply", (a, a))


def _inverse(a: Expression) -> Expression:
    return Operation("divide", (ONE, a))


def _one_minus_square(a: Expression) -> Expression:
    return Operation("subtract", (ONE, _square(a)))


_OUTER: dict[str, Callable[[Expression], Expression]] = {
    "sin": lambda a: apply("cos", a),
    "cos": lambda a: negative(apply("sin", a)),
    "tan": lambda a: apply("add", ONE, _square(apply("tan", a))),
    "asin": lambda a: _inverse(apply("sqrt", _one_minus_square(a))),
    "acos": lambda a: negative(_inverse(apply("sqrt", _one_minus_square(a)))),
    "atan": lambda a: _inverse(apply("add", ONE, _square(a))),
    "sinh": lambda a: apply("cosh", a),
    "cosh": lambda a: apply("sinh", a),
    "tanh": lambda a: _one_minus_square(apply("tanh", a)),
    "exp": lambda a: apply("exp", a),
    "log": _inverse,
    "log10": lambda a: _inverse(times(Literal(2.302585092994046), a)),
    "sqrt": lambda a: _inverse(times(Literal(2.0), apply("sqrt", a))),
    "abs": lambda a: apply("sign", a),
}
"""Outer derivatives of functions of one variable."""
