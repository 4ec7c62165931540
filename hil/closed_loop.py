"""Plant and controller without a bus, as fast as they go: for studies of thousands of runs.

The timing is that of the loop over the bus: the answer to the sensors of one cycle acts from the
next cycle on, or, if asked for, at once. A law in Python is called once a period, all else is
compiled; a controller FMU runs together with the plant in the compiled master, and Python sees only
the end.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from fmus.plant import Plant
from fmus.stepping import UNCONNECTED
from fmus.stepping import Loop as CompiledLoop
from foundation.errors import InputError
from hil.bus.dbc import REFERENCE
from hil.controllers import Controller, FmuController
from hil.sensors import SensorSettings

Array: TypeAlias = npt.NDArray[np.float64]
_RUNAWAY = 1e9


@dataclass(frozen=True, eq=False)
class Signals:
    """What drives a run, at its cycles.

    Attributes:
        references: Output → (n,).
        disturbances: Input → (n,), added to the commands.
        noise: Output → (n,), added to what is measured.
    """

    references: Mapping[str, Array]
    disturbances: Mapping[str, Array]
    noise: Mapping[str, Array]


class ClosedLoop:
    """A plant that is run again and again with one controller or another. Use it with `with`.

    Args:
        fmu: The plant; it runs in this process.
        sensors: By output; noise comes with each run's `Signals`.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> from hil.controllers import PID
        >>> fmu = cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"))
        >>> pid = PID(measured=("theta_p",), commanded=("V",), period=1e-3,
        ...     proportional=-168.0, integral=-800.0, derivative=-8.8)
        >>> with ClosedLoop(fmu) as loop:
        ...     columns = loop.run(pid, {"theta_p_start": 0.1}, Signals({}, {}, {}), 1e-3, 3000)
        >>> bool(abs(columns["theta_p"][-1]) < 1e-3)
        True
    """

    def __init__(self, fmu: Path, sensors: Mapping[str, SensorSettings] | None = None) -> None:
        self.plant = Plant(fmu)
        self.inputs = list(self.plant.inputs)
        self.outputs = list(self.plant.outputs)
        self.sensors = dict(sensors or {})

    def __enter__(self) -> ClosedLoop:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.plant.close()

    def run(
        self,
        controller: Controller,
        parameters: Mapping[str, float],
        signals: Signals,
        step: float,
        cycles: int,
        *,
        at_once: bool = False,
    ) -> dict[str, Array]:
        """Run from the start; return outputs, inputs as applied, and `command.<input>`.

        A run that leaves all bounds ends there: the columns are shorter.

        Args:
            controller: Any.
            parameters: Of the plant.
            signals: At the cycles.
            step: Of a cycle [s].
            cycles: How many.
            at_once: The answer to a cycle's sensors acts in that very cycle.

        Raises:
            FmuError: The plant or the controller FMU fails.
            InputError: The controller's period is no multiple of the step.
        """
        ratio = controller.period / step
        every = max(1, round(ratio))
        if abs(ratio - every) > 1e-6 * every:
            raise InputError(
                f"a controller every {controller.period:g} s in cycles of {step:g} s",
                where="run.step",
                remedy="choose a step that the controller's period is a multiple of",
            )
        self.plant.reset(parameters)
        controller.start()
        compiled = every == 1 and not at_once
        if compiled and isinstance(controller, FmuController) and _can_compile(controller):
            return self._compiled(controller, parameters, signals, step, cycles)
        collects = gc.isenabled()
        gc.disable()  # a cycle makes tuples and no rings, and collecting takes half the time
        try:
            return self._interpreted(controller, signals, step, cycles, every, at_once)
        finally:
            if collects:
                gc.enable()

    def _interpreted(
        self,
        controller: Controller,
        signals: Signals,
        step: float,
        cycles: int,
        every: int,
        at_once: bool = False,
    ) -> dict[str, Array]:
        m, p = len(self.inputs), len(self.outputs)
        applied, found = np.zeros((cycles + 1, m)), np.zeros((cycles + 1, p))
        for name, column in signals.disturbances.items():
            applied[:cycles, self.inputs.index(name)] = column
        commands = np.zeros((cycles, m))
        tick = self.plant.ticker(step, applied, found)
        # Flat views give and take Python floats: many times faster than arrays, element by element.
        y, u = (
            memoryview(found.data).cast("B").cast("d"),
            memoryview(applied.data).cast("B").cast("d"),
        )
        places = [self.outputs.index(name) for name in controller.measured]
        targets = [self.inputs.index(name) for name in controller.commanded]
        noise = self._noise(controller.measured, signals, cycles)
        grid = [self._sensor(name).resolution for name in controller.measured]
        references = _rows(controller.measured, signals.references, cycles)
        answers: list[Sequence[float]] = [[0.0] * len(targets)]
        answer = answers[0]
        act, fixed = controller.step, any(grid)
        first, done = places[0], cycles
        late = 0 if at_once else 1
        for k in range(cycles):
            tick_from = k * p
            if k % every == 0:
                seen = [y[tick_from + i] + n for i, n in zip(places, noise[k], strict=True)]
                if fixed:
                    seen = [q * round(v / q) if q else v for v, q in zip(seen, grid, strict=True)]
                answer = act(k * step, seen, references[k])
            answers.append(answer)
            if late:
                tick(k)
            base = (k + late) * m
            for j, value in zip(targets, answer, strict=True):
                u[base + j] += value
            if not late:
                tick(k)
            if not -_RUNAWAY < y[tick_from + first] < _RUNAWAY:
                done = k
                break
        commands[:, targets] = _padded(answers[1 - late :], cycles)
        return self._columns(found[:done], applied[:done], commands[:done])

    def _compiled(
        self,
        controller: FmuController,
        parameters: Mapping[str, float],
        signals: Signals,
        step: float,
        cycles: int,
    ) -> dict[str, Array]:
        with contextlib.ExitStack() as stack:
            law = stack.enter_context(
                Plant(
                    controller.fmu,
                    parameters=dict(controller.parameters),
                    outputs=list(controller.commanded),
                )
            )
            del parameters  # the plant has been reset with them
            return self._coupled(law, controller, signals, step, cycles)

    def _coupled(
        self, law: Plant, controller: FmuController, signals: Signals, step: float, cycles: int
    ) -> dict[str, Array]:
        p = len(self.outputs)
        table: list[Array] = []
        sources: list[int] = []
        plus: list[int] = []
        grid: list[float] = []

        def column(values: Array) -> int:
            table.append(np.asarray(values, float))
            return len(table) - 1

        for name in self.inputs:
            given = signals.disturbances.get(name)
            plus.append(-1 if given is None else column(given))
            grid.append(0.0)
            sources.append(
                p + controller.commanded.index(name)
                if name in controller.commanded
                else -1 - column(np.zeros(cycles))
            )
        for name in law.inputs:
            output = name.removesuffix(REFERENCE)
            if name in controller.measured:
                sources.append(self.outputs.index(name))
                sensor = self._sensor(name)
                noise = signals.noise.get(name)
                shift = sensor.bias + (0.0 if noise is None else noise)
                plus.append(column(np.broadcast_to(shift, cycles)))
                grid.append(sensor.resolution)
            elif output != name and output in signals.references:
                sources.append(-1 - column(signals.references[output]))
                plus.append(-1)
                grid.append(0.0)
            else:
                sources.append(UNCONNECTED)
                plus.append(-1)
                grid.append(0.0)
        # Plant first: it takes what the controller answered a cycle ago.
        loop = CompiledLoop(
            [self.plant.unit("plant"), law.unit("controller")],
            sources,
            order=[0, 1],
            plus=plus,
            grid=grid,
            sampled=True,
        )
        external = np.column_stack([*table, np.zeros(cycles)])
        shown = range(p + len(controller.commanded))
        times = self.plant.time + step * np.arange(cycles, dtype=np.float64)
        rows = loop.run(times, external, list(shown))
        commands = np.zeros((cycles, len(self.inputs)))
        for k, name in enumerate(controller.commanded):
            # In force is the answer to the cycle before.
            commands[1:, self.inputs.index(name)] = rows[:-1, p + k]
        applied = commands.copy()
        for name, values in signals.disturbances.items():
            applied[:, self.inputs.index(name)] += values
        return self._columns(rows[:, :p], applied, commands)

    def _sensor(self, name: str) -> SensorSettings:
        return self.sensors.get(name, SensorSettings())

    def _noise(
        self, measured: Sequence[str], signals: Signals, cycles: int
    ) -> list[tuple[float, ...]]:
        table = np.zeros((cycles, len(measured)))
        for k, name in enumerate(measured):
            table[:, k] = self._sensor(name).bias
            if name in signals.noise:
                table[:, k] += signals.noise[name]
        return list(map(tuple, table.tolist()))

    def _columns(self, found: Array, applied: Array, commands: Array) -> dict[str, Array]:
        columns = dict(zip(self.outputs, found.T, strict=True))
        columns |= dict(zip(self.inputs, applied.T, strict=True))
        return columns | {
            f"command.{name}": column for name, column in zip(self.inputs, commands.T, strict=True)
        }


def _can_compile(controller: FmuController) -> bool:
    # What is clipped outside of the FMU cannot be clipped inside the master.
    return controller.limit is None


def _rows(
    measured: Sequence[str], references: Mapping[str, Array], cycles: int
) -> list[tuple[float, ...]]:
    table = np.zeros((cycles, len(measured)))
    for k, name in enumerate(measured):
        if name in references:
            table[:, k] = references[name]
    return list(map(tuple, table.tolist()))


def _padded(answers: list[Sequence[float]], cycles: int) -> Array:
    """Return the commands in force at each cycle, the last one to the end."""
    table = np.array(answers[:cycles], float)
    rest = np.repeat(table[-1:], cycles - len(table), axis=0)
    return np.vstack([table, rest])
