"""What modelDescription.xml says in either version of FMI."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca

from fmus.base_units import base_unit
from fmus.casadi_expressions import SX
from fmus.dae import Dae, ScalarType
from fmus.explicit import ExplicitModel
from fmus.layout import FmuVariable, Layout
from foundation.errors import UnitError
from foundation.units import factor_and_offset

DEFAULT_TOLERANCE = 1e-8
"""The runtime's relative tolerance, unless the importer sets one."""

KINDS = ("ModelExchange", "CoSimulation")


def model_identifier(name: str) -> str:
    """Return a C identifier for a model: the name of its library.

    Example:
        >>> model_identifier("2nd try")
        '_2nd_try'
    """
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{identifier}" if identifier[0].isdigit() else identifier


def document(root: ET.Element) -> str:
    """Return an element and all below it as the text of a file."""
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode", xml_declaration=False)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def given(**attributes: str) -> dict[str, str]:
    """Return those attributes that are not empty."""
    return {name: text for name, text in attributes.items() if text}


def add_log_and_experiment(root: ET.Element) -> None:
    """Add what the log can hold, and the default experiment."""
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError")
    ET.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime="10", tolerance=repr(DEFAULT_TOLERANCE)
    )


def add_units(root: ET.Element, variables: Iterable[FmuVariable]) -> None:
    """Add the definitions of all units that variables have or are shown in."""
    shown: dict[str, set[str]] = {}
    for v in variables:
        if v.unit:
            display = display_unit(v)
            shown.setdefault(v.unit, set()).update({display} if display else set())
    if not shown:
        return  # FMI 3 has no empty elements
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted(shown):
        element = ET.SubElement(definitions, "Unit", name=unit)
        base = base_unit(unit)
        if base is not None:
            attributes = {name: str(power) for name, power in base.exponents.items()}
            if base.factor != 1.0:
                attributes["factor"] = repr(base.factor)
            if base.offset != 0.0:
                attributes["offset"] = repr(base.offset)
            ET.SubElement(element, "BaseUnit", attributes)
        for display in sorted(shown[unit]):
            factor, offset = factor_and_offset(unit, display)
            ET.SubElement(
                element, "DisplayUnit", name=display, factor=repr(factor), offset=repr(offset)
            )


def display_unit(variable: FmuVariable) -> str:
    """Return the unit to show a variable in, if it can be converted to it."""
    declared = variable.declared
    if declared is None or not declared.display_unit or declared.display_unit == variable.unit:
        return ""
    try:
        factor_and_offset(variable.unit, declared.display_unit)
    except UnitError:
        return ""
    return declared.display_unit


def value_attributes(dae: Dae, variable: FmuVariable) -> dict[str, str]:
    """Return unit, bounds, nominal and start value of a variable."""
    attributes: dict[str, str] = {}
    if variable.type is ScalarType.REAL:
        attributes |= given(unit=variable.unit, displayUnit=display_unit(variable))
    declared = variable.declared
    if declared is not None and variable.type is not ScalarType.BOOLEAN and not variable.alias:
        bounds = {"min": declared.minimum, "max": declared.maximum}
        if variable.type is ScalarType.REAL:
            bounds["nominal"] = declared.nominal
        for name, expression in bounds.items():
            if expression is not None:
                attributes[name] = _literal(dae.number(expression, 0.0), variable.type)
    if variable.start is not None:
        attributes["start"] = _literal(variable.start, variable.type)
    return attributes


def _literal(value: float, kind: ScalarType) -> str:
    match kind:
        case ScalarType.REAL:
            return repr(float(value))
        case ScalarType.INTEGER:
            return str(round(value))
        case ScalarType.BOOLEAN:
            return "true" if value else "false"


@dataclass(frozen=True)
class Structure:
    """Which variables are computed, and from what.

    Attributes:
        outputs, derivatives: Each with the inputs, states (and time) that it depends on directly.
        initial: Computed at the start.
    """

    outputs: tuple[tuple[FmuVariable, tuple[FmuVariable, ...]], ...]
    derivatives: tuple[tuple[FmuVariable, tuple[FmuVariable, ...]], ...]
    initial: tuple[FmuVariable, ...]


def structure(model: ExplicitModel, layout: Layout) -> Structure:
    """Return the structure of a solved model."""
    by_name = {v.name: v for v in layout.variables}

    def unknown(variable: FmuVariable) -> tuple[FmuVariable, tuple[FmuVariable, ...]]:
        if variable.derivative_of:
            expression = model.derivatives[model.state_names.index(variable.derivative_of)]
        else:
            expression = model.value(variable.name)
        return variable, tuple(by_name[name] for name in _dependencies(model, expression))

    return Structure(
        outputs=tuple(unknown(v) for v in layout.variables if v.causality == "output"),
        derivatives=tuple(unknown(v) for v in layout.variables if v.derivative_of),
        initial=tuple(
            v
            for v in layout.variables
            if v.initial == "calculated"
            and not v.alias
            and (
                v.causality in ("output", "calculatedParameter")
                or v.derivative_of
                or v.name in model.state_names
            )
        ),
    )


def _dependencies(model: ExplicitModel, expression: SX) -> list[str]:
    """Names of the inputs and states (and time) that an expression depends on directly."""
    arguments = ca.vertcat(model.time, model.u, model.x, model.delayed)
    names = ["time", *model.input_names, *model.state_names]
    columns = set(ca.jacobian(expression, arguments).sparsity().get_triplet()[1])
    # What comes out of a delay is a function of time for the present instant.
    found = {names[c] if c < len(names) else "time" for c in columns}
    return [name for name in names if name in found]
