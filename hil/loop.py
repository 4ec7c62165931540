"""The loop in real or virtual time: cycles at absolute deadlines, what they saw, and jitter."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from foundation.errors import BusError, ComputationError, InputError
from hil.bus.dbc import REFERENCE
from hil.clock import Clock, RealClock
from hil.nodes import ControllerNode, PlantNode
from hil.real_time import Histogram, real_time
from hil.settings import unit

Array: TypeAlias = npt.NDArray[np.float64]
Overrun: TypeAlias = Literal["catch-up", "slip", "stop"]


@dataclass(frozen=True, kw_only=True)
class LoopSettings:
    """How the loop runs.

    Attributes:
        duration: [s].
        step: Of the plant and of the bus [s].
        clock: `virtual` (deterministic, as fast as it goes) or `real`.
        overrun: What happens after a missed deadline: `catch-up` does the late cycles as fast as
            it can and keeps the deadlines; `slip` moves all later ones; `stop` ends the run.
        spin: Last part of a wait that is spent asking for the time [s].
        cpu: Processor to stay on.
        priority: Real-time priority, 1 to 99, where permitted.
        silence: How long to wait for the controller's first command [s].
        seed: Of the sensors' noise and the disturbances.

    Raises:
        InputError: A duration or a step that makes no sense.
    """

    duration: float = unit("s", 10.0)
    step: float = unit("s", 1e-3)
    clock: Literal["virtual", "real"] = "virtual"
    overrun: Overrun = "catch-up"
    spin: float = unit("s", 250e-6)
    cpu: int | None = None
    priority: int | None = None
    silence: float = unit("s", 5.0)
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.step <= self.duration < 1e7:
            raise InputError(
                f"a step of {self.step:g} s in a run of {self.duration:g} s",
                where="run",
                remedy="choose a step that is positive and shorter than the run",
            )
        if self.spin < 0 or self.silence <= 0:
            raise InputError("spin or silence is negative", where="run", remedy="give times in s")

    @property
    def cycles(self) -> int:
        """How many."""
        return round(self.duration / self.step)


@dataclass(eq=False)
class Trace:
    """What happened, one row a cycle; complete up to `count`.

    Attributes:
        time: (n,) [s].
        columns: Name → (n,): outputs as they are, inputs as applied, `measured.<output>`,
            `command.<input>`, `reference.<output>`.
        safe: (n,) whether the plant was in its safe state.
        modes: (n,) which of `mode_names` the controller was in.
        count: Cycles that were done.
    """

    time: Array
    columns: dict[str, Array]
    safe: npt.NDArray[np.bool_]
    modes: npt.NDArray[np.uint8]
    mode_names: list[str]
    count: int = 0

    def cut(self) -> Trace:
        """Return only the cycles that were done."""
        n = self.count
        columns = {name: column[:n] for name, column in self.columns.items()}
        return Trace(
            self.time[:n], columns, self.safe[:n], self.modes[:n], list(self.mode_names), n
        )


@dataclass(eq=False)
class LoopResult:
    """How a run went.

    Attributes:
        trace: What happened.
        missed: Deadlines that were missed.
        jitter: Of waking up.
        latency: From the sensors' frames to the answer; empty in virtual time.
        notes: What was not permitted or not possible.
    """

    trace: Trace
    missed: int
    jitter: Histogram
    latency: Histogram
    notes: list[str]


class Loop:
    """Plant and controller, ready to run.

    Args:
        settings: How.
        clock: What time it is.
        plant: One end.
        controller: The other; None if it is another process.
        references: Output → (n,) what it should be.
        disturbances: Input → (n,) what is added.
    """

    def __init__(
        self,
        settings: LoopSettings,
        clock: Clock,
        plant: PlantNode,
        controller: ControllerNode | None,
        references: Mapping[str, Array],
        disturbances: Mapping[str, Array],
    ) -> None:
        self.settings = settings
        self.clock = clock
        self.plant = plant
        self.controller = controller
        self._references = {name: column.tolist() for name, column in references.items()}
        self._disturbances = {name: column.tolist() for name, column in disturbances.items()}
        n = settings.cycles
        node = plant
        names = [
            *node.outputs,
            *node.inputs,
            *(f"measured.{name}" for name in node.outputs),
            *(f"command.{name}" for name in node.inputs),
            *(f"reference.{name}" for name in references),
        ]
        # Filled, not only reserved: memory that is first touched in the loop would be waited for.
        self._table = np.full((n, len(names)), np.nan)
        modes = np.full(n, 0, np.uint8)
        self.result = LoopResult(
            Trace(
                settings.step * np.arange(n, dtype=np.float64),
                dict(zip(names, self._table.T, strict=True)),
                np.full(n, False),
                modes,
                [""],
            ),
            0,
            Histogram(),
            Histogram(),
            [],
        )

    def run(self, stop: threading.Event | None = None) -> LoopResult:
        """Run to the end; the result is there even if this fails.

        Args:
            stop: When it is set, this is the end.

        Raises:
            BusError: The controller is silent from the beginning.
            ComputationError: A deadline was missed and `overrun` is `stop`.
            TwinproofError: The plant or the controller failed.
        """
        settings = self.settings
        with real_time(settings.cpu, settings.priority) as notes:
            self.result.notes += notes
            self._introduce()
            self._cycles(stop or threading.Event())
        return self.result

    def _introduce(self) -> None:
        """Send the first sensors until the controller answers; then the run's time begins."""
        first = {f"{name}{REFERENCE}": column[0] for name, column in self._references.items()}
        named = {f"{name}{REFERENCE}": 0.0 for name in self.plant.outputs} | first
        step, plant, controller = self.settings.step, self.plant, self.controller
        for k in range(max(1, round(self.settings.silence / step))):
            now = k * step
            plant.line.wait_until(now)
            plant.listen(now)
            if plant.heard:
                break
            plant.speak(now, named)
            if controller is not None:
                controller.cycle(now)
        else:
            raise BusError(
                f"the controller is silent: no valid command within {self.settings.silence:g} s",
                where=self._silence(),
                remedy="start it, and compare its identifiers, period and E2E profile with the DBC",
            )
        # The first cycles are slow, and the introduction may run late: the run begins on time.
        plant.begin(max(now, plant.line.now()) + step)
        if controller is not None:
            controller.begin()

    def _silence(self) -> str:
        counts = self.plant.statistics
        return (
            f"{counts.received} frames came, {counts.unknown} of them not in the DBC, "
            f"{counts.wrong_checksum} with a wrong checksum"
        )

    def _cycles(self, stop: threading.Event) -> None:
        settings, plant, controller = self.settings, self.plant, self.controller
        result, trace = self.result, self.result.trace
        step, line = settings.step, plant.line
        is_real = isinstance(self.clock, RealClock)
        references = list(self._references.items())
        disturbances = list(self._disturbances.items())
        outputs, inputs = list(plant.outputs), list(plant.inputs)
        reference = {f"{name}{REFERENCE}": 0.0 for name in outputs}
        for k in range(settings.cycles):
            if stop.is_set():
                return
            now = k * step
            line.wait_until(now)
            if is_real:
                result.jitter.add(line.now() - now)
                if k and (answered := line.answered) is not None:
                    result.latency.add(answered)
            plant.listen(now)
            for name, column in references:
                reference[f"{name}{REFERENCE}"] = column[k]
            line.ask()
            plant.speak(now, reference)
            plant.move(now, step, {name: column[k] for name, column in disturbances})
            if controller is not None:
                controller.cycle(now)
                if controller.controller.mode:
                    trace.modes[k] = _mode(trace.mode_names, controller.controller.mode)
            self._table[k] = [
                *[plant.true[name] for name in outputs],
                *[plant.applied[name] for name in inputs],
                *[plant.seen[name] for name in outputs],
                *[plant.commands[name] for name in inputs],
                *[column[k] for _, column in references],
            ]
            trace.safe[k] = plant.is_safe
            trace.count = k + 1
            if is_real and (late := line.now() - now - step) > 0:
                result.missed += 1
                self._overrun(now + step, late)

    def _overrun(self, deadline: float, late: float) -> None:
        if self.settings.overrun == "slip":
            self.plant.line.zero += late
        if self.settings.overrun == "stop":
            raise ComputationError(
                f"the deadline at {deadline:.6g} s was missed by {1e6 * late:.0f} µs",
                where="run.overrun = 'stop'",
                remedy="give the plant a longer step, or the loop a processor of its own",
            )


def _mode(names: list[str], mode: str) -> int:
    if mode not in names:
        names.append(mode)
    return names.index(mode)
