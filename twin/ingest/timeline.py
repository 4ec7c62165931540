"""Frames cut into slices of equal length by their stamps, however they were handed over.

What comes after works slice by slice, so a recording replayed in large pieces gives what the live
service saw in small ones. Frames older than what went before are refused; if they go on, the clock
was set back, and time begins anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from foundation.resumable import Resumable
from recordings.readers.can_frames import Frames


@dataclass(frozen=True)
class Slice:
    """Frames of one slice.

    Attributes:
        frames: In the order in which they came.
        end: Of the slice [ns]: everything before it has come.
        step: By which the clock was set back before it [ns]; 0: it was not.
    """

    frames: Frames
    end: int
    step: int = 0


class Timeline(Resumable):
    """Cuts frames into slices.

    Args:
        length: Of a slice [ns].
        patience: Stamps older than the newest by more than this are refused; if such frames go on
            for as long, the clock was set back [ns].

    Attributes:
        refused: Frames that were too old.
    """

    _changes = (
        "refused",
        "_end",
        "_newest",
        "_old_since",
        "_parts",
    )

    def __init__(self, length: int, patience: int) -> None:
        self.length, self.patience = length, patience
        self.refused = 0
        self._end: int | None = None
        self._newest = 0
        self._old_since: int | None = None
        self._parts: list[Frames] = []

    def add(self, frames: Frames) -> Iterator[Slice]:
        """Take frames; yield the slices that are complete."""
        while len(frames):
            stamps = frames.nanoseconds
            if self._end is None:
                self._begin(int(stamps[0]))
            assert self._end is not None
            top = np.maximum(np.maximum.accumulate(stamps), self._newest)
            breaks = np.flatnonzero((stamps >= self._end) | (stamps < top - self.patience))
            upto = int(breaks[0]) if breaks.size else len(frames)
            if upto:
                self._parts.append(_part(frames, 0, upto))
                self._newest, self._old_since = int(top[upto - 1]), None
            if upto == len(frames):
                return
            stamp = int(stamps[upto])
            if stamp >= self._end:
                yield Slice(Frames.joined(self._parts), self._end)
                self._parts = []
                self._end = stamp // self.length * self.length + self.length
                frames = _part(frames, upto, len(frames))
                continue
            back = self._newest - stamp
            self._old_since = stamp if self._old_since is None else min(self._old_since, stamp)
            if stamp - self._old_since > self.patience:
                yield Slice(Frames.joined(self._parts), self._end)
                self._parts = []
                self._begin(stamp)
                yield Slice(Frames.joined([]), self._end - self.length, back)
            else:
                self.refused += 1
                upto += 1
            frames = _part(frames, upto, len(frames))

    @property
    def is_open(self) -> bool:
        """Whether there are frames in a slice that is not complete."""
        return bool(self._parts)

    def finish(self, now: int | None = None) -> Iterator[Slice]:
        """Yield what is left: no more frames of that slice come.

        Args:
            now: Only if it ended longer ago than the patience [ns].
        """
        if self._end is None or not self._parts:
            return
        if now is None or now > self._end + self.patience:
            yield Slice(Frames.joined(self._parts), self._end)
            self._parts = []

    def _begin(self, stamp: int) -> None:
        self._end = stamp // self.length * self.length + self.length
        self._newest, self._old_since = stamp, None


def _part(frames: Frames, start: int, stop: int) -> Frames:
    if start == 0 and stop == len(frames):
        return frames
    return frames.ordered(np.arange(start, stop))
