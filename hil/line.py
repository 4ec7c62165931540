"""The plant's end of the bus, where faults strike and everything is logged."""

from __future__ import annotations

import heapq
import select
import time
from collections.abc import Callable, Sequence
from typing import TypeAlias

import can

from hil.bus.statistics import Statistics
from hil.clock import Clock, RealClock
from hil.faults.base import Delivery, FrameFault
from hil.frame_log import FrameLog

Listener: TypeAlias = Callable[[float, can.Message], None]
_BLIND = 80e-6  # [s] before a deadline in which nothing is read


class Line:
    """Sends and takes frames, and does to them what the faults say.

    Faults strike here for both ends, so that they are the same whether the controller is in this
    process or another.

    Args:
        bus: The plant's.
        clock: Of the loop.
        statistics: Counts what is sent.
        faults: Of frames.
        names: Message of each identifier, for faults that strike one message only.
        log: Frames that went through, from both ends.
        listener: Told of them, with the time of day of the cycle [s since 1970].

    Attributes:
        is_faulty: Whether faults strike: only once the run has begun.
        zero: The clock's time at which the run began [s]; all other times count from there.
    """

    def __init__(
        self,
        bus: can.BusABC,
        clock: Clock,
        statistics: Statistics,
        *,
        faults: Sequence[FrameFault] = (),
        names: dict[int, str] | None = None,
        log: FrameLog | None = None,
        listener: Listener | None = None,
    ) -> None:
        self.bus = bus
        self.clock = clock
        self.statistics = statistics
        self.log = log
        self._listener = listener
        self._epoch = time.time() - clock.now()
        self.is_faulty = False
        self.zero = 0.0
        self._asked = 0.0
        self._answered: float | None = None
        self._names = names or {}
        self._out = [f for f in faults if f.on in ("sensors", "both")]
        self._in = [f for f in faults if f.on in ("actuators", "both")]
        self._leaving: list[tuple[float, int, can.Message]] = []
        self._coming: list[tuple[float, int, can.Message]] = []
        self._number = 0
        self._arrived: list[tuple[float, can.Message]] = []
        self._can_wait = _has_file(bus)

    def now(self) -> float:
        """Return the time of the run [s]."""
        return self.clock.now() - self.zero

    def ask(self) -> None:
        """Note that a question goes out: what comes next is the answer."""
        self._asked = self.clock.now()
        self._answered = None

    @property
    def answered(self) -> float | None:
        """How long the answer took [s]; None: none came."""
        return None if self._answered is None else self._answered - self._asked

    def send(self, frame: can.Message, now: float) -> None:
        """Send a frame at `now` [s], unless a fault has something else in mind for it."""
        if not self._out or not self.is_faulty:
            self._send(frame, now)
            return
        for due, changed in self._struck(self._out, frame, now):
            self._queue(self._leaving, due, changed)
        self.flush(now)

    def flush(self, now: float) -> None:
        """Send what was held back until now [s]."""
        while self._leaving and self._leaving[0][0] <= now + 1e-9:
            self._send(heapq.heappop(self._leaving)[2], now)

    def _send(self, frame: can.Message, now: float) -> None:
        try:
            self.bus.send(frame, timeout=0.0)
        except can.CanError:
            self.statistics.not_sent += 1
            return
        self.statistics.sent += 1
        self._passed(now, frame)

    def _passed(self, now: float, frame: can.Message) -> None:
        if self.log is not None:
            self.log.add(now, frame)
        if self._listener is not None:
            self._listener(self._epoch + self.zero + now, frame)

    def take(self, now: float) -> list[tuple[float, can.Message]]:
        """Return the frames that have come by `now` [s], each with when it did."""
        self.read()
        arrived, self._arrived = self._arrived, []
        if self._in and self.is_faulty:
            for _, frame in arrived:
                for due, changed in self._struck(self._in, frame, now):
                    self._queue(self._coming, due, changed)
            arrived = []
        while self._coming and self._coming[0][0] <= now + 1e-9:
            due, _, frame = heapq.heappop(self._coming)
            arrived.append((due, frame))
        for _, frame in arrived:
            self._passed(now, frame)
        return arrived

    def read(self) -> None:
        """Take what is there off the bus, with the time of it."""
        while True:
            try:
                frame = self.bus.recv(0.0)
            except can.CanError:
                self.statistics.error_frames += 1
                return
            if frame is None:
                return
            now = self.clock.now()
            if self._answered is None:
                self._answered = now
            self._arrived.append((now - self.zero, frame))

    def wait_until(self, due: float) -> None:
        """Wait until a time of the run [s], and meanwhile note when frames come."""
        clock = self.clock
        due += self.zero
        if isinstance(clock, RealClock) and self._can_wait:
            end = due - clock.spin
            while (rest := end - clock.now()) > 0:
                if select.select([self.bus], [], [], rest)[0]:
                    self.read()
            # Still reading while spinning, but not so late that it could miss the deadline.
            while clock.now() < due - _BLIND:
                if select.select([self.bus], [], [], 0)[0]:
                    self.read()
        clock.wait_until(due)

    def _struck(
        self, faults: Sequence[FrameFault], frame: can.Message, now: float
    ) -> list[Delivery]:
        deliveries: list[Delivery] = [(now, frame)]
        name = self._names.get(frame.arbitration_id, "")
        for fault in faults:
            if fault.message and fault.message != name:
                continue
            deliveries = [
                (due + later - now, changed)
                for due, each in deliveries
                for later, changed in fault.deliver(each, now)
            ]
        return deliveries

    def _queue(
        self, queue: list[tuple[float, int, can.Message]], due: float, frame: can.Message
    ) -> None:
        self._number += 1
        heapq.heappush(queue, (due, self._number, frame))


def _has_file(bus: can.BusABC) -> bool:
    try:
        return bus.fileno() >= 0
    except (NotImplementedError, AttributeError, OSError):
        # How drivers say that there is nothing to wait for is left to them.
        return False
