"""Run an FMU, ours or anybody's, or a Modelica model by way of its FMU."""

from __future__ import annotations

import ctypes
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import fmpy
import fmpy.simulation
import numpy as np
import numpy.typing as npt

from fmus.archive import (
    FmuDescription,
    check_archive,
    describe,
    description_of,
    extract,
    read_description,
)
from fmus.co_simulation import Messages, run_co_simulation
from fmus.dae import Dae
from fmus.guarded import is_ours, simulate_guarded
from fmus.model_exchange import run_model_exchange
from fmus.package import cached_fmu
from fmus.sources import ModelicaSource, find_source
from fmus.stepping import can_step
from foundation.closing import Closing
from foundation.errors import FmuError, InputError, UnknownNameError

Array: TypeAlias = npt.NDArray[np.float64]
Kind: TypeAlias = Literal["CoSimulation", "ModelExchange"]
Hold: TypeAlias = Literal["zero-order", "linear"]
Inputs: TypeAlias = tuple[Array, Mapping[str, Array]]


_TOLERANCE = 1e-10
"""Of CVODE, if none is asked for: its error over a run is hundreds of times that of a step."""


_LOADING = threading.Lock()
"""FMPy changes the working directory while it loads a binary."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What came out of a run.

    Attributes:
        time: Shape (n,) [s].
        columns: Name → shape (n,), in the variable's unit.
    """

    time: Array
    columns: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]


class Fmu(Closing):
    """An FMU extracted once, to be run many times. Use it in a `with` statement.

    Its binary runs in this process: a foreign FMU can take it down. `simulate` and `open_plant`
    keep foreign ones in a child process.

    Args:
        path: The file.
        sha256: Of the file, if only that very file is to be used.

    Raises:
        FmuError: It cannot be read or extracted, or has no binary for this platform.

    Example:
        >>> from fmus.sources import library_class
        >>> with Fmu(cached_fmu(library_class("Twinproof.Plants.Pendulum"))) as fmu:
        ...     run = fmu.simulate(parameters={"theta_start": 0.1}, stop=1.0, step=0.5)
        >>> run.time
        array([0. , 0.5, 1. ])
    """

    def __init__(self, path: Path, *, sha256: str | None = None) -> None:
        self.path = path
        check_archive(path, sha256=sha256)
        self.model_description = read_description(path)
        self.description: FmuDescription = description_of(self.model_description, where=str(path))
        self._folder = tempfile.TemporaryDirectory(prefix="twinproof-")
        try:
            extract(path, Path(self._folder.name), sha256=sha256)
            platforms = fmpy.supported_platforms(self._folder.name)
            if fmpy.platform not in platforms and fmpy.platform_tuple not in platforms:
                raise FmuError(
                    f"the FMU has no binary for {fmpy.platform}",
                    where=str(path),
                    remedy=f"it has {', '.join(platforms) or 'none'}: export it for this platform",
                )
        except BaseException:
            self._folder.cleanup()
            raise

    def close(self) -> None:
        """Remove what was extracted."""
        self._folder.cleanup()

    def instantiate(self, kind: Kind = "CoSimulation") -> tuple[Any, Messages]:
        """Return a new instance of FMPy's class for it, and where its messages are collected.

        Raises:
            FmuError: The binary does not load, or refuses.
        """
        messages = Messages()
        logger = messages.add_fmi3 if self.description.fmi.startswith("3") else messages.add
        try:
            with _LOADING:
                instance = fmpy.simulation.instantiate_fmu(
                    self._folder.name, self.model_description, kind, logger=logger
                )
        except Exception as error:  # FMPy raises bare exceptions
            raise FmuError(
                f"the FMU does not load: {messages.last or error}",
                where=str(self.path),
                remedy="check it with `twinproof check`",
            ) from error
        if self.description.fmi == "1.0" and kind == "CoSimulation":
            # FMPy declares that it returns a string, and crashes on a status other than zero.
            vars(instance)["_functions"]["fmi1InitializeSlave"].restype = ctypes.c_int
        return instance, messages

    def simulate(
        self,
        *,
        inputs: Inputs | None = None,
        parameters: Mapping[str, float] | None = None,
        start: float | None = None,
        stop: float | None = None,
        step: float | None = None,
        outputs: Sequence[str] | None = None,
        kind: Kind | None = None,
        hold: Hold = "zero-order",
        tolerance: float | None = None,
    ) -> Simulation:
        """Run the FMU once. See `simulate`."""
        kind = kind or ("CoSimulation" if self.model_description.coSimulation else "ModelExchange")
        if kind not in self.description.kinds:
            raise FmuError(
                f"the FMU does not offer {kind}",
                where=str(self.path),
                remedy=f"run it as {' or '.join(self.description.kinds)}",
            )
        names = self._known(outputs, [v.name for v in self.description.outputs])
        values = dict(parameters or {})
        self._known(list(values), [])
        signals = checked_inputs(inputs, [v.name for v in self.description.inputs], self.path)
        grid = time_grid(signals, start, stop, step)
        instance, messages = self.instantiate(kind)
        try:
            is_compiled = can_step(
                self.model_description, [*names, *(signals[1] if signals else ())]
            )
            if kind == "ModelExchange" and self.description.fmi != "2.0":
                columns = self._run_with_fmpy(
                    instance, kind, grid, signals, values, names, hold, tolerance
                )
            elif kind == "CoSimulation" and not is_compiled:
                raise FmuError(
                    "arrays and texts are no signals here",
                    where=str(self.path),
                    remedy="choose outputs that are numbers",
                )
            elif kind == "CoSimulation":
                columns = run_co_simulation(
                    instance, self.model_description, grid, signals, values, names, hold, tolerance
                )
            else:
                columns = run_model_exchange(
                    instance,
                    self.model_description,
                    grid,
                    signals,
                    values,
                    names,
                    hold,
                    tolerance or _TOLERANCE,
                )
        except Exception as error:
            if isinstance(error, InputError) and not isinstance(error, FmuError):
                raise
            raise FmuError(
                f"the simulation failed: {messages.last or error}",
                where=str(self.path),
                remedy="check inputs, parameters and start values",
            ) from error
        finally:
            instance.freeInstance()
        return Simulation(grid, dict(zip(names, columns.T, strict=True)))

    def _known(self, names: Sequence[str] | None, default: Sequence[str]) -> list[str]:
        if names is None:
            return list(default)
        known = self.description.names
        for name in names:
            if name not in known:
                raise UnknownNameError("variable", name, known, where=str(self.path))
        return list(names)

    def _run_with_fmpy(
        self,
        instance: Any,
        kind: Kind,
        grid: Array,
        signals: Inputs | None,
        values: Mapping[str, float],
        names: Sequence[str],
        hold: Hold,
        tolerance: float | None,
    ) -> Array:
        step = float(grid[1] - grid[0])
        result = fmpy.simulate_fmu(
            self._folder.name,
            validate=False,
            model_description=self.model_description,
            fmu_instance=instance,
            fmi_type=kind,
            start_time=float(grid[0]),
            stop_time=float(grid[-1]),
            output_interval=step,
            relative_tolerance=tolerance or _TOLERANCE,
            start_values=dict(values),
            input=None if signals is None else _steps(signals, hold),  # pyright: ignore[reportArgumentType] - None is its default
            output=list(names),
            record_events=False,
        )
        rows = np.searchsorted(result["time"], grid - 1e-6 * step)
        if len(result) == 0 or rows[-1] >= len(result):
            raise FmuError("the FMU ended the simulation early", where=str(self.path))
        return np.column_stack([np.asarray(result[name], float)[rows] for name in names])


def simulate(
    fmu: Path,
    *,
    inputs: Inputs | None = None,
    parameters: Mapping[str, float] | None = None,
    start: float | None = None,
    stop: float | None = None,
    step: float | None = None,
    outputs: Sequence[str] | None = None,
    kind: Kind | None = None,
    hold: Hold = "zero-order",
    tolerance: float | None = None,
    guarded: bool | None = None,
    sha256: str | None = None,
) -> Simulation:
    """Run an FMU once; a foreign one in a child process with limits.

    Values at a time are those after the inputs of that time have been set.

    Args:
        fmu: The file.
        inputs: Time (n,) [s], increasing, and a column (n,) for each input that is driven. Before
            and after the given times the end values hold.
        parameters: Values to set before the start: parameters, start values.
        start, stop: Of the run [s]; default: the span of the inputs, or 0 and 10.
        step: Of the result and of communication [s]; default: the inputs' own times, or a
            thousandth of the span.
        outputs: Variables to return; default: those that are declared output.
        kind: Default: Co-Simulation if the FMU has it.
        hold: `zero-order` keeps an input until its next value, `linear` joins its values.
        tolerance: Relative, of the integrator; default: the FMU's own.
        guarded: In a child process; default: unless we compiled the FMU ourselves.
        sha256: Of the file, if only that very file is to be used.

    Raises:
        UnknownNameError: An input, a parameter or an output that the FMU does not have.
        InputError: Times that do not increase.
        FmuError: The FMU does not load, or fails while it runs.
    """
    settings: dict[str, Any] = {
        "inputs": inputs,
        "parameters": parameters,
        "start": start,
        "stop": stop,
        "step": step,
        "outputs": outputs,
        "kind": kind,
        "hold": hold,
        "tolerance": tolerance,
    }
    if guarded or (guarded is None and not is_ours(fmu)):
        answer = simulate_guarded(fmu, settings, sha256=sha256)
        return Simulation(answer["time"], answer["columns"])
    with Fmu(fmu, sha256=sha256) as opened:
        return opened.simulate(**settings)


def free_run(
    fmu: Path,
    time: Array,
    columns: Mapping[str, Array],
    *,
    parameters: Mapping[str, float] | None = None,
    hold: Hold = "zero-order",
) -> Simulation:
    """Run any FMU freely along a recording: its inputs drive, its other columns are compared with.

    Args:
        fmu: The file.
        time: Of the samples, shape (n,) [s].
        columns: Name → samples (n,), in the variables' units; names that the FMU does not have are
            left out.
        parameters: Also starts; `start_names` tells which there are.
        hold: As `simulate`.

    Returns:
        At the times of the samples, a column for each recorded variable that is no input.

    Raises:
        InputError: Nothing of the recording can be compared with.
        FmuError: As `simulate`.
    """
    description = describe(fmu)
    driving = {v.name for v in description.inputs}
    compared = [name for name in columns if name in description.names and name not in driving]
    if not compared:
        raise InputError(
            "the recording has no output of the FMU",
            where=str(fmu),
            remedy=f"it has {', '.join(v.name for v in description.outputs)}: map a channel to one",
        )
    inputs = (time, {name: column for name, column in columns.items() if name in driving})
    return simulate(
        fmu,
        inputs=inputs if inputs[1] else None,
        parameters=parameters,
        start=float(time[0]),
        stop=float(time[-1]),
        step=None if inputs[1] else float(np.min(np.diff(time))),
        outputs=compared,
        hold=hold,
    )


def start_names(fmu: Path) -> Mapping[str, str]:
    """Return for each continuous state of an FMU the name by which its start value is set.

    That is a parameter `<state>_start`, or the state itself where its start may be set. States
    whose start cannot be set are missing.

    Raises:
        FmuError: The FMU cannot be read.
    """
    description = read_description(fmu)
    variables: dict[str, Any] = {str(v.name): v for v in description.modelVariables}
    names: dict[str, str] = {}
    for state in description_of(description).states:
        parameter = f"{state}_start"
        if parameter in variables and variables[parameter].causality == "parameter":
            names[state] = parameter
        elif variables[state].initial in ("exact", "approx"):
            names[state] = state
    return names


def model_fmu(model: str | Path | ModelicaSource | Dae, roots: tuple[Path, ...] = ()) -> Path:
    """Return an FMU for whatever a user calls a MODEL; of Modelica, one in the user's cache.

    Raises:
        ModelicaError, UnsupportedModelError, CompilerError: As `export`.
        InputError: The word is neither a file nor a class.
    """
    if isinstance(model, ModelicaSource | Dae):
        return cached_fmu(model)
    if str(model).endswith(".fmu"):
        return Path(model)
    return cached_fmu(find_source(str(model), roots))


def simulate_model(
    model: str | Path | ModelicaSource | Dae, *, roots: tuple[Path, ...] = (), **settings: Any
) -> Simulation:
    """Run any MODEL: an FMU, a class of the library, a Modelica file. Settings as `simulate`.

    Raises:
        TwinproofError: As `simulate` and `model_fmu`.

    Example:
        >>> run = simulate_model("Twinproof.Plants.Pendulum", stop=0.2, step=0.1)
        >>> sorted(run.columns)
        ['omega', 'theta']
    """
    return simulate(model_fmu(model, roots), **settings)


def checked_inputs(inputs: Inputs | None, known: Sequence[str], path: Path) -> Inputs | None:
    """Return inputs as arrays, or None if nothing is driven.

    Raises:
        UnknownNameError, InputError: As `simulate`.
    """
    if inputs is None or not inputs[1]:
        return None
    time = np.asarray(inputs[0], float)
    columns = {name: np.asarray(column, float) for name, column in inputs[1].items()}
    for name, column in columns.items():
        if name not in known:
            raise UnknownNameError("input", name, known, where=str(path))
        if column.shape != time.shape:
            raise InputError(
                f"the input has {column.size} values for {time.size} times", where=name
            )
        if not np.all(np.isfinite(column)):
            raise InputError(
                "the input is not finite",
                where=f"{name} at time {time[~np.isfinite(column)][0]:g}",
                remedy="remove or repair the sample",
            )
    if time.size < 2 or not np.all(np.diff(time) > 0):
        raise InputError("the times of the inputs do not increase", where=str(path))
    return time, columns


def time_grid(
    signals: Inputs | None, start: float | None, stop: float | None, step: float | None
) -> Array:
    """Return the times of a result, shape (n,) [s]; arguments and errors as `simulate`."""
    first = start if start is not None else (float(signals[0][0]) if signals else 0.0)
    last = stop if stop is not None else (float(signals[0][-1]) if signals else first + 10.0)
    if not last > first:
        raise InputError(f"the stop time {last:g} s is not after the start time {first:g} s")
    if step is None and signals is not None:
        inside = signals[0][(signals[0] > first) & (signals[0] < last)]
        return np.concatenate([[first], inside, [last]])
    step = step if step is not None else (last - first) / 1000
    if not 0 < step <= (last - first) * (1 + 1e-9):
        raise InputError(
            f"the step {step:g} s does not fit between {first:g} s and {last:g} s",
            remedy="choose a positive step not longer than the run",
        )
    # Multiples rather than sums of the step: no rounding errors pile up.
    count = int(np.floor((last - first) / step * (1 + 1e-12))) + 1
    return first + step * np.arange(count, dtype=np.float64)


def _steps(signals: Inputs, hold: Hold) -> npt.NDArray[Any]:
    """Return inputs as FMPy takes them, with two rows at a jump: a staircase.

    FMPy holds inputs over a step, so lines become stairs through their midpoints.
    """
    time, columns = signals
    table = np.empty(
        2 * time.size - 1, dtype=[("time", float), *((name, float) for name in columns)]
    )
    table["time"] = np.repeat(time, 2)[1:]
    for name, column in columns.items():
        level = (
            column
            if hold == "zero-order"
            else np.append(np.convolve(column, [0.5, 0.5], "valid"), column[-1])
        )
        table[name] = np.repeat(level, 2)[:-1]
    return table
