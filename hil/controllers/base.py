"""What a controller is.

A new one is a dataclass that subclasses `Controller` and implements `start` and `step`; its fields
are its keys in TOML. Register it in `hil/controllers/__init__.py`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from foundation.errors import InputError
from hil.settings import unit

Transfer: TypeAlias = npt.NDArray[np.complex128]


@dataclass(kw_only=True)
class Controller(ABC):
    """From what is measured to what is commanded, once a period.

    Attributes:
        measured: Outputs of the plant that it reads, in the order in which `step` gets them.
        commanded: Inputs of the plant that it sets, in the order in which `step` returns them.
        period: Between two steps [s].
        limit: Commands are kept between minus this and this, in their unit; None: not.

    Raises:
        InputError: The period or the limit is not positive.
    """

    kind: ClassVar[str]

    measured: tuple[str, ...]
    commanded: tuple[str, ...]
    period: float = unit("s")
    limit: float | None = None

    def __post_init__(self) -> None:
        if not self.period > 0 or (self.limit is not None and not self.limit > 0):
            raise InputError(
                f"period {self.period:g} s, limit {self.limit}",
                where="controller",
                remedy="both must be positive",
            )

    @abstractmethod
    def start(self) -> None:
        """Forget everything: the next step is the first."""

    @abstractmethod
    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> Sequence[float]:
        """Return the commands until the next step.

        Args:
            time: [s].
            y: Of `measured`, in the model's units.
            r: What they should be.

        Returns:
            Of `commanded`.
        """

    def transfer(self, z: Transfer) -> Transfer | None:
        """Return the matrices K(z) of u = K y near the reference.

        Args:
            z: Shape (n,).

        Returns:
            Shape (n, commanded, measured).

            None where the controller is not linear, or its linear part is not known: then there
            are no robustness margins.
        """
        del z
        return None

    @property
    def mode(self) -> str:
        """What it is doing, for a controller that switches; empty for others."""
        return ""

    def limited(self, u: float) -> float:
        """Return a command within the limit."""
        limit = self.limit
        if limit is None or -limit <= u <= limit:
            return u
        return limit if u > limit else -limit
