"""Blocks of MDF 4 files: links between them, texts, and data in pieces.

Layout: ASAM MDF 4.1, chapter 5. Every block has an identifier, a length, links to other blocks and
data. Nothing is believed: links lead to whole blocks of the kind that is due, lists end, pieces
inflate to what they say. Here is written what is used of the format rather than a library called:
the one there is ends the process on damaged files, and prints what it thinks of them.
"""

from __future__ import annotations

import html
import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

FIRST = 64
"""Where the first block, the header, begins."""
_HEADER = struct.Struct("<4s4xQQ")
_DEFLATED = struct.Struct("<2sBxIQQ")
_TRANSPOSED = 1
_LARGEST = 1 << 28
"""Bytes that one compressed piece may inflate to; the format's own advice is 4 MB."""
_DATA = (b"##DT", b"##SD", b"##DZ")
_TEXT_OF_XML = re.compile(r"<TX[^>]*>(.*?)</TX>", re.DOTALL)


class DamagedError(ValueError):
    """A block that cannot be right; says which, and where."""


@dataclass(frozen=True)
class Block:
    """A block.

    Attributes:
        at: Where it begins in the file.
        kind: Its identifier, such as `##DG`.
        links: Where other blocks begin; 0 for none.
        begin: Where its data begin.
        end: Where they end.
    """

    at: int
    kind: bytes
    links: tuple[int, ...]
    begin: int
    end: int

    def link(self, k: int) -> int:
        """Return a link; 0 if the block has fewer."""
        return self.links[k] if k < len(self.links) else 0

    def __len__(self) -> int:
        return self.end - self.begin


class Blocks:
    """The blocks of a file that is open for reading."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, os.SEEK_END)

    def bytes(self, begin: int, end: int) -> bytes:
        """Return bytes of the file."""
        self._file.seek(begin)
        return self._file.read(end - begin)

    def is_kind(self, at: int, kind: bytes) -> bool:
        """Return whether a block of that kind begins there."""
        return 0 < at < self._size and self.bytes(at, at + 4) == kind

    def block(self, at: int, *kinds: bytes) -> Block:
        """Return the block at a link.

        Raises:
            DamagedError: There is none of these kinds, or it is not whole.
        """
        due = " or ".join(kind[2:].decode("ascii") for kind in kinds)
        if at < FIRST or at + _HEADER.size > self._size:
            raise DamagedError(f"{due} should be at byte {at} of {self._size}")
        kind, length, count = _HEADER.unpack(self.bytes(at, at + _HEADER.size))
        if kind not in kinds:
            raise DamagedError(f"no {due} at byte {at}")
        begin = at + _HEADER.size + 8 * count
        if begin > at + length or at + length > self._size:
            raise DamagedError(f"{due} of {length} bytes at byte {at} of {self._size}")
        links = struct.unpack(f"<{count}Q", self.bytes(at + _HEADER.size, begin))
        return Block(at, kind, links, begin, at + length)

    def unpack(self, block: Block, form: struct.Struct) -> tuple[Any, ...]:
        """Return what a block's data begin with.

        Raises:
            DamagedError: There are fewer data.
        """
        if form.size > len(block):
            raise DamagedError(f"a short {block.kind[2:].decode('ascii')} block at byte {block.at}")
        return form.unpack(self.bytes(block.begin, block.begin + form.size))

    def chain(self, at: int, *kinds: bytes) -> Iterator[Block]:
        """Yield the blocks of a list: the first link of each is the next.

        Raises:
            DamagedError: A block is not right, or the list goes round.
        """
        seen: set[int] = set()
        while at:
            if at in seen:
                raise DamagedError(f"a list that comes back to byte {at}")
            seen.add(at)
            block = self.block(at, *kinds)
            yield block
            at = block.link(0)

    def text(self, at: int) -> str:
        """Return a text, or the text within a description; empty at link 0."""
        if not at:
            return ""
        block = self.block(at, b"##TX", b"##MD")
        text = self.bytes(block.begin, block.end).split(b"\0")[0].decode("utf-8", "replace").strip()
        if block.kind == b"##MD":
            found = _TEXT_OF_XML.search(text)
            return html.unescape(found[1]).strip() if found else ""
        return text

    def stream(self, at: int) -> Stream:
        """Return the data at a link: one block, or a list of them; nothing at link 0."""
        pieces: list[_Piece] = []
        if at:
            first = self.block(at, *_DATA, b"##DL", b"##HL")
            if first.kind == b"##HL":
                first = self.block(first.link(0), b"##DL")
            lists = [] if first.kind != b"##DL" else self.chain(first.at, b"##DL")
            links = [first.at] if first.kind != b"##DL" else [k for b in lists for k in b.links[1:]]
            pieces = [self._piece(self.block(link, *_DATA)) for link in links if link]
        return Stream(pieces)

    def _piece(self, block: Block) -> _Piece:
        if block.kind != b"##DZ":
            return _Piece(self, block, len(block))
        _, method, width, size, packed = self.unpack(block, _DEFLATED)
        if size > _LARGEST or _DEFLATED.size + packed > len(block) or method > _TRANSPOSED:
            raise DamagedError(f"a packed block of kind {method}, {size} bytes, at byte {block.at}")
        return _Piece(self, block, size, packed, width if method == _TRANSPOSED else 1)


@dataclass(frozen=True)
class _Piece:
    blocks: Blocks
    block: Block
    size: int
    packed: int = 0
    columns: int = 1

    def read(self, begin: int, end: int) -> bytes:
        """Return bytes of a piece that is not packed."""
        end = min(end, self.size)
        return self.blocks.bytes(self.block.begin + begin, self.block.begin + end)

    def inflated(self) -> bytes:
        """Return the piece inflated, and its bytes back in the order of records."""
        inflate = zlib.decompressobj()
        begin = self.block.begin + _DEFLATED.size
        try:
            content = inflate.decompress(
                self.blocks.bytes(begin, begin + self.packed), self.size + 1
            )
        except zlib.error as error:
            raise DamagedError(f"{error}, at byte {self.block.at}") from error
        if len(content) != self.size:
            raise DamagedError(f"a packed block of another size at byte {self.block.at}")
        if self.columns < 2:
            return content
        whole = len(content) // self.columns * self.columns
        table = np.frombuffer(content, np.uint8, whole).reshape(self.columns, -1)
        return table.T.tobytes() + content[whole:]


class Stream:
    """Data that stand in several pieces of a file; one piece at a time is inflated."""

    def __init__(self, pieces: list[_Piece]) -> None:
        self._pieces = pieces
        self._ends = np.cumsum([piece.size for piece in pieces], dtype=np.int64)
        self._inflated: tuple[int, bytes] = (-1, b"")

    def __len__(self) -> int:
        return int(self._ends[-1]) if self._pieces else 0

    def read(self, begin: int, end: int) -> bytes:
        """Return the bytes from one place up to another.

        Raises:
            DamagedError: There are fewer, or a piece does not inflate.
        """
        if not 0 <= begin <= end <= len(self):
            raise DamagedError(f"bytes {begin} to {end} of data of {len(self)} bytes")
        found: list[bytes] = []
        k = int(np.searchsorted(self._ends, begin, side="right"))
        while begin < end:
            start = int(self._ends[k]) - self._pieces[k].size
            found.append(self._of_piece(k, begin - start, end - start))
            begin = int(self._ends[k])
            k += 1
        return b"".join(found)

    def _of_piece(self, k: int, begin: int, end: int) -> bytes:
        piece = self._pieces[k]
        if not piece.packed:
            return piece.read(begin, end)
        if self._inflated[0] != k:
            self._inflated = (k, piece.inflated())
        return self._inflated[1][begin:end]
