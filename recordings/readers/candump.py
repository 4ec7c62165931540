"""Logs of `candump -L` or `-l` from can-utils, plain or packed: `(time) bus id#payload`.

Lines of one form, that is of one length with the same bus and the same marks at the same places,
are read together as columns of characters. What the regular expression says of the first such
line then holds for all of them.
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from foundation.errors import FormatError
from recordings.readers.can_frames import EXTENDED, WORD, Frames
from recordings.readers.can_log import CanReader

PART = 1 << 19
"""Bytes that are read at a time: what is worked on should stay in the processor's cache."""
_LONGEST_LINE = 1 << 19
"""A file without a newline for so many bytes is no log."""
_ERROR_FRAME = 1 << 29
_LINE = re.compile(
    rb"\((?P<s>\d{1,9}|[0-8]\d{9})\.(?P<fraction>\d{1,9})\)\s+(?P<bus>[!-~]+)\s+"
    rb"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})#"
    rb"(?:(?P<remote>R)[0-9A-F]?|(?:\#[0-9A-F])?(?P<payload>(?:[0-9A-F]{2}){0,64}))"
    rb"(?:_[0-9A-F])?(?:\s+[RT])?\s*",
    re.IGNORECASE,
)
_FORMS = 24
"""Forms of one length that are tried; what is left then is read line by line."""

# Stamps beyond the year 2255 would not fit in 64 bits of nanoseconds: seconds start with 0 to 8.
# Characters as numbers: digits, in a hexadecimal sense, have bits 4 to 6 clear and their value in
# bits 0 to 3; bit 7 tells capitals. Other marks are themselves; what no log has is 0x7F.
_CODES = bytes(
    int(chr(c), 16) | (0x80 if chr(c) in "ABCDEF" else 0)
    if chr(c) in "0123456789abcdefABCDEF"
    else (c if 0x20 <= c < 0x7F else 0x7F)
    for c in range(256)
)
_NOT_HEX = 0x70


class CandumpReader(CanReader):
    """Every line must be whole: python-can's reader takes half a byte for a byte."""

    suffixes = (".log", ".log.gz")

    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames; see `CanReader.frames`."""
        packed = path.name.lower().endswith(".gz")
        try:
            with gzip.open(path) if packed else path.open("rb") as file:
                yield from _parts(cast("BinaryIO", file), path)
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise FormatError(
                f"the packed log is damaged or cut: {error}",
                where=str(path),
                remedy="copy it again, or keep what `zcat` still yields of it",
            ) from error


def _parts(file: BinaryIO, path: Path) -> Iterator[Frames]:
    lines = _Lines(path)
    rest = b""
    while part := file.read(PART):
        whole, newline, rest = (rest + part).rpartition(b"\n")
        if newline:
            yield lines.frames(whole + newline)
        elif len(rest) > _LONGEST_LINE:
            raise FormatError(
                "not a text file", where=str(path), remedy="is it a log of candump -L?"
            )
    if rest:
        lines.cut = True
        yield lines.frames(rest + b"\n")


class _Lines:
    """Turns lines into frames; knows buses and line numbers from one part to the next."""

    def __init__(self, path: Path) -> None:
        self.cut = False
        self._path = path
        self._buses: dict[bytes, int] = {}
        self._lines_before = 0

    def frames(self, text: bytes) -> Frames:
        """Return the frames of whole lines."""
        if b"\r" in text:
            text = text.replace(b"\r\n", b"\n")
        self._text = text
        # What np.flatnonzero wants most is booleans.
        ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n"))
        starts = np.concatenate([[0], ends[:-1] + 1])
        self._starts, self._ends = starts, ends
        self._codes = np.frombuffer(text.translate(_CODES), np.uint8)
        self._frames = _Columns(ends.size)
        lengths = ends - starts
        for length in np.flatnonzero(np.bincount(lengths)):
            if length:
                self._of_length(int(length), np.flatnonzero(lengths == length))
        self._lines_before += ends.size
        return self._frames.frames(tuple(name.decode() for name in self._buses))

    def _of_length(self, length: int, rows: NDArray[np.int64]) -> None:
        for _ in range(_FORMS):
            if not rows.size:
                return
            match = self._match(int(rows[0]))
            if match is None or match["payload"] is None:
                self._line(int(rows[0]), match)
                rows = rows[1:]
                continue
            form = _Form(match, self._codes[self._starts[rows[0]] :][:length])
            block = sliding_window_view(self._codes, length)[self._starts[rows]]
            fits = form.fits(block)
            if np.all(fits):
                self._put(form, match, rows, block)
                return
            self._put(form, match, rows[fits], block[fits])
            rows = rows[~fits]
        for row in rows.tolist():
            self._line(row, self._match(row))

    def _match(self, row: int) -> re.Match[bytes] | None:
        return _LINE.fullmatch(self._text[self._starts[row] : self._ends[row]])

    def _put(
        self, form: _Form, match: re.Match[bytes], rows: NDArray[np.int64], block: NDArray[np.uint8]
    ) -> None:
        bus = self._buses.setdefault(match["bus"], len(self._buses))
        self._frames.put(rows, *form.columns(block), bus)

    def _line(self, row: int, match: re.Match[bytes] | None) -> None:
        """Take a line by itself: a remote frame, nothing, a mistake, or of a rare form."""
        line = self._text[self._starts[row] : self._ends[row]]
        if match is None:
            if line.strip():
                raise self._bad(line, row)
        elif match["payload"] is None:
            self._frames.remote_frames += 1
        else:
            codes = np.frombuffer(line.translate(_CODES), np.uint8)
            self._put(_Form(match, codes), match, np.array([row]), codes[np.newaxis])

    def _bad(self, line: bytes, row: int) -> FormatError:
        where = f"{self._path}, line {self._lines_before + row + 1}"
        if not line.isascii():
            return FormatError("not a text file", where=where, remedy="is it a log of candump -L?")
        shown = line.decode().strip()[:60]
        if self.cut and row == self._ends.size - 1:
            remedy = "the log was cut: remove its last line"
        else:
            remedy = "record with `candump -L`, or remove the line"
        return FormatError(f"'{shown}' is not `(time) bus id#payload`", where=where, remedy=remedy)


class _Form:
    """Which characters of a line are digits of what, and which must be as they are."""

    def __init__(self, match: re.Match[bytes], codes: NDArray[np.uint8]) -> None:
        self._seconds = slice(*match.span("s"))
        self._fraction = slice(*match.span("fraction"))
        self._identifier = slice(*match.span("id"))
        self._payload = slice(*match.span("payload"))
        digits = np.zeros(codes.size, np.bool_)
        for part in (self._seconds, self._fraction, self._identifier, self._payload):
            digits[part] = True
        self._mask = np.where(digits, _NOT_HEX, 0xFF).astype(np.uint8)
        self._marks = codes & self._mask

    def fits(self, block: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return which lines, as codes of shape (n, length), have this form."""
        wrong = (block & self._mask) != self._marks
        decimal = (block[:, self._seconds], block[:, self._fraction])
        first = block[:, self._seconds.start] if decimal[0].shape[1] == 10 else np.uint8(0)
        if not np.any(wrong) and max(int(digits.max()) for digits in decimal) <= 9:
            return np.ones(len(block), np.bool_) & (first < 9)
        fits = ~np.any(wrong, axis=1) & (first < 9)
        for digits in decimal:
            fits &= np.all(digits <= 9, axis=1)
        return fits

    def columns(
        self, block: NDArray[np.uint8]
    ) -> tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint8]]:
        """Return time stamps, identifiers and payloads of lines of this form."""
        fraction = block[:, self._fraction]
        nanoseconds = _number(block[:, self._seconds]) * 1_000_000_000
        nanoseconds += _number(fraction) * 10 ** (9 - fraction.shape[1])
        digits = block[:, self._identifier] & np.uint8(0x0F)
        identifier = np.zeros(len(block), np.uint32)
        for k in range(digits.shape[1]):
            identifier <<= np.uint32(4)
            identifier |= digits[:, k]
        if digits.shape[1] == 8:
            identifier |= np.uint32(EXTENDED)
        halves = block[:, self._payload]
        payload = halves[:, ::2] << np.uint8(4)  # what is not of the digit is shifted out
        payload |= halves[:, 1::2] & np.uint8(0x0F)
        return nanoseconds, identifier, payload


def _number(digits: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return decimal digits, shape (n, up to 10), as numbers, shape (n,)."""
    powers = 10.0 ** np.arange(digits.shape[1])[::-1]
    return (digits.astype(np.float64) @ powers).astype(np.int64)


class _Columns:
    """Frames in the making, one place a line."""

    def __init__(self, size: int) -> None:
        self.remote_frames = 0
        self._error_frames = 0
        self._used = np.zeros(size, np.bool_)
        self._nanoseconds = np.zeros(size, np.int64)
        self._identifier = np.zeros(size, np.uint32)
        self._bus = np.zeros(size, np.int64)
        self._length = np.zeros(size, np.uint8)
        self._payload = np.zeros((size, WORD), np.uint8)

    def put(
        self,
        rows: NDArray[np.int64],
        nanoseconds: NDArray[np.int64],
        identifier: NDArray[np.uint32],
        payload: NDArray[np.uint8],
        bus: int,
    ) -> None:
        """Put frames of one length of payload and one bus in their lines' places."""
        errors = (identifier & np.uint32(_ERROR_FRAME)) != 0
        self._error_frames += int(np.count_nonzero(errors))
        self._used[rows] = ~errors
        self._nanoseconds[rows] = nanoseconds
        self._identifier[rows] = identifier
        self._bus[rows] = bus
        self._length[rows] = payload.shape[1]
        if payload.shape[1] > self._payload.shape[1]:
            more = payload.shape[1] - self._payload.shape[1]
            self._payload = np.pad(self._payload, ((0, 0), (0, more)))
        self._payload[rows, : payload.shape[1]] = payload

    def frames(self, bus_names: tuple[str, ...]) -> Frames:
        """Return the frames, without lines that have none."""
        rows = slice(None) if np.all(self._used) else self._used
        return Frames(
            self._nanoseconds[rows],
            self._identifier[rows],
            self._bus[rows],
            self._length[rows],
            self._payload[rows],
            bus_names,
            self._error_frames,
            self.remote_frames,
        )
