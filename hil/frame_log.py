"""What went over the bus, kept in memory that is there before the loop begins, written after it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np

from foundation.errors import InputError
from foundation.files import written_whole

SUFFIXES = (".blf", ".asc", ".log", ".trc")
_CLASSIC = np.dtype(
    [("time", "f8"), ("id", "u4"), ("extended", "?"), ("length", "u1"), ("data", "V8")]
)


class FrameLog:
    """Frames in the order in which they passed.

    Memory is touched here, once: a loop that runs for hours must not wait for it, nor grow.

    Args:
        room: Frames of up to 8 bytes that fit.

    Attributes:
        left_out: Frames for which there was no room.

    Example:
        >>> log = FrameLog(10)
        >>> log.add(0.5, can.Message(arbitration_id=3, data=b"ab"))
        >>> [(f.timestamp, bytes(f.data)) for f in log.frames()]
        [(0.5, b'ab')]
    """

    def __init__(self, room: int) -> None:
        self._rows = np.zeros(room, _CLASSIC)
        self._rows.view(np.uint8).fill(0)
        self._payload = self._rows["data"].view()
        self._count = 0
        self.left_out = 0

    def __len__(self) -> int:
        return self._count

    def add(self, time: float, frame: can.Message) -> None:
        """Keep a frame that passed at `time` [s]."""
        k = self._count
        if k == len(self._rows) or len(frame.data) > 8:
            self.left_out += 1
            return
        self._rows[k] = (
            time,
            frame.arbitration_id,
            frame.is_extended_id,
            len(frame.data),
            bytes(frame.data).ljust(8, b"\0"),
        )
        self._count = k + 1

    def frames(self, epoch: float = 0.0) -> Iterator[can.Message]:
        """Yield the frames; times count from `epoch` [s]."""
        for row in self._rows[: self._count]:
            yield can.Message(
                timestamp=epoch + float(row["time"]),
                arbitration_id=int(row["id"]),
                is_extended_id=bool(row["extended"]),
                data=bytes(row["data"])[: int(row["length"])],
                channel=0,
            )

    def write(self, path: Path, *, epoch: float) -> None:
        """Write a log file of the kind that its suffix says, whole or not at all.

        Args:
            path: `.blf`, `.asc`, `.log` or `.trc` (python-can's).
            epoch: Time of day of the start [s since 1970].

        Raises:
            InputError: Another suffix.
            OSError: The file cannot be written.
        """
        if path.suffix not in SUFFIXES:
            raise InputError(
                f"no CAN log of the kind '{path.suffix}' can be written",
                where=str(path),
                remedy=f"use one of {', '.join(SUFFIXES)}",
            )
        with written_whole(path) as beside:
            # python-can chooses by the suffix, which the file beside has not got.
            named = beside.with_name(beside.name + path.suffix)
            try:
                with can.Logger(named) as log:
                    for frame in self.frames(epoch):
                        log(frame)
                named.replace(beside)
            finally:
                named.unlink(missing_ok=True)
