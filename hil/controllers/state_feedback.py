"""State feedback with a gain that is given, placed, or optimal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.linalg import solve_discrete_are

from foundation.errors import ComputationError, InputError
from hil.controllers.base import Controller, Transfer
from hil.linear import Linear, Matrix
from identification.pole_placement.gains import check_poles, gain


@dataclass(kw_only=True)
class StateFeedback(Controller):
    """u = F (x − r); F is given, or made for a linear model by `design`.

    The sign is that of data-driven pole placement, u = F x + v.

    Attributes:
        gain: F, one row a command; empty until designed.
        poles: Desired poles z of the sampled loop, as text such as `0.9+0.05j`.
        Q: Weights of the states, the diagonal of the LQ problem's Q.
        R: Weights of the commands.
        balance: Value of the commands at the operating point, added to them.

    Raises:
        InputError: Not exactly one of `gain`, `poles` and `Q` with `R`; or shapes that do not fit.

    Example:
        >>> feedback = StateFeedback(
        ...     measured=("q", "v"), commanded=("u",), period=0.1, gain=((-1.0, -2.0),)
        ... )
        >>> feedback.step(0.0, [0.5, 0.0], [0.0, 0.0])
        (-0.5,)
    """

    kind: ClassVar[str] = "state-feedback"

    gain: tuple[tuple[float, ...], ...] = ()
    poles: tuple[str, ...] = ()
    Q: tuple[float, ...] = ()
    R: tuple[float, ...] = ()
    balance: tuple[float, ...] = ()
    _rows: list[tuple[float, ...]] = field(init=False, repr=False, default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        if sum(map(bool, (self.gain, self.poles, self.Q))) != 1 or bool(self.Q) != bool(self.R):
            raise InputError(
                "the gain is not determined",
                where="controller",
                remedy="give one of: gain; poles; Q and R",
            )
        n, m = len(self.measured), len(self.commanded)
        if self.gain and (len(self.gain) != m or any(len(row) != n for row in self.gain)):
            raise InputError(
                f"the gain does not fit {n} measured and {m} commanded variables",
                where="controller.gain",
                remedy=f"give {m} rows of {n} numbers",
            )
        if (self.Q and (len(self.Q), len(self.R)) != (n, m)) or (
            self.balance and len(self.balance) != m
        ):
            raise InputError(
                "the weights or the balance do not fit the variables",
                where="controller",
                remedy=f"give {n} of Q, {m} of R and of balance",
            )
        if self.gain:
            self._use(np.array(self.gain))

    def design(self, linear: Linear) -> None:
        """Make the gain for a linear model, if it is not given.

        Args:
            linear: With the measured variables among its outputs.

        Raises:
            InputError: The poles cannot be placed.
            ComputationError: There is no gain: the plant cannot be stabilised by these commands.
        """
        if self.gain:
            return
        model = linear.in_outputs(self.measured)
        columns = [model.inputs.index(name) for name in self.commanded]
        A, all_inputs = model.sampled(self.period)
        B = all_inputs[:, columns]
        if self.poles:
            wanted = check_poles([_pole(p) for p in self.poles], len(A), B.shape[1], self.period)
            self._use(gain(A, B, wanted))
        else:
            self._use(optimal_gain(A, B, np.diag(self.Q), np.diag(self.R)))

    def _use(self, F: Matrix) -> None:
        self._rows = [tuple(row) for row in F.tolist()]

    @property
    def F(self) -> Matrix:  # noqa: N802 - the field's letter for it
        """The gain in use, shape (commanded, measured)."""
        return np.array(self._rows)

    def start(self) -> None:
        """There is nothing to forget."""

    def step(self, time: float, y: Sequence[float], r: Sequence[float]) -> tuple[float, ...]:
        """Return the commands."""
        away = [a - b for a, b in zip(y, r, strict=True)]
        wanted = [sum([f * e for f, e in zip(row, away, strict=True)]) for row in self._rows]
        if self.balance:
            wanted = [u + u0 for u, u0 in zip(wanted, self.balance, strict=True)]
        return tuple([self.limited(u) for u in wanted])

    def transfer(self, z: Transfer) -> Transfer:
        """F, at all frequencies."""
        return np.broadcast_to(self.F.astype(np.complex128), (z.size, *self.F.shape))


def optimal_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Return F of u = F x that minimises the sum of x'Qx + u'Ru (discrete LQ).

    Raises:
        ComputationError: The Riccati equation has no stabilising solution.

    Example:
        >>> optimal_gain(np.eye(1), np.eye(1), np.eye(1), np.eye(1)).round(4).tolist()
        [[-0.618]]
    """
    try:
        P = solve_discrete_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ComputationError(
            f"the LQ problem has no solution: {error}",
            where="controller.Q",
            remedy="give every state that must stay a positive weight, and R > 0",
        ) from error
    return np.asarray(-np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), float)


def _pole(text: str) -> complex:
    try:
        return complex(text.replace(" ", "").replace("i", "j"))
    except ValueError:
        raise InputError(
            f"'{text}' is no pole", where="controller.poles", remedy="write for example 0.9+0.05j"
        ) from None
