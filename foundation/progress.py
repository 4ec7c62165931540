"""How far long work is: said by who does it, shown by who asked for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Told what is being done, and how many of how many like pieces of it are."""

    def __call__(self, text: str, done: int = 0, total: int = 0) -> None:
        """Take note; a `total` of 0 says that the work is not counted in pieces."""
        ...


def silent(text: str, done: int = 0, total: int = 0) -> None:
    """Say nothing."""


def counted(progress: Progress, text: str, results: Iterable[T], total: int) -> Iterator[T]:
    """Yield results as they come, and say how many there are.

    Example:
        >>> told = Spoken(print)
        >>> [x * x for x in counted(told, "squaring", [1, 2], 2)]
        squaring
        squaring (1 of 2)
        squaring (2 of 2)
        [1, 4]
    """
    progress(text, 0, total)
    for done, result in enumerate(results, 1):
        progress(text, done, total)
        yield result


class Spoken:
    """Progress as a sentence, with the time that is left once there is a basis for it.

    The estimate is of the pieces that are counted at present and of no more: what comes after them
    is not known. It is made from the second piece on, and not within the first seconds.

    Args:
        say: Told the sentences.
        clock: Seconds.

    Example:
        >>> times = iter([0.0, 1.0, 5.0])
        >>> told = Spoken(print, lambda: next(times))
        >>> for done in (0, 1, 2):
        ...     told("refitting", done, 8)
        refitting
        refitting (1 of 8)
        refitting (2 of 8, about 15 s left)
    """

    def __init__(
        self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say = say
        self._clock = clock
        self._stage = ("", 0)
        self._first = 0
        self._began = 0.0

    def __call__(self, text: str, done: int = 0, total: int = 0) -> None:
        """Say what is being done, how far it is, and what is left."""
        now = self._clock()
        if (text, total) != self._stage:
            self._stage, self._first, self._began = (text, total), done, now
        notes = [f"{done} of {total}"] if 0 < done <= total else []
        # What a study that goes on had done before is no basis.
        fresh, seconds = done - self._first, now - self._began
        if done < total and fresh >= _FEWEST and seconds >= _SHORTEST:
            notes.append(f"{about(seconds / fresh * (total - done))} left")
        self._say(f"{text} ({', '.join(notes)})" if notes else text)


_FEWEST = 2
_SHORTEST = 2.0
_STEPS: Sequence[tuple[float, float, float, str]] = (
    (10.0, 1.0, 1.0, "s"),
    (60.0, 5.0, 1.0, "s"),
    (600.0, 60.0, 60.0, "min"),
    (3600.0, 300.0, 60.0, "min"),
)


def about(seconds: float) -> str:
    """Return a time as people say one that they do not know exactly.

    Example:
        >>> [about(s) for s in (3.4, 33.0, 130.0, 2000.0, 9000.0)]
        ['about 3 s', 'about 35 s', 'about 2 min', 'about 35 min', 'about 2.5 h']
    """
    for end, step, unit, name in _STEPS:
        rounded = max(step, round(seconds / step) * step)
        if rounded < end:
            return f"about {rounded / unit:.0f} {name}"
    return f"about {seconds / 3600:.1f} h"
