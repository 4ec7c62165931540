"""A twin's buses: received in a thread, recorded first, opened again when they fail.

Where frames were stamped when they were read, the times at which they were sent are recorded, and a
replay sees what the service saw.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np

from foundation.closing import Closing
from foundation.errors import BusError
from hil.bus.interface import BusSettings, open_bus
from hil.bus.slcan import SlcanBus
from recordings.readers.can_frames import FrameList, Frames
from twin.ingest.receiver import Receiver, Reception
from twin.ingest.recorder import FrameRecorder
from twin.ingest.stamps import ArrivalStamps
from twin.settings import Settings, TwinSettings

# Between two attempts to open a bus that is gone [s].
_AGAIN = 1.0


class _Line:
    """One bus, there or not."""

    def __init__(self, settings: BusSettings, number: int, room: int, reception: Reception) -> None:
        self.settings, self.number, self.room = settings, number, room
        self._reception = reception
        self.fault = ""
        self.received = self.dropped = 0
        self._bus: can.BusABC | None = None
        self._receiver: Receiver | None = None
        self._stamps: ArrivalStamps | None = None
        self._tried = -np.inf

    def mend(self) -> None:
        """Open it if it is not; close it if it has failed."""
        receiver = self._receiver
        if receiver is not None and receiver.error is not None:
            self.close()
            self.fault = str(receiver.error) or type(receiver.error).__name__
        now = time.monotonic()
        if self._bus is not None or now - self._tried < _AGAIN:
            return
        self._tried = now
        try:
            self._bus = open_bus(self.settings)
        except BusError as error:
            self.fault = str(error)
            return
        self._receiver = Receiver(self._bus, self.number, room=self.room, reception=self._reception)
        self._receiver.start()
        # Other drivers stamp frames themselves.
        self._stamps = ArrivalStamps() if isinstance(self._bus, SlcanBus) else None
        self.fault = ""

    def drain(self) -> Frames | None:
        """Return what waits, with the times at which it was sent."""
        if self._receiver is None:
            return None
        found = self._receiver.drain()
        if not len(found):
            return None
        return found if self._stamps is None else self._stamps.frames(found)

    def counts(self) -> tuple[int, int]:
        """Return how many frames were received and dropped."""
        now = self._receiver
        return (
            self.received + (0 if now is None else now.received),
            self.dropped + (0 if now is None else now.dropped),
        )

    def close(self) -> None:
        """Close it; what waits is lost."""
        self.received, self.dropped = self.counts()
        receiver, self._receiver = self._receiver, None
        bus, self._bus = self._bus, None
        if receiver is not None:
            receiver.stop()
        if bus is not None:
            bus.shutdown()


class BusSource(Closing):
    """Where a twin's frames come from.

    A bus that is not there, or fails later, and a disk that is full are faults, not errors: what
    can still be had is had, and all is tried again.

    Args:
        settings: Of the service: where recordings go.
        twin: Its buses.
        reception: The thread that receives, of all twins of a process; default: one of its own.
    """

    def __init__(
        self, settings: Settings, twin: TwinSettings, reception: Reception | None = None
    ) -> None:
        service, reception = settings.service, reception or Reception()
        self._lines = [_Line(b.settings(), k, b.queue, reception) for k, b in enumerate(twin.buses)]
        self._make_recorder: Callable[[], FrameRecorder] = lambda: FrameRecorder(
            settings.file(service.recordings) / twin.name,
            limit=service.recordings_limit,
            part=service.recordings_part,
            buses=[f"bus{k}" for k in range(len(twin.buses))],
        )
        self._recorder: FrameRecorder | None = None
        self._unrecorded = 0
        self._disk = ""
        for line in self._lines:
            line.mend()

    def read(self) -> Frames:
        """Return what has come since the last call, in order of its stamps, recorded already."""
        parts = [found for line in self._lines if (found := line.drain()) is not None]
        if not parts:
            return FrameList().frames()
        frames = Frames.joined(parts)
        if len(parts) > 1:
            frames = frames.ordered(np.argsort(frames.nanoseconds, kind="stable"))
        self._record(frames)
        return frames

    def _record(self, frames: Frames) -> None:
        try:
            if self._recorder is None:
                self._recorder = self._make_recorder()
            self._recorder.write(frames)
            self._disk = ""
        except OSError as error:
            self._disk = f"frames are not recorded: {error.strerror or error}"
            self._unrecorded += len(frames)

    def faults(self) -> dict[str, str]:
        """Return what fails now, and why; buses that are gone are tried again."""
        found: dict[str, str] = {}
        for line in self._lines:
            line.mend()
            if line.fault:
                found[f"bus {line.settings.channel}"] = line.fault
        if self._disk:
            found["recordings"] = self._disk
        return found

    def counts(self) -> dict[str, int]:
        """Return frames received, dropped for want of room, and not recorded."""
        counts = [line.counts() for line in self._lines]
        return {
            "received": sum(received for received, _ in counts),
            "dropped": sum(dropped for _, dropped in counts),
            "unrecorded": self._unrecorded,
        }

    def recorded(self) -> list[tuple[Path, int]]:
        """Return the newest recording and how many bytes of it there are."""
        path = None if self._recorder is None else self._recorder.path
        return [] if path is None else [(path, path.stat().st_size)]

    def close(self) -> None:
        """Close buses and recording."""
        for line in self._lines:
            line.close()
        if self._recorder is not None:
            self._recorder.close()
