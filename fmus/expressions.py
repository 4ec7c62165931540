"""Expressions of a flat model: a small immutable tree that every later stage reads.

CasADi (code generation, sensitivities) and sympy (regressors) are both reached from here by a
fold, so a construct is understood in one place or refused in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Literal:
    """A number or truth value."""

    value: float | bool


@dataclass(frozen=True, slots=True)
class Time:
    """The independent variable [s]."""


@dataclass(frozen=True, slots=True)
class Symbol:
    """The present value of a variable."""

    name: str


@dataclass(frozen=True, slots=True)
class Derivative:
    """The time derivative of a variable."""

    name: str


@dataclass(frozen=True, slots=True)
class Previous:
    """`pre(name)`: the value just before the present event."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Delayed:
    """`delay(operand, duration)`; `index` numbers the model's delays."""

    index: int
    operand: Expression
    duration: Expression


@dataclass(frozen=True, slots=True, eq=False)
class Operation:
    """An operator or built-in function applied to operands, e.g. `add`, `tanh`, `less`, `if`.

    `if` has the operands condition, value if true, value if false.
    """

    operator: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Relation:
    """A comparison that makes a state or time event; `index` numbers the model's relations."""

    index: int
    comparison: Operation


Expression: TypeAlias = (
    Literal | Time | Symbol | Derivative | Previous | Delayed | Operation | Relation
)


def children(expression: Expression) -> tuple[Expression, ...]:
    """Return the direct operands of an expression."""
    match expression:
        case Operation(operands=operands):
            return operands
        case Relation(comparison=comparison):
            return (comparison,)
        case Delayed(operand=operand, duration=duration):
            return (operand, duration)
        case _:
            return ()


def walk(expression: Expression) -> Iterator[Expression]:
    """Yield an expression and everything below it, each shared node once."""
    seen: set[int] = set()
    stack = [expression]
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        yield node
        stack.extend(children(node))


def names(expression: Expression) -> set[str]:
    """Return the names of all variables whose value, derivative or previous value occurs."""
    return {
        node.name for node in walk(expression) if isinstance(node, Symbol | Derivative | Previous)
    }


def substitute(
    expression: Expression,
    replace: Callable[[Expression], Expression | None],
    memo: dict[int, Expression] | None = None,
) -> Expression:
    """Rebuild an expression; where `replace(node)` is not None, its answer stands for the node.

    Args:
        expression: The expression.
        replace: Called on every node before its operands are visited.
        memo: Share it between calls to keep nodes shared between expressions shared.

    Example:
        >>> e = Operation("add", (Symbol("a"), Literal(1)))
        >>> new = substitute(e, lambda n: Literal(2) if n == Symbol("a") else None)
        >>> new.operands
        (Literal(value=2), Literal(value=1))
    """
    done: dict[int, Expression] = {} if memo is None else memo

    def visit(node: Expression) -> Expression:
        if id(node) in done:
            return done[id(node)]
        new = replace(node)
        if new is None:
            new = _with_children(node, tuple(visit(child) for child in children(node)))
        done[id(node)] = new
        return new

    return visit(expression)


def _with_children(node: Expression, new: tuple[Expression, ...]) -> Expression:
    if all(a is b for a, b in zip(children(node), new, strict=True)):
        return node
    match node:
        case Operation(operator=operator):
            return Operation(operator, new)
        case Relation(index=index):
            comparison = new[0]
            assert isinstance(comparison, Operation)
            return Relation(index, comparison)
        case Delayed(index=index):
            return Delayed(index, new[0], new[1])
        case _:
            return node


def linear_form(  # noqa: PLR0911 - one return a case
    expression: Expression,
) -> tuple[dict[Expression, float], float] | None:
    """Read an expression as Σ number·(symbol or derivative) + number, or return None.

    Example:
        >>> linear_form(Operation("subtract", (Symbol("a"), Symbol("b"))))
        ({Symbol(name='a'): 1.0, Symbol(name='b'): -1.0}, 0.0)
    """
    match expression:
        case Literal(value=value):
            return {}, float(value)
        case Symbol() | Derivative():
            return {expression: 1.0}, 0.0
        case Operation(operator="negate", operands=(a,)):
            return _combine(linear_form(a), -1.0, ({}, 0.0), 0.0)
        case Operation(operator="add", operands=(a, b)):
            return _combine(linear_form(a), 1.0, linear_form(b), 1.0)
        case Operation(operator="subtract", operands=(a, b)):
            return _combine(linear_form(a), 1.0, linear_form(b), -1.0)
        case Operation(operator="multiply", operands=(Literal(value=k), b)):
            return _combine(linear_form(b), float(k), ({}, 0.0), 0.0)
        case _:
            return None


_Linear: TypeAlias = "tuple[dict[Expression, float], float]"


def _combine(a: _Linear | None, ka: float, b: _Linear | None, kb: float) -> _Linear | None:
    if a is None or b is None:
        return None
    terms = {key: ka * value for key, value in a[0].items()}
    for key, value in b[0].items():
        terms[key] = terms.get(key, 0.0) + kb * value
    return {key: value for key, value in terms.items() if value != 0.0}, ka * a[1] + kb * b[1]
