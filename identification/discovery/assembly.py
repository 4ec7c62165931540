"""A foreign FMU with what was added to it, as a system that any tool for SSP runs.

The FMU stays as it is. Each effect in series is an FMU of its own, made from its Modelica class.
"""

from __future__ import annotations

from dataclasses import replace

from fmus.master.system import Component, Connection, System
from fmus.package import cached_fmu
from fmus.plant import Value
from fmus.sources import ModelicaSource
from foundation.errors import UnsupportedModelError
from identification.discovery.extension import Addition, ExtendedModel, chain

PLANT = "plant"
"""Name of the FMU in the system."""
_START = ".start"


def assembled(model: ExtendedModel) -> System:
    """Return the FMU with its fitted values, and an FMU of every effect in series with it.

    Args:
        model: An extension of a foreign FMU.

    Raises:
        UnsupportedModelError: The model is not a foreign FMU's.
        CompilerError: No C compiler.
    """
    fmu = model.base.fmu
    if fmu is None:
        raise UnsupportedModelError(
            f"{model.name} is Modelica, not an FMU with effects around it",
            remedy="export it as one FMU: twinproof export",
        )
    dae = model.dae
    values: dict[str, Value] = {n.removesuffix(_START): v for n, v in model.values.items()}
    components = {PLANT: Component(fmu, values)}
    connections: list[Connection] = []
    for addition in model.additions:
        components[addition.instance] = Component(cached_fmu(_alone(addition, model.base)))
        for name in addition.effect.companions:
            connections.append(Connection(name, f"{addition.instance}.{name}"))
    for v in dae.inputs:
        stations = [v.name, *_through(model, v.name), f"{PLANT}.{v.name}"]
        connections += _pairs(stations)
    for v in dae.outputs:
        stations = [f"{PLANT}.{v.name}", *_through(model, v.name), v.name]
        connections += _pairs(stations)
    return System(
        components,
        connections,
        inputs=[v.name for v in dae.inputs],
        outputs=[v.name for v in dae.outputs],
        name=model.name,
    )


def _alone(addition: Addition, base: ModelicaSource) -> ModelicaSource:
    """Return an effect with its fitted values as a model of its own."""
    effect = addition.effect
    settings = ", ".join(f"{n} = {v!r}" for n, v in {**addition.values, **addition.starts}.items())
    text = (
        f'model {addition.instance} "{addition.label}"\n'
        f"  extends {effect.class_name}({settings});\nend {addition.instance};\n"
    )
    return replace(
        base, text=text, class_name=addition.instance, file_name=f"{addition.instance}.mo", fmu=None
    )


def _through(model: ExtendedModel, place: str) -> list[str]:
    """Return the ends of the effects at a place, in the order in which a signal meets them."""
    return [f"{a.instance}.{end}" for a in chain(model.additions, place) for end in ("u", "y")]


def _pairs(stations: list[str]) -> list[Connection]:
    # A factor, so that units are left alone: an effect has none, and takes those of its place.
    ends = zip(stations[::2], stations[1::2], strict=True)
    return [Connection(source, target, factor=1.0, offset=0.0) for source, target in ends]
