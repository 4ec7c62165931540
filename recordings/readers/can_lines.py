"""CAN logs as text through python-can's readers: Vector's .asc and PEAK's .trc.

python-can passes over lines that it does not take for frames; they are counted here, and where a
line ends its reading, the error says which one it was.
"""

from __future__ import annotations

import io
import re
from abc import abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import can

from foundation.errors import FormatError
from recordings.readers.can_frames import EXTENDED, FrameList, Frames
from recordings.readers.can_log import CanReader

PART = 500_000
"""Frames in a part."""
_LAST_NANOSECOND = 9 * 10**18
_LONGEST_LINE = 10_000


class LineReader(CanReader):
    """A text format that python-can reads."""

    comment: ClassVar[re.Pattern[str]]
    """Lines that are known to hold no frame."""
    digits: ClassVar[int]
    """Decimals of a second that a stamp's float still has right."""
    first_bus: ClassVar[int]
    """What the file calls the bus that python-can calls 0."""

    @abstractmethod
    def messages(self, lines: io.TextIOWrapper) -> Iterator[can.Message]:
        """Yield python-can's messages.

        Raises:
            Exception: Any, where the file is damaged.
        """

    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames; see `CanReader.frames`."""
        part = FrameList()
        content = frames = 0
        with path.open("rb") as file:
            lines = _Lines(file, self.comment)
            try:
                for message in self.messages(lines):
                    frames += 1
                    self._add(part, message)
                    if len(part) >= PART:
                        yield part.frames()
                        part = FrameList()
            except FormatError:
                raise
            except Exception as error:  # any, by where the damage is
                raise FormatError(
                    f"a line that is no frame: {error or type(error).__name__}",
                    where=f"{path}, line {lines.number}",
                    remedy="remove the line, or export the log again",
                ) from error
            content = lines.content
        part.passed_over = content - frames
        yield part.frames()

    def _add(self, part: FrameList, message: can.Message) -> None:
        if message.is_error_frame:
            part.error_frames += 1
            return
        if message.is_remote_frame:
            part.remote_frames += 1
            return
        nanoseconds = round(message.timestamp * 10**self.digits) * 10 ** (9 - self.digits)
        if not 0 <= message.arbitration_id < 1 << 29 or abs(nanoseconds) > _LAST_NANOSECOND:
            raise ValueError(f"identifier {message.arbitration_id:X}, {message.timestamp:g} s")
        if len(message.data) > 64:
            raise ValueError(f"a payload of {len(message.data)} bytes")
        part.add(
            nanoseconds,
            message.arbitration_id | (EXTENDED if message.is_extended_id else 0),
            (message.channel if isinstance(message.channel, int) else 0) + self.first_bus,
            bytes(message.data),
        )


class _Lines(io.TextIOWrapper):
    """Counts the lines that are taken from it."""

    def __init__(self, file: io.BufferedReader, comment: re.Pattern[str]) -> None:
        super().__init__(file, encoding="utf-8", errors="replace")
        self.number = 0
        self.content = 0
        self._comment = comment

    def __next__(self) -> str:
        line = self.readline(_LONGEST_LINE)
        self.number += 1
        if len(line) == _LONGEST_LINE:
            raise ValueError(f"more than {_LONGEST_LINE} characters")
        if line.strip() and not self._comment.match(line):
            self.content += 1
            if not line.endswith("\n"):
                # A cut last line: half a byte would be taken for a byte.
                raise StopIteration
        if not line:
            raise StopIteration
        return line
