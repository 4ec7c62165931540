"""Frames from a bus, received in a thread of their own into a bounded, counted queue."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence

import can
import numpy as np

from recordings.readers.can_frames import EXTENDED, WORD, FrameList, Frames

MICROSECOND = 1000
_WAIT = 0.1


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

    The thread only receives and queues; a frame for which there is no room is dropped and counted,
    the newest ones: what was queued stays in order.

    Args:
        bus: Open; stays the caller's.
        number: Of the bus, for the frames.
        room: Frames that wait at most.

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

    def __init__(self, bus: can.BusABC, number: int = 0, *, room: int = 100_000) -> None:
        self.bus, self.number, self.room = bus, number, room
        self.received = 0
        self.dropped = 0
        self.error: Exception | None = None
        # Appending and popping are atomic, which a lock for each frame would double the price of.
        self._queue: deque[can.Message] = deque()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"receiver-{number}", daemon=True)

    def start(self) -> None:
        """Begin to receive."""
        self._thread.start()

    def stop(self) -> None:
        """End it; what is queued can still be drained."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def waiting(self) -> int:
        """Frames in the queue."""
        return len(self._queue)

    def drain(self) -> Frames:
        """Return what waits, in the order in which it came."""
        queue = self._queue
        return columns([queue.popleft() for _ in range(len(queue))], self.number)

    def _run(self) -> None:
        receive, queue, room = self.bus.recv, self._queue, self.room
        while not self._stopping.is_set():
            try:
                frame = receive(_WAIT)
            except (can.CanError, OSError, ValueError) as error:
                self.error = error
                return
            if frame is None:
                continue
            self.received += 1
            if len(queue) < room:
                queue.append(frame)
            else:
                self.dropped += 1
