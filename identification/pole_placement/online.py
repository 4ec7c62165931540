"""On-line data-driven pole placement: model and gain from the last samples, at every sample.

A new form subclasses `OnlineUpdate` and implements `_solve(rows)`, which gives A, B and F or raises
`ExcitationError` or `ComputationError`; then the last model and gain stay.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from foundation.errors import ComputationError, ExcitationError, InputError
from identification.pole_placement.base import Rows, Triple, column_scales
from identification.pole_placement.gains import Poles, check_poles, gain
from identification.pole_placement.published import desired_pair, linear_equation, unpack
from identification.pole_placement.samples import Matrix, floats
from identification.pole_placement.two_step import regress

_SPARE = 3


@dataclass(frozen=True, eq=False)
class OnlineModel:
    """What is known after a sample.

    Attributes:
        A: (n, n), None before the first update.
        B: (n, m), None before the first update.
        F: (m, n) for u = F x + v.
        updated: Whether this sample changed it.
        because: Why not, in one sentence; empty if it did.
    """

    A: Matrix | None
    B: Matrix | None
    F: Matrix
    updated: bool = False
    because: str = ""


class OnlineUpdate(ABC):
    """Model and gain from a window of the last samples; memory and time a sample are constant.

    Args:
        poles: Desired poles, one for each state.
        inputs: Number of inputs m.
        window: Steps N that a model is made of.
        F: (m, n) gain until the first update; default 0.

    Raises:
        InputError: Poles or window do not fit.
    """

    form: ClassVar[str]

    def __init__(
        self,
        poles: Sequence[complex],
        inputs: int = 1,
        *,
        window: int,
        F: ArrayLike | None = None,
    ) -> None:
        n = len(poles)
        self._poles: Poles = check_poles(poles, n, inputs)
        if window < n + inputs:
            raise InputError(
                f"a window of {window} steps for {n} states and {inputs} inputs",
                remedy=f"give {n + inputs} or more",
            )
        start = np.zeros((inputs, n)) if F is None else np.asarray(F, np.float64)
        if start.shape != (inputs, n):
            raise InputError(f"F has shape {start.shape}", remedy=f"give shape {(inputs, n)}")
        self._states: deque[Matrix] = deque(maxlen=window + 1)
        self._inputs: deque[Matrix] = deque(maxlen=window)
        self._model = OnlineModel(None, None, start)
        self.window = window

    def update(self, state: ArrayLike, applied: ArrayLike | None = None) -> OnlineModel:
        """Take in the state x(k) and the input u(k-1) that led to it.

        Args:
            state: (n,) measured now.
            applied: (m,) held since the last sample; None at the first sample, and after a gap,
                where the window starts anew.

        Raises:
            InputError: Shapes do not fit, or a number is not finite.
        """
        m, n = self._model.F.shape
        x = np.asarray(state, np.float64)
        u = None if applied is None else np.atleast_1d(np.asarray(applied, np.float64))
        if x.shape != (n,) or (u is not None and u.shape != (m,)):
            raise InputError(
                f"state of shape {x.shape}, input of shape {None if u is None else u.shape}",
                remedy=f"give ({n},) and ({m},)",
            )
        if not np.all(np.isfinite(x)) or (u is not None and not np.all(np.isfinite(u))):
            raise InputError(
                "state or input is not finite", remedy="after a gap, give no applied input"
            )
        if u is None:
            self._states.clear()
            self._inputs.clear()
        elif self._states:
            self._inputs.append(u)
        self._states.append(x)
        self._model = self._updated()
        return self._model

    def _updated(self) -> OnlineModel:
        states = np.array(self._states)
        m = self._model.F.shape[0]
        rows = Rows(states[1:], states[:-1], np.array(self._inputs).reshape(-1, m))
        try:
            A, B, F = self._solve(rows)
        except (ExcitationError, ComputationError, np.linalg.LinAlgError) as error:
            return replace(self._model, updated=False, because=str(error))
        return OnlineModel(A, B, F, True)

    @abstractmethod
    def _solve(self, rows: Rows) -> Triple: ...


class PublishedUpdate(OnlineUpdate):
    """The published Algorithm 1: the square equation 𝒳 η = 𝒰 of the last N = n + m steps.

    Updates if rank 𝒳 = n N, a test that means something only for N = n + m, where 𝒳 is square: a
    taller 𝒳 never has that rank. So no other window is offered. Without noise it stabilises an
    unknown plant; noise it hardly bears (30 seeds of the dissertation's robot: 28 stay up at
    4e-8 rad, 2 at 4e-6).

    Reference: P. E. E. Shwe, dissertation, Kanazawa University, 2017, Ch. 4.

    Example:
        >>> online, x, rng = PublishedUpdate([0.5], 1), 1.0, np.random.default_rng(1)
        >>> model = online.update([x])
        >>> for _ in range(4):
        ...     u = model.F[0] * x + rng.normal(size=1)
        ...     x = 1.2 * x + 0.5 * u[0]
        ...     model = online.update([x], u)
        >>> model.F.round(9).tolist()
        [[-1.4]]
    """

    form: ClassVar[str] = "published"

    def __init__(
        self, poles: Sequence[complex], inputs: int = 1, *, F: ArrayLike | None = None
    ) -> None:
        super().__init__(poles, inputs, window=len(poles) + inputs, F=F)
        self._pair = desired_pair(self._poles, inputs)

    def _solve(self, rows: Rows) -> Triple:
        if len(rows) < self.window:
            raise ExcitationError(f"{len(rows)} of {self.window} steps so far")
        table, right = linear_equation(rows, *self._pair)
        if np.linalg.matrix_rank(table) < table.shape[1]:
            raise ExcitationError("the published equation is singular")
        return unpack(floats(np.linalg.solve(table, right)), *self._pair)


class WindowedUpdate(OnlineUpdate):
    """Two steps on the last N samples: regress, then place the poles.

    Starts when there are a few more steps than unknowns: a model that fits noise exactly gives a
    wild gain, and a plant that falls meanwhile is lost (the dissertation's robot, noise 4e-5 rad:
    the first model from 5, 6, 7, 8 steps keeps 86, 90, 95, 99 % of the runs up). Bears about a
    hundred times the noise of the published form; a longer window bears more, and follows a
    changing plant more slowly.

    Args:
        poles: Desired poles, one for each state.
        inputs: Number of inputs m.
        window: Steps N; default 6 (n + m).
        start: Steps of the first model; default n + m + 3.
        F: (m, n) gain until the first update; default 0.

    Raises:
        InputError: Poles, window or start do not fit.

    Example:
        >>> online, x, rng = WindowedUpdate([0.5], 1), 1.0, np.random.default_rng(1)
        >>> model = online.update([x])
        >>> for _ in range(9):
        ...     u = model.F[0] * x + rng.normal(size=1)
        ...     x = 1.2 * x + 0.5 * u[0]
        ...     model = online.update([x], u)
        >>> model.F.round(9).tolist()
        [[-1.4]]
    """

    form: ClassVar[str] = "two-step"

    def __init__(
        self,
        poles: Sequence[complex],
        inputs: int = 1,
        *,
        window: int | None = None,
        start: int | None = None,
        F: ArrayLike | None = None,
    ) -> None:
        size = len(poles) + inputs
        steps = 6 * size if window is None else window
        super().__init__(poles, inputs, window=steps, F=F)
        self.start = min(size + _SPARE, steps) if start is None else start
        if not size <= self.start <= steps:
            raise InputError(
                f"a start after {self.start} steps with a window of {steps}",
                remedy=f"give {size} … {steps}",
            )

    def _solve(self, rows: Rows) -> Triple:
        size = self._poles.size + rows.inputs.shape[1]
        if len(rows) < self.start:
            raise ExcitationError(f"{len(rows)} of {self.start} steps so far")
        scaled = rows.regressors / column_scales(rows.regressors)
        # As `matrix_rank`: what arithmetic cannot tell from zero is zero.
        if np.linalg.matrix_rank(scaled) < size:
            raise ExcitationError("states and inputs of the window depend on one another")
        A, B = regress(rows)
        return A, B, gain(A, B, self._poles)


ONLINE: dict[str, type[PublishedUpdate] | type[WindowedUpdate]] = {
    PublishedUpdate.form: PublishedUpdate,
    WindowedUpdate.form: WindowedUpdate,
}
"""Every on-line form by its word."""
