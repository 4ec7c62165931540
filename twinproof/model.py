"""A model as users name it: Modelica source or FMU, with its variables and places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path

from fmus.black_box import black_box
from fmus.dae import Dae, Role
from fmus.frontend import load
from fmus.in_series import around
from fmus.places import Place, places
from fmus.sources import ModelicaSource, check_libraries, find_source
from foundation.errors import UnsupportedModelError
from identification.discovery.extension import ExtendedModel


@dataclass(frozen=True)
class Model:
    """A model given by Modelica source, or an FMU of which no equations are known.

    Attributes:
        word: As the user named it.
        modelica: Its Modelica source, if there is one.
        fmu: The FMU, if it is one.
        roots: Folders of further libraries, whose effects may be added to the FMU.

    Example:
        >>> model = Model.of("Twinproof.Plants.Positioner")
        >>> [place.name for place in model.places]
        ['carriage', 'vir', 'q', 'v']
    """

    word: str
    modelica: ModelicaSource | None = None
    fmu: Path | None = None
    roots: tuple[Path, ...] = ()

    @classmethod
    def of(cls, word: str | ExtendedModel, modelica_path: Sequence[Path] = ()) -> Model:
        """Find a model.

        Args:
            word: `file.mo:Class.Name`, a class of a library, as `Twinproof.Plants.Positioner`, or
                `file.fmu`; or what `extend` returned.
            modelica_path: Folders of further libraries.

        Raises:
            ModelicaError: There is no such file.
            InputError: A folder of libraries holds none; see `fmus.sources.check_libraries`.
            UnsupportedModelError: A system of several FMUs is given, which can only be simulated; a
                foreign FMU that was extended is one.

        Example:
            >>> Model.of("Twinproof.Plants.Pendulum").variables
            {'tau': 'N.m', 'theta': 'rad', 'omega': 'rad/s'}
        """
        if isinstance(word, ExtendedModel):
            if word.base.fmu is not None:
                raise UnsupportedModelError(
                    "a foreign FMU with effects around it is a system, not a model",
                    where=word.name,
                    remedy="write it as SSP with `twinproof improve -o DIR`",
                )
            return cls(word.name, modelica=word.source)
        if word.endswith(".ssp"):
            raise UnsupportedModelError(
                "a system of FMUs can only be simulated",
                where=word,
                remedy="give one model: an FMU, or Modelica source as file.mo:Class.Name",
            )
        if word.endswith(".fmu"):
            return cls(word, fmu=Path(word), roots=check_libraries(modelica_path))
        return cls(word, find_source(word, check_libraries(modelica_path)))

    @property
    def source(self) -> ModelicaSource:
        """Its Modelica source.

        Raises:
            UnsupportedModelError: It is an FMU.
        """
        if self.modelica is None:
            raise UnsupportedModelError(
                "this needs the model's equations, which an FMU does not carry",
                where=self.word,
                remedy="give the Modelica source, as file.mo:Class.Name",
            )
        return self.modelica

    @property
    def extensible(self) -> ModelicaSource:
        """What effects are added to: its Modelica source, or the text around the FMU.

        Raises:
            FmuError: The FMU cannot be read.
            UnsupportedModelError: Its inputs or outputs have names that Modelica does not allow.
        """
        return self.source if self.fmu is None else around(self.fmu, self.roots)

    @cached_property
    def dae(self) -> Dae:
        """The flat model; of an FMU, its variables without equations.

        Raises:
            ModelicaError: The source is wrong; the message names file:line:column.
            FmuError: The FMU cannot be read.
        """
        return black_box(self.fmu) if self.fmu is not None else load(self.source)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Where effects can act."""
        return places(self.modelica or self.dae)

    @property
    def variables(self) -> Mapping[str, str]:
        """Units of inputs and outputs by name: what a recording is matched with."""
        return {v.name: v.unit for v in (*self.dae.inputs, *self.dae.outputs)}

    def _repr_html_(self) -> str:
        """Return inputs, outputs, parameters and places as a table."""
        parameters = self.dae.with_role(Role.PARAMETER)
        rows = [
            *(("input", v.name, v.unit, v.description) for v in self.dae.inputs),
            *(("output", v.name, v.unit, v.description) for v in self.dae.outputs),
            *(("parameter", v.name, v.unit, v.description) for v in parameters),
            *(
                ("place", p.name, p.unit, p.description)
                for p in self.places
                if p.kind not in ("input", "output")
            ),
        ]
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
        )
        return (
            f"<p><strong>{escape(self.word)}</strong></p><table><thead><tr><th>Kind</th>"
            f"<th>Name</th><th>Unit</th><th>What</th></tr></thead><tbody>{body}</tbody></table>"
        )
