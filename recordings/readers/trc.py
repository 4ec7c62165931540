"""PEAK's text format for CAN logs, versions 1.0, 1.1, 1.3, 2.0 and 2.1."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

import can

from recordings.readers.can_lines import LineReader


class TrcReader(LineReader):
    """TRC files; buses have the file's numbers, from 1."""

    suffixes = (".trc",)
    comment = re.compile(r"\s*;")
    # Stamps are days since 1899 plus milliseconds: as seconds, a float has six decimals of them.
    digits = 6
    first_bus = 0

    def messages(self, lines: io.TextIOWrapper) -> Iterator[can.Message]:
        """Yield the messages; see `LineReader.messages`."""
        yield from can.TRCReader(lines)
