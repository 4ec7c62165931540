"""One scheduler for all periodic messages of a node.

Dozens of threads, one a message, are known to turn 10 ms into 17 ms; here one list of due times is
kept, and whoever runs the node's loop asks it what is due. Due times are multiples of the period:
a late frame does not push those after it.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

import can

from foundation.errors import BusError
from hil.bus.statistics import Statistics

Frame = Callable[[float], can.Message | None]
"""Makes the frame that is due at a time [s], or None for none this time."""


Send = Callable[[can.Message, float], None]
"""Sends a frame at a time [s]."""


def sends_to(bus: can.BusABC, statistics: Statistics) -> Send:
    """Return what sends frames to a bus at once, and counts those sent and those refused."""

    def send(frame: can.Message, now: float) -> None:
        del now
        try:
            bus.send(frame, timeout=0.0)
        except can.CanError:
            statistics.not_sent += 1
        else:
            statistics.sent += 1

    return send


class PeriodicSender:
    """Sends frames when they are due.

    Args:
        send: Sends a frame.
        statistics: Counts frames that were late by more than half a period.

    Example:
        >>> from hil.bus.interface import BusSettings, open_bus
        >>> with open_bus(BusSettings(channel="a")) as bus, open_bus(BusSettings(channel="a")) as b:
        ...     counts = Statistics()
        ...     sender = PeriodicSender(sends_to(bus, counts), counts)
        ...     sender.add(0.01, lambda time: can.Message(arbitration_id=1, timestamp=time))
        ...     for k in range(5):
        ...         sender.send_due(0.005 * k)
        ...     counts.sent
        3
    """

    def __init__(self, send: Send, statistics: Statistics) -> None:
        self.statistics = statistics
        self._send = send
        self._due: list[tuple[float, int, int]] = []  # due time, number, how many were due before
        self._frames: list[tuple[float, float, Frame]] = []

    def add(self, period: float, frame: Frame, *, first: float = 0.0) -> None:
        """Send a frame every `period` [s], from `first` [s] on.

        Raises:
            BusError: The period is not positive.
        """
        if not period > 0:
            raise BusError(f"a period of {period:g} s", remedy="send after some time again")
        heapq.heappush(self._due, (first, len(self._frames), 0))
        self._frames.append((first, period, frame))

    @property
    def next_due(self) -> float:
        """When the next frame is due [s]; infinite if there is none."""
        return self._due[0][0] if self._due else float("inf")

    def send_due(self, now: float) -> None:
        """Send everything that is due now [s]; of what was missed only the last."""
        while self._due and self._due[0][0] <= now + 1e-9:
            due, number, count = self._due[0]
            first, period, frame = self._frames[number]
            lateness = now - due
            if lateness > 0.5 * period:
                self.statistics.late += 1
            skipped = int((lateness + 1e-9) / period)
            count += 1 + skipped
            heapq.heapreplace(self._due, (first + count * period, number, count))
            made = frame(now)
            if made is not None:
                self._send(made, now)
