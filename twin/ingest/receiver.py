"""Frames from buses: one thread receives from all, into a bounded, counted queue for each."""

from __future__ import annotations

import selectors
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress

import can
import numpy as np

from hil.bus.slcan import SlcanBus
from recordings.readers.can_frames import EXTENDED, WORD, FrameList, Frames

MICROSECOND = 1000
_POLL = 0.005
"""Buses that cannot be waited for are looked at so often [s]; their drivers stamp frames."""
_FILTERING = 0.001
"""So long python-can looks for a frame that passes a bus's filters [s]."""


def columns(frames: Sequence[can.Message], bus: int = 0) -> Frames:
    """Return frames as columns; stamps are rounded to microseconds, as recordings keep them."""
    if any(f.is_error_frame or f.is_remote_frame or len(f.data) > WORD for f in frames):
        return _mixed(frames, bus)
    n = len(frames)
    stamps = np.array([f.timestamp for f in frames], float)
    identifiers = [
        f.arbitration_id | EXTENDED if f.is_extended_id else f.arbitration_id for f in frames
    ]
    data = [f.data for f in frames]
    filled = b"".join([d if len(d) == WORD else bytes(d).ljust(WORD, b"\0") for d in data])
    return Frames(
        np.round(stamps * 1e6).astype(np.int64) * MICROSECOND,
        np.array(identifiers, np.uint32),
        np.full(n, bus, np.int64),
        np.array([len(d) for d in data], np.uint8),
        np.frombuffer(filled, np.uint8).reshape(n, WORD),
    )


def _mixed(frames: Sequence[can.Message], bus: int) -> Frames:
    listed = FrameList()
    for f in frames:
        if f.is_error_frame:
            listed.error_frames += 1
        elif f.is_remote_frame:
            listed.remote_frames += 1
        else:
            identifier = f.arbitration_id | (EXTENDED if f.is_extended_id else 0)
            stamp = round(f.timestamp * 1e6) * MICROSECOND
            listed.add(stamp, identifier, bus, bytes(f.data))
    return listed.frames()


class Receiver:
    """Receives from one bus until it is stopped.

    Frames are only received and queued; one for which there is no room is dropped and counted, the
    newest ones: what was queued stays in order.

    Args:
        bus: Open; stays the caller's.
        number: Of the bus, for the frames.
        room: Frames that wait at most.
        reception: The thread that receives; default: one of its own.

    Attributes:
        received: Frames taken from the bus.
        dropped: Those for which there was no room.
        error: What ended the reception, if not `stop`.

    Example:
        >>> import time
        >>> with can.Bus("r", interface="virtual") as bus, can.Bus("r", interface="virtual") as far:
        ...     receiver = Receiver(bus)
        ...     receiver.start()
        ...     far.send(can.Message(arbitration_id=5, data=b"ab"))
        ...     time.sleep(0.2)
        ...     receiver.stop()
        ...     len(receiver.drain()), receiver.dropped
        (1, 0)
    """

    def __init__(
        self,
        bus: can.BusABC,
        number: int = 0,
        *,
        room: int = 100_000,
        reception: Reception | None = None,
    ) -> None:
        self.bus, self.number, self.room = bus, number, room
        self.received = 0
        self.dropped = 0
        self.error: Exception | None = None
        # Appending and popping are atomic, which a lock for each frame would double the price of.
        self._queue: deque[can.Message] = deque()
        self._reception = reception or Reception()
        # Without a timeout the first frame that the filters hold back looks like the last one.
        self._timeout = _FILTERING if bus.filters else 0.0
        self._blocks = bus if isinstance(bus, SlcanBus) else None

    def start(self) -> None:
        """Begin to receive."""
        self._reception.add(self)

    def stop(self) -> None:
        """End it; what is queued can still be drained, and the bus is left alone from now on."""
        self._reception.remove(self)

    @property
    def waiting(self) -> int:
        """Frames in the queue."""
        return len(self._queue)

    def drain(self) -> Frames:
        """Return what waits, in the order in which it came."""
        queue = self._queue
        return columns([queue.popleft() for _ in range(len(queue))], self.number)

    def take(self) -> None:
        """Queue what the bus has."""
        receive, queue, room, timeout = self.bus.recv, self._queue, self.room, self._timeout
        try:
            while (frame := receive(timeout)) is not None:
                self.received += 1
                if len(queue) < room:
                    queue.append(frame)
                else:
                    self.dropped += 1
                if self._blocks is not None and not self._blocks.buffered:
                    return  # the selector says when there is more, for less than asking
        except Exception as error:
            # Whatever a driver raises, the other buses are received from.
            self.error = error


class Reception:
    """One thread that receives from any number of buses.

    Threads of their own would take the interpreter from each other at every frame: 50 buses at
    100 Hz fell behind. A bus with a file descriptor is read when there is something to read, so
    that frames which are stamped on reading are stamped in time; the rest are looked at every 5 ms.
    The thread begins with the first bus and ends with the last.

    Example:
        >>> import time
        >>> reception = Reception()
        >>> with can.Bus("a", interface="virtual") as a, can.Bus("b", interface="virtual") as b:
        ...     receivers = [Receiver(bus, reception=reception) for bus in (a, b)]
        ...     for receiver in receivers:
        ...         receiver.start()
        ...     with can.Bus("b", interface="virtual") as far:
        ...         far.send(can.Message(arbitration_id=5, data=b"ab"))
        ...         time.sleep(0.2)
        ...     for receiver in receivers:
        ...         receiver.stop()
        ...     [receiver.waiting for receiver in receivers]
        [0, 1]
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: _Loop | None = None

    def add(self, receiver: Receiver) -> None:
        """Receive from a bus from now on."""
        with self._lock:
            self._loop = self._loop or _Loop()
            self._loop.add(receiver)

    def remove(self, receiver: Receiver) -> None:
        """Receive from it no more: its bus is not touched when this returns."""
        with self._lock:
            if self._loop is None:
                return
            self._loop.remove(receiver)
            if self._loop.is_empty:
                self._loop.end()
                self._loop = None


class _Loop:
    """The thread, as long as there are buses."""

    def __init__(self) -> None:
        self._receivers: set[Receiver] = set()
        self._polled: set[Receiver] = set()
        # Held while buses are read: who has it may take one away.
        self._reading = threading.Lock()
        self._stopping = False
        self._selector = selectors.DefaultSelector()
        self._bell, self._rings = socket.socketpair()
        self._rings.setblocking(False)
        self._selector.register(self._rings, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="receiver", daemon=True)
        self._thread.start()

    @property
    def is_empty(self) -> bool:
        """Whether there is no bus."""
        return not self._receivers

    def add(self, receiver: Receiver) -> None:
        """Read a bus."""
        with self._reading:
            self._receivers.add(receiver)
            if not self._wait_for(receiver):
                self._polled.add(receiver)
        self._bell.send(b"!")

    def _wait_for(self, receiver: Receiver) -> bool:
        """Wait for a bus's file; return False if it has none that can be waited for."""
        if sys.platform == "win32":
            return False  # only sockets can be
        with suppress(NotImplementedError, can.CanError, OSError, ValueError):
            self._selector.register(receiver.bus.fileno(), selectors.EVENT_READ, receiver)
            return True
        return False

    def remove(self, receiver: Receiver) -> None:
        """Read it no more."""
        with self._reading:
            self._receivers.discard(receiver)
            self._leave(receiver)

    def _leave(self, receiver: Receiver) -> None:
        self._polled.discard(receiver)
        for key in list(self._selector.get_map().values()):
            if key.data is receiver:
                self._selector.unregister(key.fileobj)

    def end(self) -> None:
        """Stop the thread."""
        self._stopping = True
        self._bell.send(b"!")
        self._thread.join()
        self._selector.close()
        self._bell.close()
        self._rings.close()

    def _run(self) -> None:
        due = 0.0
        while not self._stopping:
            wait = max(0.0, due - time.monotonic()) if self._polled else None
            ready = [key.data for key, _ in self._selector.select(wait)]
            with self._reading:
                if None in ready:
                    self._rings.recv(1024)
                found = {r for r in ready if r in self._receivers}
                if time.monotonic() >= due:
                    found |= self._polled
                    due = time.monotonic() + _POLL
                for receiver in found:
                    receiver.take()
                    if receiver.error is not None:
                        self._leave(receiver)
