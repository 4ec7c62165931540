"""modelDescription.xml of FMI 3.0, and the files that FMI 3 has beside it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from fmus.codegen import GUID_MARK
from fmus.dae import Dae, ScalarType
from fmus.description import (
    KINDS,
    add_log_and_experiment,
    add_units,
    document,
    given,
    model_identifier,
    structure,
    value_attributes,
)
from fmus.explicit import ExplicitModel
from fmus.icon import Icon
from fmus.layout import FmuVariable, Layout

_ABILITIES = {
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
}
_CO_SIMULATION = {
    "canHandleVariableCommunicationStepSize": "true",
    "hasEventMode": "true",
    "mightReturnEarlyFromDoStep": "true",
}
_TYPES = {
    ScalarType.REAL: "Float64",
    ScalarType.INTEGER: "Int32",
    ScalarType.BOOLEAN: "Boolean",
}


def fmi3_description(model: ExplicitModel, layout: Layout) -> str:
    """Return the text of modelDescription.xml, with a mark where the instantiation token goes."""
    dae = model.dae
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": "3.0",
            "modelName": dae.name,
            "instantiationToken": GUID_MARK,
            **given(description=dae.description),
            "generationTool": "twinproof",
            "variableNamingConvention": "structured",
        },
    )
    for kind in KINDS:
        further = _CO_SIMULATION if kind == "CoSimulation" else _model_exchange(dae)
        identifier = {"modelIdentifier": model_identifier(dae.name)}
        ET.SubElement(root, kind, identifier | _ABILITIES | further)
    add_units(root, layout.variables)
    add_log_and_experiment(root)
    variables = ET.SubElement(root, "ModelVariables")
    _add_variables(variables, dae, layout)
    first_indicator = 1 + max(v.reference for v in layout.variables)
    indicators = range(first_indicator, first_indicator + len(dae.relations))
    for number, reference in enumerate(indicators, start=1):
        _add_indicator(variables, number, reference)
    _add_structure(root, model, layout, indicators)
    return document(root)


def build_description(identifier: str, sources: Sequence[str]) -> str:
    """Return the text of sources/buildDescription.xml: which C files make the library."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    return document(root)


def terminals(dae: Dae, layout: Layout, icon: Icon | None = None) -> str | None:
    """Return the text of terminalsAndIcons.xml: flanges and icon; None if there is neither.

    A flange of the model itself, or of one of its components, is a terminal of two variables: the
    potential (angle, position) as a signal, and the flow (torque, force) into it.
    """
    known = {v.name for v in layout.variables}
    shown = [c for c in dae.connectors if c.path.count(".") <= 1 and {c.potential, c.flow} <= known]
    if not shown and icon is None:
        return None
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    if icon is not None:
        (x1, y1), (x2, y2) = icon.extent
        corners = {"x1": repr(x1), "y1": repr(y1), "x2": repr(x2), "y2": repr(y2)}
        picture = ET.SubElement(root, "GraphicalRepresentation")
        ET.SubElement(
            picture, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": "0.1"}
        )
        ET.SubElement(picture, "Icon", corners)
    if not shown:
        return document(root)
    group = ET.SubElement(root, "Terminals")
    for connector in shown:
        terminal = ET.SubElement(
            group,
            "Terminal",
            {
                "name": connector.path,
                "matchingRule": "plug",
                **given(description=connector.description),
            },
        )
        for name, kind in ((connector.potential, "signal"), (connector.flow, "inflow")):
            ET.SubElement(
                terminal,
                "TerminalMemberVariable",
                variableName=name,
                memberName=name.rpartition(".")[2],
                variableKind=kind,
            )
    return document(root)


def _model_exchange(dae: Dae) -> dict[str, str]:
    # Delays remember what there was at completed steps.
    return {"needsCompletedIntegratorStep": "true"} if dae.delays else {}


# Variables


def _add_variables(parent: ET.Element, dae: Dae, layout: Layout) -> None:
    reference = {v.name: v.reference for v in layout.variables}
    reinitialised = {r.state for r in dae.reinits}
    elements: dict[int, ET.Element] = {}
    for variable in layout.variables:
        if variable.alias:
            ET.SubElement(
                elements[variable.reference],
                "Alias",
                {"name": variable.name, **given(description=variable.description)},
            )
            continue
        attributes = {
            "name": variable.name,
            "valueReference": str(variable.reference),
            **given(description=variable.description),
            "causality": variable.causality,
            "variability": variable.variability,
            **given(initial=variable.initial),
            **value_attributes(dae, variable),
        }
        if variable.derivative_of:
            attributes["derivative"] = str(reference[variable.derivative_of])
        if variable.name in reinitialised:
            attributes["reinit"] = "true"
        elements[variable.reference] = ET.SubElement(parent, _TYPES[variable.type], attributes)


def _add_indicator(parent: ET.Element, number: int, reference: int) -> None:
    ET.SubElement(
        parent,
        "Float64",
        name=f"_eventIndicators[{number}]",
        valueReference=str(reference),
        description="A relation switches where this changes its sign",
        causality="local",
        variability="continuous",
        initial="calculated",
    )


# Structure


def _add_structure(
    root: ET.Element, model: ExplicitModel, layout: Layout, indicators: Iterable[int]
) -> None:
    element = ET.SubElement(root, "ModelStructure")
    found = structure(model, layout)

    def add(kind: str, unknowns: Sequence[tuple[FmuVariable, tuple[FmuVariable, ...]]]) -> None:
        for variable, needed in unknowns:
            ET.SubElement(
                element,
                kind,
                valueReference=str(variable.reference),
                dependencies=" ".join(str(v.reference) for v in needed),
            )

    add("Output", found.outputs)
    add("ContinuousStateDerivative", found.derivatives)
    for variable in found.initial:
        ET.SubElement(element, "InitialUnknown", valueReference=str(variable.reference))
    for reference in indicators:
        ET.SubElement(element, "EventIndicator", valueReference=str(reference))
