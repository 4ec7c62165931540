"""Writing to the store, also while it fails: what cannot be written waits, and that is said."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

from foundation.errors import StoreError
from twin.audit import Entry
from twin.events import Event, EventKind
from twin.store.actions import Action
from twin.store.store import Store

SERVICE = ""
"""In place of a twin's name: events of the service itself."""
ROOM = 10_000
"""Events that wait at most while the store fails."""


class Journal:
    """The way to the store for everything that happens. Any thread may use it.

    Args:
        store: Where it goes.
        clock: Says when [s].
        room: Events that wait at most while the store fails; the oldest estimates go first. 0:
            nothing waits, since what it comes from comes again.

    Attributes:
        lost: Events for which there was no room.
    """

    def __init__(self, store: Store, clock: Callable[[], float], room: int = ROOM) -> None:
        self.store = store
        self.lost = 0
        self._clock = clock
        self._room = room
        self._lock = threading.RLock()
        self._waiting: deque[tuple[Event | None, tuple[Action, ...]]] = deque()
        self._failure = ""
        self._listeners: list[Callable[[list[Entry]], None]] = []

    @property
    def failure(self) -> str:
        """Why the store fails now; empty if it does not."""
        return self._failure

    @property
    def waiting(self) -> int:
        """Events that wait for the store."""
        return len(self._waiting)

    def listen(self, listener: Callable[[list[Entry]], None]) -> None:
        """Have what was written told to a function, in the thread that wrote it."""
        self._listeners.append(listener)

    def write(self, events: Sequence[Event], *also: Action) -> bool:
        """Write events, and with the last of them what else belongs to it.

        Returns:
            Whether it is in the store now. If not, it waits.

        Raises:
            InputError: What belongs to it cannot be (such as a promotion without evidence):
                nothing of it is written.
        """
        with self._lock:
            if self._waiting and not self.retry():
                self._wait(events, also)
                return False
            try:
                entries = self.store.append(events, self._clock, *also)
            except StoreError as error:
                self._failure = str(error)
                self._wait(events, also)
                return False
        self._tell(entries)
        return True

    def retry(self) -> bool:
        """Write what waits; return whether nothing waits any more."""
        with self._lock:
            if not self._waiting:
                return not self._failure or self._probe()
            events = [event for event, _ in self._waiting if event is not None]
            actions = [action for _, also in self._waiting for action in also]
            told = [
                Event(
                    self._clock(),
                    SERVICE,
                    EventKind.DEGRADED,
                    {"what": "store", "because": self._failure, "lost": self.lost},
                ),
                *events,
                Event(self._clock(), SERVICE, EventKind.RECOVERED, {"what": "store"}),
            ]
            try:
                entries = self.store.append(told, self._clock, *actions)
            except StoreError as error:
                self._failure = str(error)
                return False
            self._waiting.clear()
            self._failure = ""
        self._tell(entries)
        return True

    def _probe(self) -> bool:
        if self.store.answers():
            self._failure = ""
        return not self._failure

    def _wait(self, events: Sequence[Event], also: tuple[Action, ...]) -> None:
        if self._room == 0:
            return
        self._waiting += [(event, ()) for event in events[:-1]]
        self._waiting.append((events[-1] if events else None, also))
        while len(self._waiting) > self._room:
            self._drop()

    def _drop(self) -> None:
        self.lost += 1
        for k, (event, also) in enumerate(self._waiting):
            if event is not None and event.kind is EventKind.PARAMETERS and not also:
                del self._waiting[k]
                return
        self._waiting.popleft()

    def _tell(self, entries: list[Entry]) -> None:
        for listener in self._listeners:
            listener(entries)
