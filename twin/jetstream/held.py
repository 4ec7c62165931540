"""A twin that a worker runs: its claim, its frames, its check-points."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from nats.aio.subscription import Subscription

from recordings.readers.can_frames import FrameList, Frames
from twin.jetstream.frames import StreamedFrames
from twin.service import Running
from twin.store.actions import Action
from twin.store.claims import Claim
from twin.store.store import Store

_PERIOD = 5.0
"""Between two check-points without an event [s]: what is computed again after a kill."""
_MOST = 500
"""Batches between two check-points."""
_AT_ONCE = 50
"""Batches in one round, so that a twin that has to catch up does not hold up the rest."""


class Held:
    """A twin that a worker runs; it is a `Source` as well.

    Args:
        claim: On the twin.
        streamed: Its frames.
        seal: Makes bytes of the twin's name, the stream and the state.

    Attributes:
        running: The twin; None: it is being made.
        answers: Subscription to questions about it.
    """

    def __init__(
        self,
        claim: Claim,
        streamed: StreamedFrames,
        seal: Callable[[str, str, dict[str, Any]], bytes],
    ) -> None:
        self.claim = claim
        self.running: Running | None = None
        self.answers: Future[Subscription] | None = None
        self._streamed, self._seal = streamed, seal
        self._since, self._kept = 0, time.monotonic()

    def actions(self) -> Sequence[Action]:
        """Return what belongs into every transaction of this twin: its check-point."""
        running = self.running
        if running is None:
            return [self.claim.keep(self.claim.position, self.claim.state)]
        place = self._streamed.place
        state = {"faults": running.faults, "monitor": running.monitor.snapshot()}
        self._since, self._kept = 0, time.monotonic()
        return [self.claim.keep(place.position, self._seal(self.claim.twin, place.stream, state))]

    def feed(self, store: Store) -> None:
        """Take what has come, and write a check-point if one is due.

        Raises:
            OutpacedError: Another worker has claimed the twin.
            StoreError: The store fails.
        """
        running = self.running
        assert running is not None
        monitor = running.monitor
        # A check-point must not come between a batch's place and what it says.
        with monitor.lock:
            for batch in self._streamed.read(_AT_ONCE):
                self._since += 1
                monitor.feed(batch.frames, batch.now)
                if monitor.journal.failure:
                    return
            due = self._since >= _MOST or time.monotonic() - self._kept > _PERIOD
            if self._since and due:
                store.do(*self.actions())
            if not self._since:
                self._streamed.done()

    # As a source

    def read(self) -> Frames:
        """Return nothing: frames are fed by `feed`."""
        return FrameList().frames()

    def faults(self) -> Mapping[str, str]:
        """Return what fails at the gateway, and whether it is heard."""
        return self._streamed.faults()

    def counts(self) -> Mapping[str, int]:
        """Return what the gateway has counted."""
        return self._streamed.counts()

    def recorded(self) -> list[tuple[Path, int]]:
        """Return nothing: recordings are at the gateway."""
        return []

    def close(self) -> None:
        """End it."""
        self._streamed.close()
