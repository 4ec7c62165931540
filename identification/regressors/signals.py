"""Terms of a regression evaluated on a record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from foundation.errors import DivergenceError
from identification.problem import Problem
from identification.regressors.regression import Regression
from identification.regressors.sympy_fold import Sym

Array = NDArray[np.float64]

Operator: TypeAlias = "Callable[[Array, Array, int], Array]"
"""(values just after each sample, values just before the next, order) → order-th derivative."""


@dataclass(frozen=True)
class Rows:
    """A regression on a record: matrix[i] @ lumps = right[i] + noise, for each equation i.

    Attributes:
        matrix: (equations, n, columns).
        right: (equations, n).
        size: (equations, columns) size that a column would have if nothing in it cancelled; a
            column much smaller than this is zero up to rounding.
        nuisance: (n, r) motions that each equation may hold in any amount.
    """

    matrix: Array
    right: Array
    size: Array
    nuisance: Array


def signals(regression: Regression, problem: Problem) -> dict[Sym, Array]:
    """Return the variables of a problem's model as (n,) arrays.

    Rates that are not recorded are central differences of their coordinates.
    """
    recorded = dict(zip(problem.output_names, problem.outputs.T, strict=True))
    known: dict[Sym, Array] = {regression.time: problem.time}
    for symbol, values in zip(regression.inputs, problem.inputs.T, strict=True):
        known[symbol] = values
    for coordinate in regression.coordinates:
        reading = regression.readings[coordinate.position.name]
        known[coordinate.position] = (recorded[reading.channel] - reading.offset) / reading.gain
        rate = regression.readings.get(coordinate.rate.name)
        if rate is None:
            position = known[coordinate.position]
            known[coordinate.rate] = np.gradient(position, problem.sample_time, edge_order=2)
        else:
            known[coordinate.rate] = (recorded[rate.channel] - rate.offset) / rate.gain
    return known


def accelerations(regression: Regression, problem: Problem) -> dict[Sym, Array]:
    """Return `signals` and the accelerations, as differences of the rates."""
    known = signals(regression, problem)
    for coordinate in regression.coordinates:
        if coordinate.acceleration is not None:
            rate = known[coordinate.rate]
            known[coordinate.acceleration] = np.gradient(rate, problem.sample_time, edge_order=2)
    return known


def evaluate(expressions: Sequence[Sym], known: dict[Sym, Array]) -> list[Array]:
    """Evaluate sympy expressions on signals; each result has shape (n,)."""
    n = len(next(iter(known.values())))
    function = _compiled(tuple(known), tuple(expressions))
    with np.errstate(all="ignore"):
        values = function(list(known.values()))
    return [np.array(np.broadcast_to(v, (n,)), dtype=float) for v in values]


@lru_cache(maxsize=64)
def _compiled(symbols: tuple[Sym, ...], expressions: tuple[Sym, ...]) -> Callable[..., list[Any]]:
    return sp.lambdify([list(symbols)], list(expressions), "numpy", cse=True)


def filtered_rows(
    regression: Regression, problem: Problem, operator: Operator, nuisance: Array
) -> Rows:
    """Form every term as operator(φ2, 2) + operator(φ1, 1) + operator(φ0, 0).

    States are straight lines between samples; inputs are held, unless they were measured. A term is
    taken just after each sample and, with the input still held, just before the next. A rate that
    is not recorded is held too, at the slope of its coordinate over the interval: that is its mean
    there exactly, whereas a central difference is wrong wherever the input jumps.

    Raises:
        DivergenceError: A term is not finite on this record.
    """
    parts = [(t.phi2, t.phi1, t.phi0) for t in regression.terms]
    present = {(2 - k, phi) for part in parts for k, phi in enumerate(part) if phi != 0}
    wanted = sorted(present, key=str)
    known = signals(regression, problem)
    pairs = zip(regression.inputs, problem.dae.inputs, strict=True)
    held = {symbol for symbol, v in pairs if v.name not in problem.measured_inputs}
    for coordinate in regression.coordinates:
        if coordinate.rate.name in regression.differenced:
            slope = np.diff(known[coordinate.position]) / problem.sample_time
            known[coordinate.rate] = np.append(slope, slope[-1])
            held.add(coordinate.rate)
    after = evaluate([phi for _, phi in wanted], known)
    # Left limits at the next sample; the last one is never used.
    ahead = {s: np.append(v[1:], v[-1]) for s, v in known.items() if s not in held}
    before = evaluate([phi for _, phi in wanted], {**known, **ahead})
    made: dict[tuple[int, Sym], Array] = {}
    sizes: dict[tuple[int, Sym], float] = {}
    for key, start, end in zip(wanted, after, before, strict=True):
        _check(key[1], start, problem)
        made[key] = operator(start, end, key[0])
        # The largest |φ| times the operator's gain: rounding leaves a tiny share of this.
        sizes[key] = float(np.max(np.abs(start))) * _gain(operator, len(start), key[0])

    def total(part: tuple[Sym, Sym, Sym]) -> Array:
        found = [made[2 - k, phi] for k, phi in enumerate(part) if phi != 0]
        return np.sum(found, axis=0) if found else np.zeros_like(problem.time)

    def size(part: tuple[Sym, Sym, Sym]) -> float:
        return sum(sizes[2 - k, phi] for k, phi in enumerate(part) if phi != 0)

    m, k = len(regression.known), len(regression.columns)
    columns = np.array([total(part) for part in parts[: m * k]]).reshape(k, m, -1)
    size_array = np.array([size(part) for part in parts[: m * k]]).reshape(k, m)
    right = np.array([total(part) for part in parts[m * k :]])
    return Rows(np.transpose(columns, (1, 2, 0)), right, size_array.T, nuisance)


def _gain(operator: Operator, n: int, order: int) -> float:
    pulse = np.zeros(n)
    pulse[1] = 1.0
    return float(np.sum(np.abs(operator(pulse, pulse, order))))


def differenced_rows(regression: Regression, problem: Problem) -> Rows:
    """Form every term as it stands in the equation, with differenced rates and accelerations.

    Raises:
        DivergenceError: A term is not finite on this record.
    """
    known = accelerations(regression, problem)
    wholes = [t.whole for t in regression.terms]
    values = evaluate(wholes, known)
    for whole, value in zip(wholes, values, strict=True):
        _check(whole, value, problem)
    m, k = len(regression.known), len(regression.columns)
    columns = np.array(values[: m * k]).reshape(k, m, -1)
    size = np.max(np.abs(columns), axis=2)
    return Rows(
        np.transpose(columns, (1, 2, 0)),
        np.array(values[m * k :]),
        size.T,
        np.zeros((len(problem.time), 0)),
    )


def _check(term: Sym, values: Array, problem: Problem) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise DivergenceError(
            f"the term {term} of {problem.dae.name} is not finite on this record",
            where=f"t = {problem.time[bad[0]]:.6g} s",
            remedy="check the units of the channels in it, or use --method output-error",
        )
