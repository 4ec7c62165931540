"""Windowed simulation with exact sensitivities, compiled.

The record is cut into windows; each starts from its own initial state, so errors do not grow over
the whole record and an unstable plant stays near its data. Within a window the model runs freely.
Sensitivities are those of the discretised model itself (the derivative of every Runge–Kutta step),
not of a separate equation: the gradient belongs exactly to the cost that is minimised.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.black_box import check_equations
from fmus.casadi_expressions import SX
from fmus.compiler import shared_library
from fmus.dae import Dae
from fmus.explicit import ExplicitModel, explicit
from foundation.errors import UnsupportedModelError
from identification.delayed_outputs import DelayedOutputs, at_inputs, at_outputs, split
from identification.problem import Problem

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# A step of the fourth-order method is no longer than this, so that the smoothed friction laws of
# the library stay inside its stability region at the sample times of CAN buses.
LONGEST_STEP = 1e-3
_PREFIX = "twinproof"
_DRIVERS = Path(__file__).parent / "drivers"


@dataclass(frozen=True)
class Response:
    """What a window answered.

    Attributes:
        outputs: (n, ny).
        sensitivities: (n, ny, nx + ns), with respect to the initial state, then the chosen
            parameters; (0, ny, nx + ns) where not asked for.
        finite: Number of samples before the state left ±1e12.
    """

    outputs: Matrix
    sensitivities: NDArray[np.float64]
    finite: int


class Shooting:
    """A model compiled for windowed simulation.

    Args:
        dae: The model.
        output_names: Measured variables, in the order of the answer.
        sensitive: Parameters with respect to which sensitivities are wanted.
        measured_inputs: Inputs that run in straight lines between samples; others hold.
        following: States whose start is not free: that of a sensor's filter follows from the signal
            that it filters, as if that had run in a straight line before.
        briefly: It will only be run once or twice: compile fast rather than well.
        longest_step: Of the integration [s].

    Raises:
        UnsupportedModelError: The model has when-equations, or feels a delay of its own motion.
        CompilerError: No C compiler.
    """

    def __init__(
        self,
        dae: Dae,
        output_names: Sequence[str],
        sensitive: Sequence[str],
        *,
        measured_inputs: Collection[str] = (),
        following: Collection[str] = (),
        briefly: bool = False,
        longest_step: float = LONGEST_STEP,
    ) -> None:
        self.dae = dae
        self._longest_step = longest_step
        # More than -O1 takes longer to compile and runs no faster.
        self._optimise = "-O0" if briefly else "-O1"
        self.output_names = tuple(output_names)
        self.sensitive = tuple(sensitive)
        self.model = _plain(dae)
        _check_operands(self.model, self.sensitive)
        self.parameter_names = self.model.parameter_names
        self.nx = len(self.model.state_names)
        self.following = tuple(name for name in self.model.state_names if name in following)
        names = [v.name for v in dae.inputs]
        self.ramps = np.array([name in measured_inputs for name in names], dtype=np.int32)

    @classmethod
    def of(
        cls,
        problem: Problem,
        sensitive: Sequence[str] | None = None,
        *,
        watched: Sequence[str] | None = None,
        briefly: bool = False,
    ) -> Shooting:
        """Compile a problem's model as its record asks: how inputs run, which starts follow.

        Args:
            problem: Model and record.
            sensitive: As for the class; by default the problem's free parameters.
            watched: Variables to return; by default the problem's outputs.
            briefly: As for the class.
        """
        return cls(
            problem.dae,
            problem.output_names if watched is None else watched,
            problem.free if sensitive is None else sensitive,
            measured_inputs=problem.measured_inputs,
            following=problem.following,
            briefly=briefly,
        )

    @cached_property
    def _library(self) -> ctypes.CDLL:
        return _compiled(
            self.model, self.output_names, self.sensitive, self.following, self._optimise
        )

    @cached_property
    def _late(self) -> DelayedOutputs | None:
        """What puts outputs with delays together; None if there are none."""
        model = self.model
        if not at_outputs(model):
            return None
        outputs = ca.vertcat(*(model.value(name) for name in self.output_names))
        return DelayedOutputs.of(model, outputs, _parameters(model, self.sensitive))

    @property
    def state_names(self) -> tuple[str, ...]:
        """The states, in the order of the initial state."""
        return self.model.state_names

    @property
    def measured_states(self) -> Mapping[int, tuple[int, float]]:
        """State → (output, gain) where an output is this one state times a constant, or nearly so.

        An offset at the sensor is left to the fit.
        """
        return _measured(self.model, self.output_names)

    @property
    def rate_of(self) -> Mapping[str, str]:
        """State → the state that is its derivative, where the model says so."""
        return _rates(self.model)

    @property
    def begins_anywhere(self) -> bool:
        """Always: every state can be set, and a model without states has nothing to remember."""
        return True

    def with_measured(self, measured_inputs: Collection[str]) -> Shooting:
        """Return the same compiled model for a record in which other inputs were measured."""
        other = copy(self)
        names = [v.name for v in self.dae.inputs]
        other.ramps = np.array([name in measured_inputs for name in names], dtype=np.int32)
        other.__dict__.pop("_stairs", None)
        return other

    def parameter_vector(self, values: Mapping[str, float]) -> Vector:
        """Return the (np,) vector of all independent parameters."""
        return np.array([values[name] for name in self.parameter_names], dtype=float)

    def inputs_with_delays(self, inputs: Matrix, h: float, p: Vector) -> Matrix:
        """Return inputs with, for each delay operator, its value, slope and present duration.

        Args:
            inputs: (n, nu).
            h: Sample time [s].
            p: (np,) parameters.
        """
        if not at_inputs(self.model):
            return np.ascontiguousarray(inputs, dtype=float)
        columns = [inputs]
        # A held input is a staircase; a delayed one is the straight lines through the middles of
        # its stairs, so that its derivative with respect to the duration exists. Lines through the
        # samples would run ahead of the staircase by half a step, and the fit would add that. (A
        # measured input is the lines through its samples.)
        samples = np.arange(len(inputs), dtype=float)
        operands = _delay_operands(self.model)
        # One column of parameters serves every sample: repeated here, it takes 50 times as long.
        signals = np.asarray(operands(inputs.T, p)[0]).T
        durations = np.asarray(operands(np.zeros(inputs.shape[1]), p)[1]).ravel()
        for k, duration in enumerate(durations):
            signal = signals[:, k]
            past = samples - (0.5 if self._stairs[k] else 0.0) - duration / h
            value = np.interp(past, samples, signal)
            slope = (
                np.interp(past + 0.5, samples, signal) - np.interp(past - 0.5, samples, signal)
            ) / h
            columns.append(np.column_stack([value, slope, np.full(len(inputs), duration)]))
        return np.ascontiguousarray(np.column_stack(columns), dtype=float)

    @cached_property
    def _stairs(self) -> list[bool]:
        """Whether the operand of each delay holds between samples."""
        held = [
            u for u, ramps in zip(ca.vertsplit(self.model.u), self.ramps, strict=True) if not ramps
        ]
        return [
            bool(held) and bool(ca.depends_on(self.model.fold(d.operand), ca.vertcat(*held)))
            for d in at_inputs(self.model)
        ]

    def run(
        self,
        x0: Vector,
        inputs: Matrix,
        p: Vector,
        h: float,
        *,
        t0: float = 0.0,
        sensitivities: bool = False,
    ) -> Response:
        """Simulate one window.

        Args:
            x0: (nx,) initial state.
            inputs: (n, nu + 3·delays) from `inputs_with_delays`.
            p: (np,) parameters.
            h: Sample time [s].
            t0: Time of the first sample [s].
            sensitivities: Also return the derivatives.
        """
        late = self._late
        n, nc = len(inputs), self.nx + len(self.sensitive)
        ny = len(self.output_names) + (late.delays if late is not None else 0)
        y = np.full((n, ny), np.nan)
        dy = np.zeros((n if sensitivities else 0, nc, ny))
        x0 = np.ascontiguousarray(x0, dtype=float)
        finite = self._library.twinproof_shoot(
            n,
            substeps(h, self._longest_step),
            ctypes.c_double(h),
            ctypes.c_double(t0),
            _pointer(x0),
            _pointer(inputs),
            ctypes.c_void_p(self.ramps.ctypes.data),
            _pointer(p),
            int(sensitivities),
            _pointer(y),
            _pointer(dy),
        )
        y[finite:] = np.nan
        changes = dy.transpose(0, 2, 1)
        if late is not None:
            y, changes = late.together(y, changes, p, h)
        return Response(y, changes, int(finite))


def substeps(h: float, longest: float = LONGEST_STEP) -> int:
    """Return into how many integration steps a sample interval of `h` seconds is divided.

    Example:
        >>> [substeps(h) for h in (0.5e-3, 1e-3, 1.4e-3, 10e-3)]
        [1, 1, 2, 10]
    """
    return max(1, math.ceil(h / longest - 1e-6))


def _pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


@lru_cache(maxsize=256)
def _plain(dae: Dae) -> ExplicitModel:
    check_equations(dae)
    if dae.when_equations or dae.reinits:
        raise UnsupportedModelError(
            f"{dae.name} changes its state at events, which has no sensitivities here",
            remedy="write the law as a smooth or piecewise function",
        )
    model = explicit(dae)
    at_outputs(model)  # refuses what cannot be had
    return model


def _check_operands(model: ExplicitModel, sensitive: Sequence[str]) -> None:
    for delay in at_inputs(model):
        operand = model.fold(delay.operand)
        for name in sensitive:
            if ca.depends_on(operand, model.p[model.parameter_names.index(name)]):
                raise UnsupportedModelError(
                    f"{model.dae.name} delays a signal that depends on {name}, which is to be "
                    "fitted",
                    remedy="let the parameter act after the delay, or declare it known",
                )


@lru_cache(maxsize=256)
def _delay_operands(model: ExplicitModel) -> ca.Function:
    """(u, p) → (operand of every delay, its duration)."""
    delays = at_inputs(model)
    operands = ca.vertcat(*(model.fold(delay.operand) for delay in delays))
    durations = ca.vertcat(*(model.fold(delay.duration) for delay in delays))
    return ca.Function("operands", [model.u, model.p], [operands, durations])


@lru_cache(maxsize=256)
def _measured(
    model: ExplicitModel, output_names: tuple[str, ...]
) -> Mapping[int, tuple[int, float]]:
    found: dict[int, tuple[int, float]] = {}
    p0 = [model.dae.parameter_values[name] for name in model.parameter_names]
    operands = ca.vertcat(*(model.fold(delay.operand) for delay in model.dae.delays))
    for k, name in enumerate(output_names):
        # A delayed state is nearly that state.
        shown = ca.substitute(model.value(name), model.delayed, operands)
        row = ca.substitute(ca.jacobian(shown, model.x), model.p, ca.DM(p0))
        entries = [j for j in range(row.shape[1]) if not row[0, j].is_zero()]
        if len(entries) == 1 and row[0, entries[0]].is_constant():
            found.setdefault(entries[0], (k, float(row[0, entries[0]])))
    return found


@lru_cache(maxsize=256)
def _rates(model: ExplicitModel) -> Mapping[str, str]:
    rates: dict[str, str] = {}
    for i, name in enumerate(model.state_names):
        for j, rate in enumerate(model.state_names):
            if ca.is_equal(model.derivatives[i], model.x[j]):
                rates[name] = rate
    return rates


@lru_cache(maxsize=256)
def _compiled(
    model: ExplicitModel,
    output_names: tuple[str, ...],
    sensitive: tuple[str, ...],
    following: tuple[str, ...],
    optimise: str,
) -> ctypes.CDLL:
    source = step_code(model, output_names, sensitive, "shooting.c", following)
    library = ctypes.CDLL(str(shared_library(source, optimise=optimise)))
    library.twinproof_shoot.restype = ctypes.c_int
    return library


def step_code(
    model: ExplicitModel,
    output_names: tuple[str, ...],
    sensitive: tuple[str, ...],
    driver: str,
    following: tuple[str, ...] = (),
) -> str:
    """Return C: one integration step and the outputs, with derivatives, and a driver around them.

    Args:
        model: The model.
        output_names: The outputs wanted.
        sensitive: Parameters with respect to which derivatives are wanted.
        driver: File in `identification/drivers` that calls the generated functions.
        following: States whose start follows from the others.
    """
    early = at_inputs(model)
    n_delays = len(early)
    # Each delay brings three columns: value d, slope e and duration T₀ at the point of
    # linearisation; d - e·(T - T₀) has the right value and the right derivative there.
    lag = ca.SX.sym("lag", 3 * n_delays)
    delayed = [
        lag[3 * k] - lag[3 * k + 1] * (model.fold(delay.duration) - lag[3 * k + 2])
        for k, delay in enumerate(early)
    ]
    late = at_outputs(model)
    own = [model.delayed[k] for k in range(len(model.dae.delays)) if k not in late]
    u = ca.vertcat(model.u, lag)

    def with_delays(expression: SX) -> SX:
        if not n_delays:
            return expression
        return ca.substitute(expression, ca.vertcat(*own), ca.vertcat(*delayed))

    f = ca.Function("f", [model.time, model.x, u, model.p], [with_delays(model.derivatives)])
    t, x, p = model.time, model.x, model.p
    u0 = ca.SX.sym("u0", u.shape[0])
    u1 = ca.SX.sym("u1", u.shape[0])
    h = ca.SX.sym("h")
    middle = (u0 + u1) / 2
    k1 = f(t, x, u0, p)
    k2 = f(t + h / 2, x + h / 2 * k1, middle, p)
    k3 = f(t + h / 2, x + h / 2 * k2, middle, p)
    k4 = f(t + h, x + h * k3, u1, p)
    x_next = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    s = _parameters(model, sensitive)
    y = ca.vertcat(*(model.value(name) for name in output_names))
    if late:
        # The rest is done when the motion is known: `DelayedOutputs`.
        rest, _, signals, _ = split(model, y)
        y = ca.vertcat(rest, signals)
    y = with_delays(y)
    step_in = [t, x, u0, u1, p, h]
    output_in = [t, x, u, p]
    start = _starts(model, with_delays(model.derivatives), following)

    def full(function: SX, of: SX) -> SX:
        return ca.densify(ca.jacobian(function, of)) if of.shape[0] else ca.SX(0, 0)

    functions = [
        ca.Function(f"{_PREFIX}_step", step_in, [ca.densify(x_next)], {"cse": True}),
        ca.Function(
            f"{_PREFIX}_step_sensitive",
            step_in,
            [ca.densify(x_next), full(x_next, x), full(x_next, s)],
            {"cse": True},
        ),
        ca.Function(f"{_PREFIX}_output", output_in, [ca.densify(y)]),
        ca.Function(
            f"{_PREFIX}_output_sensitive",
            output_in,
            [ca.densify(y), full(y, x), full(y, s)],
            {"cse": True},
        ),
        ca.Function(
            f"{_PREFIX}_start",
            output_in,
            [ca.densify(start), full(start, x), full(start, s)],
            {"cse": True},
        ),
    ]
    generator = ca.CodeGenerator(
        "steps", {"casadi_int": "int", "with_header": False, "with_export": False}
    )
    for function in functions:
        generator.add(function)
    sizes = {
        "NX": model.x.shape[0],
        "NU": u.shape[0],
        "NS": len(sensitive),
        "NY": y.shape[0],
        "ND": 3 * n_delays,
        "FOLLOWING": len(following),
        "WORK": max(1, *(int(function.sz_w()) for function in functions)),
    }
    defines = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    return str(generator.dump()) + defines + _driver(driver)


def _parameters(model: ExplicitModel, names: Sequence[str]) -> SX:
    """Return (names,) parameters."""
    theta = [model.p[model.parameter_names.index(name)] for name in names]
    return ca.vertcat(*theta) if theta else ca.SX(0, 1)


def _driver(name: str) -> str:
    """Return a driver's text with the drivers' headers in their places.

    Libraries are kept under their text, so all of it must be in it.
    """
    text = (_DRIVERS / name).read_text(encoding="utf-8")
    return re.sub(r'^#include "(.+)"$', lambda found: _driver(found[1]), text, flags=re.MULTILINE)


def _starts(model: ExplicitModel, derivatives: SX, following: tuple[str, ...]) -> SX:
    """Return the initial state with following ones put where the signal they filter leads them.

    For dx/dt = a·x + b that is the x which runs as straight as b: x = -b/a - (db/dt)/a².
    """
    start = model.x
    for name in following:
        k = model.state_names.index(name)
        own = model.x[k]
        slope = ca.jacobian(derivatives[k], own)
        drive = ca.substitute(derivatives[k], own, 0)
        others = ca.jacobian(model.derivatives, own)
        others[k] = 0
        if (others.nnz() and not others.is_zero()) or ca.depends_on(slope, model.x):
            raise UnsupportedModelError(
                f"{name} of {model.dae.name} is no filter of a sensor: it acts back on the plant, "
                "or is not linear",
                remedy="put the effect at an input",
            )
        rate = ca.jacobian(drive, model.x) @ derivatives
        start = ca.substitute(start, own, -drive / slope - rate / slope**2)
    return start
