"""At the machines: frames are received, recorded and published; nothing is decoded.

Publishing waits for nobody: what JetStream does not take yet stays in an outbox of bounded length.
A batch has an identifier, by which the server knows it again if its receipt was lost, and names the
batch before it, so that a second gateway of the same twin is refused.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from nats.js.errors import APIError, NotFoundError

from foundation.closing import Closing
from recordings.readers.can_frames import FrameList, Frames
from twin.ingest import Reception
from twin.ingest.buses import BusSource
from twin.jetstream.batch import Batch, packed
from twin.jetstream.connection import FAILURES, PATIENCE, Connection
from twin.settings import Settings, TwinSettings

_LOG = logging.getLogger("twinproof.twin")
_AGAIN = 0.2
# A twin of which nothing was published for so long has no other gateway [s].
_QUIET = 1.0
_FAREWELL = 5.0
_LARGEST = 4000
"""Frames in a message: with 64 bytes each the megabyte that a server takes is not reached."""
_WRONG_SEQUENCE = 10071
_ID, _BEFORE = "Nats-Msg-Id", "Nats-Expected-Last-Subject-Sequence"


class _Bus(Protocol):
    """What a gateway needs of `BusSource`."""

    def read(self) -> Frames: ...

    def faults(self) -> dict[str, str]: ...

    def counts(self) -> dict[str, int]: ...

    def close(self) -> None: ...


@dataclass(eq=False)
class Outbox:
    """What waits to be published.

    Attributes:
        room: Frames at most; the newest have to go, and are counted.
        dropped: How many had to.
    """

    room: int
    dropped: int = 0
    _parts: list[Frames] = field(default_factory=list[Frames])
    _now: float = 0.0
    _fresh: bool = False
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def put(self, frames: Frames, now: float) -> None:
        """Add what was received until `now` [s]."""
        with self._lock:
            self._now, self._fresh = now, True
            if len(self) + len(frames) > self.room:
                self.dropped += len(frames)
            elif len(frames):
                self._parts.append(frames)

    def take(self) -> tuple[Frames, float] | None:
        """Return what one message may hold of it, oldest first; None: nothing is new."""
        with self._lock:
            if not self._fresh:
                return None
            taken: list[Frames] = []
            while self._parts and sum(map(len, taken)) < _LARGEST:
                taken.append(self._parts.pop(0))
            # What is still here came before `now` too: the clock's word goes with the last of it.
            now, self._fresh = self._now, bool(self._parts)
            frames = Frames.joined(taken) if taken else FrameList().frames()
            if self._parts:
                now = float(frames.nanoseconds.max()) * 1e-9
            return frames, now

    def __len__(self) -> int:
        return sum(map(len, self._parts))


@dataclass(eq=False)
class _Line:
    name: str
    source: _Bus
    outbox: Outbox
    faults: dict[str, str] = field(default_factory=dict[str, str])
    rival: str = ""
    publishing: Future[Any] | None = None
    published: int = 0


class Gateway(Closing):
    """Publishes the frames of all twins of a file of settings.

    Args:
        settings: With `[jetstream]`.
        name: Of this gateway.
        source: Opens a twin's buses; default: `BusSource`, received from in one thread.
        clock: That of the frames [s].

    Raises:
        StreamError: There is no server, no JetStream, or no room for the stream.
    """

    def __init__(
        self,
        settings: Settings,
        name: str,
        source: Callable[[Settings, TwinSettings], _Bus] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        opened = source or partial(BusSource, reception=Reception())
        self._connection = Connection(settings, name)
        self._name, self._clock = name, clock
        self._period = settings.stream.period
        # Numbers of a gateway that was started again are others.
        self._run = f"{name}:{time.time_ns()}"
        self._stopping = threading.Event()
        self._lines = [
            _Line(twin.name, opened(settings, twin), Outbox(sum(b.queue for b in twin.buses)))
            for twin in settings.twins
        ]
        self._thread = threading.Thread(target=self._receive, name="gateway", daemon=True)

    def start(self) -> None:
        """Begin."""
        for line in self._lines:
            line.publishing = self._connection.start(self._publish(line))
        self._thread.start()
        _LOG.info("gateway started", extra={"twins": [line.name for line in self._lines]})

    def wait(self) -> None:
        """Return when it is to stop."""
        self._stopping.wait()

    def stop(self) -> None:
        """Tell it to stop; also from a signal."""
        self._stopping.set()

    def close(self) -> None:
        """Stop in order: what was received is still published, if the server takes it."""
        self.stop()
        if self._thread.ident is not None:
            self._thread.join()
        end = time.monotonic() + _FAREWELL
        while time.monotonic() < end and any(
            line.publishing is not None and not (line.publishing.done() or line.rival)
            for line in self._lines
        ):
            time.sleep(0.01)
        for line in self._lines:
            if line.publishing is not None:
                line.publishing.cancel()
            line.source.close()
        self._connection.close()

    def counts(self, twin: str) -> dict[str, int]:
        """Return what has been counted of a twin: received, dropped, …, published."""
        line = next(line for line in self._lines if line.name == twin)
        return {**self._counts(line), "published": line.published}

    def _counts(self, line: _Line) -> dict[str, int]:
        counts = line.source.counts()
        return {**counts, "dropped": counts.get("dropped", 0) + line.outbox.dropped}

    def _receive(self) -> None:
        looked = 0.0
        while True:
            began = time.monotonic()
            stopping = self._stopping.is_set()
            looks = began - looked > 1.0
            for line in self._lines:
                try:
                    self._read(line, looks)
                except Exception:
                    # One twin's fault must not silence the others.
                    _LOG.exception("a twin was not read", extra={"twin": line.name})
            looked = began if looks else looked
            if stopping:
                return
            self._stopping.wait(max(0.001, self._period - (time.monotonic() - began)))

    def _read(self, line: _Line, looks: bool) -> None:
        now = self._clock()
        line.outbox.put(line.source.read(), now)
        if not looks:
            return
        found = line.source.faults()
        if line.rival:
            found["gateway"] = line.rival
        for what in found.keys() - line.faults.keys():
            _LOG.warning("degraded", extra={"twin": line.name, what: found[what]})
        for what in line.faults.keys() - found.keys():
            _LOG.info("recovered", extra={"twin": line.name, "what": what})
        line.faults = found

    # In the connection's loop

    async def _publish(self, line: _Line) -> None:
        number, before = 0, None
        while True:
            taken = line.outbox.take()
            if taken is None:
                if self._stopping.is_set() and not self._thread.is_alive():
                    return
                await asyncio.sleep(self._period / 4)
                continue
            frames, now = taken
            batch = Batch(frames, now, self._name, self._counts(line), line.faults)
            number += 1
            before = await self._sent(
                line, packed(batch), f"{line.name}:{self._run}:{number}", before
            )
            line.published += len(frames)

    async def _sent(self, line: _Line, content: bytes, name: str, before: int | None) -> int:
        """Publish until the server has it; return its number in the stream."""
        subject, js = self._connection.frames_of(line.name), self._connection.jetstream()
        while True:
            try:
                before = await self._quiet(line, subject) if before is None else before
                headers = {_ID: name, _BEFORE: str(before)}
                receipt = await js.publish(subject, content, timeout=PATIENCE, headers=headers)
            except APIError as error:
                if error.err_code != _WRONG_SEQUENCE:
                    _LOG.warning("not published yet", extra={"because": str(error)})
                    await asyncio.sleep(_AGAIN)
                    continue
                before = None
            except FAILURES:
                await asyncio.sleep(_AGAIN)
            else:
                return receipt.seq

    async def _quiet(self, line: _Line, subject: str) -> int:
        """Wait until nobody else publishes; return the number of the newest message."""
        before = await self._newest(subject)
        while before > 0:
            await asyncio.sleep(_QUIET)
            newest = await self._newest(subject)
            if newest == before:
                break
            line.rival = "another gateway publishes frames of this twin: end one of them"
            before = newest
        line.rival = ""
        return before

    async def _newest(self, subject: str) -> int:
        try:
            found = await self._connection.jetstream().get_last_msg(
                self._connection.stream, subject
            )
        except NotFoundError:
            return 0
        return found.seq or 0
