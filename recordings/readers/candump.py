"""Logs of `candump -L` or `-l` from can-utils, plain or packed: `(time) bus id#payload`."""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from foundation.errors import FormatError
from recordings.readers.can_log import EXTENDED, CanReader, FrameList, Frames

PART = 500_000
"""Frames in a part."""
_ERROR_FRAME = 1 << 29
_LINE = re.compile(
    r"\((?P<s>\d+)\.(?P<fraction>\d{1,9})\)\s+(?P<bus>\S+)\s+"
    r"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})#"
    r"(?:(?P<remote>R)[0-9A-F]?|(?:\#[0-9A-F])?(?P<payload>(?:[0-9A-F]{2})*))"
    r"(?:_[0-9A-F])?(?:\s+[RT])?\s*",
    re.IGNORECASE,
)


class CandumpReader(CanReader):
    """Every line must be whole: python-can's reader takes half a byte for a byte."""

    suffixes = (".log", ".log.gz")

    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames; see `CanReader.frames`."""
        packed = path.name.lower().endswith(".gz")
        try:
            with (
                gzip.open(path, "rt", encoding="ascii") if packed else path.open(encoding="ascii")
            ) as lines:
                yield from _parts(lines, path)
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise FormatError(
                f"the packed log is damaged or cut: {error}",
                where=str(path),
                remedy="copy it again, or keep what `zcat` still yields of it",
            ) from error
        except UnicodeDecodeError as error:
            raise FormatError(
                "not a text file", where=str(path), remedy="is it a log of candump -L?"
            ) from error


def _parts(lines: TextIO, path: Path) -> Iterator[Frames]:
    buses: dict[str, int] = {}
    part = FrameList()
    for number, line in enumerate(lines, start=1):
        match = _LINE.fullmatch(line)
        if match is None:
            if line.strip():
                raise _bad_line(line, f"{path}, line {number}")
            continue
        seconds, fraction, bus, identifier, remote, payload = match.groups()
        key = int(identifier, 16)
        if key & _ERROR_FRAME:
            part.error_frames += 1
        elif remote:
            part.remote_frames += 1
        else:
            part.add(
                int(seconds + fraction.ljust(9, "0")),
                key | EXTENDED if len(identifier) == 8 else key,
                buses.setdefault(bus, len(buses)),
                bytes.fromhex(payload),
            )
        if len(part) >= PART:
            yield part.frames()
            part = FrameList()
    yield part.frames()


def _bad_line(line: str, where: str) -> FormatError:
    shown = line.strip()[:60]
    if line.endswith("\n"):
        remedy = "record with `candump -L`, or remove the line"
    else:
        remedy = "the log was cut: remove its last line"
    return FormatError(f"'{shown}' is not `(time) bus id#payload`", where=where, remedy=remedy)
