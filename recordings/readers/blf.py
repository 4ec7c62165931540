"""Vector's binary logging format: objects in compressed containers, read a container at a time.

There is no public specification; the layout is that of python-can's reader (`can/io/blf.py`) and
of T. Lorenz's Vector BLF library, which it follows. Objects are found by their signature, all at
once; that each one ends where the next one begins shows that none was mistaken.
"""

from __future__ import annotations

import datetime
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from foundation.errors import FormatError
from recordings.readers.can_frames import EXTENDED, Frames
from recordings.readers.can_log import CanReader

PART = 1 << 19
"""Bytes of objects that are taken together."""
_LARGEST = 1 << 28
"""A container that says it inflates to more is damaged, or meant to fill the memory."""

_FILE_HEADER = struct.Struct("<4sL")
_START = struct.Struct("<8H")
_START_AT = 40
_OBJECT_HEADER = struct.Struct("<4sHHLL")
_CONTAINER_HEADER = struct.Struct("<H6xL4x")
_STORED, _DEFLATED = 0, 2
_CONTAINER = 10
_ERRORS = (2, 73)
_SIGNATURE = b"LOBJ"
_MOST_PADDING = 4

_BASE = np.dtype(
    {
        "names": ["version", "size", "type"],
        "formats": ["<u2", "<u4", "<u4"],
        "offsets": [6, 8, 12],
        "itemsize": 16,
    }
)
_BODY = {1: 32, 2: 40}
"""Where an object's body begins, by version of its header."""
_FD_MESSAGE_64 = 101
_CLASSIC = {
    "bus": ("<u2", 0),
    "flags": ("u1", 2),
    "valid": ("u1", 3),
    "id": ("<u4", 4),
    "data": (("u1", 8), 8),
}
_FD = {
    "bus": ("<u2", 0),
    "flags": ("u1", 2),
    "id": ("<u4", 4),
    "valid": ("u1", 14),
    "data": (("u1", 64), 20),
}
_FD_64 = {
    "bus": ("u1", 0),
    "valid": ("u1", 2),
    "id": ("<u4", 4),
    "flags": ("<u4", 12),
    "extra": ("u1", 35),
    "crc": ("<u4", 36),
}
_FIELDS = {1: _CLASSIC, 86: _CLASSIC, 100: _FD, _FD_MESSAGE_64: _FD_64}
"""Fields of the body, with their places in it, by type of object."""


def _layout(kind: int, version: int) -> np.dtype[Any]:
    """Return the fields that are used of an object: of its header, and of its body."""
    body = {name: (form, _BODY[version] + at) for name, (form, at) in _FIELDS[kind].items()}
    fields = {"clock": ("<u4", 16), "stamp": ("<u8", 24), **body}
    forms, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": list(forms), "offsets": list(offsets)})


_LAYOUTS = {(k, v): _layout(k, v) for k in _FIELDS for v in _BODY}
_TEN_MICROSECONDS = 1
_REMOTE, _REMOTE_64 = 0x80, 0x10
_VALID = np.where(np.arange(64) < np.arange(65)[:, np.newaxis], 0xFF, 0).astype(np.uint8)
"""Row n keeps the first n bytes of a payload."""


class BlfReader(CanReader):
    """BLF files, classic CAN and CAN FD."""

    suffixes = (".blf",)

    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames; see `CanReader.frames`."""
        with path.open("rb") as file:
            start, first = _file_header(file, path)
            position = first
            rest = b""
            gathered: list[bytes] = []
            for content, position in _containers(file, path, first):
                gathered.append(content)
                if sum(map(len, gathered)) >= PART:
                    frames, rest = _objects(b"".join([rest, *gathered]), start, path, position)
                    yield frames
                    gathered.clear()
            frames, _ = _objects(b"".join([rest, *gathered]), start, path, position)
            yield frames


def _file_header(file: BinaryIO, path: Path) -> tuple[int, int]:
    """Return when the recording started, ns since 1970, and where the first object is."""
    head = file.read(_START_AT + _START.size)
    if len(head) < _START_AT + _START.size or head[:4] != b"LOGG":
        what = "the file is empty" if not head else "not a BLF file"
        raise FormatError(what, where=str(path), remedy="record or copy it again")
    _, size = _FILE_HEADER.unpack_from(head)
    year, month, _, day, hour, minute, second, milli = _START.unpack_from(head, _START_AT)
    try:
        start = datetime.datetime(
            year, month, day, hour, minute, second, milli * 1000, datetime.UTC
        )
    except ValueError:  # all zeros where the logger had no clock
        return 0, size
    return round(start.timestamp() * 1000) * 1_000_000, size


def _containers(file: BinaryIO, path: Path, position: int) -> Iterator[tuple[bytes, int]]:
    """Yield the inflated content of the containers, each with its place in the file."""
    size = path.stat().st_size
    while position < size:
        file.seek(position)
        header = file.read(_OBJECT_HEADER.size)
        if len(header) < _OBJECT_HEADER.size:
            raise _cut(path, position, size)
        signature, _, _, length, kind = _OBJECT_HEADER.unpack(header)
        if signature != _SIGNATURE or length < _OBJECT_HEADER.size + _CONTAINER_HEADER.size:
            raise _damaged("no object where one is due", path, position)
        if position + length > size:
            raise _cut(path, position, size)
        if kind == _CONTAINER:
            yield _inflated(file.read(length - _OBJECT_HEADER.size), path, position), position
        # python-can pads objects by this rule, not up to a multiple of four.
        position += length + length % 4


def _inflated(container: bytes, path: Path, position: int) -> bytes:
    method, size = _CONTAINER_HEADER.unpack_from(container)
    content = container[_CONTAINER_HEADER.size :]
    if method == _STORED:
        return content
    if method != _DEFLATED:
        raise _damaged(f"compression of an unknown kind ({method})", path, position)
    if size > _LARGEST:
        raise _damaged(f"a container of {size} bytes", path, position)
    inflate = zlib.decompressobj()
    try:
        inflated = inflate.decompress(content, _LARGEST)
    except zlib.error as error:
        raise _damaged(str(error), path, position) from error
    if not inflate.eof:
        raise _damaged("a container that does not end", path, position)
    return inflated


def _cut(path: Path, position: int, size: int) -> FormatError:
    return FormatError(
        "the BLF file is cut",
        where=f"{path}, byte {position} of {size}",
        remedy="copy it again; if the logger lost power, repair it with its own tool",
    )


def _damaged(what: str, path: Path, position: int) -> FormatError:
    return FormatError(
        f"the BLF file is damaged: {what}",
        where=f"{path}, byte {position}",
        remedy="copy it again, or export it as a candump .log",
    )


def _objects(content: bytes, start: int, path: Path, position: int) -> tuple[Frames, bytes]:
    """Return the frames among neighbouring objects, and the bytes of one that is not whole yet."""
    data = np.frombuffer(content, np.uint8)
    begins, end = _begins(content, data, path, position)
    base = _gather(data, begins, _BASE)
    kinds, versions = base["type"].astype(np.int64), base["version"].astype(np.int64)
    count = np.bincount(np.minimum(kinds, 255), minlength=256)
    parts: list[tuple[NDArray[np.int64], Frames]] = []
    for (kind, version), layout in _LAYOUTS.items():
        if not count[kind]:
            continue
        rows = np.flatnonzero((kinds == kind) & (versions == version))
        if not rows.size:
            continue
        if np.any(base["size"][rows] < layout.itemsize):
            raise _damaged("an object that is too short for its kind", path, position)
        parts.append(_frames(data, begins[rows], base["size"][rows], kind, layout, rows, start))
    return _in_order(parts, sum(int(count[kind]) for kind in _ERRORS)), content[end:]


def _frames(
    data: NDArray[np.uint8],
    at: NDArray[np.int64],
    size: NDArray[np.uint32],
    kind: int,
    layout: np.dtype[Any],
    rows: NDArray[np.int64],
    start: int,
) -> tuple[NDArray[np.int64], Frames]:
    """Return the data frames of one kind of object, after the rows that they came from.

    Args:
        data: Bytes of all objects.
        at: Where those of this kind begin, shape (n,).
        size: Their bytes, shape (n,).
        kind: Their type.
        layout: Their fields.
        rows: Their places among all objects, shape (n,).
        start: When the recording started, ns since 1970.
    """
    found = _gather(data, at, layout)
    ticks = found["stamp"].astype(np.int64)
    stamps = np.where(found["clock"] == _TEN_MICROSECONDS, 10_000 * ticks, ticks) + start
    if kind == _FD_MESSAGE_64:
        is_remote = (found["flags"] & _REMOTE_64) != 0
        length = np.minimum(found["valid"], 64)
        # Bytes that are announced but not there are zeros, as CANoe has it (python-can, 1905).
        end = np.where(found["extra"] != 0, found["extra"], size)
        there = np.minimum(length, np.maximum(end, layout.itemsize) - layout.itemsize)
        payload = sliding_window_view(np.pad(data, (0, 64)), 64)[at + layout.itemsize]
    else:
        is_remote = (found["flags"] & _REMOTE) != 0
        payload = np.ascontiguousarray(found["data"])
        length = there = np.minimum(found["valid"], payload.shape[1])
    payload = payload & _VALID[there, : payload.shape[1]]
    frames = Frames(
        stamps,
        found["id"] & np.uint32(EXTENDED | 0x1FFFFFFF),
        found["bus"].astype(np.int64),
        length,
        payload,
    )
    if not np.any(is_remote):
        return rows, frames
    kept = np.flatnonzero(~is_remote)
    remote_frames = len(frames) - kept.size
    return rows[kept], replace(frames.ordered(kept), remote_frames=remote_frames)


def _in_order(parts: list[tuple[NDArray[np.int64], Frames]], errors: int) -> Frames:
    """Return the frames of all kinds in the order of their objects."""
    rows = np.concatenate([np.zeros(0, np.int64), *(rows for rows, _ in parts)])
    joined = Frames.joined([frames for _, frames in parts], errors)
    return joined if len(parts) < 2 else joined.ordered(np.argsort(rows))


def _begins(
    content: bytes, data: NDArray[np.uint8], path: Path, position: int
) -> tuple[NDArray[np.int64], int]:
    """Return where whole objects begin, shape (n,), and where the last one ends."""
    aligned = data[: data.size & ~3].view("<u4")
    begins = 4 * np.flatnonzero(aligned == np.frombuffer(_SIGNATURE, "<u4")[0])
    begins = begins[begins <= data.size - _OBJECT_HEADER.size]
    ends = begins + _gather(data, begins, _BASE)["size"].astype(np.int64)
    gaps = begins[1:] - ends[:-1]
    first = int(begins[0]) if begins.size else data.size
    if first > _MOST_PADDING or np.any((gaps < 0) | (gaps > _MOST_PADDING)):
        # Somebody pads to another boundary, or has the signature in a payload: one by one.
        begins, ends = _chain(content, path, position)
    whole = ends <= data.size
    return begins[whole], int(ends[whole][-1]) if np.any(whole) else 0


def _chain(
    content: bytes, path: Path, position: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where objects begin and end, shape (n,) each, found one after the other."""
    begins: list[int] = []
    ends: list[int] = []
    end = 0
    while end + _OBJECT_HEADER.size + _MOST_PADDING <= len(content):
        begin = content.find(_SIGNATURE, end, end + _MOST_PADDING + len(_SIGNATURE))
        if begin < 0:
            raise _damaged("no object where one is due, in the container", path, position)
        if begin + _OBJECT_HEADER.size > len(content):
            break
        size = _OBJECT_HEADER.unpack_from(content, begin)[3]
        if size < _OBJECT_HEADER.size:
            raise _damaged(f"an object of {size} bytes in the container", path, position)
        end = begin + size
        begins.append(begin)
        ends.append(end)
    return np.array(begins, np.int64), np.array(ends, np.int64)


def _gather(
    data: NDArray[np.uint8], begins: NDArray[np.int64], kind: np.dtype[Any]
) -> NDArray[Any]:
    """Return structures that begin at some bytes, shape (n,)."""
    if not begins.size:
        return np.zeros(0, kind)
    return sliding_window_view(data, kind.itemsize)[begins].view(kind)[:, 0]
