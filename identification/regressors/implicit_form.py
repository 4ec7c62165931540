"""Equations of motion in measured quantities: 0 = f(q, q', q'', u, t; parameters).

From the flat model every algebraic variable is eliminated, until what is left holds only measured
coordinates, their rates and accelerations, inputs and parameters. Nothing is solved for the
accelerations: that would divide by parameters.
"""

from __future__ import annotations

import operator
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from fmus.dae import Dae, Role, ScalarType
from fmus.expressions import Delayed, Derivative, Expression, Previous, Symbol, Time
from foundation.errors import UnsupportedModelError
from identification.regressors.sympy_fold import Sym, SympyFold, exact

_REMEDY = "use --method output-error"


@dataclass(frozen=True)
class Coordinate:
    """A measured coordinate q, its rate q' and, unless its equation is of first order, q''."""

    position: Sym
    rate: Sym
    acceleration: Sym | None


@dataclass(frozen=True)
class Reading:
    """How a state is had from a recorded channel: state = (channel - offset) / gain."""

    channel: str
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class ImplicitForm:
    """Equations of motion that vanish, without unmeasured variables.

    Attributes:
        coordinates: Measured coordinates; there are as many equations.
        inputs: Symbols of the inputs.
        time: Symbol of time.
        free: Symbols of the free parameters, in the order asked for.
        equations: Each vanishes; parameters that are not free stand as exact numbers.
        readings: State symbol → where it is recorded. A rate that is missing here has to be had
            from its coordinate by differencing.
        notes: What was assumed.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Sym, ...]
    time: Sym
    free: tuple[Sym, ...]
    equations: tuple[Sym, ...]
    readings: Mapping[Sym, Reading]
    notes: tuple[str, ...]


def implicit_form(
    dae: Dae, *, free: Sequence[str], values: Mapping[str, float], measured: Collection[str]
) -> ImplicitForm:
    """Reduce a model to equations of motion in measured quantities.

    Args:
        dae: The flat model.
        free: Parameters that stay symbols.
        values: Numbers of the other independent parameters, where they differ from the declared.
        measured: Recorded variables among the model's outputs.

    Raises:
        UnsupportedModelError: A state is neither measured nor the rate of a measured one (a lag, a
            delay, a hidden body), coordinates are constrained by one another, or an algebraic loop
            cannot be solved.
    """
    reader = _Reader(dae, free, values)
    residuals = [reader.fold(r) for r in dae.residuals]
    residuals, rates = _kinematics(residuals, reader)
    algebraic = [reader.symbol(v.name) for v in dae.with_role(Role.ALGEBRAIC)]
    parameters = frozenset(reader.free)
    inputs = tuple(reader.symbol(v.name) for v in dae.inputs)
    residuals, solved = _simplest(residuals, algebraic, parameters, frozenset(inputs))
    readings = _readings(reader, solved, measured)
    coordinates, hidden = _coordinates(reader, rates, readings, residuals)
    unknown = {*hidden, *reader.opaque, *(z for z in algebraic if z not in solved)}
    equations = [r for r in residuals if not r.free_symbols & unknown]
    highest = {c.rate if c.acceleration is None else c.acceleration for c in coordinates}
    dropped = [r for r in residuals if r.free_symbols & unknown]
    # An unmeasured part that moves nothing else may go, unless it is to be fitted.
    if len(equations) != len(coordinates) or any(r.free_symbols & parameters for r in dropped):
        raise _hidden(reader, hidden, unknown, residuals)
    for equation in equations:
        if not equation.free_symbols & highest:
            names = sorted(s.name for s in equation.free_symbols - parameters)
            raise UnsupportedModelError(
                f"an equation of {dae.name} constrains {', '.join(names)} without their "
                "derivatives, so the coordinates are not independent",
                remedy=f"choose independent coordinates, or {_REMEDY}",
            )
    if dae.reinits or dae.when_equations:
        raise UnsupportedModelError(
            f"{dae.name} changes its states at events, which no filter of the record can follow",
            remedy=_REMEDY,
        )
    differenced = [c.rate.name for c in coordinates if c.rate not in readings]
    notes = tuple(
        f"{name} is not recorded: where it is needed it is had by differencing its coordinate"
        for name in differenced
    )
    return ImplicitForm(
        coordinates=coordinates,
        inputs=inputs,
        time=reader.time,
        free=reader.free,
        equations=tuple(equations),
        readings={s: r for s, r in readings.items() if s not in hidden},
        notes=notes,
    )


class _Reader:
    """Gives every leaf of the flat model its sympy form."""

    def __init__(self, dae: Dae, free: Sequence[str], values: Mapping[str, float]) -> None:
        self.dae = dae
        self.time: Sym = sp.Symbol("time", real=True)
        self.opaque: dict[Sym, str] = {}
        self._symbols: dict[str, Sym] = {}
        self._values = {**dae.parameter_values, **values}
        self._free = frozenset(free)
        self.free = tuple(self.symbol(name) for name in free)
        self.fold = SympyFold(self._leaf)

    def symbol(self, name: str) -> Sym:
        return self._symbols.setdefault(name, sp.Symbol(name, real=True))

    def derivative(self, state: str) -> Sym:
        return self.symbol(f"der({state})")

    def _leaf(self, node: Expression) -> Sym:
        match node:
            case Time():
                return self.time
            case Derivative(name=name):
                return self.derivative(name)
            case Symbol(name=name):
                return self._variable(name)
            case Previous(name=name):
                return self._opaque(f"pre({name})", f"the discrete variable {name}")
            case Delayed(index=index):
                return self._opaque(f"delay {index}", "a delay")
            case _:
                raise AssertionError(node)

    def _variable(self, name: str) -> Sym:
        variable = self.dae.variables[name]
        if variable.role is Role.DISCRETE:
            return self._opaque(name, f"the discrete variable {name}")
        if variable.role not in (Role.PARAMETER, Role.CONSTANT) or name in self._free:
            return self.symbol(name)
        if name in self.dae.dependent_parameters and variable.binding is not None:
            return self.fold(variable.binding)
        if variable.type is ScalarType.BOOLEAN:
            return sp.true if self._values[name] else sp.false
        return exact(self._values[name])

    def _opaque(self, name: str, what: str) -> Sym:
        symbol = self.symbol(name)
        self.opaque[symbol] = what
        return symbol


def _kinematics(residuals: Sequence[Sym], reader: _Reader) -> tuple[list[Sym], dict[str, str]]:
    """Take out the equations der(q) = w between states, and put w for der(q) elsewhere."""
    states = {reader.symbol(v.name): v.name for v in reader.dae.states}
    derivatives = {reader.derivative(v.name): v.name for v in reader.dae.states}
    rates: dict[str, str] = {}
    rest: list[Sym] = []
    for residual in residuals:
        symbols = residual.free_symbols
        if len(symbols) == 2:
            dq = next((s for s in symbols if s in derivatives), None)
            w = next((s for s in symbols if s in states), None)
            if dq is not None and w is not None:
                ratio = sp.cancel(residual / (dq - w))
                q = derivatives[dq]
                taken = {*rates, *rates.values()}
                if ratio.is_number and q not in taken and states[w] not in taken:
                    rates[q] = states[w]
                    continue
        rest.append(residual)
    new = {reader.derivative(q): reader.symbol(w) for q, w in rates.items()}
    return [r.xreplace(new) for r in rest], rates


def _simplest(
    residuals: Sequence[Sym],
    unknowns: Sequence[Sym],
    parameters: frozenset[Sym],
    inputs: frozenset[Sym],
) -> tuple[list[Sym], dict[Sym, Sym]]:
    """Eliminate in two orders and keep the one with fewer products of parameters.

    A force can be taken from the law that makes it or from a balance that holds it. The one leaves
    every input in its own equation, the other multiplies inputs by the parameters of the next.
    """
    found = [_eliminate(residuals, unknowns, parameters, last) for last in (frozenset(), inputs)]

    def products(pair: tuple[list[Sym], dict[Sym, Sym]]) -> int:
        terms: list[Sym] = [t for e in pair[0] for t in sp.Add.make_args(sp.expand(e))]
        return len({t.as_independent(*parameters, as_Add=False)[1] for t in terms})

    return min(found, key=products)


def _eliminate(
    residuals: Sequence[Sym],
    unknowns: Iterable[Sym],
    parameters: frozenset[Sym],
    inputs: frozenset[Sym],
) -> tuple[list[Sym], dict[Sym, Sym]]:
    """Solve for algebraic variables that occur linearly; return what is left and the solutions.

    A numeric coefficient is taken first, then one of parameters only (the division is cleared
    later), then one that depends on signals but not on parameters (it may vanish somewhere, so
    it comes last). Among equals, equations that hold one of `inputs` come last, and small ones
    first.
    """
    equations = list(residuals)
    pending = set(unknowns)
    solved: dict[Sym, Sym] = {}
    while pending:
        best = _cheapest(equations, pending, parameters, inputs)
        if best is None:
            break
        index, unknown, coefficient = best
        rest = (equations.pop(index) - coefficient * unknown).expand()
        solution = -rest / coefficient
        pending.remove(unknown)
        solved[unknown] = solution
        new = {unknown: solution}
        equations = [e.xreplace(new) if unknown in e.free_symbols else e for e in equations]
        solved = {z: e.xreplace(new) for z, e in solved.items()}
    return equations, solved


def _cheapest(
    equations: Sequence[Sym],
    pending: set[Sym],
    parameters: frozenset[Sym],
    inputs: frozenset[Sym],
) -> tuple[int, Sym, Sym] | None:
    found: list[tuple[int, bool, int, int, str, Sym, Sym]] = []
    for index, equation in enumerate(equations):
        driven = bool(equation.free_symbols & inputs)
        for unknown in equation.free_symbols & pending:
            coefficient = sp.diff(equation, unknown).expand()
            symbols = coefficient.free_symbols
            if coefficient.is_zero or unknown in symbols:
                continue
            if coefficient.is_number:
                kind = 0
            elif symbols <= parameters:
                kind = 1
            elif not symbols & parameters:
                kind = 2
            else:
                continue
            size = int(sp.count_ops(equation))
            found.append((kind, driven, size, index, unknown.name, unknown, coefficient))
    if not found:
        return None
    _, _, _, index, _, unknown, coefficient = min(found, key=operator.itemgetter(slice(5)))
    return index, unknown, coefficient


def _readings(
    reader: _Reader, solved: Mapping[Sym, Sym], measured: Collection[str]
) -> dict[Sym, Reading]:
    """Find for every state the channel that shows it, directly or by an affine equation."""
    states = [reader.symbol(v.name) for v in reader.dae.states]
    found: dict[Sym, Reading] = {}
    for state in states:
        if state.name in measured:
            found[state] = Reading(state.name)
    for name in measured:
        expression = solved.get(reader.symbol(name))
        if expression is None or len(expression.free_symbols) != 1:
            continue
        (state,) = expression.free_symbols
        gain = sp.diff(expression, state)
        if state in states and state not in found and gain.is_number and not gain.is_zero:
            offset = expression.subs(state, 0)
            found[state] = Reading(name, float(gain), float(offset))
    return found


def _coordinates(
    reader: _Reader,
    rates: Mapping[str, str],
    readings: Mapping[Sym, Reading],
    residuals: Sequence[Sym],
) -> tuple[tuple[Coordinate, ...], set[Sym]]:
    """Sort the states into measured coordinates and hidden ones (with their derivatives)."""
    used: set[Sym] = set().union(*(r.free_symbols for r in residuals))
    coordinates: list[Coordinate] = []
    hidden: set[Sym] = set()
    is_rate = set(rates.values())
    for state in reader.dae.states:
        symbol = reader.symbol(state.name)
        first_order = Coordinate(symbol, reader.derivative(state.name), None)
        if state.name in rates:
            rate = reader.symbol(rates[state.name])
            if symbol in readings:
                acceleration = reader.derivative(rates[state.name])
                coordinates.append(Coordinate(symbol, rate, acceleration))
            elif rate in readings and symbol not in used:
                # Only the speed is recorded, and nothing depends on where the machine stands.
                derivative = reader.derivative(rates[state.name])
                coordinates.append(Coordinate(rate, derivative, None))
            else:
                hidden |= {symbol, rate, reader.derivative(rates[state.name])}
        elif state.name in is_rate:
            continue
        elif symbol in readings:
            coordinates.append(first_order)
        else:
            hidden |= {symbol, first_order.rate}
    return tuple(coordinates), hidden


def _hidden(
    reader: _Reader, hidden: Collection[Sym], unknown: Collection[Sym], residuals: Sequence[Sym]
) -> UnsupportedModelError:
    """Say which unmeasured quantity stands in the way."""
    in_way: set[Sym] = set().union(*(r.free_symbols for r in residuals)) & set(unknown)
    opaque = sorted(reader.opaque[s] for s in in_way if s in reader.opaque)
    states = {v.name for v in reader.dae.states}
    names = sorted(s.name for s in in_way if s in hidden and s.name in states)
    if opaque:
        what = f"the equations of {reader.dae.name} hold {opaque[0]}, which no channel shows"
    elif names:
        what = (
            f"{' and '.join(names)} of {reader.dae.name} "
            f"{'is' if len(names) == 1 else 'are'} neither recorded nor the rate of a recorded one"
        )
    else:
        algebraic = sorted(s.name for s in in_way)
        what = (
            f"the equations of {reader.dae.name} cannot be solved symbolically for "
            f"{', '.join(algebraic) or 'its algebraic variables'}"
        )
    return UnsupportedModelError(what, remedy=f"record it, or {_REMEDY}" if names else _REMEDY)
