"""Who notices that the other end has gone silent."""

from __future__ import annotations


class Watchdog:
    """Barks when it has not been fed for a time; quiet again once fed.

    Args:
        timeout: [s].

    Attributes:
        spans: When it barked: from, to [s]; the last may still be open, to infinity.

    Example:
        >>> dog = Watchdog(0.02)
        >>> dog.feed(0.0)
        >>> [dog.barks(t) for t in (0.01, 0.02, 0.021, 0.03)]
        [False, False, True, True]
        >>> dog.feed(0.04)
        >>> dog.barks(0.04), dog.spans
        (False, [(0.021, 0.04)])
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self.spans: list[tuple[float, float]] = []
        self._fed = 0.0
        self._since: float | None = None

    def feed(self, now: float) -> None:
        """Say that something good came [s]."""
        self._fed = now

    def barks(self, now: float) -> bool:
        """Whether too long has passed [s]."""
        if now - self._fed > self.timeout + 1e-9:
            if self._since is None:
                self._since = now
                self.spans.append((now, float("inf")))
            return True
        if self._since is not None:
            self.spans[-1] = (self._since, now)
            self._since = None
        return False
