"""FMUs stepped in compiled code: one along its inputs, or several connected ones.

The loop is `loop.c`; here its structures are filled from FMPy's instances.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from ctypes import POINTER, Structure, c_double, c_int32, c_int64, c_void_p
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from fmus.compiler import shared_library
from foundation.errors import FmuError

Array: TypeAlias = npt.NDArray[np.float64]
Method: TypeAlias = Literal["jacobi", "gauss-seidel"]

UNCONNECTED = -(2**31)
_STAGES = ("", "inputs", "outputs", "step", "slopes", "saving", "restoring", "end")
# Our types of a number, by the names that FMI 3 (and 1 and 2) have for them.
_DTYPES = (
    np.float64,
    np.float32,
    np.int8,
    np.uint8,
    np.int16,
    np.uint16,
    np.int32,
    np.uint32,
    np.int64,
    np.uint64,
)
_FMI3_NUMBERS = (
    *("Float64", "Float32", "Int8", "UInt8", "Int16"),
    *("UInt16", "Int32", "UInt32", "Int64", "UInt64"),
)
_NUMBER_TYPES: Mapping[str, Mapping[str, int]] = {
    "1": {"Real": 0, "Integer": 6, "Enumeration": 6, "Boolean": 3},
    "2": {"Real": 0, "Integer": 6, "Enumeration": 6, "Boolean": 6},
    "3": {
        **{name: code for code, name in enumerate(_FMI3_NUMBERS)},
        "Enumeration": 8,
        "Boolean": 3,
    },
}


class _Group(Structure):
    _fields_ = (
        ("function", c_void_p),
        ("references", c_void_p),
        ("places", c_void_p),
        ("buffer", c_void_p),
        ("type", c_int32),
        ("n", c_int32),
    )


class _Unit(Structure):
    _fields_ = (
        ("component", c_void_p),
        ("do_step", c_void_p),
        ("get_state", c_void_p),
        ("set_state", c_void_p),
        ("set_slopes", c_void_p),
        ("inputs", POINTER(_Group)),
        ("outputs", POINTER(_Group)),
        ("version", c_int32),
        ("n_inputs", c_int32),
        ("n_outputs", c_int32),
        ("first", c_int32),
        ("last", c_int32),
    )


class _System(Structure):
    _fields_ = (
        ("units", POINTER(_Unit)),
        ("order", c_void_p),
        ("source", c_void_p),
        ("owner", c_void_p),
        ("factor", c_void_p),
        ("offset", c_void_p),
        ("u", c_void_p),
        ("y", c_void_p),
        ("before", c_void_p),
        ("rise", c_void_p),
        ("ahead", c_void_p),
        ("stepped", c_void_p),
        ("n_units", c_int32),
        ("n_u", c_int32),
        ("failed_unit", c_int32),
        ("failed_at", c_int32),
        ("status", c_int32),
        ("has_before", c_int32),
        ("span", c_double),
        ("plus", c_void_p),
        ("grid", c_void_p),
        ("sampled", c_int32),
    )


@cache
def _library() -> ctypes.CDLL:
    source = (Path(__file__).parent / "loop.c").read_text(encoding="utf-8")
    library = ctypes.CDLL(str(shared_library(source)))
    system = POINTER(_System)
    library.loop_settle.argtypes = [system, c_void_p]
    library.loop_advance.argtypes = [system, c_double, c_double, c_int32, c_int32]
    library.loop_tick.argtypes = [system, c_void_p, c_double, c_double, c_void_p]
    library.loop_evaluate.argtypes = [system, c_int32]
    library.loop_read.argtypes = [system]
    library.loop_save.argtypes = library.loop_restore.argtypes = [system, c_void_p]
    library.loop_run.argtypes = [
        *(system, c_int64, c_void_p, c_void_p, c_int64, c_void_p, c_void_p, c_void_p),
        *(c_void_p, c_int64, c_int32, c_int32),
    ]
    library.loop_run.restype = c_int64
    for name in ("settle", "advance", "tick", "evaluate", "read", "save", "restore"):
        getattr(library, f"loop_{name}").restype = ctypes.c_bool
    return library


def prepare() -> None:
    """Compile the loop, if it is not in the user's cache yet.

    Raises:
        CompilerError: There is no compiler.
    """
    _library()


@dataclass(frozen=True)
class UnitOf:
    """An initialised Co-Simulation instance that takes part.

    Attributes:
        instance: Of FMPy.
        description: FMPy's model description.
        inputs: Names of the variables that are set at each step.
        outputs: Names of the variables that are read.
        name: For messages.
    """

    instance: Any
    description: Any
    inputs: Sequence[str]
    outputs: Sequence[str]
    name: str = ""


def can_step(description: Any, names: Sequence[str]) -> bool:
    """Whether all named variables are scalar numbers of types that the loop knows."""
    types = _NUMBER_TYPES[str(description.fmiVersion)[0]]
    variables = {v.name: v for v in description.modelVariables}
    return all(
        variables[name].type in types and not getattr(variables[name], "dimensions", ())
        for name in names
    )


class Loop:
    """One or several instances, ready to be stepped.

    All inputs, unit after unit, stand in `u`; all outputs in `y`.

    Args:
        units: The instances.
        sources: For each input its output (place in `y`), `-1 - column` for a column of the inputs
            from outside, or UNCONNECTED.
        order: Places of the units, sources first; default: as given.
        factors, offsets: Of each input: it is set to factor × source + offset.
        plus: For each input the column of the inputs from outside that is added to it, or -1; for
            disturbances and noise. Jacobi's method of order 1 only.
        grid: Resolution of each input, or 0; it is rounded to that, noise included.
        sampled: Outputs are only read where a point is settled: what a unit gets from one that is
            later in the order is then exactly a step old, as from a sampled controller.
    """

    def __init__(
        self,
        units: Sequence[UnitOf],
        sources: Sequence[int],
        *,
        order: Sequence[int] | None = None,
        factors: Sequence[float] | Array | None = None,
        offsets: Sequence[float] | Array | None = None,
        plus: Sequence[int] | None = None,
        grid: Sequence[float] | None = None,
        sampled: bool = False,
    ) -> None:
        self.units = tuple(units)
        n_u = sum(len(unit.inputs) for unit in units)
        n_y = sum(len(unit.outputs) for unit in units)
        self.u, self.y = np.zeros(n_u), np.zeros(n_y)
        self._before, self._rise, self._ahead = np.zeros((3, n_u))
        self._stepped = np.zeros(len(units), np.uint8)
        self._order = np.array(range(len(units)) if order is None else order, np.int32)
        self.sources = np.array(sources, np.int32)
        self.owner = np.repeat(
            np.arange(len(units), dtype=np.int32), [len(unit.outputs) for unit in units]
        )
        self.factors = np.ones(n_u) if factors is None else np.array(factors, float)
        self.offsets = np.zeros(n_u) if offsets is None else np.array(offsets, float)
        self._plus = None if plus is None else np.array(plus, np.int32)
        self._grid = None if grid is None else np.array(grid, float)
        self._kept: list[Any] = []
        structures: list[_Unit] = []
        first_u = first_y = 0
        for unit in units:
            structures.append(self._unit(unit, first_u, first_y))
            first_u += len(unit.inputs)
            first_y += len(unit.outputs)
        self._units = (_Unit * len(units))(*structures)
        self._system = _System(
            units=self._units,
            order=_address(self._order),
            source=_address(self.sources),
            owner=_address(self.owner),
            factor=_address(self.factors),
            offset=_address(self.offsets),
            u=_address(self.u),
            y=_address(self.y),
            before=_address(self._before),
            rise=_address(self._rise),
            ahead=_address(self._ahead),
            stepped=_address(self._stepped),
            n_units=len(units),
            n_u=n_u,
            plus=None if self._plus is None else _address(self._plus),
            grid=None if self._grid is None else _address(self._grid),
            sampled=int(sampled),
        )
        self._pointer = ctypes.pointer(self._system)
        self._library = _library()

    def _unit(self, unit: UnitOf, first_u: int, first_y: int) -> _Unit:
        version = str(unit.description.fmiVersion)[0]
        inputs = self._groups(unit, unit.inputs, "Set", first_u)
        outputs = self._groups(unit, unit.outputs, "Get", first_y)
        state = {"1": "", "2": "FMUstate", "3": "FMUState"}[version]
        return _Unit(
            component=_handle(unit.instance.component),
            do_step=_function(unit, "DoStep"),
            get_state=_function(unit, f"Get{state}", needed=False),
            set_state=_function(unit, f"Set{state}", needed=False),
            set_slopes=_function(unit, "SetRealInputDerivatives", needed=False),
            inputs=inputs,
            outputs=outputs,
            version=int(version),
            n_inputs=len(inputs),
            n_outputs=len(outputs),
            first=first_u,
            last=first_u + len(unit.inputs),
        )

    def _groups(
        self, unit: UnitOf, names: Sequence[str], verb: str, first: int
    ) -> ctypes.Array[_Group]:
        version = str(unit.description.fmiVersion)[0]
        variables = {v.name: v for v in unit.description.modelVariables}
        members: dict[tuple[str, int], list[int]] = {}
        for place, name in enumerate(names):
            kind = str(variables[name].type)
            code = _NUMBER_TYPES[version].get(kind)
            if code is None:
                raise FmuError(
                    f"'{name}' is of type {kind}, which is no number",
                    where=unit.name,
                    remedy="leave it out",
                )
            called = {"1": "Integer", "2": "Integer", "3": "Int64"}[version]
            members.setdefault((called if kind == "Enumeration" else kind, code), []).append(place)
        groups: list[_Group] = []
        for (kind, code), places in members.items():
            references = np.array([variables[names[p]].valueReference for p in places], np.uint32)
            where = np.array([first + p for p in places], np.int32)
            buffer = np.zeros(len(places), _DTYPES[code])
            self._kept += [references, where, buffer]
            groups.append(
                _Group(
                    function=_function(unit, verb + kind),
                    references=_address(references),
                    places=_address(where),
                    buffer=_address(buffer),
                    type=code,
                    n=len(places),
                )
            )
        return (_Group * len(groups))(*groups)

    def run(
        self,
        times: Array,
        external: Array,
        shown: Sequence[int],
        *,
        slopes: Array | None = None,
        recorded: npt.NDArray[np.bool_] | None = None,
        method: Method = "jacobi",
        order: int = 1,
    ) -> Array:
        """Step along `times`.

        Args:
            times: Communication points, shape (n,) [s].
            external: Inputs from outside, shape (n, columns): each row from its time on.
            shown: Places in `y` that are recorded.
            slopes: Of the inputs, shape as `external`; one FMI 2 instance only.
            recorded: Which points are recorded, shape (n,); default: all.
            method, order: Of the coupling, see `fmus.master`.

        Returns:
            Shape (recorded points, shown).

        Raises:
            FmuError: A call did not succeed.
        """
        times = np.ascontiguousarray(times, float)
        external = np.ascontiguousarray(external, float)
        rows = times.size if recorded is None else int(np.count_nonzero(recorded))
        result = np.empty((rows, len(shown)))
        columns = np.array(shown, np.int32)
        flags = None if recorded is None else np.ascontiguousarray(recorded, np.uint8)
        self.forget()
        reached = self._library.loop_run(
            self._pointer,
            times.size,
            _address(times),
            _address(external),
            external.shape[1],
            None if slopes is None else _address(slopes),
            None if flags is None else _address(flags),
            _address(result),
            _address(columns),
            len(shown),
            int(method == "gauss-seidel"),
            order,
        )
        if reached < times.size:
            raise self._failure(float(times[reached]))
        return result

    def ticker(
        self, start: float, length: float, external: Array, outputs: Array
    ) -> Callable[[int], None]:
        """Return what steps a single unit along tables, one call a step.

        Args:
            start: Time of the first step [s].
            length: Of a step [s].
            external: Inputs, shape (n, inputs); row k is held over step k.
            outputs: Shape (n + 1, outputs); row k + 1 is filled at the end of step k.

        Returns:
            A function of k; it raises `FmuError` if the FMU refuses.

        Raises:
            ValueError: A table is not contiguous, or there are several units.
        """
        tables = (external, outputs)
        if len(self.units) != 1 or not all(t.flags.c_contiguous for t in tables):
            raise ValueError("one unit and contiguous tables")
        tick, pointer = self._library.loop_tick, self._pointer
        given, width = _address(external), 8 * external.shape[1]
        found, height = _address(outputs), 8 * outputs.shape[1]

        def step(k: int) -> None:
            time = start + k * length
            if not tick(pointer, given + k * width, time, length, found + (k + 1) * height):
                raise self._failure(time)

        return step

    def forget(self) -> None:
        """Do not extrapolate from what was before."""
        self._system.has_before = 0

    def settle(self, external: Array) -> None:
        """Bring outputs to inputs at one point in time, in order."""
        self._succeed(self._library.loop_settle(self._pointer, _address(external)))

    def input_defects(self) -> Array:
        """Return how far connected inputs of the last step were from the mean over the step.

        Shape (inputs,); to be called at the settled end of a step.
        """
        mean = 0.5 * (self._before + self.u)
        return np.where(self.sources >= 0, np.abs(self._ahead - mean), 0.0)

    def note_rise(self) -> None:
        """Take the rise of the inputs since the last point for extrapolation."""
        np.subtract(self.u, self._before, out=self._rise)

    def evaluate(self, unit: int) -> None:
        """Set the inputs of one unit from `u` and read its outputs to `y`."""
        self._succeed(self._library.loop_evaluate(self._pointer, unit))

    def advance(self, time: float, length: float, method: Method, order: int) -> None:
        """One step of all units from a settled point [s]."""
        done = self._library.loop_advance(
            self._pointer, time, length, int(method == "gauss-seidel"), order
        )
        self._succeed(done, time)

    def read(self) -> None:
        """Read all outputs to `y`."""
        self._succeed(self._library.loop_read(self._pointer))

    def save(self, room: ctypes.Array[c_void_p]) -> Mapping[str, Any]:
        """Save all units' states, in the FMUs' memory, which `room` points to from then on."""
        self._succeed(self._library.loop_save(self._pointer, ctypes.addressof(room)))
        return {
            "before": self._before.copy(),
            "rise": self._rise.copy(),
            "has": self._system.has_before,
            "span": self._system.span,
            "u": self.u.copy(),
            "y": self.y.copy(),
        }

    def restore(self, room: ctypes.Array[c_void_p], kept: Mapping[str, Any]) -> None:
        """Go back to a saved state."""
        self._succeed(self._library.loop_restore(self._pointer, ctypes.addressof(room)))
        self._before[:], self._rise[:] = kept["before"], kept["rise"]
        self.u[:], self.y[:] = kept["u"], kept["y"]
        self._system.has_before, self._system.span = kept["has"], kept["span"]

    def _succeed(self, done: bool, time: float | None = None) -> None:
        if not done:
            raise self._failure(time)

    def _failure(self, time: float | None) -> FmuError:
        unit = self.units[self._system.failed_unit]
        stage = _STAGES[self._system.failed_at]
        at = "" if time is None else f" at time {time:g} s"
        if stage == "end":
            return FmuError(f"the FMU ended the simulation{at}", where=unit.name)
        return FmuError(f"the FMU refused: {stage}{at}", where=unit.name)


def _address(array: npt.NDArray[Any]) -> int:
    return int(array.ctypes.data)


def _handle(component: Any) -> int:
    return int(getattr(component, "value", component))


def _function(unit: UnitOf, name: str, *, needed: bool = True) -> int | None:
    version = str(unit.description.fmiVersion)[0]
    if version == "1":
        symbol = f"{unit.instance.modelIdentifier}_fmi{name}"
    else:
        symbol = f"fmi{version}{name}"
    function = getattr(unit.instance.dll, symbol, None)
    if function is None:
        if needed:
            raise FmuError(f"the FMU's binary has no function {symbol}", where=unit.name)
        return None
    return ctypes.cast(function, c_void_p).value
