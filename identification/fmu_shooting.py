"""Windowed simulation of an FMU, with sensitivities.

By differences of whole runs; of an FMU for Model Exchange alone, by its directional derivatives.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from fmus.black_box import BlackBox
from fmus.guarded import open_plant
from fmus.running import simulate, start_names
from fmus.variational import has_sensitivities, sensitivities
from foundation.errors import FmuError
from identification.problem import Matrix, Vector
from identification.shooting import Response

_STEP = 1e-4
"""Of the differences, relative: its error is far below what a fit notices, and still well above
the errors of the FMU's own integrator."""
_LARGEST = 1e12


class FmuShooting:
    """An FMU for windowed simulation; the counterpart of `Shooting`.

    A foreign FMU runs in a child process, which ends with this object.

    Args:
        model: The FMU.
        output_names: Measured variables, in the order of the answer.
        sensitive: Parameters with respect to which sensitivities are wanted.

    Raises:
        FmuError: It does not load.
    """

    def __init__(
        self, model: BlackBox, output_names: Sequence[str], sensitive: Sequence[str]
    ) -> None:
        self.model = model
        self.output_names = tuple(output_names)
        self.sensitive = tuple(sensitive)
        self._starts = start_names(model.fmu)
        self.state_names = tuple(self._starts)
        self.nx = len(self.state_names)
        self.parameter_names = tuple(
            v.name for v in model.parameters if v.name not in set(self._starts.values())
        )
        self.input_names = tuple(v.name for v in model.inputs)
        self.failure: FmuError | None = None
        self._has_run = False
        self._plant: Any = None

    @property
    def measured_states(self) -> Mapping[int, tuple[int, float]]:
        """State → (output, 1) where a state is an output."""
        return {
            i: (self.output_names.index(name), 1.0)
            for i, name in enumerate(self.state_names)
            if name in self.output_names
        }

    @property
    def rate_of(self) -> Mapping[str, str]:
        """Nothing: an FMU does not say which state is another's derivative."""
        return {}

    @property
    def begins_anywhere(self) -> bool:
        """Not if no state can be set: an FMU does not say whether it has any."""
        return self.nx > 0

    def parameter_vector(self, values: Mapping[str, float]) -> Vector:
        """Return the (np,) vector of all parameters that are no start values."""
        return np.array([values[name] for name in self.parameter_names], dtype=float)

    def inputs_with_delays(self, inputs: Matrix, h: float, p: Vector) -> Matrix:
        """Return the inputs: delays are inside the FMU."""
        del h, p
        return np.ascontiguousarray(inputs, dtype=float)

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
        """Simulate one window; inputs are held over a sample. See `Shooting.run`.

        Raises:
            FmuError: The FMU refuses the very first run.
        """
        n, ny = len(inputs), len(self.output_names)
        outputs = self._outputs(x0, inputs, p, h, t0)
        small = np.all(np.abs(outputs) < _LARGEST, axis=1)
        finite = n if np.all(small) else int(np.argmin(small))
        outputs[finite:] = np.nan
        columns = self.nx + len(self.sensitive)
        if not sensitivities:
            return Response(outputs, np.zeros((0, ny, columns)), finite)
        if self._has_derivatives and finite == n:
            return Response(outputs, self._derivatives(x0, inputs, p, h, t0), finite)
        changes = np.zeros((n, ny, columns))
        for k in range(columns):
            moved_x0, moved_p = x0.copy(), p.copy()
            vector, place = (
                (moved_x0, k)
                if k < self.nx
                else (moved_p, self.parameter_names.index(self.sensitive[k - self.nx]))
            )
            step = _STEP * (abs(vector[place]) or 1.0)
            vector[place] += step
            changes[:, :, k] = (self._outputs(moved_x0, inputs, moved_p, h, t0) - outputs) / step
        return Response(outputs, np.where(np.isfinite(changes), changes, 0.0), finite)

    @cached_property
    def _has_derivatives(self) -> bool:
        # Of Co-Simulation, differences of runs are quicker: the FMU's own steps are compiled.
        return "CoSimulation" not in self.model.kinds and has_sensitivities(self.model.fmu)

    def _derivatives(self, x0: Vector, inputs: Matrix, p: Vector, h: float, t0: float) -> Matrix:
        values = self._values(x0, p)
        starts = list(self._starts.values())
        _, found = sensitivities(
            self.model.fmu,
            time=t0 + h * np.arange(len(inputs), dtype=np.float64),
            inputs=dict(zip(self.input_names, inputs.T, strict=True)),
            values=values,
            by={n: _STEP * (abs(values[n]) or 1.0) for n in (*starts, *self.sensitive)},
            starts=starts,
            outputs=self.output_names,
        )
        return found

    def _values(self, x0: Vector, p: Vector) -> dict[str, float]:
        values = {
            name: value
            for name, value in zip(self.parameter_names, p.tolist(), strict=True)
            if name in self.sensitive or value != self.model.parameter_values[name]
        }
        return {**values, **dict(zip(self._starts.values(), x0.tolist(), strict=True))}

    def _outputs(self, x0: Vector, inputs: Matrix, p: Vector, h: float, t0: float) -> Matrix:
        values = self._values(x0, p)
        time = t0 + h * np.arange(len(inputs))
        signals = (time, dict(zip(self.input_names, inputs.T, strict=True)))
        try:
            columns = self._simulated(values, signals, h)
        except FmuError as error:
            self._close()
            if not self._has_run:
                raise
            self.failure = error
            return np.full((len(inputs), len(self.output_names)), np.nan)
        self._has_run = True
        return np.column_stack([columns[name] for name in self.output_names])

    def _simulated(self, values: Mapping[str, float], signals: Any, h: float) -> Any:
        time, driven = signals
        ends: dict[str, Any] = {"stop": float(time[-1]), "step": None if driven else h}
        if "CoSimulation" not in self.model.kinds:
            return simulate(
                self.model.fmu,
                inputs=signals if driven else None,
                parameters=values,
                start=float(time[0]),
                outputs=self.output_names,
                **ends,
            )
        if self._plant is None:
            self._plant = open_plant(self.model.fmu, outputs=self.output_names)
            weakref.finalize(self, self._plant.close)
        first = {name: float(column[0]) for name, column in driven.items()}
        self._plant.reset({**values, **first}, start=float(time[0]))
        return self._plant.run(signals if driven else None, **ends)

    def _close(self) -> None:
        """A plant that has failed is not used again."""
        if self._plant is not None:
            self._plant.close()
            self._plant = None
