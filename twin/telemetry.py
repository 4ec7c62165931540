"""Which messages come, which have fallen silent: from the frames' own stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from foundation.resumable import Resumable
from twin.ingest.decoder import Decoded


@dataclass(frozen=True)
class Change:
    """Telemetry went stale, or came back.

    Attributes:
        time: When [ns].
        stale: Whether it is stale from then on.
        message: Which message it hung on.
        gap: How long it was silent [ns].
    """

    time: int
    stale: bool
    message: str
    gap: int


class Telemetry(Resumable):
    """Watches the wanted messages: silent for longer than a limit, and all is stale.

    Args:
        messages: All that are wanted.
        limit: [ns].

    Attributes:
        stale: Messages that are silent.
        newest: Stamp of the newest good frame [ns]; None: none yet.

    Example:
        >>> watch = Telemetry(["a"], limit=5)
        >>> watch.take(Decoded({}, {"a": (0, 3)}), 4)
        []
        >>> [(c.time, c.stale) for c in watch.take(Decoded(), 20)]
        [(8, True)]
        >>> [(c.time, c.stale, c.gap) for c in watch.take(Decoded({}, {"a": (21, 23)}), 24)]
        [(21, False, 18)]
    """

    _changes = (
        "newest",
        "_last",
        "stale",
    )

    def __init__(self, messages: Sequence[str], limit: int) -> None:
        self._messages, self._limit = tuple(messages), limit
        self.newest: int | None = None
        self.restart()

    def restart(self) -> None:
        """Forget when messages came: the clock was set."""
        self._last: dict[str, int] = {}
        self.stale: set[str] = set()

    def take(self, decoded: Decoded, end: int) -> list[Change]:
        """Take what a slice up to `end` [ns] says; return what changed, in order."""
        changes: list[Change] = []
        came = decoded.messages
        for name in self._messages:
            self._fallen_silent(name, came[name][0] if name in came else end, changes)
        for name, (first, last) in came.items():
            if name in self.stale:
                self.stale.discard(name)
                if not self.stale:
                    changes.append(Change(first, False, name, first - self._last[name]))
            self._last[name] = last
            self.newest = max(self.newest or 0, last)
        return changes

    def silent(self, now: int) -> list[Change]:
        """Return what has changed by `now` [ns] though nothing came."""
        changes: list[Change] = []
        for name in self._messages:
            self._fallen_silent(name, now, changes)
        return changes

    def _fallen_silent(self, name: str, now: int, changes: list[Change]) -> None:
        # A message that has never come is waited for from the first look on.
        last = self._last.setdefault(name, now)
        if name in self.stale or now - last <= self._limit:
            return
        if not self.stale:
            changes.append(Change(last + self._limit, True, name, now - last))
        self.stale.add(name)
