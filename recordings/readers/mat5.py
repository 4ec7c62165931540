"""Whether a MATLAB 5 to 7 file is whole, found without reading its values.

SciPy's reader believes what the tags of the file say; where they are damaged, it ends the process
instead of raising. Layout: MathWorks, MAT-File Format (R2024a), chapter 1, "Level 5 MAT-Files".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from math import prod

HEADER = 128
"""Bytes of text and version before the first element."""

_MATRIX, _COMPRESSED = 14, 15
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
"""Bytes a value by type of element."""
_INT8, _INT32, _UINT32 = 1, 5, 6
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
_LEADING = {
    _CELL: [_INT32, _INT8],
    _STRUCT: [_INT32, _INT8, _INT32, _INT8],
    _OBJECT: [_INT32, _INT8, _INT8, _INT32, _INT8],
    _CHAR: [_INT32, _INT8],
    _SPARSE: [_INT32, _INT8, _INT32, _INT32],
    **{numeric: [_INT32, _INT8] for numeric in range(6, 16)},
}
"""Types of the parts before the values by class: shape, name, and what else the class has.

Function handles and objects of MATLAB code have other classes; nobody describes their content.
"""
_COMPLEX = 0x0800


class DamagedError(ValueError):
    """The file is not whole; says at which byte of which element."""


def check(content: bytes) -> None:
    """Check the whole of a file's content.

    Raises:
        DamagedError: An element's tag cannot be right, or the file ends within an element.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:HEADER])
    if order is None:
        raise DamagedError("no header of MATLAB 5 to 7")
    for kind, data in _elements(content[HEADER:], order):
        if kind == _COMPRESSED:
            try:
                inflated = zlib.decompress(data)
            except zlib.error as error:
                raise DamagedError(f"a compressed variable: {error}") from error
            for inner, matrix in _elements(inflated, order):
                _check_matrix(inner, matrix, order)
        else:
            _check_matrix(kind, data, order)


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and data of neighbouring elements; each has a tag and is filled to 8 bytes."""
    position = 0
    while position < len(content):
        if position + 8 > len(content):
            raise DamagedError("the file ends within a tag")
        kind, size = struct.unpack_from(f"{order}LL", content, position)
        start = position + 8
        if kind >> 16:  # a small element: its data, up to 4 bytes, stand in the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, position + 4
        end = start + size
        small = start == position + 4
        if end > len(content) or (small and size > 4):
            raise DamagedError(f"an element of {size} bytes where {len(content) - start} are left")
        yield kind, content[start:end]
        position = position + 8 if small else end if kind == _COMPRESSED else end + -end % 8


def _check_matrix(kind: int, data: bytes, order: str) -> None:
    if kind != _MATRIX:
        raise DamagedError(f"an element of type {kind} where a variable is due")
    if not data:
        return
    (first, flags), *parts = _elements(data, order)
    if first != _UINT32 or len(flags) != 8:
        raise DamagedError("a variable without its class")
    (bits,) = struct.unpack_from(f"{order}L", flags)
    if (leading := _LEADING.get(bits & 0xFF)) is None:
        return
    head, values = parts[: len(leading)], parts[len(leading) :]
    if [part_kind for part_kind, _ in head] != leading or any(
        len(part) % _SIZES[part_kind] for part_kind, part in head
    ):
        raise DamagedError("a variable with missing parts")
    shape = struct.unpack(f"{order}{len(head[0][1]) // 4}l", head[0][1])
    if len(shape) < 2 or min(shape) < 0:
        raise DamagedError(f"a variable of shape {shape}")
    if bits & 0xFF in (_CELL, _STRUCT, _OBJECT):
        fields = 1 if bits & 0xFF == _CELL else _field_count(head, order)
        if len(values) != prod(shape) * fields:
            raise DamagedError(f"{len(values)} parts in a structure of {prod(shape) * fields}")
        for part_kind, part in values:
            _check_matrix(part_kind, part, order)
    else:
        counts = _value_counts(values, parts=2 if bits & _COMPLEX else 1)
        if bits & 0xFF not in (_CHAR, _SPARSE) and set(counts) != {prod(shape)}:
            raise DamagedError(f"an array of shape {shape} with {counts[0]} values")


def _field_count(head: list[tuple[int, bytes]], order: str) -> int:
    (_, length), (_, names) = head[-2:]
    if len(length) != 4:
        raise DamagedError("a structure without field names")
    (size,) = struct.unpack(f"{order}l", length)
    if not names:
        return 0
    if size <= 0 or len(names) % size:
        raise DamagedError(f"field names of {size} bytes in {len(names)}")
    return len(names) // size


def _value_counts(values: list[tuple[int, bytes]], parts: int) -> list[int]:
    if len(values) != parts:
        raise DamagedError(f"an array with {len(values)} parts of {parts}")
    for kind, data in values:
        if kind not in _SIZES or len(data) % _SIZES[kind]:
            raise DamagedError(f"values of type {kind} in {len(data)} bytes")
    return [len(data) // _SIZES[kind] for kind, data in values]
