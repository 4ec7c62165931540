"""From a flat model to a linear regression whose terms the output filter can form."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from fmus.black_box import check_equations
from fmus.dae import Dae
from foundation.errors import UnknownNameError
from identification.regressors.base_parameters import LinearForm, linear_form
from identification.regressors.implicit_form import (
    Coordinate,
    ImplicitForm,
    Reading,
    implicit_form,
)
from identification.regressors.split import ZERO, Split, split
from identification.regressors.sympy_fold import Sym, names_of, symbols_of

_REMEMBERED = 64


@dataclass(frozen=True)
class Column:
    """One unknown of the regression and what it multiplies.

    Attributes:
        lump: The unknown in terms of the free parameters, often one of them.
        terms: Its factor in each equation, split into d²/dt² φ2 + d/dt φ1 + φ0.
        needs: Names of the variables (positions, rates, inputs) that must be known.
    """

    lump: Sym
    terms: tuple[Split, ...]

    @cached_property
    def needs(self) -> frozenset[str]:
        """Names of the signals that the column is a function of."""
        return frozenset(s.name for term in self.terms for s in term.signals)


@dataclass(frozen=True, eq=False)
class Regression:
    """Σ_j lump_j(p) · [d²/dt² φ2 + d/dt φ1 + φ0]_ij = y_i for every equation of motion i.

    Attributes:
        coordinates: Measured coordinates with rate and acceleration; one an equation.
        inputs: Symbols of the inputs, in the model's order.
        time: Symbol of time.
        columns: The unknowns (base parameters) with their factors.
        known: Right-hand side of each equation, split likewise.
        free: Names of all free parameters, in the order asked for.
        shape: Those that sit inside functions of signals (a Stribeck speed, a dead zone's width);
            the regression holds them at the values given.
        inert: Those that occur in no equation.
        readings: Variable → channel that shows it. Rates missing here are had by differencing.
        notes: What was assumed.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Sym, ...]
    time: Sym
    columns: tuple[Column, ...]
    known: tuple[Split, ...]
    free: tuple[str, ...]
    shape: tuple[str, ...]
    inert: tuple[str, ...]
    readings: Mapping[str, Reading]
    notes: tuple[str, ...]

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the free parameters that occur in lumps, in the order of `free`."""
        present = names_of(*(column.lump for column in self.columns))
        return tuple(name for name in self.free if name in present)

    @cached_property
    def differenced(self) -> tuple[str, ...]:
        """Rates that a term needs and no channel shows."""
        needed = symbols_of(*(phi for t in self.terms for phi in (t.phi2, t.phi1, t.phi0)))
        return tuple(
            c.rate.name
            for c in self.coordinates
            if c.rate in needed and c.rate.name not in self.readings
        )

    @cached_property
    def terms(self) -> tuple[Split, ...]:
        """All terms: of the columns, one after another, then of the right-hand side."""
        return tuple(term for column in self.columns for term in column.terms) + self.known

    def is_affine(self, names: Collection[str]) -> bool:
        """Tell whether the lumps are linear (plus a constant) in these parameters."""
        return not any(pair <= set(names) for pair in self._curved)

    @cached_property
    def _curved(self) -> set[frozenset[str]]:
        """Parameters a, b with ∂²lump/∂a∂b ≠ 0 (a alone where the square bends)."""
        found: set[frozenset[str]] = set()
        for lump in (column.lump for column in self.columns if not column.lump.is_Symbol):
            for a in symbols_of(lump):
                slope = sp.diff(lump, a)
                found |= {frozenset((a.name, b)) for b in names_of(slope)}
        return found

    def lumps(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        """Return the value of every lump, shape (columns,), from parameters."""
        return np.array(self._lump_functions[0](self._arguments(values)), dtype=float)

    def lump_jacobian(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        """Return ∂lump/∂parameter, shape (columns, parameters)."""
        rows = self._lump_functions[1](self._arguments(values))
        return np.array(rows, dtype=float).reshape(len(self.columns), len(self.parameters))

    def _arguments(self, values: Mapping[str, float]) -> list[float]:
        return [values[name] for name in self.parameters]

    @cached_property
    def _lump_functions(self) -> tuple[Callable[[Sequence[float]], Any], ...]:
        symbols = [sp.Symbol(name, real=True) for name in self.parameters]
        lumps = [column.lump for column in self.columns]
        jacobian = [[sp.diff(lump, s) for s in symbols] for lump in lumps]
        return (
            sp.lambdify([symbols], lumps, "math"),
            sp.lambdify([symbols], jacobian, "math"),
        )


def derive(
    dae: Dae,
    *,
    free: Sequence[str],
    values: Mapping[str, float],
    measured: Collection[str],
    use_rates: bool = True,
) -> Regression:
    """Derive the regression of a model; remembered for the last models asked for.

    Args:
        dae: The flat model.
        free: Unknown parameters.
        values: Numbers of the other parameters and of shape parameters, SI units; a parameter
            without a number here has its declared value.
        measured: Recorded variables among the model's outputs.
        use_rates: Where a rate is recorded, an acceleration is its derivative; else it is the
            second derivative of the position, as in the paper.

    Raises:
        UnsupportedModelError: The model has no such regression; the message says what stands in
            the way (a state that is not recorded, a lag, a delay, a constraint, an input that
            multiplies an acceleration).
        UnknownNameError: `free` names no independent parameter.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> dae = load(library_class("Twinproof.Plants.Positioner"))
        >>> regression = derive(dae, free=["M", "Fv"], values={}, measured=["q"])
        >>> [(str(c.lump), c.terms[0].phi2, c.terms[0].phi1) for c in regression.columns]
        [('M', q, 0), ('Fv', 0, q)]
        >>> regression.known[0].phi0
        351507*vir/10000
    """
    # The flat model holds dictionaries, so it is told by identity and kept alive beside the result.
    numbers = tuple(sorted(values.items()))
    key = (id(dae), tuple(free), numbers, tuple(sorted(measured)), use_rates)
    with _lock:
        if key in _remembered:
            _remembered.move_to_end(key)
            return _remembered[key][1]
    regression = _derive(dae, tuple(free), values, measured, use_rates)
    with _lock:
        _remembered[key] = (dae, regression)
        while len(_remembered) > _REMEMBERED:
            _remembered.popitem(last=False)
    return regression


_remembered: OrderedDict[tuple[Any, ...], tuple[Dae, Regression]] = OrderedDict()
_lock = Lock()


def _derive(
    dae: Dae,
    free: tuple[str, ...],
    values: Mapping[str, float],
    measured: Collection[str],
    use_rates: bool,
) -> Regression:
    check_equations(dae)
    independent = [v.name for v in dae.parameters if v.name not in dae.dependent_parameters]
    for name in free:
        if name not in independent:
            raise UnknownNameError("parameter", name, independent, where=dae.name)
    numbers = {**dae.parameter_values, **values}
    form = implicit_form(dae, free=free, values=numbers, measured=measured)
    controls = (*form.inputs, form.time)
    linear = linear_form(form.equations, form.free, numbers, controls)
    columns, known = _split_all(linear, form, use_rates)
    present = symbols_of(*form.equations)
    return Regression(
        coordinates=form.coordinates,
        inputs=form.inputs,
        time=form.time,
        columns=columns,
        known=known,
        free=free,
        shape=tuple(s.name for s in linear.shape),
        inert=tuple(s.name for s in form.free if s not in present),
        readings={s.name: reading for s, reading in form.readings.items()},
        notes=(*form.notes, *linear.notes),
    )


def _split_all(
    linear: LinearForm, form: ImplicitForm, use_rates: bool
) -> tuple[tuple[Column, ...], tuple[Split, ...]]:
    """Split all terms, leaving out equations without an unknown."""
    used = [
        i for i in range(len(linear.known)) if any(lump.column[i] != 0 for lump in linear.lumps)
    ]
    recorded = form.readings if use_rates else ()
    done: dict[Sym, Split] = {sp.S.Zero: ZERO}

    def once(term: Sym) -> Split:
        if term not in done:
            done[term] = split(term, form.coordinates, form.time, recorded)
        return done[term]

    columns = tuple(
        Column(lump.value, tuple(once(lump.column[i]) for i in used)) for lump in linear.lumps
    )
    return columns, tuple(once(linear.known[i]) for i in used)
