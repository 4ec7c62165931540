"""What an FMU shows of a model: its variables and their value references."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from fmus.casadi_expressions import SX
from fmus.dae import Dae, Role, ScalarType, Variable
from fmus.explicit import ExplicitModel
from fmus.expressions import Expression, Literal, Symbol, walk

TIME_REFERENCE = 0


@dataclass(frozen=True)
class FmuVariable:
    """One variable of an FMU, in FMI's words.

    Attributes:
        name: Full name.
        reference: Value reference: an index into the runtime's array of values.
        declared: The Modelica variable; None for `time` and derivatives.
        causality, variability, initial: As in FMI 2.0.4, section 2.2.7; `initial` may be empty.
        start: Start value, if `initial` asks for one.
        unit: Unit as written in Modelica.
        description: One line.
        derivative_of: Name of the state whose derivative this is.
        alias: Shares its value reference with an earlier variable.
    """

    name: str
    reference: int
    declared: Variable | None
    causality: str
    variability: str
    initial: str = ""
    start: float | None = None
    unit: str = ""
    description: str = ""
    derivative_of: str = ""
    alias: bool = False

    @property
    def type(self) -> ScalarType:
        """Scalar type; derivatives and time are Real."""
        return self.declared.type if self.declared is not None else ScalarType.REAL


@dataclass(frozen=True)
class Layout:
    """All variables of an FMU, and how the runtime's array of values is filled.

    The array holds, in this order: time, independent parameters, inputs, states, discrete
    variables, derivatives of the states, and the others, which are computed.

    Attributes:
        variables: In the order in which they are listed.
        starts: Start values of parameters, inputs, states and discrete variables.
        computed_starts: Column of states and discrete variables at the start, in terms of
            `model.p`, or the value that was set where the importer may set it.
        settable_starts: Column symbol of the values that were set.
        tunable: For each independent parameter, whether it may be set.
        others: Names and expressions of the computed values after the derivatives.
    """

    variables: tuple[FmuVariable, ...]
    starts: tuple[float, ...]
    computed_starts: SX
    settable_starts: SX
    tunable: tuple[bool, ...]
    others: tuple[tuple[str, SX], ...]

    def __getitem__(self, name: str) -> FmuVariable:
        return next(v for v in self.variables if v.name == name)


class _Builder:
    def __init__(self, model: ExplicitModel) -> None:
        self._model = model
        self._dae: Dae = model.dae
        self._variables: list[FmuVariable] = [
            FmuVariable(
                "time",
                TIME_REFERENCE,
                None,
                causality="independent",
                variability="continuous",
                unit="s",
                description="Simulation time",
            )
        ]
        self._next = 1
        self._starts: list[float] = []
        self._others: list[tuple[str, SX]] = []

    def build(self) -> Layout:
        model, dae = self._model, self._dae
        tunable = tuple(dae.variables[name].tunable for name in model.parameter_names)
        for name, may_change in zip(model.parameter_names, tunable, strict=True):
            causality = ("parameter", "tunable") if may_change else ("local", "constant")
            self._stored(dae.variables[name], *causality, dae.parameter_values[name])
        for name in model.input_names:
            variable = dae.variables[name]
            self._stored(variable, "input", "continuous", dae.number(variable.start, 0.0))
        settable = ca.SX.sym("start", len(model.state_names) + len(model.discrete_names))
        computed: list[SX] = []
        for k, name in enumerate((*model.state_names, *model.discrete_names)):
            computed.append(self._started(dae.variables[name], settable[k]))
        for name in model.state_names:
            self._derivative(dae.variables[name])
        self._add_others()
        self._add_aliases()
        return Layout(
            tuple(self._variables),
            tuple(self._starts),
            ca.vertcat(*computed) if computed else ca.SX(0, 1),
            settable,
            tunable,
            tuple(self._others),
        )

    def _add(
        self,
        variable: Variable,
        causality: str,
        variability: str,
        initial: str,
        start: float | None = None,
        *,
        reference: int | None = None,
    ) -> None:
        self._variables.append(
            FmuVariable(
                variable.name,
                self._next if reference is None else reference,
                variable,
                causality,
                variability,
                initial,
                start,
                variable.unit,
                variable.description,
                alias=reference is not None,
            )
        )
        if reference is None:
            self._next += 1

    def _stored(self, variable: Variable, causality: str, variability: str, start: float) -> None:
        self._starts.append(start)
        # An input's start is exact by definition and FMI does not want it said.
        self._add(variable, causality, variability, "" if causality == "input" else "exact", start)

    def _started(self, variable: Variable, settable: SX) -> SX:
        """Add a state or discrete variable; return its value at the start."""
        causality = "output" if variable.output else "local"
        variability = "discrete" if variable.role is Role.DISCRETE else "continuous"
        start = self._dae.number(variable.start, 0.0)
        self._starts.append(start)
        if variable.start is not None and self._depends_on_tunable(variable.start):
            self._add(variable, causality, variability, "calculated")
            return self._model.fold(variable.start)
        self._add(variable, causality, variability, "exact", start)
        return settable

    def _depends_on_tunable(self, expression: Expression) -> bool:
        names = {node.name for node in walk(expression) if isinstance(node, Symbol)}
        return bool(names - {v.name for v in self._dae.with_role(Role.CONSTANT)})

    def _derivative(self, state: Variable) -> None:
        self._variables.append(
            FmuVariable(
                f"der({state.name})",
                self._next,
                None,
                causality="local",
                variability="continuous",
                initial="calculated",
                unit=_rate_unit(state.unit),
                description=f"Time derivative of {state.name}",
                derivative_of=state.name,
            )
        )
        self._next += 1

    def _computed(self, variable: Variable, value: SX, causality: str, variability: str) -> None:
        self._others.append((variable.name, value))
        self._add(variable, causality, variability, "calculated")

    def _add_others(self) -> None:
        model, dae = self._model, self._dae
        for variable in dae.parameters:
            if variable.name in model.dependent:
                value = model.dependent[variable.name]
                self._computed(variable, value, "calculatedParameter", "tunable")
            elif variable.role is Role.CONSTANT:
                self._constant(variable, dae.parameter_values[variable.name])
        for variable in dae.with_role(Role.ALGEBRAIC):
            value = model.algebraics[variable.name]
            causality = "output" if variable.output else "local"
            variability = "continuous" if variable.type is ScalarType.REAL else "discrete"
            self._computed(variable, value, causality, variability)
        for constant in dae.constant_values.values():
            self._constant(constant.declared, constant.value)

    def _constant(self, variable: Variable, value: float) -> None:
        self._others.append((variable.name, ca.SX(value)))
        self._add(variable, "local", "constant", "exact", value)

    def _add_aliases(self) -> None:
        references = {v.name: v for v in self._variables}
        for alias in self._dae.aliases.values():
            kept = references[alias.of]
            shares = alias.sign > 0 and (
                kept.causality == "local"
                # Of a computed output, FMI 3 would count aliases among the initial unknowns.
                or (kept.causality == "output" and kept.initial != "calculated")
            )
            if shares and kept.variability in ("continuous", "discrete"):
                self._add(
                    alias.declared,
                    "local",
                    kept.variability,
                    "calculated",
                    reference=kept.reference,
                )
            else:
                value = self._model.value(alias.name)
                self._computed(alias.declared, value, "local", "continuous")


def layout(model: ExplicitModel) -> Layout:
    """Give every variable of a model its place in an FMU."""
    return _Builder(model).build()


def with_starts(dae: Dae, starts: dict[str, float]) -> Dae:
    """Return the model with other start values of states that have no start parameter.

    Example:
        A state `x(start = 1)` can be given here; for `q(start = q_start)` set `q_start`.
    """
    variables = dict(dae.variables)
    for name, value in starts.items():
        variables[name] = replace(variables[name], start=Literal(value))
    return replace(dae, variables=variables)


def _rate_unit(unit: str) -> str:
    """Unit of a time derivative, in Modelica's grammar: `m` gives `m/s`, `m/s` gives `m/s2`."""
    if not unit:
        return ""
    numerator, slash, denominator = unit.partition("/")
    if not slash:
        return f"{unit}/s"
    if denominator == "s":
        return f"{numerator}/s2"
    return f"{numerator}/({denominator.strip('()')}.s)"
