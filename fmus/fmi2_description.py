"""modelDescription.xml of FMI 2.0."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from fmus.codegen import GUID_MARK
from fmus.dae import Dae
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
from fmus.layout import FmuVariable, Layout

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
            **given(description=dae.description),
            "generationTool": "twinproof",
            "variableNamingConvention": "structured",
            "numberOfEventIndicators": str(len(dae.relations)),
        },
    )
    for kind in KINDS:
        further = _CO_SIMULATION if kind == "CoSimulation" else {}
        identifier = {"modelIdentifier": model_identifier(dae.name)}
        element = ET.SubElement(root, kind, identifier | further | _ABILITIES)
        files = ET.SubElement(element, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    add_units(root, layout.variables)
    add_log_and_experiment(root)
    variables = ET.SubElement(root, "ModelVariables")
    index = {v.name: i for i, v in enumerate(layout.variables, start=1)}
    reinitialised = {r.state for r in dae.reinits}
    for variable in layout.variables:
        _add_variable(variables, dae, variable, index, reinitialised)
    _add_structure(root, model, layout, index)
    return document(root)


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
            **given(description=variable.description),
            "causality": variable.causality,
            "variability": variable.variability,
            **given(initial=variable.initial),
        },
    )
    attributes = value_attributes(dae, variable)
    if variable.derivative_of:
        attributes["derivative"] = str(index[variable.derivative_of])
    if variable.name in reinitialised:
        attributes["reinit"] = "true"
    ET.SubElement(scalar, variable.type.value.capitalize(), attributes)


def _add_structure(
    root: ET.Element, model: ExplicitModel, layout: Layout, index: dict[str, int]
) -> None:
    element = ET.SubElement(root, "ModelStructure")
    found = structure(model, layout)
    for kind, unknowns in (("Outputs", found.outputs), ("Derivatives", found.derivatives)):
        if unknowns:
            group = ET.SubElement(element, kind)
            for variable, needed in unknowns:
                ET.SubElement(
                    group,
                    "Unknown",
                    index=str(index[variable.name]),
                    dependencies=" ".join(map(str, sorted(index[v.name] for v in needed))),
                )
    if found.initial:
        group = ET.SubElement(element, "InitialUnknowns")
        for variable in found.initial:
            ET.SubElement(group, "Unknown", index=str(index[variable.name]))
