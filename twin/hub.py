"""Live data to any number of readers: encoded once, sent to all; nobody waits for a slow one."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field

# So that proxies and readers see that the connection lives [s].
_HEARTBEAT = 10.0
_ALIVE = b": alive\n\n"
FLEET = ""
"""Topic about all twins."""


@dataclass(frozen=True)
class _Text:
    """What was published last, as it is sent; numbers tell whether it was sent already."""

    number: int = 0
    event: bytes = b""


@dataclass(eq=False)
class _Reader:
    topic: str
    loop: asyncio.AbstractEventLoop
    news: asyncio.Event = field(default_factory=asyncio.Event)


class Hub:
    """Distributes texts by topic. Any thread may publish.

    A reader gets the newest text whenever it has taken the one before: who is slow misses some, and
    is sent nothing that is old.

    Attributes:
        missed: Texts that readers were too slow for.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._readers: list[_Reader] = []
        self._newest: dict[str, _Text] = {}
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
        """Send a text, of one line, to all who read a topic."""
        number = self._text(topic).number + 1
        self._newest[topic] = _Text(number, f"data: {text}\n\n".encode())
        self._wake([r for r in self._readers if r.topic == topic])

    def close(self) -> None:
        """End all streams."""
        self._closed = True
        self._wake(list(self._readers))

    def _text(self, topic: str) -> _Text:
        return self._newest.get(topic, _Text())

    def _wake(self, readers: list[_Reader]) -> None:
        loops: dict[asyncio.AbstractEventLoop, list[_Reader]] = {}
        for reader in readers:
            loops.setdefault(reader.loop, []).append(reader)
        for loop, group in loops.items():
            # One wake-up for all of them; a loop that has ended needs nothing any more.
            try:
                loop.call_soon_threadsafe(_tell, group)
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

    async def stream(self, topic: str) -> AsyncGenerator[bytes]:
        """Yield server-sent events of a topic, beginning with the newest, until `close`."""
        with self._reading(topic) as reader:
            sent = 0
            while not self._closed:
                reader.news.clear()
                text = self._text(topic)
                if text.number != sent:
                    self.missed += text.number - sent - 1 if sent else 0
                    sent = text.number
                    yield text.event
                elif not await _told(reader.news):
                    yield _ALIVE


def _tell(readers: list[_Reader]) -> None:
    for reader in readers:
        reader.news.set()


async def _told(news: asyncio.Event) -> bool:
    """Wait for news; return False if there are none for a while."""
    try:
        async with asyncio.timeout(_HEARTBEAT):
            return await news.wait()
    except TimeoutError:
        return False
