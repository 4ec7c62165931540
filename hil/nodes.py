"""The two ends of the loop: the plant with its sensors and drives, and the controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import can

from hil.bus.codec import Layout, Packer, Unpacker
from hil.bus.dbc import REFERENCE
from hil.bus.sender import PeriodicSender
from hil.bus.statistics import Statistics
from hil.controllers.base import Controller
from hil.faults.base import SignalFault
from hil.faults.plant import ParameterChange
from hil.line import Line
from hil.sensors import Sensors
from hil.watchdog import Watchdog


class Steppable(Protocol):
    """A plant: `fmus.plant.Plant` or one in a child process."""

    def set(self, values: Mapping[str, float], /) -> None:
        """Set inputs."""
        ...

    def read(self) -> dict[str, float]:
        """Read outputs."""
        ...

    def step(self, length: float, /) -> None:
        """Advance."""
        ...


@dataclass
class PlantNode:
    """The plant: takes commands, sends what its sensors say, moves on.

    Commands that have come by the start of a cycle act during the whole cycle: an answer to the
    sensors of one cycle acts from the next on, however fast it was.

    Attributes:
        plant: Stepped.
        inputs, outputs: Its variables.
        line: Its end of the bus.
        sensors: Of its outputs.
        packers: Of the sensors' messages.
        references: Packers of the references' messages.
        unpacker: Of the commands' messages.
        watchdog: Over the commands.
        safe: Values of the inputs while commands are missing.
        step: Period of messages for which the DBC says none [s].
        sensor_faults, actuator_faults: By signal.
        changes: Of parameters, and the values that these have otherwise.
    """

    plant: Steppable
    inputs: Sequence[str]
    outputs: Sequence[str]
    line: Line
    sensors: Sensors
    packers: Sequence[Packer]
    references: Sequence[Packer]
    unpacker: Unpacker
    watchdog: Watchdog
    safe: Mapping[str, float]
    step: float
    sensor_faults: Sequence[SignalFault] = ()
    actuator_faults: Sequence[SignalFault] = ()
    changes: Sequence[tuple[ParameterChange, float]] = ()

    def __post_init__(self) -> None:
        self.commands = dict(self.safe)
        self.applied = dict(self.safe)
        self.true: dict[str, float] = {}
        self.seen: dict[str, float] = {}
        self.is_safe = False
        self.heard = 0
        self._reference: Mapping[str, float] = {}
        self._sender = self._schedule()

    @property
    def statistics(self) -> Statistics:
        """Counts of this node."""
        return self.unpacker.statistics

    def begin(self, zero: float) -> None:
        """Begin the run at the clock's time `zero` [s], with the safe commands."""
        self.line.zero = zero
        self.line.is_faulty = True
        self.commands = dict(self.safe)
        self.watchdog.feed(0.0)
        self._sender = self._schedule()

    def _schedule(self) -> PeriodicSender:
        sender = PeriodicSender(self.line.send, self.statistics)
        for packer in self.references:
            period = packer.layout.period or self.step
            sender.add(period, lambda now, p=packer: p.pack(self._reference, time=now))
        for packer in self.packers:
            period = packer.layout.period or self.step
            sender.add(period, lambda now, p=packer: p.pack(self.seen, time=now))
        return sender

    def listen(self, now: float) -> None:
        """Take the commands that have come."""
        for arrival, frame in self.line.take(now):
            reading = self.unpacker.unpack(frame, arrival)
            if reading is not None and reading.values:
                self.commands.update(reading.values)
                self.watchdog.feed(arrival)
                self.heard += 1

    def speak(self, now: float, reference: Mapping[str, float]) -> None:
        """Send what the sensors say, and the references."""
        self.line.flush(now)
        self.true = self.plant.read()
        read = self.sensors.read([self.true[name] for name in self.outputs])
        self.seen = dict(zip(self.outputs, read, strict=True))
        for fault in self.sensor_faults:
            self.seen[fault.signal] = fault.value(self.seen[fault.signal], now)
        self._reference = reference
        self._sender.send_due(now)

    def move(self, now: float, length: float, disturbance: Mapping[str, float]) -> None:
        """Advance by `length` [s] with the commands in force, or the safe ones if they are old."""
        self.is_safe = self.watchdog.barks(now)
        self.applied = dict(self.safe if self.is_safe else self.commands)
        for fault in self.actuator_faults:
            self.applied[fault.signal] = fault.value(self.applied[fault.signal], now)
        for name, value in disturbance.items():
            self.applied[name] += value
        changed = {change.parameter: change.value(usual, now) for change, usual in self.changes}
        self.plant.set({**self.applied, **changed})
        self.plant.step(length)


@dataclass
class ControllerNode:
    """A controller in this process: takes what the sensors say, sends commands.

    Attributes:
        controller: The law.
        bus: Its end of the bus.
        unpacker: Of the sensors' and references' messages.
        packers: Of the commands' messages.
        watchdog: Over the sensors: while they are silent the safe commands are sent.
        safe: These.
        sensor_layouts: Messages without which it is blind.
    """

    controller: Controller
    bus: can.BusABC
    unpacker: Unpacker
    packers: Sequence[Packer]
    watchdog: Watchdog
    safe: Mapping[str, float]
    sensor_layouts: Sequence[Layout]

    def __post_init__(self) -> None:
        self.values: dict[str, float] = {}
        self.is_safe = False
        self._ticks = 0
        self._wanted = {layout.message.name for layout in self.sensor_layouts}
        self._fed: dict[str, float] = {}
        self.controller.start()

    def begin(self) -> None:
        """Begin the run at time zero, knowing nothing."""
        self.values.clear()
        self._fed.clear()
        self._ticks = 0
        self.controller.start()

    def cycle(self, now: float) -> None:
        """Take what has come; step if it is time for it."""
        while (frame := self.bus.recv(0.0)) is not None:
            reading = self.unpacker.unpack(frame, now)
            if reading is not None and reading.values:
                self.values.update(reading.values)
                self._fed[reading.message] = now
        if now < self._ticks * self.controller.period - 1e-9:
            return
        if self._wanted <= self._fed.keys():
            # Fed by the stalest of its messages: one sensor that is silent is enough.
            self.watchdog.feed(min(self._fed[name] for name in self._wanted))
        controller = self.controller
        if any(name not in self.values for name in controller.measured):
            return
        self._ticks = int(now / controller.period + 1e-6) + 1
        self.is_safe = self.watchdog.barks(now)
        if self.is_safe:
            commands = {name: self.safe[name] for name in controller.commanded}
        else:
            y = [self.values[name] for name in controller.measured]
            r = [self.values.get(f"{name}{REFERENCE}", 0.0) for name in controller.measured]
            u = controller.step(now, y, r)
            commands = dict(zip(controller.commanded, u, strict=True))
        for packer in self.packers:
            try:
                self.bus.send(packer.pack(commands, time=now), timeout=0.0)
            except can.CanError:
                self.unpacker.statistics.not_sent += 1
            else:
                self.unpacker.statistics.sent += 1
