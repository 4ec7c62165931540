"""modelDescription.xml of FMI 2.0."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

import casadi as ca

from fmus.base_units import base_unit
from fmus.casadi_expressions import SX
from fmus.codegen import GUID_MARK
from fmus.dae import Dae, ScalarType
from fmus.explicit import ExplicitModel
from fmus.layout import FmuVariable, Layout
from foundation.errors import UnitError
from foundation.units import factor_and_offset

DEFAULT_TOLERANCE = 1e-8
"""The runtime's relative tolerance, unless the importer sets one."""

_ABILITIES = {
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
_CO_SIMULATION = {
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "true",
}


def model_identifier(name: str) -> str:
    """Return a C identifier for a model: the name of its library.

    Example:
        >>> model_identifier("2nd try")
        '_2nd_try'
    """
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{identifier}" if identifier[0].isdigit() else identifier


def fmi2_description(model: ExplicitModel, layout: Layout, sources: Sequence[str]) -> str:
    """Return the text of modelDescription.xml, with a mark where the GUID goes.

    Args:
        model: The solved model.
        layout: Its variables.
        sources: C files that an importer compiles, of those in `sources/`.
    """
    dae = model.dae
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": "2.0",
            "modelName": dae.name,
            "guid": GUID_MARK,
            **_optional(description=dae.description),
            "generationTool": "twinproof",
            "variableNamingConvention": "structured",
            "numberOfEventIndicators": str(len(dae.relations)),
        },
    )
    for kind, further in (("ModelExchange", {}), ("CoSimulation", _CO_SIMULATION)):
        identifier = {"modelIdentifier": model_identifier(dae.name)}
        element = ET.SubElement(root, kind, identifier | further | _ABILITIES)
        files = ET.SubElement(element, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    _add_units(root, layout.variables)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError")
    ET.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime="10", tolerance=repr(DEFAULT_TOLERANCE)
    )
    variables = ET.SubElement(root, "ModelVariables")
    index = {v.name: i for i, v in enumerate(layout.variables, start=1)}
    reinitialised = {r.state for r in dae.reinits}
    for variable in layout.variables:
        _add_variable(variables, dae, variable, index, reinitialised)
    _add_structure(root, model, layout, index)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=False)


def _optional(**attributes: str) -> dict[str, str]:
    return {name: text for name, text in attributes.items() if text}


# Units


def _add_units(root: ET.Element, variables: Iterable[FmuVariable]) -> None:
    shown: dict[str, set[str]] = {}
    for v in variables:
        if v.unit:
            display = _display_unit(v)
            shown.setdefault(v.unit, set()).update({display} if display else set())
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


def _display_unit(variable: FmuVariable) -> str:
    """Return the unit to show a variable in, if it can be converted to it."""
    declared = variable.declared
    if declared is None or not declared.display_unit or declared.display_unit == variable.unit:
        return ""
    try:
        factor_and_offset(variable.unit, declared.display_unit)
    except UnitError:
        return ""
    return declared.display_unit


# Variables


def _add_variable(
    parent: ET.Element,
    dae: Dae,
    variable: FmuVariable,
    index: dict[str, int],
    reinitialised: set[str],
) -> None:
    scalar = ET.SubElement(
        parent,
        "ScalarVariable",
        {
            "name": variable.name,
            "valueReference": str(variable.reference),
            **_optional(description=variable.description),
            "causality": variable.causality,
            "variability": variable.variability,
            **_optional(initial=variable.initial),
        },
    )
    attributes: dict[str, str] = {}
    if variable.type is ScalarType.REAL:
        attributes |= _optional(unit=variable.unit, displayUnit=_display_unit(variable))
        if variable.derivative_of:
            attributes["derivative"] = str(index[variable.derivative_of])
        if variable.name in reinitialised:
            attributes["reinit"] = "true"
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
    ET.SubElement(scalar, variable.type.value.capitalize(), attributes)


def _literal(value: float, kind: ScalarType) -> str:
    match kind:
        case ScalarType.REAL:
            return repr(float(value))
        case ScalarType.INTEGER:
            return str(round(value))
        case ScalarType.BOOLEAN:
            return "true" if value else "false"


# Structure


def _add_structure(
    root: ET.Element, model: ExplicitModel, layout: Layout, index: dict[str, int]
) -> None:
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [v for v in layout.variables if v.causality == "output"]
    derivatives = [v for v in layout.variables if v.derivative_of]
    initial = [
        v
        for v in layout.variables
        if v.initial == "calculated"
        and (
            v.causality in ("output", "calculatedParameter")
            or v.derivative_of
            or v.name in model.state_names
        )
    ]

    def expression(variable: FmuVariable) -> SX:
        if variable.derivative_of:
            return model.derivatives[model.state_names.index(variable.derivative_of)]
        return model.value(variable.name)

    for kind, unknowns in (("Outputs", outputs), ("Derivatives", derivatives)):
        if unknowns:
            element = ET.SubElement(structure, kind)
            for variable in unknowns:
                needed = _dependencies(model, expression(variable), index)
                ET.SubElement(
                    element,
                    "Unknown",
                    index=str(index[variable.name]),
                    dependencies=" ".join(map(str, needed)),
                )
    if initial:
        element = ET.SubElement(structure, "InitialUnknowns")
        for variable in initial:
            ET.SubElement(element, "Unknown", index=str(index[variable.name]))


def _dependencies(model: ExplicitModel, expression: SX, index: dict[str, int]) -> list[int]:
    """Indices of the inputs and states (and time) that an expression depends on directly."""
    arguments = ca.vertcat(model.x, model.u, model.time, model.delayed)
    names = [*model.state_names, *model.input_names]
    columns = ca.jacobian(expression, arguments).sparsity().get_triplet()[1]
    # What comes out of a delay is a function of time for the present instant.
    return sorted({index[names[c] if c < len(names) else "time"] for c in columns})
