"""Equations sorted by what is unknown in them: Σ lump(parameters)·column(signals) = known(signals).

The parameters of an equation of motion enter as sums of products. Products whose columns are
linearly dependent cannot be told apart by any experiment; they are folded into one *base parameter*
(M. Gautier, W. Khalil, "Direct calculation of minimum set of inertial parameters of serial robots",
IEEE Trans. Robotics and Automation 6 (1990) 368-373), here called a lump. Dependence is found
numerically at random points (M. Gautier, "Numerical calculation of the base inertial parameters of
robots", Journal of Robotic Systems 8 (1991) 485-506).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from foundation.errors import UnsupportedModelError
from identification.regressors.sympy_fold import Sym, exact

_DEPENDENT = 1e-9  # relative distance of a column from the span of the others
_MONOMIALS = 400  # beyond this, an equation was not meant to be linear in its parameters


@dataclass(frozen=True)
class Lump:
    """One unknown of the regression.

    Attributes:
        value: What it is in terms of the free parameters.
        column: Its factor in each equation, free of parameters.
    """

    value: Sym
    column: tuple[Sym, ...]


@dataclass(frozen=True)
class LinearForm:
    """Σ_j lumps[j].value · lumps[j].column[i] = known[i] for every equation i.

    Attributes:
        lumps: The base parameters.
        known: Right-hand sides, free of parameters.
        shape: Free parameters inside functions of signals, which stand at their values.
        notes: Sentences, e.g. that only ratios are determined.
    """

    lumps: tuple[Lump, ...]
    known: tuple[Sym, ...]
    shape: tuple[Sym, ...]
    notes: tuple[str, ...]


Table = dict[Sym, list[Sym]]
"""Product of parameters → its factor in each equation."""


def linear_form(
    equations: Sequence[Sym],
    free: Sequence[Sym],
    values: Mapping[str, float],
    controls: Iterable[Sym] = (),
) -> LinearForm:
    """Write equations as a linear regression in base parameters.

    Args:
        equations: Each vanishes.
        free: Symbols of the unknown parameters.
        values: Numbers at which shape parameters are held.
        controls: Inputs and time: where every term holds an unknown, the equation is divided by
            the unknown in front of a term of these alone.

    Raises:
        UnsupportedModelError: No free parameter is left outside functions of signals, or the
            equations expand beyond reason.

    Example:
        >>> m, l, a, u = sp.symbols("m l a u", real=True)
        >>> form = linear_form([m * l**2 * a - u], [m, l], {})
        >>> form.lumps, form.known
        ((Lump(value=l**2*m, column=(a,)),), (u,))
    """
    shape, table = _monomials(list(equations), list(free), values)
    n = len(equations)
    lumps: list[Lump] = []
    known: list[Sym] = [sp.S.Zero] * n
    notes: list[str] = []
    for rows in _components(table, n):
        part = {
            key: [c if i in rows else sp.S.Zero for i, c in enumerate(column)]
            for key, column in table.items()
        }
        part = {key: column for key, column in part.items() if any(c != 0 for c in column)}
        found = _base(part, free)
        pivot = _pivot(found, set(controls))
        if pivot is None:
            continue
        scale = found[pivot].value
        others = [lump for index, lump in enumerate(found) if index != pivot]
        if not others:
            continue
        for i in rows:
            known[i] = -found[pivot].column[i]
        if scale.free_symbols:
            notes.append(f"only ratios to {scale} are determined")
        lumps += [Lump(_tidy(lump.value / scale), lump.column) for lump in others]
    if not lumps:
        names = ", ".join(p.name for p in free) or "none is free"
        raise UnsupportedModelError(
            f"no free parameter enters the equations of motion linearly ({names})",
            remedy="use --method output-error, or free other parameters",
        )
    return LinearForm(tuple(lumps), tuple(known), tuple(shape), tuple(notes))


def _monomials(
    equations: list[Sym], free: list[Sym], values: Mapping[str, float]
) -> tuple[list[Sym], Table]:
    """Expand into products of parameters; parameters that resist are shape, held at values."""
    shape: list[Sym] = []
    while True:
        unknown = [p for p in free if p not in shape]
        prepared = [_prepare(e, set(unknown)) for e in equations]
        table, resisting = _collect(prepared, unknown)
        if not resisting:
            return shape, table
        shape += [p for p in unknown if p in resisting]
        held = {p: exact(values[p.name]) for p in resisting}
        equations = [e.xreplace(held) for e in equations]


def _prepare(equation: Sym, unknown: set[Sym]) -> Sym:
    """Bring an equation into a form whose expansion shows the parameters as factors."""
    equation = _open_angles(equation, unknown)
    equation = _open_branches(equation, unknown)
    while True:
        found = _denominator(equation, unknown)
        if found is None:
            return sp.expand(equation)
        base, exponent = found
        # expand() does not cancel sums, a symbol in the place of the sum does.
        stand_in = sp.Dummy()
        cleared = sp.expand(equation.subs(base, stand_in) * stand_in**exponent)
        equation = cleared.subs(stand_in, base)


def _denominator(equation: Sym, unknown: set[Sym]) -> tuple[Sym, int] | None:
    for power in equation.atoms(sp.Pow):
        base, exponent = power.args
        if base.is_Add and exponent.is_Integer and exponent < 0 and base.free_symbols & unknown:
            same = [p.args[1] for p in equation.atoms(sp.Pow) if p.args[0] == base]
            return base, max(-int(e) for e in same if e.is_Integer)
    return None


def _open_angles(equation: Sym, unknown: set[Sym]) -> Sym:
    """sin(q + p) = sin q cos p + cos q sin p where p is unknown."""
    new = {
        f: sp.expand_trig(f)
        for f in equation.atoms(sp.sin, sp.cos)
        if f.args[0].is_Add and f.free_symbols & unknown and not f.free_symbols <= unknown
    }
    return equation.xreplace(new)


def _open_branches(equation: Sym, unknown: set[Sym]) -> Sym:
    """Pull parameters out of the branches of Piecewise, where no condition holds one."""
    new: dict[Sym, Sym] = {}
    for piecewise in equation.atoms(sp.Piecewise):
        conditions = [c for _, c in piecewise.args]
        values = [v for v, _ in piecewise.args]
        if any(c.free_symbols & unknown for c in conditions if c not in (sp.true, sp.false)):
            continue
        if not any(v.free_symbols & unknown for v in values):
            continue
        table, resisting = _collect([_prepare(v, unknown) for v in values], sorted_symbols(unknown))
        if not resisting:
            new[piecewise] = sp.Add(
                *(
                    key * sp.Piecewise(*zip(column, conditions, strict=True))
                    for key, column in table.items()
                )
            )
    return equation.xreplace(new)


def sorted_symbols(symbols: Iterable[Sym]) -> list[Sym]:
    """Return symbols by name."""
    return sorted(symbols, key=lambda s: s.name)


def _collect(equations: Sequence[Sym], unknown: Sequence[Sym]) -> tuple[Table, set[Sym]]:
    table: Table = {}
    resisting: set[Sym] = set()
    parameters = set(unknown)
    for index, equation in enumerate(equations):
        for term in sp.Add.make_args(equation):
            factor, product = term.as_independent(*unknown, as_Add=False)
            for part in sp.Mul.make_args(product):
                if not part.free_symbols <= parameters:
                    resisting |= _innermost(part, parameters)
            column = table.setdefault(product, [sp.S.Zero] * len(equations))
            column[index] += factor
    if resisting:
        return {}, resisting
    table = {key: column for key, column in table.items() if any(c != 0 for c in column)}
    if len(table) > _MONOMIALS:
        raise UnsupportedModelError(
            f"the equations of motion expand into {len(table)} products of parameters",
            remedy="write the mass matrix implicitly (not solved for accelerations), free fewer "
            "parameters, or use --method output-error",
        )
    return table, resisting


def _innermost(part: Sym, parameters: set[Sym]) -> set[Sym]:
    """Parameters to hold so that `part` opens: those in conditions first, else all inside."""
    conditions: set[Sym] = set()
    for piecewise in part.atoms(sp.Piecewise):
        for _, condition in piecewise.args:
            conditions |= condition.free_symbols & parameters
    return conditions or part.free_symbols & parameters


def _components(table: Table, n: int) -> list[set[int]]:
    """Equations that share an unknown belong together; each group has a scale of its own."""
    groups = [{i} for i in range(n)]
    for key, column in table.items():
        if key != 1:
            rows = {i for i, c in enumerate(column) if c != 0}
            touched = [g for g in groups if g & rows]
            groups = [g for g in groups if not g & rows]
            if touched:
                groups.append(set().union(*touched))
    return sorted(groups, key=min)


def _base(table: Table, free: Sequence[Sym]) -> list[Lump]:
    """Fold dependent columns into independent ones; the known column, if any, comes first."""
    place = {p: index for index, p in enumerate(free)}

    def rank(key: Sym) -> tuple[bool, int, int, list[int], str]:
        order = sorted(place[s] for s in key.free_symbols)
        return key != 1, len(order), int(sp.count_ops(key)), order, str(key)

    keys = sorted(table, key=rank)
    matrix = _random_matrix([table[key] for key in keys])
    norms = np.linalg.norm(matrix, axis=0)
    alive = [j for j in range(len(keys)) if norms[j] > 0]
    kept: list[int] = []
    values = dict(enumerate(keys))
    for j in alive:
        if kept:
            scaled = matrix[:, kept] / norms[kept]
            target = matrix[:, j] / norms[j]
            weights, *_ = np.linalg.lstsq(scaled, target, rcond=None)
            if np.linalg.norm(scaled @ weights - target) < _DEPENDENT:
                for k, weight in zip(kept, weights * norms[j] / norms[kept], strict=True):
                    if abs(weight) * norms[k] > _DEPENDENT * norms[j]:
                        values[k] += _rational(float(weight)) * keys[j]
                continue
        kept.append(j)
    return [Lump(values[j], tuple(table[keys[j]])) for j in kept]


def _random_matrix(columns: Sequence[Sequence[Sym]]) -> NDArray[np.float64]:
    """Evaluate columns, equations stacked, at points of all magnitudes.

    A tanh(v/v0) is a sign far from zero and linear near it: points of one magnitude would call
    either a dependence.
    """
    signals = sorted_symbols({s for column in columns for c in column for s in c.free_symbols})
    points = 50 + 4 * len(columns)
    random = np.random.default_rng(0)
    sizes = 10.0 ** random.uniform(-5, 0.5, (len(signals), points))
    arguments = sizes * random.choice([-1.0, 1.0], sizes.shape)
    rows: list[NDArray[np.float64]] = []
    with np.errstate(all="ignore"):
        for i in range(len(columns[0])):
            function = sp.lambdify([signals], [column[i] for column in columns], "numpy", cse=True)
            evaluated = [np.broadcast_to(v, points) for v in function(arguments)]
            rows.append(np.column_stack(evaluated).astype(float))
    matrix = np.vstack(rows)
    return matrix[np.all(np.isfinite(matrix), axis=1)]


def _rational(weight: float) -> Sym:
    near = Fraction(weight).limit_denominator(10_000)
    if abs(float(near) - weight) <= 1e-9 * abs(weight):
        return sp.Rational(near)
    return exact(float(f"{weight:.12g}"))


def _pivot(lumps: Sequence[Lump], controls: set[Sym]) -> int | None:
    """Choose the column that goes to the right-hand side."""
    if lumps and not lumps[0].value.free_symbols:
        return 0
    for index, lump in enumerate(lumps):
        symbols = set().union(*(c.free_symbols for c in lump.column))
        if symbols and symbols <= controls:
            return index
    # Nothing drives the equations, or the driving term shares its column with others: the scale is
    # arbitrary, and the first unknown (known part folded in) sets it.
    return 0 if lumps else None


def _tidy(value: Sym) -> Sym:
    """Cancel a ratio of parameters and factor what is common, keeping sums of products readable."""
    return sp.expand(value) if value.is_polynomial() else sp.cancel(value)
