"""Sensitivities along the run of a Model Exchange FMU, from its directional derivatives.

For x' = f(x, u, p) and y = g(x, u, p), S = ∂x/∂p follows S' = ∂f/∂x·S + ∂f/∂p along the trajectory.
CVODE gives the trajectory; ∂f/∂x and ∂g/∂x are the FMU's own directional derivatives, in the middle
of every sample, where the rule of the implicit midpoint wants them. FMI 2 has no derivatives by
parameters: ∂f/∂p and ∂g/∂p are differences of right-hand sides at the same state, which an
integrator's error does not enter, of one more instance for each parameter.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus.archive import description_of, read_description
from fmus.co_simulation import initialise
from fmus.guarded import ask, is_ours
from fmus.model_exchange import settle
from fmus.running import Fmu, Inputs
from foundation.errors import FmuError

Array = npt.NDArray[np.float64]


def has_sensitivities(fmu: Path) -> bool:
    """Whether an FMU lets them be followed: FMI 2, with derivatives, and nothing that switches.

    Raises:
        FmuError: It cannot be read.
    """
    model = read_description(fmu)
    description = description_of(model)
    return (
        description.fmi == "2.0"
        and "ModelExchange" in description.kinds
        and description.directional_derivatives
        and int(model.numberOfEventIndicators or 0) == 0
    )


def sensitivities(
    fmu: Path,
    *,
    time: Array,
    inputs: Mapping[str, Array],
    values: Mapping[str, float],
    by: Mapping[str, float],
    starts: Sequence[str],
    outputs: Sequence[str],
    guarded: bool | None = None,
) -> tuple[Array, Array]:
    """Run an FMU as Model Exchange with the derivatives of its outputs; a foreign one in a child.

    Args:
        fmu: One that `has_sensitivities`.
        time: (n,) [s].
        inputs: Name → (n,), each held until the next.
        values: Parameters and start values to set, those of `by` among them.
        by: Parameter or start value → step of its difference.
        starts: Of those, what acts at the start only.
        outputs: Names.
        guarded: In a child process; default: unless we compiled the FMU ourselves.

    Returns:
        Outputs (n, ny) and derivatives (n, ny, by).

    Raises:
        FmuError: It does not load, or fails.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> fmu = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
        >>> time = np.linspace(0, 0.1, 11)
        >>> still = {"tau": np.zeros(11)}
        >>> _, s = sensitivities(
        ...     fmu, time=time, inputs=still, values={"theta_start": 0.0},
        ...     by={"theta_start": 1e-4}, starts=["theta_start"], outputs=["theta"],
        ... )  # a small swing is a cosine
        >>> bool(abs(s[-1, 0, 0] - np.cos(np.sqrt(3.61 / 0.185) * 0.1)) < 2e-4)
        True
    """
    if guarded or (guarded is None and not is_ours(fmu)):
        settings: dict[str, Any] = {
            "time": time,
            "inputs": dict(inputs),
            "values": dict(values),
            "by": dict(by),
            "starts": list(starts),
            "outputs": list(outputs),
        }
        answer = ask("sensitivities", fmu, settings=settings)
        return answer["outputs"], answer["derivatives"]
    with Fmu(fmu) as opened:
        states = opened.description.states
        signals: Inputs | None = (time, inputs) if inputs else None
        run = opened.simulate(
            inputs=signals,
            parameters=values,
            start=float(time[0]),
            stop=float(time[-1]),
            step=None if inputs else float(time[1] - time[0]),
            outputs=[*outputs, *states],
            kind="ModelExchange",
        )
        instances = [opened.instantiate("ModelExchange")[0] for _ in range(len(by) + 1)]
        try:
            points = _points(instances, opened.model_description, time, inputs, values, by, outputs)
            derivatives = _follow(
                points,
                time,
                np.column_stack([run[name] for name in states]),
                np.array([*inputs.values()]).reshape(len(inputs), len(time)).T,
                np.array([*by.values()]),
                [k for k, name in enumerate(by) if name not in starts],
            )
        except Exception as error:  # FMPy raises bare exceptions
            raise FmuError(
                f"the FMU's derivatives failed: {error}",
                where=str(fmu),
                remedy="check it with `twinproof check`",
            ) from error
        finally:
            for instance in instances:
                instance.freeInstance()
    return np.column_stack([run[name] for name in outputs]), derivatives


class _Point:
    """An instance in continuous-time mode, to be asked at any time, state and input."""

    def __init__(
        self,
        instance: Any,
        description: Any,
        values: Mapping[str, float],
        inputs: Mapping[str, float],
        outputs: Sequence[str],
        start: float,
    ) -> None:
        initialise(
            instance, description, values, start=start, stop=None, tolerance=None, inputs=inputs
        )
        settle(instance)
        reference = {v.name: v.valueReference for v in description.modelVariables}
        derivatives = [v.variable for v in description.derivatives]
        self._instance = instance
        self._nx = len(derivatives)
        self._x, self._dx = np.empty(self._nx), np.empty(self._nx)
        self._states = [v.derivative.valueReference for v in derivatives]
        self._unknowns = [v.valueReference for v in derivatives]
        self._inputs = [reference[name] for name in inputs]
        self._outputs = [reference[name] for name in outputs]

    def state(self) -> Array:
        """Return (nx,) the present state."""
        self._instance.getContinuousStates(_address(self._x), self._nx)
        return self._x.copy()

    def move(self, time: float, x: Array, u: Array) -> None:
        """Go to a time [s], a state (nx,) and inputs."""
        self._x[:] = x
        self._instance.setTime(time)
        self._instance.setContinuousStates(_address(self._x), self._nx)
        if self._inputs:
            self._instance.setReal(self._inputs, u.tolist())

    def rates(self) -> Array:
        """Return (nx,) f here."""
        self._instance.getDerivatives(_address(self._dx), self._nx)
        return self._dx.copy()

    def shown(self) -> Array:
        """Return (ny,) g here."""
        return np.array(self._instance.getReal(self._outputs))

    def partials(self, *, of_outputs: bool) -> Array:
        """Return ∂f/∂x (nx, nx) or ∂g/∂x (ny, nx) here."""
        unknowns = self._outputs if of_outputs else self._unknowns
        columns = [
            self._instance.getDirectionalDerivative(unknowns, [state], [1.0])
            for state in self._states
        ]
        return np.array(columns, float).reshape(self._nx, len(unknowns)).T


def _points(
    instances: Sequence[Any],
    description: Any,
    time: Array,
    inputs: Mapping[str, Array],
    values: Mapping[str, float],
    by: Mapping[str, float],
    outputs: Sequence[str],
) -> list[_Point]:
    """Return the model as it is, and with each number moved by its step."""
    first = {name: float(column[0]) for name, column in inputs.items()}
    moved = [{}, *({name: values[name] + step} for name, step in by.items())]
    return [
        _Point(instance, description, {**values, **change}, first, outputs, float(time[0]))
        for instance, change in zip(instances, moved, strict=True)
    ]


def _follow(
    points: Sequence[_Point],
    time: Array,
    states: Array,
    inputs: Array,
    steps: Array,
    acting: Sequence[int],
) -> Array:
    """Return (n, ny, steps) along a trajectory (n, nx); `acting` are those with an effect later."""
    here, moved = points[0], points[1:]
    begun = here.state()
    s = np.column_stack([p.state() - begun for p in moved]) / steps
    nx, identity = len(begun), np.eye(len(begun))
    rows: list[Array] = []
    for k, (t, x, u) in enumerate(zip(time.tolist(), states, inputs, strict=True)):
        here.move(t, x, u)
        row, shown = here.partials(of_outputs=True) @ s, here.shown()
        for i in acting:
            moved[i].move(t, x, u)
            row[:, i] += (moved[i].shown() - shown) / steps[i]
        rows.append(row)
        if k + 1 == len(time):
            break
        h, middle = float(time[k + 1] - t), 0.5 * (x + states[k + 1])
        here.move(t + h / 2, middle, u)
        a, rates = here.partials(of_outputs=False), here.rates()
        b = np.zeros((nx, len(steps)))
        for i in acting:
            moved[i].move(t + h / 2, middle, u)
            b[:, i] = (moved[i].rates() - rates) / steps[i]
        s = np.linalg.solve(identity - h / 2 * a, (identity + h / 2 * a) @ s + h * b)
    return np.array(rows)


def _address(numbers: Array) -> Any:
    return numbers.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
