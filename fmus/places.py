"""Where effects can act on a model: its points, flanges, inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass

from fmus.dae import Connector, Dae
from fmus.in_series import model_of
from fmus.sources import ModelicaSource

_KIND_OF_FLOW_UNIT = {"N.m": "rotational", "N": "translational"}
_KIND_OF_NAMES = {("phi", "tau"): "rotational", ("s", "f"): "translational"}
_FLOW_UNIT = {"rotational": "N.m", "translational": "N"}


@dataclass(frozen=True)
class Place:
    """Somewhere that an effect can act on a model.

    Attributes:
        name: What users call it: `wheel` for a point, `inertia.flange_b` or `flange` for another
            connector, `V` for an input or output.
        kind: `rotational`, `translational`, `input` or `output`.
        unit: Of the torque or force, or of the signal.
        description: What the model's author wrote about it.
        connector: What to name in a `connect` equation.
        inherited_connect: A class that extends the model may connect to it. A connector of the
            model itself is one to the outside: only a class that contains the model can.
        also: Other connectors that are rigidly the same place.
    """

    name: str
    kind: str
    unit: str = ""
    description: str = ""
    connector: str = ""
    inherited_connect: bool = True
    also: tuple[str, ...] = ()


def places(model: ModelicaSource | Dae) -> tuple[Place, ...]:
    """Return the places of a model: points, then other flanges, inputs, outputs.

    Flanges that always move alike, such as both ends of a rigid shaft, are one place; it has the
    name of its point if there is one, else of the first connector declared. Connectors deeper than
    one component down cannot be connected to in Modelica and are no places.

    Args:
        model: Source, or the flat model that was made of it.

    Raises:
        ModelicaError: The source is wrong.

    Example:
        >>> from fmus.sources import library_class
        >>> [place.name for place in places(library_class("Twinproof.Plants.Pendulum"))]
        ['joint', 'tau', 'theta', 'omega']
    """
    dae = model_of(model) if isinstance(model, ModelicaSource) else model
    signals = [
        Place(v.name, kind, v.unit, v.description, v.name, inherited_connect=False)
        for kind, variables in (("input", dae.inputs), ("output", dae.outputs))
        for v in variables
    ]
    return (*_mechanical(dae), *signals)


def _mechanical(dae: Dae) -> list[Place]:
    found: dict[tuple[str, float], list[Place]] = {}
    for connector in dae.connectors:
        kind = connector_kind(connector)
        # On something that does not move, forces do nothing.
        if kind is None or connector.path.count(".") > 1:
            continue
        if connector.potential in dae.constant_values:
            continue
        alias = dae.aliases.get(connector.potential)
        node = (alias.of, alias.sign) if alias is not None else (connector.potential, 1.0)
        point = _point(dae, connector)
        found.setdefault(node, []).append(
            Place(
                point or connector.path,
                kind,
                _FLOW_UNIT[kind],
                connector.description,
                connector.path,
                inherited_connect=not connector.top_level,
            )
        )
    merged = [_merged(alike) for alike in found.values()]
    return sorted(merged, key=lambda place: place.name == place.connector)


def _merged(alike: list[Place]) -> Place:
    first = min(alike, key=lambda place: place.name == place.connector)
    also = tuple(place.connector for place in alike if place is not first)
    return Place(
        first.name,
        first.kind,
        first.unit,
        first.description,
        first.connector,
        first.inherited_connect,
        also,
    )


def connector_kind(connector: Connector) -> str | None:
    """Return `rotational` or `translational`, or None for other physics."""
    if connector.flow_unit:
        return _KIND_OF_FLOW_UNIT.get(connector.flow_unit)
    ends = connector.potential.rpartition(".")[2], connector.flow.rpartition(".")[2]
    return _KIND_OF_NAMES.get(ends)


def _point(dae: Dae, connector: Connector) -> str | None:
    """Return the name of the point that holds a connector, if it is one.

    A point has a flange called `flange` and, beside it, what the flange holds as variables.
    """
    component, _, end = connector.path.rpartition(".")
    if end != "flange":
        return None
    beside = (
        f"{component}.{name.rpartition('.')[2]}" for name in (connector.potential, connector.flow)
    )
    known = (dae.variables, dae.aliases, dae.constant_values)
    return component if all(any(b in names for names in known) for b in beside) else None
