"""Communication steps chosen by their error: once whole, once in halves, back where too large.

Two errors are watched: that of outputs and listed states, by the difference of the whole step and
its halves; and that of connected inputs, which are held while their sources move. The second is
what is left where an FMU does not list its states: an error of its velocity shows late in its
position.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_void_p
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from fmus.master.loops import Differentiable, Wiring, arrive
from fmus.stepping import Loop, Method
from foundation.errors import FmuError, InputError

Array: TypeAlias = npt.NDArray[np.float64]

_SAFETY = 0.85
_LARGEST_GROWTH, _SMALLEST = 2.0, 0.2
_SHORTEST = 1e-9  # of a step, relative to the run


class Saving(Differentiable, Protocol):
    """A unit whose state can be saved."""

    @property
    def saves_state(self) -> bool:
        """Whether it can."""
        ...

    def free_handle(self, handle: int | None) -> None:
        """Free a state that the loop has saved."""
        ...


def controlled_run(
    loop: Loop,
    wiring: Wiring,
    plants: Sequence[Saving],
    points: Array,
    table: Array,
    recorded: npt.NDArray[np.bool_],
    shown: Sequence[int],
    *,
    method: Method,
    order: int,
    tolerance: float,
) -> Array:
    """Run with steps such that the error per unit of time keeps the tolerance over the run.

    The two halves are kept; the whole step only estimates. Steps end at all `points`. Arguments as
    `System.simulate`; returns shape (recorded points, shown).

    Raises:
        InputError: An FMU cannot save its state; a tolerance that is not positive.
        FmuError: Steps become too short; an FMU refuses.
    """
    _check(wiring, plants, tolerance)
    span = float(points[-1] - points[0])
    rooms = (c_void_p * len(plants))()
    scale = np.ones(loop.y.size)
    rows: list[Array] = []
    step = span * 1e-3

    def settle(k: int) -> None:
        arrive(loop, wiring, plants, table[k])

    loop.read()
    try:
        for k, begin in enumerate(points.tolist()):
            arrive(loop, wiring, plants, table[k], table[k - 1] if k else None)
            np.maximum(scale, np.abs(loop.y), out=scale)
            if recorded[k]:
                rows.append(loop.y[list(shown)])
            if k + 1 == points.size:
                break
            end, time = float(points[k + 1]), float(begin)
            while end - time > 1e-12 * span:
                length = min(step, end - time)
                if end - time < 1.5 * length:  # no crumbs: two nearly equal steps
                    length = end - time if end - time <= step else 0.5 * (end - time)
                kept = loop.save(rooms)
                loop.advance(time, length, method, order)
                settle(k)
                whole = loop.y.copy()
                loop.restore(rooms, kept)
                for part in (0, 1):
                    loop.advance(time + 0.5 * part * length, 0.5 * length, method, order)
                    settle(k)
                # Of the halves: a p-th order method leaves 1 / (2^p - 1) of the difference.
                error = np.max(np.abs(whole - loop.y) / scale) / (2**order - 1)
                defect = np.max(loop.input_defects() / (1.0 + np.abs(loop.u)), initial=0.0)
                excess = max(float(error) * span / length, float(defect)) / tolerance
                growth = _SAFETY * max(excess, 1e-12) ** (-1 / order)
                if excess <= 1:
                    np.maximum(scale, np.abs(loop.y), out=scale)
                    time += length
                    proposed = length * min(_LARGEST_GROWTH, max(growth, _SMALLEST))
                    # A step cut short by a point says little about how long the next may be.
                    step = max(step, proposed) if length < step and growth >= 1 else proposed
                    continue
                loop.restore(rooms, kept)
                step = length * max(_SMALLEST, min(growth, 0.9))
                if step < _SHORTEST * span:
                    raise FmuError(
                        f"the steps of the co-simulation become too short at time {time:g} s",
                        remedy="loosen the tolerance, or look for a jump in a connected signal",
                    )
    finally:
        for plant, handle in zip(plants, rooms, strict=True):
            plant.free_handle(handle)
    return np.array(rows)


def _check(wiring: Wiring, plants: Sequence[Saving], tolerance: float) -> None:
    if not 0 < tolerance < 1:
        raise InputError(
            f"the tolerance {tolerance:g} is not between 0 and 1", remedy="choose for example 1e-4"
        )
    for name, plant in zip(wiring.names, plants, strict=True):
        if not plant.saves_state:
            raise InputError(
                "error control needs FMUs that can save their state",
                where=name,
                remedy="simulate with fixed steps: leave the tolerance out",
            )
