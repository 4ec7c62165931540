"""A plant that is stepped: named inputs, outputs and parameters, with their units."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from fmpy.fmi2 import fmi2FMUstate
from fmpy.fmi3 import fmi3FMUState
from fmpy.simulation import apply_start_values

from fmus.archive import FmuVariableInfo
from fmus.co_simulation import communication_points, initialise, sampled
from fmus.running import Fmu, Hold, Inputs, Simulation, checked_inputs, time_grid
from fmus.stepping import Loop, UnitOf
from foundation.closing import Closing
from foundation.errors import FmuError, InputError, UnknownNameError
from foundation.units import factor_and_offset

Array: TypeAlias = npt.NDArray[np.float64]
Value: TypeAlias = float | tuple[float, str]
"""A number in the variable's own unit, or a number and its unit."""


class SavedState:
    """A plant's state to rewind to; belongs to the plant that saved it."""

    def __init__(self, time: float, handle: Any, inputs: Array) -> None:
        self.time = time
        self.handle = handle
        self.inputs = inputs


class Plant(Closing):
    """A Co-Simulation FMU, initialised and ready to be stepped. Use it in a `with` statement.

    It runs in this process; `fmus.guarded.open_plant` keeps a foreign one in a child process.

    Args:
        path: The FMU.
        parameters: Values to set before the start: parameters, start values.
        outputs: Variables that are read; default: those declared output.
        start: Time [s].
        tolerance: Relative, for the FMU's integrator.
        sha256: Of the file, if only that very file is to be used.
        with_states: Read the continuous states that the FMU lists, too.

    Raises:
        UnknownNameError: A parameter or an output that the FMU does not have.
        UnitError: A unit that does not fit.
        FmuError: The FMU does not load or refuses, or offers no Co-Simulation.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> fmu = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
        >>> with Plant(fmu, parameters={"theta_start": (90.0, "deg")}) as plant:
        ...     plant.set({"tau": 0.1})
        ...     before = plant.read()
        ...     plant.step(0.1)
        >>> round(before["theta"], 6)
        1.570796
    """

    def __init__(
        self,
        path: Path,
        *,
        parameters: Mapping[str, Value] | None = None,
        outputs: Sequence[str] | None = None,
        start: float = 0.0,
        tolerance: float | None = None,
        sha256: str | None = None,
        with_states: bool = False,
    ) -> None:
        self.path = path
        self._with_states = with_states
        self._fmu = Fmu(path, sha256=sha256)
        try:
            self._open(parameters or {}, outputs, start, tolerance)
        except BaseException:
            self._fmu.close()
            raise

    def _open(
        self,
        parameters: Mapping[str, Value],
        outputs: Sequence[str] | None,
        start: float,
        tolerance: float | None,
    ) -> None:
        description = self._fmu.description
        if "CoSimulation" not in description.kinds:
            raise FmuError(
                "the FMU does not offer CoSimulation",
                where=str(self.path),
                remedy="export it for Co-Simulation, or run it whole with `simulate`",
            )
        self.inputs: Mapping[str, FmuVariableInfo] = {v.name: v for v in description.inputs}
        self.parameters: Mapping[str, FmuVariableInfo] = {v.name: v for v in description.parameters}
        declared = {v.name: v for v in description.outputs}
        names = list(declared) if outputs is None else list(outputs)
        if self._with_states:
            names += [name for name in description.states if name not in names]
        for name in names:
            if name not in description.names:
                raise UnknownNameError("variable", name, description.names, where=str(self.path))
        known = {**self.inputs, **self.parameters, **declared}
        unknown_unit = FmuVariableInfo("", "", "", None, None, None, None)
        self.outputs: Mapping[str, FmuVariableInfo] = {n: known.get(n, unknown_unit) for n in names}
        self._settable = {**known}
        self._tolerance = tolerance
        self._variables = {v.name: v for v in self._fmu.model_description.modelVariables}
        instance, self._messages = self._fmu.instantiate("CoSimulation")
        self._instance: Any = instance
        self._loop = self._new_loop()
        self._start(parameters, start)

    def unit(self, name: str) -> UnitOf:
        """Return this plant as a part of a loop, called `name` in messages."""
        md = self._fmu.model_description
        return UnitOf(self._instance, md, list(self.inputs), list(self.outputs), name)

    def ticker(self, length: float, inputs: Array, outputs: Array) -> Callable[[int], None]:
        """Return what steps along tables from where the plant is, one call a step.

        Args:
            length: Of a step [s].
            inputs: Shape (n, inputs), in the variables' units; row k is held over step k, and may
                be filled just before.
            outputs: Shape (n + 1, outputs); row 0 is filled now, row k + 1 at the end of step k.

        Raises:
            FmuError: The FMU refuses.
        """
        self._held[:] = inputs[0]
        self._try(lambda: self._loop.settle(self._held))
        outputs[0] = self._loop.y
        return self._loop.ticker(self.time, length, inputs, outputs)

    def feedthrough(self) -> Mapping[str, frozenset[str]]:
        """Return for each output the inputs that act on it at once, as the FMU declares.

        An FMU that does not say may have any.
        """
        unknowns = getattr(self._fmu.model_description, "outputs", None) or []
        declared: dict[str, frozenset[str]] = {}
        for unknown in unknowns:
            if unknown.dependencies is not None:
                names = {str(v.name) for v in unknown.dependencies}
                declared[str(unknown.variable.name)] = frozenset(names & set(self.inputs))
        return {name: declared.get(name, frozenset(self.inputs)) for name in self.outputs}

    def declares(self, name: str) -> bool:
        """Whether a variable is declared output."""
        return str(self._variables[name].causality) == "output"

    @property
    def saves_state(self) -> bool:
        """Whether its state can be saved."""
        return self._fmu.description.saves_state

    def free_handle(self, handle: int | None) -> None:
        """Free a state that a loop has saved."""
        if handle:
            kind = fmi3FMUState if self._fmu.description.fmi.startswith("3") else fmi2FMUstate
            self._instance.freeFMUState(kind(handle))

    def partial(self, output: str, given: str) -> float | None:
        """Return ∂output/∂input where the plant is, or None if the FMU does not provide it."""
        if not self._fmu.description.directional_derivatives:
            return None
        unknown, known = (self._variables[n].valueReference for n in (output, given))
        values: list[float] = []
        self._try(lambda: values.extend(self._derivative([unknown], [known])))
        return values[0]

    def _new_loop(self) -> Loop:
        unit = self.unit(str(self.path))
        return Loop([unit], [-1 - column for column in range(len(self.inputs))])

    def close(self) -> None:
        """Free the instance and what was extracted."""
        if self._instance is not None:
            self._instance.freeInstance()
            self._instance = None
        self._fmu.close()

    @property
    def name(self) -> str:
        """Of the model."""
        return self._fmu.description.name

    def set(self, values: Mapping[str, Value]) -> None:
        """Set inputs and tunable parameters, from now on.

        Raises:
            UnknownNameError, UnitError: A name or a unit is wrong.
            FmuError: The FMU refuses.
        """
        numbers = self._numbers(values)
        places = {name: place for place, name in enumerate(self.inputs)}
        rest = {name: value for name, value in numbers.items() if name not in places}
        for name, value in numbers.items():
            if name in places:
                self._held[places[name]] = value
        md = self._fmu.model_description

        def tune() -> None:
            apply_start_values(self._instance, md, rest)

        if rest:
            self._try(tune)

    def held(self, name: str) -> float:
        """Return the value that an input is held at."""
        return float(self._held[list(self.inputs).index(name)])

    def is_real(self, name: str) -> bool:
        """Whether a variable is a real number rather than an integer, a Boolean, a choice."""
        return str(self._variables[name].type) in ("Real", "Float64", "Float32")

    def read(self) -> dict[str, float]:
        """Return the outputs as they are now, with the inputs as they are set.

        Raises:
            FmuError: The FMU refuses.
        """
        self._try(lambda: self._loop.settle(self._held))
        return dict(zip(self.outputs, self._loop.y.tolist(), strict=True))

    def step(self, length: float) -> None:
        """Advance by `length` [s].

        Raises:
            FmuError: The FMU refuses.
        """
        if not length > 0:
            raise InputError(f"a step of {length:g} s", remedy="step forward in time")
        self._try(lambda: self._loop.settle(self._held))
        self._try(lambda: self._loop.advance(self.time, length, "jacobi", 1))
        self.time += length

    def run(
        self,
        inputs: Inputs | None = None,
        *,
        stop: float | None = None,
        step: float | None = None,
        units: Mapping[str, str] | None = None,
        hold: Hold = "zero-order",
    ) -> Simulation:
        """Step along whole trajectories of the inputs, in compiled code, from where the plant is.

        Values at a time are those after the inputs of that time have been set. Inputs that are not
        driven keep their value.

        Args:
            inputs: Time (n,) [s], the first the plant's own, and a column (n,) for each input.
            stop: Last time [s]; default: that of the inputs.
            step: Of the result [s]; default: the inputs' own times.
            units: Of the columns, where they are not the variables' own.
            hold: `zero-order`, or `linear` between the values.

        Raises:
            UnknownNameError, UnitError, InputError: The inputs are wrong.
            FmuError: The FMU fails while it runs.
        """
        if inputs is not None and inputs[1]:
            factors = self._conversions(units or {})
            inputs = (
                inputs[0],
                {
                    name: np.asarray(column, float) * factors.get(name, (1.0, 0.0))[0]
                    + factors.get(name, (1.0, 0.0))[1]
                    for name, column in inputs[1].items()
                },
            )
        signals = checked_inputs(inputs, list(self.inputs), self.path)
        grid = time_grid(signals, self.time, stop, step)
        result = self._run(signals, grid, hold)
        self.time = float(grid[-1])
        return Simulation(grid, dict(zip(self.outputs, result.T, strict=True)))

    def _run(self, signals: Inputs | None, grid: Array, hold: Hold) -> Array:
        table, points, recorded = input_table(signals, grid, hold, list(self.inputs), self._held)
        result: list[Array] = []
        self._try(
            lambda: result.append(
                self._loop.run(points, table, range(len(self.outputs)), recorded=recorded)
            )
        )
        if self.inputs:
            self._held[:] = table[-1]
        return result[0]

    def reset(
        self, parameters: Mapping[str, Value] | None = None, *, start: float | None = None
    ) -> None:
        """Start anew, with further parameters than those of the FMU.

        Raises:
            UnknownNameError, UnitError: A name or a unit is wrong.
            FmuError: The FMU refuses.
        """
        self._try(self._instance.reset)
        self._loop.forget()
        self._start(parameters or {}, self._began if start is None else start)

    def _start(self, parameters: Mapping[str, Value], start: float) -> None:
        numbers = self._numbers(parameters, may_be_any=True)
        self._held = np.array([_start_value(self._variables[name]) for name in self.inputs])
        for place, name in enumerate(self.inputs):
            self._held[place] = numbers.pop(name, self._held[place])
        self._try(
            lambda: initialise(
                self._instance,
                self._fmu.model_description,
                numbers,
                start=start,
                stop=None,
                tolerance=self._tolerance,
                inputs=dict(zip(self.inputs, self._held.tolist(), strict=True)),
            )
        )
        self.time = self._began = start

    def rerun(
        self, parameters: Mapping[str, Value], signals: Inputs | None, grid: Array, hold: Hold
    ) -> Array:
        """Reset, and run over a grid of times; return the outputs, shape (n, outputs).

        `signals` have been through `checked_inputs`. Errors as `reset` and `run`.
        """
        values = dict(parameters)
        if signals is not None:
            values |= {name: float(column[0]) for name, column in signals[1].items()}
        self.reset(values, start=float(grid[0]))
        result = self._run(signals, grid, hold)
        self.time = float(grid[-1])
        return result

    def save(self) -> SavedState:
        """Return the state as it is now, to be given to `rewind`; free it with `forget`.

        Raises:
            FmuError: The FMU cannot save its state.
        """
        self._needs(self._fmu.description.saves_state, "cannot save its state")
        handles: list[Any] = []
        self._try(lambda: handles.append(self._instance.getFMUState()))
        return SavedState(self.time, handles[0], self._held.copy())

    def rewind(self, state: SavedState) -> None:
        """Go back to a saved state; it can be used again.

        Raises:
            FmuError: The FMU refuses.
        """
        self._try(lambda: self._instance.setFMUState(state.handle))
        self.time = state.time
        self._held[:] = state.inputs

    def forget(self, state: SavedState) -> None:
        """Free a saved state."""
        self._try(lambda: self._instance.freeFMUState(state.handle))

    def derivatives(self, of: Sequence[str], by: Sequence[str]) -> Array:
        """Return ∂of/∂by at the present point, shape (of, by), in the variables' units.

        Raises:
            UnknownNameError: A name that the FMU does not have.
            FmuError: The FMU does not provide derivatives, or not these.
        """
        self._needs(
            self._fmu.description.directional_derivatives, "provides no directional derivatives"
        )
        for name in (*of, *by):
            if name not in self._variables:
                raise UnknownNameError("variable", name, self._variables, where=str(self.path))
        self._try(lambda: self._loop.settle(self._held))
        unknowns = [self._variables[name].valueReference for name in of]
        columns: list[Sequence[float]] = []
        for name in by:
            known = [self._variables[name].valueReference]
            self._try(lambda known=known: columns.append(self._derivative(unknowns, known)))
        return np.array(columns, float).reshape(len(by), len(of)).T

    def _derivative(self, unknowns: list[int], known: list[int]) -> list[float]:
        if not self._fmu.description.fmi.startswith("3"):
            return list(self._instance.getDirectionalDerivative(unknowns, known, [1.0]))
        return list(
            self._instance.getDirectionalDerivative(
                unknowns=unknowns, knowns=known, seed=[1.0], nSensitivity=len(unknowns)
            )
        )

    def _numbers(
        self, values: Mapping[str, Value], *, may_be_any: bool = False
    ) -> dict[str, float]:
        numbers: dict[str, float] = {}
        for name, value in values.items():
            if name not in self._variables or (not may_be_any and name not in self._settable):
                raise UnknownNameError("variable", name, self._settable, where=str(self.path))
            if isinstance(value, tuple):
                number, unit = value
                info = self._settable.get(name)
                factor, offset = factor_and_offset(unit, info.unit if info else "", where=name)
                numbers[name] = factor * number + offset
            else:
                numbers[name] = float(value)
            if not np.isfinite(numbers[name]):
                raise InputError("the value is not finite", where=name)
        return numbers

    def _conversions(self, units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
        for name in units:
            if name not in self.inputs:
                raise UnknownNameError("input", name, self.inputs, where=str(self.path))
        return {
            name: factor_and_offset(unit, self.inputs[name].unit, where=name)
            for name, unit in units.items()
        }

    def _needs(self, ability: bool, lack: str) -> None:
        if not ability:
            raise FmuError(
                f"the FMU {lack}",
                where=str(self.path),
                remedy="export it with that ability, or do without",
            )

    def _try(self, action: Callable[[], object]) -> None:
        try:
            action()
        except InputError as error:
            if not isinstance(error, FmuError):
                raise
            raise self._failure(error) from error
        except Exception as error:  # FMPy's are of its own kinds
            raise self._failure(error) from error

    def _failure(self, error: Exception) -> FmuError:
        said = self._messages.last
        return FmuError(
            f"{getattr(error, 'what', error)}{f': {said}' if said else ''}",
            where=str(self.path),
            remedy="check inputs, parameters and start values",
        )


def run_many(
    fmu: Path,
    parameters: Mapping[str, Array],
    *,
    inputs: Inputs | None = None,
    start: float | None = None,
    stop: float | None = None,
    step: float | None = None,
    outputs: Sequence[str] | None = None,
    hold: Hold = "zero-order",
    tolerance: float | None = None,
    workers: int | None = None,
) -> tuple[Array, Array]:
    """Run an FMU once for each set of parameters, over all cores; in this process.

    Args:
        fmu: The file.
        parameters: Name → one value a set, shape (sets,), in the variables' units.
        inputs, start, stop, step, outputs, hold, tolerance: As `simulate`; the same for all sets.
        workers: Threads; default: as many as cores.

    Returns:
        Times (n,) [s] and outputs, shape (sets, n, outputs).

    Raises:
        UnknownNameError, InputError: As `simulate`.
        FmuError: The FMU fails; the message names the set.
    """
    columns = {name: np.atleast_1d(np.asarray(c, float)) for name, c in parameters.items()}
    sizes = {column.size for column in columns.values()}
    if len(sizes) != 1:
        raise InputError(
            "the parameters have different numbers of values" if sizes else "no parameters",
            remedy="give every parameter one value for each set",
        )
    count = sizes.pop()
    with Fmu(fmu) as opened:
        description = opened.description
    for name in columns:
        if name not in description.names:
            raise UnknownNameError("variable", name, description.names, where=str(fmu))
    signals = checked_inputs(inputs, [v.name for v in description.inputs], fmu)
    grid = time_grid(signals, start, stop, step)
    names = [v.name for v in description.outputs] if outputs is None else list(outputs)
    result = np.empty((count, grid.size, len(names)))
    todo = iter(range(count))
    lock = threading.Lock()

    def work() -> None:
        with Plant(fmu, outputs=names, start=float(grid[0]), tolerance=tolerance) as plant:
            while True:
                with lock:
                    k = next(todo, None)
                if k is None:
                    return
                values = {name: float(column[k]) for name, column in columns.items()}
                try:
                    result[k] = plant.rerun(values, signals, grid, hold)
                except FmuError as error:
                    raise FmuError(
                        f"set {k} ({_brief(values)}): {error.what}", where=error.where
                    ) from error

    is_single = opened.model_description.coSimulation is not None and bool(
        getattr(opened.model_description.coSimulation, "canBeInstantiatedOnlyOncePerProcess", False)
    )
    threads = 1 if is_single else max(1, min(workers or os.cpu_count() or 1, count))
    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(work) for _ in range(threads)]:
            done.result()
    return grid, result


def input_table(
    signals: Inputs | None, grid: Array, hold: Hold, names: Sequence[str], held: Array
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return all inputs at all communication points, these points, and which are in the grid.

    Args:
        signals: Driven inputs.
        grid: Times of the result (n,) [s].
        hold: `zero-order`, or `linear`: then each value is the mean over its step.
        names: Of all inputs.
        held: Values (inputs,) of those that are not driven.
    """
    points = communication_points(grid, signals)
    recorded = np.ones(points.size, bool)
    if points.size > grid.size:
        recorded[:] = False
        recorded[np.searchsorted(points, grid)] = True
    if signals is not None and list(signals[1]) == list(names):
        return sampled(points, signals, hold, can_interpolate=False)[0], points, recorded
    table = np.tile(held, (points.size, 1))
    if signals is not None:
        driven, _ = sampled(points, signals, hold, can_interpolate=False)
        for column, name in enumerate(signals[1]):
            table[:, names.index(name)] = driven[:, column]
    return np.ascontiguousarray(table), points, recorded


def _start_value(variable: Any) -> float:
    text = str(variable.start or 0.0)
    return float(text == "true") if text in ("true", "false") else float(text)


def _brief(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in list(values.items())[:4])
