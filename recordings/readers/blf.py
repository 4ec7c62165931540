"""Vector's binary logging format, through python-can."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import can

from foundation.errors import FormatError
from recordings.readers.can_log import EXTENDED, CanReader, FrameList, Frames

PART = 500_000
"""Frames in a part."""
_FILE_HEADER = struct.Struct("<4sL")
_OBJECT_HEADER = struct.Struct("<4sHHLL")


class BlfReader(CanReader):
    """BLF files, classic CAN and CAN FD."""

    suffixes = (".blf",)

    def frames(self, path: Path) -> Iterator[Frames]:
        """Yield the frames; see `CanReader.frames`."""
        _check_whole(path)
        part = FrameList()
        count = 0
        try:
            with can.BLFReader(path) as log:
                for message in log:
                    count += 1
                    _add(part, message)
                    if len(part) >= PART:
                        yield part.frames()
                        part = FrameList()
        except Exception as error:  # struct, zlib and python-can's own, by where the damage is
            raise FormatError(
                f"the BLF file is damaged: {error or type(error).__name__}",
                where=f"{path}, after frame {count}",
                remedy="copy it again, or export it as a candump .log",
            ) from error
        yield part.frames()


def _add(part: FrameList, message: can.Message) -> None:
    if message.is_error_frame:
        part.error_frames += 1
    elif message.is_remote_frame:
        part.remote_frames += 1
    else:
        part.add(
            round(message.timestamp * 1e9),
            message.arbitration_id | (EXTENDED if message.is_extended_id else 0),
            message.channel if isinstance(message.channel, int) else 0,
            bytes(message.data),
        )


def _check_whole(path: Path) -> None:
    """Walk over the file's objects: python-can reads a cut one as far as it goes and says nothing.

    Raises:
        FormatError: The file does not start as a BLF, or ends within an object.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(_FILE_HEADER.size)
        if len(start) < _FILE_HEADER.size or start[:4] != b"LOGG":
            what = "the file is empty" if not start else "not a BLF file"
            raise FormatError(what, where=str(path), remedy="record or copy it again")
        _, position = _FILE_HEADER.unpack(start)
        while position < size:
            file.seek(position)
            header = file.read(_OBJECT_HEADER.size)
            whole = len(header) == _OBJECT_HEADER.size
            signature, _, _, length, _ = (
                _OBJECT_HEADER.unpack(header) if whole else (b"",) + (0,) * 4
            )
            if whole and (signature != b"LOBJ" or length < _OBJECT_HEADER.size):
                raise FormatError(
                    "the BLF file is damaged: no object where one is due",
                    where=f"{path}, byte {position}",
                    remedy="copy it again",
                )
            if not whole or position + length > size:
                raise FormatError(
                    "the BLF file is cut",
                    where=f"{path}, byte {position} of {size}",
                    remedy="copy it again; if the logger lost power, repair it with its own tool",
                )
            # python-can pads objects by this rule, not up to a multiple of four.
            position += length + length % 4
