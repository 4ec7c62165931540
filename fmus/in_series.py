"""A foreign FMU with Modelica blocks before and behind it.

Its equations are not known, so nothing can act inside of it; what acts on its inputs and outputs
can be written in Modelica all the same. The text around an FMU is a class with the FMU's inputs and
outputs, and for each of them the other end, where the FMU is to be thought of:

    model Heater
      input power; output power_sent;       // power_sent goes into the FMU
      input rise_computed; output rise;     // rise_computed comes out of it
    equation
      power_sent = power; rise = rise_computed;
    end Heater;

Blocks in series are added to it as to any other model. Who simulates it (`SeriesModel.chain`)
closes the gap by running the FMU.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from fmus.black_box import BlackBox, black_box
from fmus.dae import Dae, Role, ScalarType, Variable
from fmus.frontend import load
from fmus.sources import ModelicaSource
from foundation.errors import UnsupportedModelError

_IDENTIFIER = re.compile(r"[A-Za-z_]\w*\Z")


@dataclass(frozen=True, eq=False)
class SeriesModel(BlackBox):
    """A black box with blocks around it; inputs and outputs are those of the whole.

    Attributes:
        box: The FMU alone.
        chain: The blocks; it has the inputs of the whole and the outputs of the FMU as inputs.
        means: Input of the FMU → state of the chain that is the integral of what goes there.
        computed: Output of the FMU → input of the chain that it comes back by.
    """

    box: BlackBox = field(default_factory=lambda: BlackBox("", {}, ()))
    chain: Dae = field(default_factory=lambda: Dae("", {}, ()))
    means: tuple[tuple[str, str], ...] = ()
    computed: tuple[tuple[str, str], ...] = ()


def around(fmu: Path, roots: tuple[Path, ...] = ()) -> ModelicaSource:
    """Return the text around an FMU, to which blocks can be added.

    Args:
        fmu: The file.
        roots: Folders of further libraries.

    Raises:
        FmuError: The FMU cannot be read.
        UnsupportedModelError: An input or output has a name that Modelica does not allow.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> text = around(cached_fmu(library_class("Twinproof.Plants.Pendulum")))
        >>> [v.name for v in model_of(text).outputs]
        ['theta', 'omega']
    """
    box = black_box(fmu)
    declared: list[str] = []
    equations: list[str] = []
    for v in box.inputs:
        _check_name(v.name, fmu)
        declared += [
            f"  Twinproof.Interfaces.RealInput {v.name}{_attributes(v)};\n",
            f'  Twinproof.Interfaces.RealOutput {_sent(v.name)} "What the FMU gets";\n',
            f'  Real {_integral(v.name)}(start = 0, fixed = true) "Its mean is held a sample";\n',
        ]
        equations += [
            f"  {_sent(v.name)} = {v.name};\n",
            f"  der({_integral(v.name)}) = {_sent(v.name)};\n",
        ]
    for v in _real_outputs(box):
        _check_name(v.name, fmu)
        declared += [
            f'  Twinproof.Interfaces.RealInput {_computed(v.name)} "What the FMU says";\n',
            f"  Twinproof.Interfaces.RealOutput {v.name}{_attributes(v)};\n",
        ]
        equations.append(f"  {v.name} = {_computed(v.name)};\n")
    name = re.sub(r"\W", "_", box.name) or "Fmu"
    name = name if _IDENTIFIER.match(name) else f"Fmu_{name}"
    text = (
        f'model {name} "Around {fmu.name}, whose equations are not known"\n'
        f"{''.join(declared)}equation\n{''.join(equations)}end {name};\n"
    )
    return ModelicaSource(text, name, f"{name}.mo", str(fmu), roots, fmu=fmu)


def model_of(source: ModelicaSource) -> Dae:
    """Return the flat model of a text: of one around an FMU, the FMU with what the text adds.

    Raises:
        ModelicaError, UnsupportedModelError: As `load`.
        FmuError: The FMU cannot be read.
    """
    return load(source) if source.fmu is None else _series(source)


# As for `load`: discovery asks for the same model again and again.
@lru_cache(maxsize=512)
def _series(source: ModelicaSource) -> SeriesModel:
    assert source.fmu is not None
    box, chain = black_box(source.fmu), load(source)

    def inside(name: str) -> str:
        # A wrapper has the text around the FMU as its component.
        return name if name in chain.variables else f"plant.{name}"

    means = tuple((v.name, inside(_integral(v.name))) for v in box.inputs)
    integrals = {state for _, state in means}
    own = [
        v
        for v in chain.with_role(Role.PARAMETER, Role.CONSTANT, Role.STATE)
        if v.name not in integrals
    ]
    return SeriesModel(
        name=source.short_name,
        variables={**_real(box), **{v.name: replace(v, output=False) for v in own}},
        residuals=(),
        fmu=box.fmu,
        kinds=box.kinds,
        box=box,
        chain=chain,
        means=means,
        computed=tuple((v.name, _computed(v.name)) for v in _real_outputs(box)),
    )


def _real(box: BlackBox) -> dict[str, Variable]:
    """Return an FMU's variables without outputs that are no Reals: no effect acts on these."""
    kept = {v.name for v in _real_outputs(box)}
    return {name: v for name, v in box.variables.items() if not v.output or name in kept}


def _real_outputs(box: BlackBox) -> list[Variable]:
    return [v for v in box.outputs if v.type is ScalarType.REAL]


def _attributes(v: Variable) -> str:
    unit = f'(unit = "{v.unit}")' if v.unit else ""
    description = v.description.replace("\\", "\\\\").replace('"', '\\"')
    return f'{unit} "{description}"' if description else unit


def _sent(name: str) -> str:
    return f"{name}_sent"


def _integral(name: str) -> str:
    return f"{name}_integral"


def _computed(name: str) -> str:
    return f"{name}_computed"


def _check_name(name: str, fmu: Path) -> None:
    if not _IDENTIFIER.match(name):
        raise UnsupportedModelError(
            f"'{name}' is no name in Modelica, in which effects at it would be written",
            where=str(fmu),
            remedy="export the FMU with plain names of its inputs and outputs",
        )
