"""A model as users name it: Modelica source or FMU, with its variables and places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from fmus.dae import Dae
from fmus.frontend import load
from fmus.places import Place, places
from fmus.sources import ModelicaSource, find_source
from foundation.errors import UnsupportedModelError


@dataclass(frozen=True)
class Model:
    """A model given by Modelica source.

    Attributes:
        word: As the user named it.
        source: Its Modelica source.

    Example:
        >>> model = Model.of("Twinproof.Plants.Positioner")
        >>> [place.name for place in model.places]
        ['carriage', 'vir', 'q', 'v']
    """

    word: str
    source: ModelicaSource

    @classmethod
    def of(cls, word: str, modelica_path: Sequence[Path] = ()) -> Model:
        """Find a model.

        Args:
            word: `file.mo:Class.Name` or a class of a library, as `Twinproof.Plants.Positioner`.
            modelica_path: Folders of further libraries.

        Raises:
            ModelicaError: There is no such file.
            UnsupportedModelError: An FMU is given where Modelica source is needed.
        """
        if word.endswith((".fmu", ".ssp")):
            raise UnsupportedModelError(
                "this needs the model's equations, which an FMU does not carry",
                where=word,
                remedy="give the Modelica source, as file.mo:Class.Name",
            )
        return cls(word, find_source(word, tuple(modelica_path)))

    @cached_property
    def dae(self) -> Dae:
        """The flat model.

        Raises:
            ModelicaError: The source is wrong; the message names file:line:column.
        """
        return load(self.source)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Where effects can act."""
        return places(self.source)

    @property
    def variables(self) -> Mapping[str, str]:
        """Units of inputs and outputs by name: what a recording is matched with."""
        return {v.name: v.unit for v in (*self.dae.inputs, *self.dae.outputs)}
