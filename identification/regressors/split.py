"""Terms of an equation of motion as exact time derivatives: e = d²/dt² φ2 + d/dt φ1 + φ0.

The output filter differentiates φ2 and φ1 itself, so the more of a term that sits there, the fewer
rates and accelerations have to be measured. With e = A(q, q')·q'' + B(q, q', u, t):

1. A·q'' = d/dt G - ∂G/∂q·q', where G = A·q' if A depends on q alone, else a potential of A in q'.
2. Of G, the part that is linear in q' and exact is d/dt of a potential F(q): φ2 = F; the rest of G
   goes to φ1. Where the rate itself is recorded, its terms stay in φ1: the filter then
   differentiates a signal once instead of twice, with far less noise.
3. Of what remains besides A·q'', the exact part linear in q' goes to φ1 likewise; the rest is φ0.

For the wheeled pendulum this is (26) of C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12 (2023)
4569, with the sign of φ24 put right and cos(θ)·θ'' - sin(θ)·θ'² recognised as d²/dt² sin(θ).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp
from sympy.integrals.manualintegrate import manualintegrate

from foundation.errors import UnsupportedModelError
from identification.regressors.implicit_form import Coordinate
from identification.regressors.sympy_fold import Sym, symbols_of


@dataclass(frozen=True)
class Split:
    """e = d²/dt² φ2 + d/dt φ1 + φ0.

    Attributes:
        whole: The term e itself.
        phi2: Depends on positions.
        phi1: Depends on positions and rates.
        phi0: Depends on positions, rates, inputs and time.
    """

    whole: Sym
    phi2: Sym
    phi1: Sym
    phi0: Sym

    @cached_property
    def signals(self) -> frozenset[Sym]:
        """The symbols that have to be known to evaluate it."""
        return symbols_of(self.phi2, self.phi1, self.phi0)


ZERO = Split(sp.S.Zero, sp.S.Zero, sp.S.Zero, sp.S.Zero)


def split(
    expression: Sym,
    coordinates: Sequence[Coordinate],
    time: Sym,
    recorded: Collection[Sym] = (),
) -> Split:
    """Split a term; the result has been verified symbolically.

    Args:
        expression: A term, linear in the accelerations, free of parameters.
        coordinates: The coordinates it is a function of.
        time: Symbol of time.
        recorded: Rates whose own record is used in the place of a position differentiated.

    Raises:
        UnsupportedModelError: An acceleration is multiplied by an input, by time or by another
            acceleration, so that no filter of measured signals gives the term.

    Example:
        >>> q, w, a, t = sp.symbols("q w a t", real=True)
        >>> e = sp.cos(q) * a - sp.sin(q) * w**2
        >>> found = split(e, [Coordinate(q, w, a)], t)
        >>> found.phi2, found.phi1, found.phi0
        (sin(q), 0, 0)
    """
    if expression == 0:
        return ZERO
    motion = _Motion(coordinates, time, frozenset(recorded))
    return motion.split(sp.expand(expression))


class _Motion:
    """The calculus of functions of q, q', q'' along a motion."""

    def __init__(
        self, coordinates: Sequence[Coordinate], time: Sym, recorded: frozenset[Sym]
    ) -> None:
        self.q = [c.position for c in coordinates]
        self.w = [c.rate for c in coordinates]
        self.a = [c.acceleration for c in coordinates if c.acceleration is not None]
        self.moving = [c.rate for c in coordinates if c.acceleration is not None]
        self.time = time
        self.recorded = recorded

    def derivative(self, f: Sym) -> Sym:
        """Total time derivative of f(q, q')."""
        terms = [sp.diff(f, q) * w for q, w in zip(self.q, self.w, strict=True)]
        terms += [sp.diff(f, w) * a for w, a in zip(self.moving, self.a, strict=True)]
        return sp.Add(*terms)

    def split(self, e: Sym) -> Split:
        leading = [sp.diff(e, a) for a in self.a]
        allowed = {*self.q, *self.moving}
        for a, factor in zip(self.a, leading, strict=True):
            strangers = symbols_of(factor) - allowed
            if strangers:
                names = ", ".join(sorted(s.name for s in strangers))
                raise UnsupportedModelError(
                    f"the acceleration {a.name} is multiplied by {names}, so its term is no "
                    "derivative of measured signals",
                    remedy="use --method output-error",
                )
        momentum = self._momentum(leading)
        phi2, from_momentum = self._lower(momentum, self.recorded)
        remainder = sp.expand(e - self.derivative(momentum))
        phi1, phi0 = self._lower(remainder)
        result = Split(e, phi2, sp.expand(from_momentum + phi1), phi0)
        self._verify(e, result)
        return result

    def _momentum(self, leading: Sequence[Sym]) -> Sym:
        """G with ∂G/∂q' = A."""
        if not any(f.free_symbols & set(self.moving) for f in leading):
            return sp.Add(*(f * w for f, w in zip(leading, self.moving, strict=True)))
        g = _potential(leading, self.moving)
        if g is None:
            raise UnsupportedModelError(
                "a mass that depends on speed is no derivative of measured signals: "
                + ", ".join(str(f) for f in leading if f != 0),
                remedy="use --method output-error",
            )
        return g

    def _lower(self, f: Sym, leave: Collection[Sym] = ()) -> tuple[Sym, Sym]:
        """Return F(q) and a rest with f = d/dt F + rest; rates in `leave` stay in the rest."""
        linear: list[Sym] = [sp.S.Zero for _ in self.q]
        rest: list[Sym] = []
        rates, positions = set(self.w), set(self.q)
        for term in sp.Add.make_args(sp.expand(f)):
            present = [j for j, w in enumerate(self.w) if term.has(w)]
            if len(present) == 1 and self.w[present[0]] not in leave:
                j = present[0]
                factor = sp.diff(term, self.w[j])
                if not factor.free_symbols & rates and factor.free_symbols <= positions:
                    linear[j] += factor
                    continue
            rest.append(term)
        if all(factor == 0 for factor in linear):
            return sp.S.Zero, sp.Add(*rest)
        potential = _potential(linear, self.q)
        if potential is not None:
            return potential, sp.Add(*rest)
        return self._lower_own(linear, rest)

    def _lower_own(self, linear: Sequence[Sym], rest: list[Sym]) -> tuple[Sym, Sym]:
        """As `_lower` where the whole is not exact: terms A_j(q_j)·q_j' are exact alone."""
        total = sp.S.Zero
        for q, w, factor in zip(self.q, self.w, linear, strict=True):
            for term in sp.Add.make_args(sp.expand(factor)):
                integral = _integral(term, q) if term.free_symbols <= {q} else None
                if integral is None:
                    rest.append(term * w)
                else:
                    total += integral
        return total, sp.Add(*rest)

    def _verify(self, e: Sym, s: Split) -> None:
        d2 = self.derivative(self.derivative(s.phi2))
        difference = sp.expand(d2 + self.derivative(s.phi1) + s.phi0 - e)
        if difference != 0 and sp.simplify(difference) != 0:
            # Reached only if sympy integrated wrongly; a wrong regressor must not get out.
            raise UnsupportedModelError(
                f"the term {e} could not be split into derivatives of measured signals",
                remedy="use --method output-error",
            )


def _potential(gradient: Sequence[Sym], variables: Sequence[Sym]) -> Sym | None:
    """Return F with ∂F/∂x_j = gradient_j, or None if there is none (or sympy finds none)."""
    for j, f in enumerate(gradient):
        for k in range(j):
            curl = sp.diff(f, variables[k]) - sp.diff(gradient[k], variables[j])
            if curl != 0 and sp.simplify(curl) != 0:
                return None
    total = sp.S.Zero
    for f, x in zip(gradient, variables, strict=True):
        missing = sp.expand(f - sp.diff(total, x))
        if missing != 0:
            integral = _integral(missing, x)
            if integral is None:
                return None
            total += integral
    return total


def _integral(f: Sym, x: Sym) -> Sym | None:
    """Antiderivative by rules (fast); None where the rules end."""
    if x not in f.free_symbols:
        return f * x
    found = manualintegrate(f, x)
    return None if found.has(sp.Integral) else sp.expand(found)
