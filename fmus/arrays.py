"""Arrays of expressions as nested tuples, and Modelica's operators on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial, reduce
from itertools import chain
from typing import TypeAlias

from fmus.casadi_expressions import evaluate
from fmus.expressions import Expression, Literal, Operation, walk

Value: TypeAlias = "Expression | tuple[Value, ...]"

_ONE_BY_ONE = {
    f"{prefix}_{operator}": operator
    for prefix in ("element", "elementwise")
    for operator in ("add", "subtract", "multiply", "divide", "power")
}
_CONSTANT_FOLDED = frozenset(
    (
        *("add", "subtract", "multiply", "negate", "not", "and", "or"),
        *("less", "less_equal", "greater", "greater_equal", "equal", "not_equal"),
    )
)


def of_names(name: str, shape: Sequence[int], leaf: Callable[[str], Expression]) -> Value:
    """Return the leaf of a scalar variable, or those of an array's elements.

    Example:
        >>> from fmus.expressions import Symbol
        >>> of_names("x", [2], Symbol)
        (Symbol(name='x[1]'), Symbol(name='x[2]'))
    """

    def build(subscripts: tuple[int, ...]) -> Value:
        if len(subscripts) == len(shape):
            return leaf(element_name(name, subscripts))
        return tuple(build((*subscripts, k + 1)) for k in range(shape[len(subscripts)]))

    return build(())


def element_name(name: str, subscripts: Sequence[int]) -> str:
    """Return `x[1,2]`; of a scalar, its name."""
    return f"{name}[{','.join(map(str, subscripts))}]" if subscripts else name


def flat(value: Value) -> Iterator[Expression]:
    """Yield the elements in row-major order; a scalar is one element."""
    if isinstance(value, tuple):
        for part in value:
            yield from flat(part)
    else:
        yield value


def shape(value: Value) -> tuple[int, ...]:
    """Return the lengths of all dimensions; () for a scalar."""
    if not isinstance(value, tuple):
        return ()
    return (len(value), *(shape(value[0]) if value else ()))


def number(value: Value) -> float | None:
    """Return the number that an expression without variables is; None for others."""
    if isinstance(value, tuple):
        return None
    if any(not isinstance(node, Literal | Operation) for node in walk(value)):
        return None
    if any(isinstance(n, Operation) and n.operator == "initial" for n in walk(value)):
        return None
    return evaluate(value, {})


def choose(condition: Expression, value: Value, otherwise: Value) -> Value:
    """Return `if condition then value else otherwise`, element by element."""
    return _broadcast(lambda a, b: Operation("if", (condition, a, b)), value, otherwise)


def element(value: Value, subscripts: Sequence[Value | None]) -> Value:
    """Return what subscripts select; None is a colon.

    Raises:
        ValueError: A subscript is outside the array.
    """
    if not subscripts:
        return value
    if not isinstance(value, tuple):
        raise ValueError("a subscript on a number")
    first, rest = subscripts[0], subscripts[1:]
    if first is None:
        return tuple(element(part, rest) for part in value)
    if isinstance(first, tuple):
        return tuple(element(value, [one, *rest]) for one in first)
    known = number(first)
    if known is not None:
        if not 1 <= known <= len(value):
            raise ValueError(f"the subscript {known:g} outside 1 to {len(value)}")
        return element(value[int(known) - 1], rest)
    # A subscript that changes chooses among all elements.
    result = element(value[-1], rest)
    for k in range(len(value) - 1, 0, -1):
        here = Operation("equal", (first, Literal(k)))
        result = choose(here, element(value[k - 1], rest), result)
    return result


def apply(operator: str, operands: Sequence[Value]) -> Value:
    """Apply an operator or built-in function of Modelica.

    Raises:
        ValueError: It has no meaning for arrays of these shapes.
    """
    if operator in _OF_ARRAYS:
        return _OF_ARRAYS[operator](*operands)
    name = _ONE_BY_ONE.get(operator, operator)
    if not any(isinstance(o, tuple) for o in operands):
        return _scalar(name, [o for o in operands if not isinstance(o, tuple)])
    if operator == "multiply":
        return _product(operands[0], operands[1])
    if operator in ("min", "max") and len(operands) == 1:
        return _fold(operator, operands[0])
    if len(operands) == 1:
        return _each(lambda a: _scalar(name, [a]), operands[0])
    if len(operands) == 2:
        return _broadcast(lambda a, b: _scalar(name, [a, b]), operands[0], operands[1])
    raise ValueError(f"the function '{operator}' of an array")


def _scalar(operator: str, operands: Sequence[Expression]) -> Expression:
    result = Operation(operator, tuple(operands))
    # Subscripts and conditions on them must become plain numbers.
    if operator in _CONSTANT_FOLDED and all(isinstance(o, Literal) for o in operands):
        value = evaluate(result, {})
        return Literal(int(value) if value.is_integer() else value)
    return result


def _each(function: Callable[[Expression], Expression], value: Value) -> Value:
    if isinstance(value, tuple):
        return tuple(_each(function, part) for part in value)
    return function(value)


def _broadcast(
    function: Callable[[Expression, Expression], Expression], a: Value, b: Value
) -> Value:
    if isinstance(a, tuple) and isinstance(b, tuple):
        if len(a) != len(b):
            raise ValueError(f"arrays of {len(a)} and {len(b)} elements together")
        return tuple(_broadcast(function, x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, tuple):
        return tuple(_broadcast(function, x, b) for x in a)
    if isinstance(b, tuple):
        return tuple(_broadcast(function, a, y) for y in b)
    return function(a, b)


def _product(a: Value, b: Value) -> Value:
    """Modelica's `*`: scaling, scalar product, or product of matrices."""
    if not isinstance(a, tuple) or not isinstance(b, tuple):
        return _broadcast(lambda x, y: _scalar("multiply", [x, y]), a, b)
    if len(shape(a)) == 2:
        return tuple(_product(row, b) for row in a)
    if len(shape(b)) == 2:
        columns = _transpose(b)
        assert isinstance(columns, tuple)
        return tuple(_product(a, column) for column in columns)
    if len(a) != len(b):
        raise ValueError(f"a product of {len(a)} and {len(b)} elements")
    return _fold("add", _broadcast(lambda x, y: _scalar("multiply", [x, y]), a, b))


def _fold(operator: str, value: Value) -> Expression:
    elements = list(flat(value))
    if not elements:
        return Literal(1 if operator == "multiply" else 0)
    return reduce(lambda a, b: _scalar(operator, [a, b]), elements)


def _transpose(value: Value) -> Value:
    if not isinstance(value, tuple) or not isinstance(value[0], tuple):
        raise ValueError("transpose of something that is no matrix")
    rows = [row for row in value if isinstance(row, tuple)]
    return tuple(tuple(row[k] for row in rows) for k in range(len(rows[0])))


def _integer(value: Value) -> int:
    known = number(value)
    if known is None:
        raise ValueError("an array size that is no constant")
    return int(known)


def _size(value: Value, dimension: Value | None = None) -> Value:
    lengths = shape(value)
    if dimension is None:
        return tuple(Literal(n) for n in lengths)
    return Literal(lengths[_integer(dimension) - 1])


def _filled(value: Expression, sizes: Sequence[Value]) -> Value:
    if not sizes:
        return value
    return tuple(_filled(value, sizes[1:]) for _ in range(_integer(sizes[0])))


def _fill(value: Value, *sizes: Value) -> Value:
    if not sizes:
        return value
    return tuple(_fill(value, *sizes[1:]) for _ in range(_integer(sizes[0])))


def _identity(size: Value) -> Value:
    n = range(_integer(size))
    return tuple(tuple(Literal(int(i == j)) for j in n) for i in n)


def _diagonal(value: Value) -> Value:
    entries = list(flat(value))
    n = range(len(entries))
    return tuple(tuple(entries[i] if i == j else Literal(0) for j in n) for i in n)


def _linspace(first: Value, last: Value, size: Value) -> Value:
    n = _integer(size)

    def at(k: int) -> Value:
        step = _product(Literal(k / (n - 1)), apply("subtract", (last, first)))
        return apply("add", (first, step))

    return tuple(at(k) for k in range(n))


def _cross(a: Value, b: Value) -> Value:
    x, y = list(flat(a)), list(flat(b))
    if len(x) != 3 or len(y) != 3:
        raise ValueError("cross product of vectors that have not three elements")

    def part(i: int, j: int) -> Expression:
        terms = (_scalar("multiply", [x[i], y[j]]), _scalar("multiply", [x[j], y[i]]))
        return _scalar("subtract", terms)

    return (part(1, 2), part(2, 0), part(0, 1))


def _skew(a: Value) -> Value:
    x, y, z = flat(a)

    def minus(e: Expression) -> Expression:
        return _scalar("negate", [e])

    zero = Literal(0)
    return ((zero, minus(z), y), (z, zero, minus(x)), (minus(y), x, zero))


def _outer(a: Value, b: Value) -> Value:
    return tuple(tuple(_scalar("multiply", [x, y]) for y in flat(b)) for x in flat(a))


def _promoted(value: Value, dimensions: int) -> Value:
    """Give a value further dimensions of length one behind its own, as `[a, b; c, d]` does."""
    if isinstance(value, tuple):
        return tuple(_promoted(part, dimensions - 1) for part in value)
    return value if dimensions == 0 else (_promoted(value, dimensions - 1),)


def _joined(dimension: int, *values: Value) -> Value:
    if dimension == 1:
        parts = (value if isinstance(value, tuple) else (value,) for value in values)
        return tuple(chain.from_iterable(parts))
    rows = [value for value in values if isinstance(value, tuple)]
    return tuple(_joined(dimension - 1, *parts) for parts in zip(*rows, strict=True))


def _cat(dimension: Value, *values: Value) -> Value:
    return _joined(_integer(dimension), *values)


def _rows(*values: Value) -> Value:
    return _joined(1, *(_promoted(value, 2) for value in values))


def _columns(*values: Value) -> Value:
    return _joined(2, *(_promoted(value, 2) for value in values))


def _dimensions(value: Value) -> Value:
    return Literal(len(shape(value)))


def _vector(value: Value) -> Value:
    return tuple(flat(value))


def _only(value: Value) -> Value:
    elements = list(flat(value))
    if len(elements) != 1:
        raise ValueError(f"scalar() of {len(elements)} elements")
    return elements[0]


def _symmetric(value: Value) -> Value:
    rows = [list(flat(row)) for row in value] if isinstance(value, tuple) else []
    n = range(len(rows))
    return tuple(tuple(rows[min(i, j)][max(i, j)] for j in n) for i in n)


_OF_ARRAYS: dict[str, Callable[..., Value]] = {
    "sum": partial(_fold, "add"),
    "product": partial(_fold, "multiply"),
    "transpose": _transpose,
    "size": _size,
    "ndims": _dimensions,
    "zeros": lambda *sizes: _filled(Literal(0), sizes),
    "ones": lambda *sizes: _filled(Literal(1), sizes),
    "fill": _fill,
    "identity": _identity,
    "diagonal": _diagonal,
    "linspace": _linspace,
    "cross": _cross,
    "skew": _skew,
    "outer_product": _outer,
    "outerProduct": _outer,
    "symmetric": _symmetric,
    "scalar": _only,
    "vector": _vector,
    "cat": _cat,
    "promoted_cat1": _rows,
    "promoted_cat2": _columns,
}
