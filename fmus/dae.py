"""The flat hybrid model that the front end delivers, typed: the one form all later stages read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

from fmus.casadi_expressions import evaluate
from fmus.expressions import Delayed, Expression, Literal, Relation, Symbol, walk


class Role(Enum):
    """What a variable is to the equations."""

    PARAMETER = "parameter"
    CONSTANT = "constant"
    INPUT = "input"
    STATE = "state"
    ALGEBRAIC = "algebraic"
    DISCRETE = "discrete"


class ScalarType(Enum):
    """Type of a scalar variable."""

    REAL = "real"
    INTEGER = "integer"
    BOOLEAN = "boolean"


@dataclass(frozen=True)
class Position:
    """A place in Modelica source; line and column count from 1."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True)
class Variable:
    """One scalar variable of the flat model.

    Attributes:
        name: Full name, with dots.
        output: Declared `output` at the top level.
        start: Start value of a state or algebraic; for an input its default.
        fixed: The start is an initial equation.
        binding: Value of a parameter or constant.
        tunable: The value may change between runs (not `final`, not structural).
        known: Declared `annotation(__twinproof(known=true))`: never fitted.
        unit_in_series: Declared `annotation(__twinproof(unit="1/signal"))`: the unit where its
            block stands in series, by that of the signal.
        position: Where it is declared.
    """

    name: str
    role: Role
    type: ScalarType = ScalarType.REAL
    output: bool = False
    unit: str = ""
    display_unit: str = ""
    description: str = ""
    start: Expression | None = None
    fixed: bool = False
    minimum: Expression | None = None
    maximum: Expression | None = None
    nominal: Expression | None = None
    binding: Expression | None = None
    tunable: bool = False
    known: bool = False
    unit_in_series: str = ""
    flow: bool = False
    position: Position | None = None


@dataclass(frozen=True)
class Reinit:
    """`when trigger then reinit(state, value)`."""

    state: str
    value: Expression
    trigger: Expression


@dataclass(frozen=True)
class WhenEquation:
    """`when trigger then target = value`, as a residual in target that vanishes at the event."""

    residual: Expression
    trigger: Expression


@dataclass(frozen=True)
class DiscreteEquation:
    """`name = value` at every event; the value may hold `pre(…)`, also of the variable itself."""

    name: str
    value: Expression


@dataclass(frozen=True)
class Assertion:
    """`assert(condition, message)`: the simulation fails where the condition does not hold."""

    condition: Expression
    message: str


@dataclass(frozen=True)
class Termination:
    """`when trigger then terminate(message)`: the simulation ends, without a fault."""

    trigger: Expression
    message: str


@dataclass(frozen=True)
class Alias:
    """`name` equals `sign` times the variable `of` (which has no alias itself).

    `declared` is the variable as it was before it was removed.
    """

    name: str
    of: str
    sign: float
    declared: Variable


@dataclass(frozen=True)
class ConstantValue:
    """A variable that an equation of the model sets to a number, such as an unconnected flow."""

    declared: Variable
    value: float


@dataclass(frozen=True)
class Connector:
    """A connector of one potential and one flow variable, as before alias elimination.

    Attributes:
        path: Full name, e.g. `wheel.flange`.
        potential, flow: Names of its two variables.
        potential_unit, flow_unit: Their units.
        connected: A `connect` equation of the model names it.
        top_level: Declared in the model itself, not in a component of it.
        description: Description string of the component that it belongs to.
    """

    path: str
    potential: str
    flow: str
    potential_unit: str
    flow_unit: str
    connected: bool
    top_level: bool
    description: str = ""


@dataclass(frozen=True, eq=False)
class Dae:
    """A flat model: 0 = residual(time, x, der(x), z, u, p) with events.

    Attributes:
        name: Short class name.
        variables: All variables by name, in order of declaration.
        residuals: Continuous equations; each vanishes.
        residual_positions: Where each was written.
        initial_residuals: Equations that hold at the start only.
        relations: Comparisons that make events, by index.
        delays: Delay operators, by index.
        reinits: State changes at events.
        when_equations: Equations of discrete variables that hold as a condition rises.
        discrete_equations: Equations of discrete variables that hold at every event.
        assertions, terminations: What ends a simulation.
        clock_relations: Indices of the relations that stand for `sample(…)`.
        initial_relations: Likewise for `initial()`; they hold while the model is initialised.
        aliases: Variables removed because another one equals them.
        constant_values: Variables removed because they equal a number.
        connectors: All mechanical connectors, by which effects attach.
        description: Description string of the class.
    """

    name: str
    variables: Mapping[str, Variable]
    residuals: tuple[Expression, ...]
    residual_positions: tuple[Position | None, ...] = ()
    initial_residuals: tuple[Expression, ...] = ()
    relations: tuple[Relation, ...] = ()
    delays: tuple[Delayed, ...] = ()
    reinits: tuple[Reinit, ...] = ()
    when_equations: tuple[WhenEquation, ...] = ()
    discrete_equations: tuple[DiscreteEquation, ...] = ()
    assertions: tuple[Assertion, ...] = ()
    terminations: tuple[Termination, ...] = ()
    clock_relations: frozenset[int] = frozenset()
    initial_relations: frozenset[int] = frozenset()
    aliases: Mapping[str, Alias] = field(default_factory=dict[str, Alias])
    constant_values: Mapping[str, ConstantValue] = field(default_factory=dict[str, ConstantValue])
    connectors: tuple[Connector, ...] = ()
    description: str = ""

    def expressions(self) -> Iterator[Expression]:
        """Yield everything that equations and events are made of; no attributes of variables."""
        yield from self.residuals
        yield from self.initial_residuals
        yield from self.relations
        yield from self.delays
        for reinit in self.reinits:
            yield from (reinit.value, reinit.trigger)
        for equation in self.when_equations:
            yield from (equation.residual, equation.trigger)
        yield from (equation.value for equation in self.discrete_equations)
        yield from (assertion.condition for assertion in self.assertions)
        yield from (termination.trigger for termination in self.terminations)

    def mapped(self, change: Callable[[Expression], Expression]) -> Dae:
        """Return the model with every expression changed; relations and delays stay such."""
        relations: list[Relation] = []
        for relation in self.relations:
            changed = change(relation)
            assert isinstance(changed, Relation)
            relations.append(changed)
        delays: list[Delayed] = []
        for delay in self.delays:
            changed = change(delay)
            assert isinstance(changed, Delayed)
            delays.append(changed)
        return replace(
            self,
            residuals=tuple(map(change, self.residuals)),
            initial_residuals=tuple(map(change, self.initial_residuals)),
            relations=tuple(relations),
            delays=tuple(delays),
            reinits=tuple(
                Reinit(r.state, change(r.value), change(r.trigger)) for r in self.reinits
            ),
            when_equations=tuple(
                WhenEquation(change(w.residual), change(w.trigger)) for w in self.when_equations
            ),
            discrete_equations=tuple(
                DiscreteEquation(d.name, change(d.value)) for d in self.discrete_equations
            ),
            assertions=tuple(Assertion(change(a.condition), a.message) for a in self.assertions),
            terminations=tuple(
                Termination(change(t.trigger), t.message) for t in self.terminations
            ),
        )

    def with_role(self, *roles: Role) -> tuple[Variable, ...]:
        """Return the variables that have one of the roles, in order of declaration."""
        return tuple(v for v in self.variables.values() if v.role in roles)

    @cached_property
    def states(self) -> tuple[Variable, ...]:
        """The states, in order of declaration."""
        return self.with_role(Role.STATE)

    @cached_property
    def inputs(self) -> tuple[Variable, ...]:
        """The inputs, in order of declaration."""
        return self.with_role(Role.INPUT)

    @cached_property
    def outputs(self) -> tuple[Variable, ...]:
        """Everything declared `output`, states included, in order of declaration."""
        return tuple(v for v in self.variables.values() if v.output)

    @cached_property
    def parameters(self) -> tuple[Variable, ...]:
        """Parameters and constants, in order of declaration."""
        return self.with_role(Role.PARAMETER, Role.CONSTANT)

    @cached_property
    def dependent_parameters(self) -> frozenset[str]:
        """Names of the parameters whose value is computed from other parameters."""
        return frozenset(
            v.name
            for v in self.parameters
            if v.binding is not None and any(isinstance(n, Symbol) for n in walk(v.binding))
        )

    @cached_property
    def start_parameters(self) -> Mapping[str, str]:
        """Parameter name → state whose start value it is (`start = q_start`)."""
        found: dict[str, str] = {}
        for state in self.states:
            start = state.start
            # A wrapper hands its own parameter down: follow `plant.q_start = q_start`.
            while isinstance(start, Symbol):
                found[start.name] = state.name
                start = self.variables[start.name].binding
        return found

    @cached_property
    def parameter_values(self) -> Mapping[str, float]:
        """Declared value of every parameter and constant, dependent ones computed."""
        values: dict[str, float] = {}
        pending = list(self.parameters)
        while pending:
            rest: list[Variable] = []
            for v in pending:
                expression = v.binding if v.binding is not None else (v.start or Literal(0.0))
                try:
                    values[v.name] = evaluate(expression, values)
                except KeyError:
                    rest.append(v)
            if len(rest) == len(pending):
                # A cycle cannot come out of a checked model; stop rather than loop.
                raise AssertionError(f"parameters depend on each other: {[v.name for v in rest]}")
            pending = rest
        return values

    def number(self, expression: Expression | None, default: float) -> float:
        """Evaluate an attribute that may depend on parameters; `default` if there is none."""
        if expression is None:
            return default
        return evaluate(expression, self.parameter_values)
