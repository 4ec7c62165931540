"""The loop of FMI 2.0 Model Exchange around SUNDIALS' CVODE, as FMPy carries it.

Unlike FMPy's own loop it takes thousands of input samples without searching them all at each step,
and follows linear inputs between samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from fmpy.sundials import CVodeSolver

from fmus.co_simulation import Calls, communication_points, initialise, sampled

Array: TypeAlias = npt.NDArray[np.float64]

_SHORTEST = 1e-13  # of a step that CVODE is asked for, relative to time
_MOST_STEPS = 100_000  # of CVODE between two communication points


def run_model_exchange(
    instance: Any,
    description: Any,
    grid: Array,
    signals: tuple[Array, Mapping[str, Array]] | None,
    values: Mapping[str, float],
    outputs: Sequence[str],
    hold: str,
    tolerance: float,
) -> Array:
    """Run one instance over a grid of times.

    Args:
        instance: A fresh FMU2Model of FMPy.
        description: FMPy's model description.
        grid: Times of the result, shape (n,) [s].
        signals: Time and columns of the inputs.
        values: Parameters and start values.
        outputs: Variables to record.
        hold: `zero-order` or `linear`.
        tolerance: Relative tolerance of the integrator.

    Returns:
        Shape (n, number of outputs).

    Raises:
        FmuError: A call did not succeed.
        InputError: A value cannot be set.
        Exception: CVODE or FMPy gave up; the kind of exception is theirs.
    """
    points = communication_points(grid, signals)
    held, slopes = sampled(points, signals, hold, can_interpolate=True)
    names = list(signals[1]) if signals is not None else []
    initialise(
        instance,
        description,
        values,
        start=float(grid[0]),
        stop=float(grid[-1]),
        tolerance=tolerance,
        inputs=dict(zip(names, held[0].tolist(), strict=True)),
    )
    calls = Calls(instance, description, names, outputs)
    inputs = _Inputs(calls, points, held, follows=slopes is not None)
    next_event = settle(instance)

    def set_time(time: float) -> None:
        instance.setTime(time)
        inputs.apply(time)

    solver = CVodeSolver(
        nx=description.numberOfContinuousStates,
        nz=description.numberOfEventIndicators,
        get_x=instance.getContinuousStates,
        set_x=instance.setContinuousStates,
        get_dx=instance.getDerivatives,
        get_z=instance.getEventIndicators,
        get_nominals=instance.getNominalsOfContinuousStates,
        set_time=set_time,
        input=inputs,
        startTime=float(grid[0]),
        maxStep=float(grid[-1] - grid[0]) / 50,
        relativeTolerance=tolerance,
        maxNumSteps=_MOST_STEPS,
    )
    is_recorded = np.zeros(points.size, bool)
    is_recorded[np.searchsorted(points, grid)] = True
    result = np.empty((grid.size, len(outputs)))
    row = 0
    time = float(points[0])
    for k, target in enumerate(points.tolist()):
        while time < target:
            stop = min(target, max(next_event, time))
            found = False
            if stop - time > _SHORTEST * max(1.0, abs(stop)):
                found, _, time = solver.step(time, stop)
            else:
                time = stop
            set_time(time)
            instance.completedIntegratorStep()
            if found or time >= next_event:
                instance.enterEventMode()
                next_event = settle(instance)
                solver.reset(time)
        if inputs.jumps_at(k):
            instance.enterEventMode()
            inputs.move_to(k)
            next_event = settle(instance)
            solver.reset(time)
        if is_recorded[k]:
            calls.get_outputs(result, row)
            row += 1
    return result


def settle(instance: Any) -> float:
    """Iterate an event to its end; return the time of the next one, or infinity."""
    while True:
        needed, terminates, _, _, is_defined, time = instance.newDiscreteStates()
        if terminates:
            raise RuntimeError("the FMU ended the simulation")
        if not needed:
            instance.enterContinuousTimeMode()
            return float(time) if is_defined else np.inf


class _Inputs:
    """Inputs at any time: held from one communication point to the next, or joined by lines."""

    def __init__(self, calls: Calls, points: Array, held: Array, *, follows: bool) -> None:
        self._calls = calls
        self._points = points
        self._held = held
        self._follows = follows and held.shape[1] > 0
        self._now = np.empty((1, held.shape[1]))

    def apply(self, time: float) -> None:
        """Set continuous inputs for a trial of the integrator."""
        if self._follows:
            for column in range(self._held.shape[1]):
                self._now[0, column] = np.interp(time, self._points, self._held[:, column])
            self._calls.set_inputs(self._now, 0)

    def jumps_at(self, k: int) -> bool:
        """Whether held inputs change at point `k`."""
        if self._follows or k == 0 or self._held.shape[1] == 0:
            return False
        return bool(np.any(self._held[k] != self._held[k - 1]))

    def move_to(self, k: int) -> None:
        """Set the inputs that hold from point `k` on."""
        self._calls.set_inputs(self._held, k)
