"""Vector's text format for CAN logs."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

import can

from foundation.errors import FormatError
from recordings.readers.can_lines import LineReader


class AscReader(LineReader):
    """ASC files, classic CAN and CAN FD; buses have the file's numbers, from 1."""

    suffixes = (".asc",)
    comment = re.compile(
        r"\s*(date|base|(no )?internal|//|begin trigger|end trigger|previous log|"
        r"[\d.]+\s+(start of|log |\d+\s+statistic|can \d+ status))",
        re.IGNORECASE,
    )
    digits = 9
    first_bus = 1

    def messages(self, lines: io.TextIOWrapper) -> Iterator[can.Message]:
        """Yield the messages; see `LineReader.messages`."""
        reader = can.ASCReader(lines)
        for message in reader:
            if reader.timestamps_format == "relative":
                raise FormatError(
                    "each time stamp counts from the line before",
                    where=str(lines.name),
                    remedy="export it again with absolute time stamps",
                )
            yield message
