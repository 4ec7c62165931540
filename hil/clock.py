"""Time for everything in the loop: the machine's, or one that only moves when it is told to."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod


class Clock(ABC):
    """A time that starts at zero and can be waited for."""

    @abstractmethod
    def now(self) -> float:
        """Return the time since the start [s]."""

    @abstractmethod
    def wait_until(self, due: float) -> None:
        """Return at `due` [s], or at once if it is past."""


class VirtualClock(Clock):
    """A clock that jumps to whatever is waited for: deterministic, as fast as the machine allows.

    Example:
        >>> clock = VirtualClock()
        >>> clock.wait_until(3600.0)
        >>> clock.now()
        3600.0
    """

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the time [s]."""
        return self._now

    def wait_until(self, due: float) -> None:
        """Jump forward to `due` [s]."""
        self._now = max(self._now, due)


class RealClock(Clock):
    """The machine's monotonic clock.

    The kernel wakes a sleeper late, by tens of microseconds on a quiet machine; so the last part
    of a wait is spent asking what time it is.

    Args:
        spin: Length of that last part [s].
    """

    def __init__(self, spin: float = 250e-6) -> None:
        self.spin = spin
        self._start = time.perf_counter()

    def now(self) -> float:
        """Return the time since this clock was made [s]."""
        return time.perf_counter() - self._start

    def wait_until(self, due: float) -> None:
        """Sleep, then spin, until `due` [s]."""
        rest = due - self.now() - self.spin
        if rest > 0:
            time.sleep(rest)
        end = self._start + due
        while time.perf_counter() < end:
            pass
