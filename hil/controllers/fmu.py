"""A controller that is an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from fmus.guarded import open_plant
from fmus.running import model_fmu
from foundation.errors import ModelError, UnknownNameError
from hil.bus.dbc import REFERENCE
from hil.controllers.base import Controller, Transfer
from hil.linear import Linear, linearised


@dataclass(kw_only=True)
class FmuController(Controller):
    """A Co-Simulation FMU whose inputs are called as what it measures, outputs as what it commands.

    References go to inputs `<measured>_ref`, where it has them. At each period the inputs are set,
    the commands read, and then the FMU is stepped by a period. It is closed with `close`.

    Attributes:
        model: MODEL: a file, a class of the library, `file.mo:Class`.
        parameters: Of the FMU.

    Raises:
        UnknownNameError: It has no such input or output.
        TwinproofError: As for every MODEL.
    """

    kind: ClassVar[str] = "fmu"

    model: str
    parameters: dict[str, float] = field(default_factory=dict[str, float])

    def __post_init__(self) -> None:
        super().__post_init__()
        self.fmu: Path = model_fmu(self.model)
        self._plant: Any = open_plant(
            self.fmu, parameters=self.parameters, outputs=list(self.commanded)
        )
        for name in self.measured:
            if name not in self._plant.inputs:
                raise UnknownNameError(
                    "input", name, self._plant.inputs, where=f"controller {self.model}"
                )
        self._follows = [f"{name}{REFERENCE}" for name in self.measured]
        self._follows = [n if n in self._plant.inputs else "" for n in self._follows]
        self._linear: Linear | None = None

    def start(self) -> None:
        """Reset the FMU."""
        self._plant.reset(self.parameters)

    def close(self) -> None:
        """Free the FMU."""
        self._plant.close()

    def transfer(self, z: Transfer) -> Transfer | None:
        """K(z) from the FMU's directional derivatives where it starts, its inputs held.

        None for an FMU that does not provide them, or whose law is sampled inside.
        """
        if self._linear is None:
            self.start()
            try:
                self._linear = linearised(self._plant, self.commanded)
            except ModelError:
                return None
        linear = self._linear
        columns = [linear.inputs.index(name) for name in self.measured]
        D = linear.D[:, columns]
        if not linear.states and not np.any(D):
            return None
        A, B = linear.sampled(self.period)
        inner = np.linalg.solve(z[:, np.newaxis, np.newaxis] * np.eye(len(A)) - A, B[:, columns])
        return np.asarray(linear.C @ inner + D, np.complex128)

    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> tuple[float, ...]:
        """Return the commands."""
        values = dict(zip(self.measured, y, strict=True))
        values |= {n: v for n, v in zip(self._follows, r, strict=True) if n}
        self._plant.set(values)
        commands = self._plant.read()
        self._plant.step(self.period)
        return tuple(self.limited(commands[name]) for name in self.commanded)
