"""Live data to any number of readers: made once, sent to all; nobody waits for a slow one."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field

_ROOM = 16
# So that proxies and readers see that the connection lives [s].
_HEARTBEAT = 10.0
FLEET = ""
"""Topic about all twins."""


@dataclass(eq=False)
class _Reader:
    topic: str
    loop: asyncio.AbstractEventLoop
    queue: asyncio.Queue[str | None] = field(default_factory=lambda: asyncio.Queue(_ROOM))
    missed: int = 0

    def take(self, text: str | None) -> None:
        if self.queue.full():
            self.queue.get_nowait()
            self.missed += 1
        self.queue.put_nowait(text)


class Hub:
    """Distributes texts by topic. Any thread may publish.

    Attributes:
        missed: Texts that readers were too slow for.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._readers: list[_Reader] = []
        self._newest: dict[str, str] = {}
        self._closed = False
        self.missed = 0

    @property
    def readers(self) -> int:
        """How many read now."""
        return len(self._readers)

    def wanted(self, topic: str) -> bool:
        """Return whether anybody reads a topic."""
        return any(r.topic == topic for r in self._readers)

    def publish(self, topic: str, text: str) -> None:
        """Send a text to all who read a topic."""
        self._newest[topic] = text
        self._send([r for r in self._readers if r.topic == topic], text)

    def close(self) -> None:
        """End all streams."""
        self._closed = True
        self._send(list(self._readers), None)

    def _send(self, readers: list[_Reader], text: str | None) -> None:
        loops: dict[asyncio.AbstractEventLoop, list[_Reader]] = {}
        for reader in readers:
            loops.setdefault(reader.loop, []).append(reader)
        for loop, group in loops.items():
            # One wake-up for all of them; a loop that has ended needs nothing any more.
            try:
                loop.call_soon_threadsafe(_hand_out, group, text)
            except RuntimeError:
                continue

    @contextmanager
    def _reading(self, topic: str) -> Generator[_Reader]:
        reader = _Reader(topic, asyncio.get_running_loop())
        with self._lock:
            self._readers = [*self._readers, reader]
        try:
            yield reader
        finally:
            with self._lock:
                self._readers = [r for r in self._readers if r is not reader]
                self.missed += reader.missed

    async def stream(self, topic: str) -> AsyncGenerator[str]:
        """Yield server-sent events of a topic, beginning with the newest, until `close`."""
        with self._reading(topic) as reader:
            if topic in self._newest:
                yield _event(self._newest[topic])
            while not self._closed:
                try:
                    text = await asyncio.wait_for(reader.queue.get(), _HEARTBEAT)
                except TimeoutError:
                    yield ": alive\n\n"
                    continue
                if text is None:
                    return
                yield _event(text)


def _hand_out(readers: list[_Reader], text: str | None) -> None:
    for reader in readers:
        reader.take(text)


def _event(text: str) -> str:
    return f"data: {text}\n\n"
