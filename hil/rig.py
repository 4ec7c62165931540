"""A scenario put together and run: bus, plant, controller, faults, recording."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np

from fmus.guarded import open_plant
from foundation.errors import TwinproofError
from foundation.progress import Progress, silent
from hil.bus.bridge import bridged_terminals
from hil.bus.codec import Packer, Unpacker
from hil.bus.interface import open_bus
from hil.bus.statistics import Statistics
from hil.clock import RealClock, VirtualClock
from hil.controllers import FmuController
from hil.criteria import Evidence, Verdict
from hil.faults import FrameFault, SignalFault
from hil.faults.plant import ParameterChange
from hil.faults.signals import MotorFailure, SupplySag
from hil.frame_log import FrameLog
from hil.line import Line, Listener
from hil.loop import Loop, LoopResult, Trace
from hil.nodes import ControllerNode, PlantNode
from hil.process import running
from hil.recorded import check_suffix, write_recording
from hil.scenario import Scenario
from hil.sensors import Sensors
from hil.watchdog import Watchdog

_VIRTUAL_START = 1e9
"""Time of day at which virtual runs begin [s since 1970]: the same for all, so that logs are."""
_SPARE = 1.25
_number = itertools.count()


@dataclass(frozen=True, eq=False)
class HilResult:
    """What came of a scenario.

    Attributes:
        scenario: That was run.
        loop: Trace, deadlines, jitter, latency.
        verdicts: One a criterion.
        plant, controller: Counts of frames; the latter None for another process.
        faults: (kind, how often it happened) of each.
        safe: Spans in which the plant was in its safe state [s].
        recording: What went over the bus.

    Example:
        >>> import tempfile
        >>> from hil.scenario import read_scenario
        >>> text = '''
        ... [plant]
        ... model = "Twinproof.Plants.Pendulum"
        ... [controller]
        ... kind = "pid"
        ... measured = ["theta"]
        ... commanded = ["tau"]
        ... period = "5 ms"
        ... proportional = 6.0
        ... derivative = 0.8
        ... [references.theta]
        ... kind = "step"
        ... at = 0.1
        ... after = "10 deg"
        ... [[criteria]]
        ... kind = "limit"
        ... signal = "theta"
        ... high = "15 deg"
        ... [run]
        ... duration = 1.0
        ... step = "1 ms"
        ... '''
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "step.toml"
        ...     _ = path.write_text(text)
        ...     result = run_scenario(read_scenario(path))
        >>> result.passed, result.loop.missed
        (True, 0)
    """

    scenario: Scenario
    loop: LoopResult
    verdicts: tuple[Verdict, ...]
    plant: Statistics
    controller: Statistics | None
    faults: tuple[tuple[str, int], ...]
    safe: tuple[tuple[float, float], ...]
    recording: Path

    @property
    def passed(self) -> bool:
        """Whether all criteria are met."""
        return all(v.passed for v in self.verdicts)

    @property
    def trace(self) -> Trace:
        """What happened."""
        return self.loop.trace


def run_scenario(
    scenario: Scenario,
    *,
    recording: Path | None = None,
    stop: threading.Event | None = None,
    listener: Listener | None = None,
    progress: Progress = silent,
) -> HilResult:
    """Run a scenario once.

    Args:
        scenario: From `read_scenario`.
        recording: File for what went over the bus, in place of the scenario's.
        stop: When it is set the run ends; criteria about what was to come are not met.
        listener: Told every frame that the plant sends or takes, with the time of day of its cycle,
            as an interface with a clock of its own would say it at the plant's plug.
        progress: Told what is being done.

    Raises:
        BusError: The bus is absent, or the controller silent.
        TwinproofError: The plant or the controller failed while running; the recording up to then
            is written, and the message says where.
        InputError: The recording's suffix is not known.
        OSError: The recording cannot be written.
    """
    target = scenario.recording if recording is None else recording
    check_suffix(target)
    progress("preparing plant and controller")
    with contextlib.ExitStack() as stack:
        rig = _assemble(scenario, stack, listener)
        progress(f"running {scenario.run.duration:g} s")
        began = _VIRTUAL_START if scenario.run.clock == "virtual" else time.time()
        try:
            rig.loop.run(stop)
        except TwinproofError as error:
            error.remedy = f"{error.remedy}; {_left(scenario, rig, target, began)}".lstrip("; ")
            raise
        except BaseException:
            _left(scenario, rig, target, began)
            raise
    progress("writing the recording")
    result = rig.loop.result
    result.trace = result.trace.cut()
    write_recording(target, scenario, result.trace, rig.log, began)
    return _judged(scenario, rig, target)


@dataclass(frozen=True, eq=False)
class _Rig:
    loop: Loop
    log: FrameLog
    plant: PlantNode
    controller: ControllerNode | None


def _left(scenario: Scenario, rig: _Rig, target: Path, began: float) -> str:
    """Write what there is of a run that failed, and say so."""
    trace = rig.loop.result.trace.cut()
    if not len(rig.log):
        return "nothing was recorded"
    try:
        write_recording(target, scenario, trace, rig.log, began)
    except (OSError, TwinproofError) as error:
        return f"the recording could not be written: {error}"
    return f"the recording up to then is {target}"


def _judged(scenario: Scenario, rig: _Rig, target: Path) -> HilResult:
    result = rig.loop.result
    trace = result.trace
    counts = rig.plant.statistics
    counts.error_frames += getattr(rig.plant.line.bus, "malformed", 0)
    if rig.log.left_out:
        result.notes.append(f"{rig.log.left_out} frames had no room in the recording")
    ends = [counts] if rig.controller is None else [counts, rig.controller.unpacker.statistics]
    evidence = Evidence(
        trace.time,
        trace.columns,
        trace.safe,
        scenario.run.duration,
        scenario.run.step,
        sum(end.dropped for end in ends),
        result.missed,
    )
    return HilResult(
        scenario,
        result,
        tuple(criterion.judge(evidence) for criterion in scenario.criteria),
        counts,
        None if rig.controller is None else rig.controller.unpacker.statistics,
        tuple((fault.kind, fault.happened) for fault in scenario.faults),
        tuple(rig.plant.watchdog.spans),
        target,
    )


def _assemble(scenario: Scenario, stack: contextlib.ExitStack, listener: Listener | None) -> _Rig:
    run, messages, bus_table = scenario.run, scenario.messages, scenario.bus
    for fault in scenario.faults:
        fault.reset()
    plant_channel, controller_channel = _channels(scenario, stack)
    bus = stack.enter_context(open_bus(bus_table.settings(plant_channel)))
    plant = stack.enter_context(
        open_plant(scenario.plant.fmu, parameters=dict(scenario.plant.parameters))
    )
    inputs = [p.name for p in scenario.plant.inputs]
    outputs = [p.name for p in scenario.plant.outputs]
    safe = {name: float(bus_table.safe.get(name, 0.0)) for name in inputs}
    frames = len(messages.sensors) + len(messages.references) + 2 * len(messages.actuators)
    log = FrameLog(int(_SPARE * frames * run.cycles) + 1000)
    statistics = Statistics()
    clock = VirtualClock() if run.clock == "virtual" else RealClock(run.spin)
    line = Line(
        bus,
        clock,
        statistics,
        faults=[f for f in scenario.faults if isinstance(f, FrameFault)],
        names={m.frame_id: m.name for m in messages.database.messages},
        log=log,
        listener=listener,
    )
    unpacker = Unpacker(messages.actuators, statistics)
    unpacker.know(messages.database.messages)
    of_signals = [f for f in scenario.faults if isinstance(f, SignalFault)]
    actuator_faults = [f for f in of_signals if isinstance(f, MotorFailure | SupplySag)]
    plant_node = PlantNode(
        plant,
        inputs,
        outputs,
        line,
        Sensors(outputs, scenario.plant.sensors, seed=run.seed),
        [Packer(layout) for layout in messages.sensors],
        [Packer(layout) for layout in messages.references],
        unpacker,
        Watchdog(bus_table.timeout),
        safe,
        run.step,
        sensor_faults=[f for f in of_signals if f not in actuator_faults],
        actuator_faults=actuator_faults,
        changes=[
            (f, scenario.plant.value(f.parameter))
            for f in scenario.faults
            if isinstance(f, ParameterChange)
        ],
    )
    node: ControllerNode | None = None
    if scenario.controller is not None:
        node = _controller_node(scenario, stack, controller_channel, safe)
        # The DBC says how often a command may come; the law knows how often it does.
        unpacker.period = max(node.controller.period, run.step)
    elif scenario.process is not None:
        stack.enter_context(running(scenario.process, controller_channel))
    times = run.step * np.arange(run.cycles, dtype=np.float64)
    rng = np.random.default_rng([run.seed, 1])
    loop = Loop(
        run,
        clock,
        plant_node,
        node,
        {name: wave.values(times, rng) for name, wave in scenario.references.items()},
        {name: wave.values(times, rng) for name, wave in scenario.disturbances.items()},
    )
    return _Rig(loop, log, plant_node, node)


def _controller_node(
    scenario: Scenario, stack: contextlib.ExitStack, channel: str, safe: Mapping[str, float]
) -> ControllerNode:
    assert scenario.controller is not None
    messages = scenario.messages
    controller = scenario.controller()
    if isinstance(controller, FmuController):
        stack.callback(controller.close)
    bus: can.BusABC = stack.enter_context(open_bus(scenario.bus.settings(channel)))
    unpacker = Unpacker([*messages.sensors, *messages.references], Statistics())
    unpacker.know(messages.database.messages)
    needed = [
        layout
        for layout in messages.sensors
        if any(f.variable in controller.measured for f in layout.fields)
    ]
    commanded = [
        layout
        for layout in messages.actuators
        if any(f.variable in controller.commanded for f in layout.fields)
    ]
    timeout = max(scenario.bus.timeout, 2 * scenario.run.step)
    return ControllerNode(
        controller,
        bus,
        unpacker,
        [Packer(layout) for layout in commanded],
        Watchdog(timeout),
        safe,
        needed,
    )


def _channels(scenario: Scenario, stack: contextlib.ExitStack) -> tuple[str, str]:
    """Return the names of both ends of the bus."""
    bus = scenario.bus
    if bus.interface == "slcan" and bus.channel in ("", "bridge"):
        return stack.enter_context(bridged_terminals())
    if bus.interface == "virtual" and not bus.channel:
        own = f"twinproof-{os.getpid()}-{next(_number)}"
        return own, own
    return bus.channel, bus.channel
