"""Windowed simulation with exact sensitivities, compiled.

The record is cut into windows; each starts from its own initial state, so errors do not grow over
the whole record and an unstable plant stays near its data. Within a window the model runs freely.
Sensitivities are those of the discretised model itself (the derivative of every Runge–Kutta step),
not of a separate equation: the gradient belongs exactly to the cost that is minimised.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.casadi_expressions import SX
from fmus.compiler import shared_library
from fmus.dae import Dae
from fmus.explicit import ExplicitModel, explicit
from foundation.errors import UnsupportedModelError

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# A step of the fourth-order method is no longer than this, so that the smoothed friction laws of
# the library stay inside its stability region at the sample times of CAN buses.
_LONGEST_STEP = 1e-3
_PREFIX = "twinproof_shoot"

_DRIVER = r"""
#include <string.h>
enum {{ NX = {nx}, NU = {nu}, NS = {ns}, NY = {ny}, NP = {np}, NC = NX + NS }};
/* One window of n samples: y and dy/d(x0, s) at every sample. sensitive = 0: no sensitivities.
   The input is held over a sample interval, the delayed signals (the last {nd} columns) run
   linearly between samples. Returns the number of samples with finite state. */
__attribute__((visibility("default")))
int twinproof_shoot(int n, int substeps, double h, double t0, const double *x0, const double *u,
                    const double *p, int sensitive, double *y, double *dy) {{
  double x[NX + 1], xn[NX + 1], a[NX * NX + 1], b[NX * NS + 1], c[NY * NX + 1], d[NY * NS + 1];
  double s[NX * NC + 1], sn[NX * NC + 1], us[NU + 1], t, hs = h / substeps;
  double w[{work}];
  int i, j, k, l, m;
  memcpy(x, x0, NX * sizeof(double));
  memset(s, 0, sizeof s);
  for (i = 0; i < NX; i++) s[i * NX + i] = 1;
  for (k = 0; k < n; k++) {{
    const double *uk = u + (long)k * NU, *un = k + 1 < n ? uk + NU : uk;
    t = t0 + k * h;
    for (i = 0; i < NX; i++)
      if (!(x[i] > -1e12 && x[i] < 1e12)) return k;
    {{
      const double *arg[4] = {{&t, x, uk, p}};
      double *res[3] = {{y + (long)k * NY, c, d}};
      if (sensitive) {prefix}_output_sensitive(arg, res, 0, w, 0);
      else {prefix}_output(arg, res, 0, w, 0);
    }}
    if (sensitive) {{
      double *o = dy + (long)k * NC * NY; /* column-major: o[column * NY + output] */
      for (j = 0; j < NC; j++)
        for (i = 0; i < NY; i++) {{
          double v = j < NX ? 0 : d[(j - NX) * NY + i];
          for (l = 0; l < NX; l++) v += c[l * NY + i] * s[j * NX + l];
          o[j * NY + i] = v;
        }}
    }}
    if (k + 1 == n) break;
    for (m = 0; m < substeps; m++) {{
      double from = (double)m / substeps, to = (double)(m + 1) / substeps, uf[NU + 1];
      for (i = 0; i < NU; i++) {{
        double ramp = i < NU - {nd} ? 0 : un[i] - uk[i];
        us[i] = uk[i] + from * ramp;
        uf[i] = uk[i] + to * ramp;
      }}
      {{
        double ts = t + m * hs;
        const double *arg[6] = {{&ts, x, us, uf, p, &hs}};
        double *res[3] = {{xn, a, b}};
        if (sensitive) {prefix}_step_sensitive(arg, res, 0, w, 0);
        else {prefix}_step(arg, res, 0, w, 0);
      }}
      if (sensitive) {{
        for (j = 0; j < NC; j++)
          for (i = 0; i < NX; i++) {{
            double v = j < NX ? 0 : b[(j - NX) * NX + i];
            for (l = 0; l < NX; l++) v += a[l * NX + i] * s[j * NX + l];
            sn[j * NX + i] = v;
          }}
        memcpy(s, sn, sizeof s);
      }}
      memcpy(x, xn, NX * sizeof(double));
    }}
  }}
  return n;
}}
"""


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

    Raises:
        UnsupportedModelError: The model has when-equations, or delays something else than an input.
        CompilerError: No C compiler.
    """

    def __init__(self, dae: Dae, output_names: Sequence[str], sensitive: Sequence[str]) -> None:
        self.dae = dae
        self.output_names = tuple(output_names)
        self.sensitive = tuple(sensitive)
        self._model = _plain(dae)
        self.parameter_names = self._model.parameter_names
        self.nx = len(self._model.state_names)
        self._library = _compiled(self._model, self.output_names, self.sensitive)

    @property
    def state_names(self) -> tuple[str, ...]:
        """The states, in the order of the initial state."""
        return self._model.state_names

    @property
    def measured_states(self) -> Mapping[int, tuple[int, float]]:
        """State → (output, gain) where an output is this one state times a constant, or nearly so.

        An offset at the sensor is left to the fit.
        """
        return _measured(self._model, self.output_names)

    @property
    def rate_of(self) -> Mapping[str, str]:
        """State → the state that is its derivative, where the model says so."""
        return _rates(self._model)

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
        if not self.dae.delays:
            return np.ascontiguousarray(inputs, dtype=float)
        columns = [inputs]
        # Held inputs change between samples; a delayed one is interpolated linearly, so that its
        # derivative with respect to the duration exists.
        samples = np.arange(len(inputs), dtype=float)
        operands = _delay_operands(self._model)
        signals = np.asarray(operands(inputs.T, np.tile(p[:, None], len(inputs)))[0]).T
        durations = np.asarray(operands(np.zeros(inputs.shape[1]), p)[1]).ravel()
        for k, duration in enumerate(durations):
            signal = signals[:, k]
            past = samples - duration / h
            value = np.interp(past, samples, signal)
            slope = (
                np.interp(past + 0.5, samples, signal) - np.interp(past - 0.5, samples, signal)
            ) / h
            columns.append(np.column_stack([value, slope, np.full(len(inputs), duration)]))
        return np.ascontiguousarray(np.column_stack(columns), dtype=float)

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
        n, ny, nc = len(inputs), len(self.output_names), self.nx + len(self.sensitive)
        y = np.full((n, ny), np.nan)
        dy = np.zeros((n if sensitivities else 0, nc, ny))
        x0 = np.ascontiguousarray(x0, dtype=float)
        finite = self._library.twinproof_shoot(
            n,
            max(1, round(h / _LONGEST_STEP)),
            ctypes.c_double(h),
            ctypes.c_double(t0),
            _pointer(x0),
            _pointer(inputs),
            _pointer(p),
            int(sensitivities),
            _pointer(y),
            _pointer(dy),
        )
        y[finite:] = np.nan
        return Response(y, dy.transpose(0, 2, 1), int(finite))


def _pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


@lru_cache(maxsize=256)
def _plain(dae: Dae) -> ExplicitModel:
    if dae.when_equations or dae.reinits:
        raise UnsupportedModelError(
            f"{dae.name} changes its state at events, which has no sensitivities here",
            remedy="write the law as a smooth or piecewise function",
        )
    model = explicit(dae)
    for delay in dae.delays:
        if ca.depends_on(model.fold(delay.operand), ca.vertcat(model.x, model.delayed)):
            raise UnsupportedModelError(
                f"{dae.name} delays a signal that depends on the states",
                remedy="put the delay at an input, or use a first-order lag",
            )
        if ca.depends_on(model.fold(delay.duration), ca.vertcat(model.x, model.u, model.delayed)):
            raise UnsupportedModelError(
                f"{dae.name}: a delay's duration varies while it runs",
                remedy="make the duration a parameter",
            )
    return model


@lru_cache(maxsize=256)
def _delay_operands(model: ExplicitModel) -> ca.Function:
    """(u, p) → (operand of every delay, its duration)."""
    delays = model.dae.delays
    operands = ca.vertcat(*(model.fold(delay.operand) for delay in delays))
    durations = ca.vertcat(*(model.fold(delay.duration) for delay in delays))
    return ca.Function("operands", [model.u, model.p], [operands, durations])


@lru_cache(maxsize=256)
def _measured(
    model: ExplicitModel, output_names: tuple[str, ...]
) -> Mapping[int, tuple[int, float]]:
    found: dict[int, tuple[int, float]] = {}
    p0 = [model.dae.parameter_values[name] for name in model.parameter_names]
    for k, name in enumerate(output_names):
        row = ca.substitute(ca.jacobian(model.value(name), model.x), model.p, ca.DM(p0))
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
    model: ExplicitModel, output_names: tuple[str, ...], sensitive: tuple[str, ...]
) -> ctypes.CDLL:
    source = _generate(model, output_names, sensitive)
    library = ctypes.CDLL(str(shared_library(source)))
    library.twinproof_shoot.restype = ctypes.c_int
    return library


def _generate(
    model: ExplicitModel, output_names: tuple[str, ...], sensitive: tuple[str, ...]
) -> str:
    n_delays = len(model.dae.delays)
    # Each delay brings three columns: value d, slope e and duration T₀ at the point of
    # linearisation; d - e·(T - T₀) has the right value and the right derivative there.
    lag = ca.SX.sym("lag", 3 * n_delays)
    delayed = [
        lag[3 * k] - lag[3 * k + 1] * (model.fold(delay.duration) - lag[3 * k + 2])
        for k, delay in enumerate(model.dae.delays)
    ]
    u = ca.vertcat(model.u, lag)

    def with_delays(expression: SX) -> SX:
        if not n_delays:
            return expression
        return ca.substitute(expression, model.delayed, ca.vertcat(*delayed))

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
    theta = [p[model.parameter_names.index(name)] for name in sensitive]
    s = ca.vertcat(*theta) if theta else ca.SX(0, 1)
    y = with_delays(ca.vertcat(*(model.value(name) for name in output_names)))
    step_in = [t, x, u0, u1, p, h]
    output_in = [t, x, u, p]

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
    ]
    generator = ca.CodeGenerator(
        "shooting", {"casadi_int": "int", "with_header": False, "with_export": False}
    )
    for function in functions:
        generator.add(function)
    driver = _DRIVER.format(
        nx=model.x.shape[0],
        nu=u.shape[0],
        ns=len(sensitive),
        ny=len(output_names),
        np=p.shape[0],
        nd=3 * n_delays,
        prefix=_PREFIX,
        work=max(1, *(int(function.sz_w()) for function in functions)),
    )
    return str(generator.dump()) + driver
