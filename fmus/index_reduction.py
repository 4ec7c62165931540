"""Constraints between states: differentiated until every derivative can be computed.

C. C. Pantelides, The consistent initialization of differential-algebraic systems, SIAM J. Sci.
Stat. Comput. 9 (1988) 213-231, finds what to differentiate; S. E. Mattsson, G. Söderlind, Index
reduction in differential-algebraic equations using dummy derivatives, SIAM J. Sci. Comput. 14
(1993) 677-692, choose which derivatives become algebraic. The choice is made once, at the start
values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.casadi_expressions import SX, CasadiFold
from fmus.dae import Dae, Role, Variable
from fmus.differentiation import ZERO, NotDifferentiableError, time_derivative
from fmus.expressions import Derivative, Expression, Operation, Symbol, Time, substitute, walk
from foundation.errors import UnsupportedModelError

Level = tuple[str, int]
"""A variable and how many times it is differentiated."""

_MOST_DIFFERENTIATIONS = 8


def reduce_index(dae: Dae) -> Dae:
    """Return a model of index 1 with the same solutions; the model itself if it is of index 1.

    States that constraints determine become algebraic. Which ones is chosen where the constraints
    are best conditioned at the start values, states without `fixed = true` first.

    Raises:
        UnsupportedModelError: A constraint cannot be differentiated, there is an equation too many
            for some variables, or the constraints are singular at the start values.
    """
    system = _System(dae)
    if not system.differentiate():
        return dae
    return _Reduced(dae, system).model()


def leaf_of(level: Level) -> Expression:
    """Return the expression that stands for a level while equations are differentiated."""
    name, order = level
    return Symbol(name) if order == 0 else Derivative(_named(name, order - 1))


def _named(name: str, order: int) -> str:
    return name if order == 0 else f"der({_named(name, order - 1)})"


def _level(node: Expression) -> Level | None:
    if isinstance(node, Symbol):
        return node.name, 0
    if isinstance(node, Derivative):
        name, order = node.name, 1
        while name.startswith("der("):
            name, order = name[4:-1], order + 1
        return name, order
    return None


@dataclass
class _System:
    """Pantelides' algorithm on the equations of a model.

    Attributes:
        equations: The model's, and after them those that were derived.
        derived: Index of an equation → index of its derivative.
        orders: Highest derivative of each unknown that occurs.
    """

    dae: Dae
    equations: list[Expression] = field(default_factory=list[Expression])
    derived: dict[int, int] = field(default_factory=dict[int, int])
    orders: dict[str, int] = field(default_factory=dict[str, int])
    _matched: dict[Level, int] = field(default_factory=dict[Level, int])

    def differentiate(self) -> bool:
        """Differentiate what is needed; return whether anything was."""
        self.equations = list(self.dae.residuals)
        for variable in self.dae.with_role(Role.STATE, Role.ALGEBRAIC):
            self.orders[variable.name] = int(variable.role is Role.STATE)
        if len(self.equations) != len(self.orders):
            return False  # reported where the equations are solved
        for start in range(len(self.dae.residuals)):
            equation = start
            for _ in range(_MOST_DIFFERENTIATIONS):
                seen_equations: set[int] = {equation}
                seen: set[Level] = set()
                if self._augment(equation, seen_equations, seen):
                    break
                self._differentiate_all(seen_equations, seen, start)
                equation = self.derived[equation]
            else:
                raise self._singular(start)
        return bool(self.derived)

    def incidence(self, equation: int) -> set[Level]:
        """Return the unknowns of an equation at their highest order."""
        levels = (_level(node) for node in walk(self.equations[equation]))
        return {v for v in levels if v is not None and self.orders.get(v[0]) == v[1]}

    def _augment(self, equation: int, seen_equations: set[int], seen: set[Level]) -> bool:
        seen_equations.add(equation)
        unknowns = sorted(self.incidence(equation))
        for level in unknowns:
            if level not in self._matched:
                self._matched[level] = equation
                return True
        for level in unknowns:
            if level not in seen:
                seen.add(level)
                if self._augment(self._matched[level], seen_equations, seen):
                    self._matched[level] = equation
                    return True
        return False

    def _differentiate_all(self, equations: set[int], levels: set[Level], start: int) -> None:
        for name, order in levels:
            self.orders[name] = order + 1
        for equation in sorted(equations):
            derivative = self._derivative(equation, start)
            self.derived[equation] = len(self.equations)
            self.equations.append(derivative)
        for name, order in levels:
            self._matched[name, order + 1] = self.derived[self._matched[name, order]]

    def _derivative(self, equation: int, start: int) -> Expression:
        def leaf(node: Expression) -> Expression:
            level = _level(node)
            assert level is not None
            name, order = level
            if name in self.orders:
                return leaf_of((name, order + 1))
            if self.dae.variables[name].role is Role.INPUT:
                raise NotDifferentiableError(f"the input '{name}'")
            return ZERO

        try:
            return time_derivative(self.equations[equation], leaf)
        except NotDifferentiableError as error:
            raise self._error(
                start,
                f"a constraint between states (index > 1) asks for the time derivative of {error}",
                "give the derivative as an input of its own, or model the constraint by a spring",
            ) from error

    def _singular(self, start: int) -> UnsupportedModelError:
        return self._error(
            start,
            "the equations do not determine every derivative and algebraic variable (no finite "
            "index): one contradicts or repeats others",
            "remove the equation, or write it for the variable that has none",
        )

    def _error(self, equation: int, what: str, remedy: str) -> UnsupportedModelError:
        place = (*self.dae.residual_positions, *[None] * len(self.equations))[equation]
        return UnsupportedModelError(f"{place or self.dae.name}: {what}", remedy=remedy)


class _Reduced:
    """Dummy derivatives, and the model made of them."""

    def __init__(self, dae: Dae, system: _System) -> None:
        self._dae = dae
        self._system = system
        self._dummies = self._choose()

    def _choose(self) -> set[Level]:
        """Choose, from the highest derivatives down, which ones become algebraic."""
        system = self._system
        before = {after: equation for equation, after in system.derived.items()}
        equations = [e for e in before if e not in system.derived]
        candidates = [(n, k) for n, k in system.orders.items() if k > 0]
        chosen: set[Level] = set()
        while equations:
            columns = self._pivots(equations, candidates)
            chosen |= set(columns)
            equations = [before[e] for e in equations if before[e] in before]
            candidates = [(n, k - 1) for n, k in columns if k > 1]
        return chosen

    def _pivots(self, equations: Sequence[int], candidates: Sequence[Level]) -> list[Level]:
        """Return as many candidates as equations, such that the equations determine them."""
        matrix = self._jacobian(equations, candidates)
        weights = np.array([self._weight(level) for level in candidates])
        columns: list[Level] = []
        rows = list(range(len(equations)))
        for _ in equations:
            scores = np.abs(matrix[rows]) * weights
            scores[:, [candidates.index(level) for level in columns]] = 0.0
            if scores.size == 0 or not scores.max() > 1e-12:
                raise UnsupportedModelError(
                    f"{self._dae.name}: the constraints between states are singular at the start "
                    "values",
                    remedy="give start values at which the constraints determine the motion",
                )
            row, column = np.unravel_index(int(scores.argmax()), scores.shape)
            pivot = rows.pop(int(row))
            columns.append(candidates[int(column)])
            for other in rows:
                matrix[other] -= matrix[pivot] * (matrix[other, column] / matrix[pivot, column])
        return columns

    def _weight(self, level: Level) -> float:
        """States with fixed starts, and outputs, rather stay states; second derivatives do not."""
        variable = self._dae.variables[level[0]]
        weight = 0.3 if variable.fixed else 0.9 if variable.output else 1.0
        return weight * (10.0 if level[1] > 1 else 1.0)

    def _jacobian(
        self, equations: Sequence[int], candidates: Sequence[Level]
    ) -> NDArray[np.float64]:
        symbols: dict[Expression, SX] = {}
        values: dict[Expression, float] = {}

        def leaf(node: Expression) -> SX:
            if node not in symbols:
                symbols[node] = ca.SX.sym(f"v{len(symbols)}")
                values[node] = self._start(node)
            return symbols[node]

        fold = CasadiFold(leaf)
        residual = ca.vertcat(*(fold(self._system.equations[e]) for e in equations))
        columns = ca.vertcat(*(leaf(leaf_of(level)) for level in candidates))
        jacobian = ca.Function(
            "jacobian", list(symbols.values()), [ca.densify(ca.jacobian(residual, columns))]
        )
        return np.array(jacobian(*values.values()), float).reshape(len(equations), -1)

    def _start(self, node: Expression) -> float:
        if isinstance(node, Symbol):
            variable = self._dae.variables[node.name]
            if node.name in self._dae.parameter_values:
                return self._dae.parameter_values[node.name]
            return self._dae.number(variable.start, 0.0)
        # Derivatives are unknown here; a time of exactly zero would be a special point.
        return 1e-3 if isinstance(node, Time) else 0.0

    def model(self) -> Dae:
        """Return the model in which dummy derivatives are variables of their own."""
        dae, system = self._dae, self._system
        variables: dict[str, Variable] = {}
        added: list[Variable] = []
        for name, variable in dae.variables.items():
            if name not in system.orders:
                variables[name] = variable
                continue
            variables[name] = replace(variable, role=self._role((name, 0)))
            for order in range(1, system.orders[name] + 1):
                if (name, order) in self._dummies or self._role((name, order)) is Role.STATE:
                    added.append(self._dummy(variable, order))
        variables |= {v.name: v for v in added}
        links = [
            Operation("subtract", (Derivative(self._name(below)), Symbol(self._name(level))))
            for level, below in self._chained()
        ]
        kept_free = [v for v in variables.values() if v.role is Role.STATE and not v.fixed]
        if not kept_free:
            # Starts of the others follow from the constraints.
            for state in dae.states:
                if variables[state.name].role is Role.ALGEBRAIC:
                    variables[state.name] = replace(variables[state.name], fixed=False)
        residuals = (*(self._translated(e) for e in system.equations), *links)
        extra = len(residuals) - len(dae.residuals)
        reduced = replace(
            dae.mapped(self._translated),
            variables=variables,
            residual_positions=(*dae.residual_positions, *[None] * extra),
        )
        return replace(reduced, residuals=residuals)

    def _chained(self) -> list[tuple[Level, Level]]:
        """States whose derivative is a state too: (derivative, state)."""
        return [
            ((name, order), (name, order - 1))
            for name, highest in self._system.orders.items()
            for order in range(1, highest)
            if self._role((name, order)) is self._role((name, order - 1)) is Role.STATE
        ]

    def _name(self, level: Level) -> str:
        """Name of the variable that stands for a level."""
        name, order = level
        if order == 0:
            return name
        if self._role(level) is Role.STATE:
            owner, dot, last = name.rpartition(".")
            return f"{owner}{dot}_der{order}_{last}"
        return f"der({name})" if order == 1 else f"der({name},{order})"

    def _role(self, level: Level) -> Role:
        above = (level[0], level[1] + 1)
        exists = above[1] <= self._system.orders[level[0]]
        return Role.STATE if exists and above not in self._dummies else Role.ALGEBRAIC

    def _dummy(self, variable: Variable, order: int) -> Variable:
        level = (variable.name, order)
        return Variable(
            self._name(level),
            self._role(level),
            description=f"Time derivative of {self._name((variable.name, order - 1))}",
            position=variable.position,
        )

    def _translated(self, expression: Expression) -> Expression:
        def new(node: Expression) -> Expression | None:
            level = _level(node)
            if level is None or level[0] not in self._system.orders or level[1] == 0:
                return None
            below = (level[0], level[1] - 1)
            if self._role(below) is Role.STATE:
                return Derivative(self._name(below))
            return Symbol(self._name(level))

        return substitute(expression, new)
