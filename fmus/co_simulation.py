"""A run of one Co-Simulation FMU along its inputs, for FMI 1, 2 and 3."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from ctypes import c_int, c_size_t, c_uint32, c_void_p
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from fmpy.simulation import (
    apply_start_values,
    settable_in_initialization_mode,
    settable_in_instantiated,
)

from fmus.stepping import Loop, UnitOf
from foundation.errors import FmuError, InputError

Array: TypeAlias = npt.NDArray[np.float64]

_WARNING = 1


class Messages:
    """Collects what FMUs say through their logger."""

    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=1000)

    def add_fmi3(self, _environment: Any, _status: int, _kind: Any, text: bytes) -> None:
        """Take one message of FMI 3; called from C."""
        self.lines.append(text.decode(errors="replace"))

    def add(self, _environment: Any, _name: Any, _status: int, _kind: Any, text: bytes) -> None:
        """Take one message; called from C."""
        self.lines.append(text.decode(errors="replace"))

    @property
    def last(self) -> str:
        """The newest message, or nothing."""
        return self.lines[-1] if self.lines else ""


def initialise(
    instance: Any,
    description: Any,
    values: Mapping[str, float],
    *,
    start: float,
    stop: float | None,
    tolerance: float | None,
    inputs: Mapping[str, float] | None = None,
) -> None:
    """Bring an instance to the end of its initialization.

    Raises:
        InputError: A value cannot be set: it is not a parameter or start value.
    """
    version = str(description.fmiVersion)[0]
    if version == "1":
        rest = apply_start_values(instance, description, {**values, **(inputs or {})})
        _all_set(rest, description)
        instance.initialize(tStart=start, stopTime=stop)
        return
    if version == "2":
        instance.setupExperiment(tolerance=tolerance, startTime=start, stopTime=stop)
    rest = apply_start_values(instance, description, dict(values), settable_in_instantiated)
    if version == "2":
        instance.enterInitializationMode()
    else:
        instance.enterInitializationMode(tolerance=tolerance, startTime=start, stopTime=stop)
    rest = apply_start_values(instance, description, rest, settable_in_initialization_mode)
    _all_set(rest, description)
    apply_start_values(instance, description, dict(inputs or {}))
    instance.exitInitializationMode()


def _all_set(rest: Mapping[str, float], description: Any) -> None:
    if rest:
        name = next(iter(rest))
        raise InputError(
            f"'{name}' cannot be set: it is constant, or computed by the FMU",
            where=str(description.modelName),
            remedy="set what it depends on, such as a start parameter",
        )


def run_co_simulation(
    instance: Any,
    description: Any,
    grid: Array,
    signals: tuple[Array, Mapping[str, Array]] | None,
    values: Mapping[str, float],
    outputs: Sequence[str],
    hold: str,
    tolerance: float | None,
) -> Array:
    """Run one instance over a grid of times.

    Args:
        instance: A fresh Co-Simulation instance of FMPy.
        description: FMPy's model description.
        grid: Times of the result, shape (n,) [s]. Communication also happens at the inputs' times.
        signals: Time and columns of the inputs.
        values: Parameters and start values.
        outputs: Variables to record.
        hold: `zero-order` or `linear`.
        tolerance: For the FMU.

    Returns:
        Shape (n, number of outputs).

    Raises:
        FmuError: A call did not succeed.
        InputError: A value cannot be set.
    """
    points = communication_points(grid, signals)
    rows = np.searchsorted(points, grid)
    is_recorded = np.zeros(points.size, bool)
    is_recorded[rows] = True
    names = list(signals[1]) if signals is not None else []
    held, slopes = sampled(points, signals, hold, _can_interpolate(description))
    first = dict(zip(names, held[0].tolist(), strict=True))
    initialise(
        instance,
        description,
        values,
        start=float(grid[0]),
        stop=float(grid[-1]),
        tolerance=tolerance,
        inputs=first,
    )
    unit = UnitOf(instance, description, names, outputs, str(description.modelName))
    loop = Loop([unit], [-1 - column for column in range(len(names))])
    return loop.run(points, held, range(len(outputs)), slopes=slopes, recorded=is_recorded)


def communication_points(grid: Array, signals: tuple[Array, Mapping[str, Array]] | None) -> Array:
    """Return the times of the result and of the inputs together, shape (m,), rising."""
    if signals is None or np.array_equal(signals[0], grid):
        return grid if signals is None else signals[0]
    time = signals[0]
    inside = time[(time > grid[0]) & (time < grid[-1])]
    # An input's time that differs from a result's by rounding only is the same point.
    after = np.clip(np.searchsorted(grid, inside), 1, grid.size - 1)
    distance = np.minimum(np.abs(grid[after] - inside), np.abs(grid[after - 1] - inside))
    nearby = distance <= 1e-6 * np.min(np.diff(grid))
    return np.sort(np.concatenate([grid, inside[~nearby]]))


def _can_interpolate(description: Any) -> bool:
    is_fmi2 = str(description.fmiVersion).startswith("2")
    return is_fmi2 and bool(description.coSimulation.canInterpolateInputs)


def sampled(
    points: Array,
    signals: tuple[Array, Mapping[str, Array]] | None,
    hold: str,
    can_interpolate: bool,
) -> tuple[Array, Array | None]:
    """Values of the inputs at each point, shape (m, inputs), and their slopes from there on."""
    if signals is None:
        return np.empty((points.size, 0)), None
    time, columns = signals
    table = np.column_stack(list(columns.values()))
    if hold == "zero-order" and points is time:
        return np.ascontiguousarray(table), None
    if hold == "zero-order":
        # A point just before an input's time by rounding already has the new value.
        tiny = 1e-6 * np.min(np.diff(time))
        index = np.searchsorted(time, points + tiny, side="right") - 1
        return np.ascontiguousarray(table[np.clip(index, 0, None)]), None
    values = np.column_stack([np.interp(points, time, column) for column in table.T])
    rise = np.diff(values, axis=0, append=values[-1:])
    if can_interpolate:
        span = np.diff(points, append=points[-1] + 1.0)
        return np.ascontiguousarray(values), np.ascontiguousarray(rise / span[:, None])
    # The mean over a step is second-order accurate where the FMU holds inputs.
    return np.ascontiguousarray(values + rise / 2), None


class Calls:
    """The FMU's functions, called on rows of NumPy arrays.

    Args:
        instance: FMPy's instance.
        description: FMPy's model description.
        inputs: Names of the inputs, in the order of the columns that are set.
        outputs: Names of the variables to get.
    """

    def __init__(
        self, instance: Any, description: Any, inputs: Sequence[str], outputs: Sequence[str]
    ) -> None:
        variables = {v.name: v for v in description.modelVariables}
        others = [name for name in outputs if variables[name].type != "Real"]
        self._others = [(outputs.index(name), variables[name]) for name in others]
        self._instance = instance
        self._component = c_void_p(instance.component)
        self._inputs = _references(variables[name].valueReference for name in inputs)
        self._outputs = _references(
            variables[name].valueReference for name in outputs if name not in others
        )
        self._real_columns = [i for i, name in enumerate(outputs) if name not in others]
        self._buffer = np.empty(len(self._outputs))
        self._set_real = _function(instance, "fmi2SetReal", c_void_p, c_size_t, c_void_p)
        self._get_real = _function(instance, "fmi2GetReal", c_void_p, c_size_t, c_void_p)

    def set_inputs(self, table: Array, k: int) -> None:
        """Set all inputs from row `k` of a table (m, inputs)."""
        n = len(self._inputs)
        address = table.ctypes.data + 8 * n * k
        _succeed(self._set_real(self._component, self._inputs, n, address), "inputs")

    def get_outputs(self, table: Array, row: int) -> None:
        """Put the present outputs into a row of a table (n, outputs)."""
        n, address = len(self._outputs), self._buffer.ctypes.data
        _succeed(self._get_real(self._component, self._outputs, n, address), "outputs")
        table[row, self._real_columns] = self._buffer
        for column, variable in self._others:
            getter = getattr(self._instance, f"get{variable.type}")
            table[row, column] = float(getter([variable.valueReference])[0])


def _references(references: Any) -> ctypes.Array[c_uint32]:
    numbers = [int(r) for r in references]
    return (c_uint32 * len(numbers))(*numbers)


def _function(instance: Any, name: str, *arguments: Any) -> Callable[..., int]:
    return ctypes.CFUNCTYPE(c_int, c_void_p, *arguments)((name, instance.dll))


def _succeed(status: int, what: str) -> None:
    if status > _WARNING:
        raise FmuError(f"the FMU refused: {what}")
