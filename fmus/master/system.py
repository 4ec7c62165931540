"""A system of connected Co-Simulation FMUs, of any FMI versions, and its simulation.

At each communication point outputs are brought to inputs until all agree (sources first; around
algebraic loops by Newton's method); then all units step. Methods:

- Jacobi: all units step from the values of the point.
- Gauss-Seidel: one after the other; each sees the new outputs of those before it.

With `order=1` connected inputs are held over a step. With `order=2` they are held at the value that
they have at the middle of the step, extrapolated from the last two points (Gauss-Seidel: the mean
of old and new value where the new is known), which makes the coupling second-order accurate.

With a tolerance, every step is done once whole and once in two halves, from a saved state; the
difference estimates the error, and the step is repeated, shorter, where it is too large.

References: Broman et al., Determinate composition of FMUs for co-simulation (2013); Schierz, Arnold
and Clauß, Co-simulation with communication step size control (2012).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from fmus.master.loops import Wiring, arrive
from fmus.master.steps import controlled_run
from fmus.plant import Plant, Value, input_table
from fmus.running import Hold, Inputs, Simulation, checked_inputs, time_grid
from fmus.stepping import UNCONNECTED, Loop, Method
from foundation.errors import InputError, UnknownNameError
from foundation.units import factor_and_offset

Array: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Component:
    """An FMU in a system.

    Attributes:
        fmu: The file.
        parameters: Values to set before the start, each with or without a unit.
    """

    fmu: Path
    parameters: Mapping[str, Value] = field(default_factory=dict[str, Value])


@dataclass(frozen=True)
class Connection:
    """From an output to an input: input = factor × output + offset.

    Attributes:
        source, target: `component.variable`, or the name of an input or output of the system.
        factor, offset: None: from the units of both ends.
    """

    source: str
    target: str
    factor: float | None = None
    offset: float | None = None


@dataclass(frozen=True)
class System:
    """Connected FMUs.

    Attributes:
        components: Name → FMU.
        connections: Between them, and from and to the system's own inputs and outputs.
        inputs: Names of the system's own inputs; every `component.variable` input that is not
            connected is one too.
        outputs: Name of the system's own outputs; default: all outputs of all components.
        name: For messages.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> fmu = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
        >>> two = System(
        ...     {"a": Component(fmu, {"theta_start": 0.1}), "b": Component(fmu)},
        ...     [Connection("a.theta", "b.tau", factor=0.1, offset=0.0)],
        ... )
        >>> sorted(two.simulate(stop=0.1, step=0.01).columns)
        ['a.omega', 'a.theta', 'b.omega', 'b.theta']
    """

    components: Mapping[str, Component]
    connections: Sequence[Connection] = ()
    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    name: str = "system"

    def simulate(
        self,
        *,
        inputs: Inputs | None = None,
        parameters: Mapping[str, Value] | None = None,
        start: float | None = None,
        stop: float | None = None,
        step: float | None = None,
        method: Method = "jacobi",
        order: int = 1,
        tolerance: float | None = None,
        hold: Hold = "zero-order",
    ) -> Simulation:
        """Run the system, in this process.

        Args:
            inputs: Time (n,) [s] and columns (n,) of the system's inputs.
            parameters: `component.variable` → value.
            start, stop: [s]; default: the span of the inputs, or 0 and 10.
            step: Of communication [s], or of the result if there is a tolerance.
            method: `jacobi` or `gauss-seidel`.
            order: Of the coupling, 1 or 2.
            tolerance: Of the coupling's error over the whole run, relative to each output's
                largest value (or 1); steps are then chosen. Default: steps as given.
            hold: Of the inputs.

        Raises:
            UnknownNameError: A component, variable or parameter that is not there.
            InputError: Two sources for one input; a tolerance with FMUs that cannot save state.
            UnitError: Ends of a connection with units that do not fit.
            FmuError: An FMU does not load, refuses or fails.
        """
        if method not in ("jacobi", "gauss-seidel") or order not in (1, 2):
            raise InputError(
                f"method {method} of order {order}",
                remedy="use jacobi or gauss-seidel, of order 1 or 2",
            )
        values = self._parameters(parameters or {})
        with contextlib.ExitStack() as stack:
            first = start if start is not None else float(inputs[0][0]) if inputs else 0.0
            plants = {
                name: stack.enter_context(
                    Plant(
                        part.fmu,
                        parameters=values[name],
                        start=first,
                        with_states=tolerance is not None,
                    )
                )
                for name, part in self.components.items()
            }
            wiring = self._wiring(plants)
            signals = checked_inputs(inputs, wiring.external, Path(self.name))
            grid = time_grid(signals, first, stop, step)
            # Inputs of the system that are not driven keep the start value of what they go to.
            table, points, recorded = input_table(
                signals, grid, hold, wiring.external, wiring.external_starts
            )
            loop = Loop(
                [plant.unit(name) for name, plant in plants.items()],
                wiring.sources,
                order=wiring.order,
                factors=wiring.factors,
                offsets=wiring.offsets,
            )
            loop.u[:] = wiring.starts
            shown = list(wiring.shown.values())
            if tolerance is not None:
                result = controlled_run(
                    loop,
                    wiring,
                    list(plants.values()),
                    points,
                    table,
                    recorded,
                    shown,
                    method=method,
                    order=order,
                    tolerance=tolerance,
                )
            elif wiring.cycles:
                result = _looped_run(
                    loop,
                    wiring,
                    list(plants.values()),
                    points,
                    table,
                    recorded,
                    shown,
                    method,
                    order,
                )
            else:
                result = loop.run(
                    points, table, shown, recorded=recorded, method=method, order=order
                )
        columns = dict(zip(wiring.shown, result.T, strict=True))
        for connection in self.connections:
            if connection.target in columns and connection.factor is not None:
                columns[connection.target] = connection.factor * columns[connection.target] + (
                    connection.offset or 0.0
                )
        return Simulation(grid, columns)

    def split(self, name: str) -> tuple[str, str]:
        """Return component and variable of a full name, both of which may have dots.

        Example:
            >>> System({"inner.plant": Component(Path("p.fmu"))}).split("inner.plant.body.phi")
            ('inner.plant', 'body.phi')
        """
        parts = [part for part in self.components if name.startswith(f"{part}.")]
        part = max(parts, key=len, default="")
        return part, name.removeprefix(f"{part}.")

    def _parameters(self, extra: Mapping[str, Value]) -> dict[str, dict[str, Value]]:
        values = {name: dict(part.parameters) for name, part in self.components.items()}
        for name, value in extra.items():
            part, variable = self.split(name)
            if not part:
                raise UnknownNameError("component", name.partition(".")[0], values, where=name)
            values[part][variable] = value
        return values

    def _wiring(self, plants: Mapping[str, Plant]) -> Wiring:
        """Resolve names to places."""
        targets = {
            f"{part}.{name}": (part, name) for part, p in plants.items() for name in p.inputs
        }
        outputs = {
            f"{part}.{name}": (part, name) for part, p in plants.items() for name in p.outputs
        }
        place_of_target = {name: place for place, name in enumerate(targets)}
        place_of_output = {name: place for place, name in enumerate(outputs)}
        external = list(self.inputs)
        sources = [UNCONNECTED] * len(targets)
        factors, offsets = np.ones(len(targets)), np.zeros(len(targets))
        shown: dict[str, int] = {}
        for connection in self.connections:
            source, target = connection.source, connection.target
            if source not in place_of_output and source not in external:
                raise UnknownNameError("output", source, [*outputs, *external], where=self.name)
            if target in self.outputs and source in place_of_output:
                shown[target] = place_of_output[source]
                continue
            if target not in place_of_target:
                raise UnknownNameError("input", target, [*targets, *self.outputs], where=self.name)
            place = place_of_target[target]
            if sources[place] != UNCONNECTED:
                raise InputError(
                    f"the input '{target}' has two sources",
                    where=self.name,
                    remedy="remove one of the connections",
                )
            if source in place_of_output:
                sources[place] = place_of_output[source]
                factors[place], offsets[place] = _conversion(connection, plants, outputs, targets)
            else:
                sources[place] = -1 - external.index(source)
                factors[place] = 1.0 if connection.factor is None else connection.factor
                offsets[place] = connection.offset or 0.0
        starts = np.array([plants[part].held(name) for part, name in targets.values()])
        external_starts = [0.0] * len(external)
        for place, name in enumerate(targets):
            if sources[place] == UNCONNECTED:
                sources[place] = -1 - len(external)
                external.append(name)
                external_starts.append(float(starts[place]))
            elif sources[place] < 0 and factors[place] != 0:
                external_starts[-1 - sources[place]] = float(
                    (starts[place] - offsets[place]) / factors[place]
                )
        return Wiring(
            names=list(plants),
            inputs=[(list(plants).index(part), name) for part, name in targets.values()],
            outputs=[(list(plants).index(part), name) for part, name in outputs.values()],
            sources=sources,
            factors=factors,
            offsets=offsets,
            starts=starts,
            external=external,
            external_starts=np.array(external_starts),
            shown=shown
            or {
                name: place
                for name, place in place_of_output.items()
                if plants[outputs[name][0]].declares(outputs[name][1])
            },
            feedthrough=[plant.feedthrough() for plant in plants.values()],
        )


def _conversion(
    connection: Connection,
    plants: Mapping[str, Plant],
    outputs: Mapping[str, tuple[str, str]],
    targets: Mapping[str, tuple[str, str]],
) -> tuple[float, float]:
    if connection.factor is not None or connection.offset is not None:
        factor = 1.0 if connection.factor is None else connection.factor
        return factor, connection.offset or 0.0
    part, name = outputs[connection.source]
    given = plants[part].outputs[name].unit
    part, name = targets[connection.target]
    wanted = plants[part].inputs[name].unit
    if not given or not wanted:
        return 1.0, 0.0
    return factor_and_offset(given, wanted, where=f"{connection.source} → {connection.target}")


def _looped_run(
    loop: Loop,
    wiring: Wiring,
    plants: Sequence[Plant],
    points: Array,
    table: Array,
    recorded: npt.NDArray[np.bool_],
    shown: Sequence[int],
    method: Method,
    order: int,
) -> Array:
    """Fixed steps with algebraic loops, which Newton's method solves at each point."""
    rows: list[Any] = []
    loop.read()
    for k, time in enumerate(points.tolist()):
        arrive(loop, wiring, plants, table[k], table[k - 1] if k else None)
        if recorded[k]:
            rows.append(loop.y[list(shown)])
        if k + 1 < points.size:
            loop.advance(time, float(points[k + 1]) - time, method, order)
    return np.array(rows)
