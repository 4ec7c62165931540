"""A plant near an operating point, from its FMU's directional derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from fmus.archive import describe
from fmus.plant import Plant
from foundation.errors import UnsupportedModelError

Matrix: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Linear:
    """x' = A x + B u, y = C x + D u, all deviations from an operating point.

    Attributes:
        A, B, C, D: Shapes (n, n), (n, m), (p, n), (p, m).
        states, inputs, outputs: Names.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def sampled(self, period: float) -> tuple[Matrix, Matrix]:
        """Return A and B of x(k+1) = A x(k) + B u(k) for inputs held over a period [s].

        Example:
            >>> double = Linear(np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]),
            ...     np.eye(2), np.zeros((2, 1)), ("q", "v"), ("u",), ("q", "v"))
            >>> [m.round(6).tolist() for m in double.sampled(0.1)]
            [[[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]]]
        """
        n, m = self.B.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.A, self.B
        step = np.asarray(expm(block * period), float)
        return step[:n, :n], step[:n, n:]

    def in_outputs(self, names: Sequence[str]) -> Linear:
        """Return the model with the named outputs as its states, where they are enough.

        Raises:
            UnsupportedModelError: The outputs do not say how they go on.
        """
        rows = [self.outputs.index(name) for name in names]
        C = self.C[rows]
        # x that leads to y; what is in the kernel of C must not act on y.
        back = np.linalg.pinv(C)
        A = C @ self.A @ back
        hidden = C @ self.A - A @ C
        if np.any(np.abs(hidden) > 1e-7 * (1 + np.abs(self.A).max())) or np.any(self.D[rows]):
            raise UnsupportedModelError(
                f"{', '.join(names)} do not determine how they go on",
                where="controller.measured",
                remedy=f"measure all states: {', '.join(self.states)}",
            )
        return Linear(
            A, C @ self.B, np.eye(len(rows)), self.D[rows], tuple(names), self.inputs, tuple(names)
        )


def linearised(plant: Plant, outputs: Sequence[str] | None = None) -> Linear:
    """Return the linear model where a plant is.

    Raises:
        UnsupportedModelError: The FMU does not list its states and their derivatives.
        FmuError: It provides no directional derivatives.
    """
    described = describe(plant.path)
    states = described.states
    rates = [f"der({name})" for name in states]
    if any(rate not in described.names for rate in rates):
        raise UnsupportedModelError(
            "the FMU does not name the derivatives of its states",
            where=str(plant.path),
            remedy="export it from Modelica with `twinproof export`",
        )
    inputs = list(plant.inputs)
    chosen = list(plant.outputs if outputs is None else outputs)
    n = len(states)
    both = plant.derivatives([*rates, *chosen], [*states, *inputs])
    return Linear(
        both[:n, :n],
        both[:n, n:],
        both[n:, :n],
        both[n:, n:],
        tuple(states),
        tuple(inputs),
        tuple(chosen),
    )


def linear_model(
    fmu: Path,
    *,
    point: dict[str, float] | None = None,
    parameters: dict[str, float] | None = None,
    outputs: Sequence[str] | None = None,
) -> Linear:
    """Return the linear model of an FMU at an operating point.

    Args:
        fmu: The file.
        point: Values of states and inputs; others as the FMU starts.
        parameters: Values of parameters.
        outputs: Default: those declared output.

    Raises:
        UnknownNameError: A name that the FMU does not have.
        UnsupportedModelError, FmuError: As `linearised`.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> fmu = cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"))
        >>> np.sort(np.linalg.eigvals(linear_model(fmu).A).real).round(2).tolist()
        [-18.54, -1.95, 0.0, 2.08]
    """
    names = set(describe(fmu).names)
    values = dict(parameters or {})
    for name, value in (point or {}).items():
        values[f"{name}_start" if f"{name}_start" in names else name] = value
    with Plant(fmu, parameters=values) as plant:
        return linearised(plant, outputs)
