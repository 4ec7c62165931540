"""What a real-time loop needs of the machine, and how well it got it."""

from __future__ import annotations

import contextlib
import gc
import os
from array import array
from collections.abc import Callable, Generator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt


class Histogram:
    """How often which time was measured: 1 µs wide bins, and all that is longer in one.

    Args:
        top: Longest time that is told apart [s].

    Attributes:
        longest: [s].

    Example:
        >>> times = Histogram()
        >>> for k in range(100):
        ...     times.add(k * 1e-6)
        >>> round(1e6 * times.percentile(50)), round(1e6 * times.longest)
        (50, 99)
    """

    def __init__(self, top: float = 0.02) -> None:
        self._counts = array("q", bytes(8 * (round(top * 1e6) + 1)))
        self.longest = 0.0
        self._last = len(self._counts) - 1

    def add(self, seconds: float) -> None:
        """Count a time [s]; negative ones as zero."""
        k = int(seconds * 1e6)
        self._counts[max(0, min(k, self._last))] += 1
        self.longest = max(self.longest, seconds)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Number of times in each bin."""
        return np.array(self._counts, np.int64)

    @property
    def count(self) -> int:
        """How many times were measured."""
        return int(self.counts.sum())

    def percentile(self, p: float) -> float:
        """Return the time that p percent do not exceed [s]; to 1 µs, upper end of the bin."""
        if not self.count:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self.counts), p / 100 * self.count))
        if place >= self._last:
            return self.longest
        return min(1e-6 * (place + 1), self.longest)


@contextmanager
def real_time(cpu: int | None = None, priority: int | None = None) -> Generator[list[str]]:
    """Keep the garbage collector out, and ask for a processor and a priority; undone at the end.

    Args:
        cpu: Number of the processor to stay on.
        priority: 1 to 99 of the kernel's first-in-first-out scheduling.

    Yields:
        What was not permitted, in sentences.
    """
    notes: list[str] = []
    undo = contextlib.ExitStack()
    if cpu is not None:
        _try(notes, "the loop cannot be kept on one processor", lambda: _pin(cpu, undo))
    if priority is not None:
        _try(notes, "real-time priority is not permitted", lambda: _rise(priority, undo))
    collects = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield notes
    finally:
        if collects:
            gc.enable()
        gc.unfreeze()
        undo.close()


def _try(notes: list[str], lack: str, action: Callable[[], None]) -> None:
    try:
        action()
    except (OSError, AttributeError, ValueError) as error:
        notes.append(f"{lack}: {getattr(error, 'strerror', None) or error}")


def _pin(cpu: int, undo: contextlib.ExitStack) -> None:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {cpu})
    undo.callback(os.sched_setaffinity, 0, before)


def _rise(priority: int, undo: contextlib.ExitStack) -> None:
    policy, before = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    undo.callback(os.sched_setscheduler, 0, policy, before)
