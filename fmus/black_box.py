"""An FMU as a model that hides its equations: variables, and values to start from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmus.archive import FmuVariableInfo, describe, read_description
from fmus.dae import Dae, Role, ScalarType, Variable
from fmus.expressions import Expression, Literal, Symbol
from fmus.running import start_names
from foundation.errors import UnsupportedModelError

_TYPES = {"Boolean": ScalarType.BOOLEAN, "Real": ScalarType.REAL}


@dataclass(frozen=True, eq=False)
class BlackBox(Dae):
    """A model without equations.

    Attributes:
        fmu: The file that computes them.
        kinds: `CoSimulation`, `ModelExchange`, as it offers them.
    """

    fmu: Path = Path()
    kinds: tuple[str, ...] = ()


def black_box(fmu: Path) -> BlackBox:
    """Return what an FMU shows of itself, in the form that other models have.

    States are those whose start can be set. A parameter may be changed between runs even if it is
    fixed during one.

    Raises:
        FmuError: The FMU cannot be read.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> box = black_box(cached_fmu(library_class("Twinproof.Plants.Pendulum")))
        >>> [v.name for v in box.states], [v.name for v in box.outputs]
        (['theta', 'omega'], ['theta', 'omega'])
    """
    shown = describe(fmu)
    declared: dict[str, Any] = {str(v.name): v for v in read_description(fmu).modelVariables}
    outputs = {v.name: v for v in shown.outputs}
    starts = start_names(fmu)

    def variable(info: FmuVariableInfo, role: Role, **further: Any) -> Variable:
        kind = str(declared[info.name].type)
        real = kind.startswith("Float")
        return Variable(
            info.name,
            role,
            ScalarType.REAL if real else _TYPES.get(kind, ScalarType.INTEGER),
            output=info.name in outputs,
            unit=info.unit,
            description=info.description,
            minimum=_literal(info.minimum),
            maximum=_literal(info.maximum),
            nominal=_literal(info.nominal),
            **further,
        )

    variables = [variable(v, Role.INPUT, start=_literal(v.start)) for v in shown.inputs]
    variables += [
        variable(v, Role.PARAMETER, binding=Literal(v.start or 0.0), tunable=True)
        for v in shown.parameters
    ]
    for state, by in starts.items():
        start = Symbol(by) if by != state else Literal(_start_of(declared[state]))
        variables.append(
            variable(outputs[state], Role.STATE, start=start)
            if state in outputs
            else Variable(state, Role.STATE, start=start)
        )
    variables += [variable(v, Role.ALGEBRAIC) for v in shown.outputs if v.name not in starts]
    return BlackBox(
        name=shown.name,
        variables={v.name: v for v in variables},
        residuals=(),
        fmu=fmu,
        kinds=shown.kinds,
    )


def check_equations(model: Dae) -> None:
    """Refuse an FMU where equations are needed.

    Raises:
        UnsupportedModelError: The model is an FMU.
    """
    if isinstance(model, BlackBox):
        raise UnsupportedModelError(
            "this needs the model's equations, which an FMU does not carry",
            where=str(model.fmu),
            remedy="choose --method output-error, or give the Modelica source",
        )


def _literal(number: float | None) -> Expression | None:
    return None if number is None else Literal(number)


def _start_of(variable: Any) -> float:
    return float(variable.start or 0.0)
