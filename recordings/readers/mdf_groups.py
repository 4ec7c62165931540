"""Channel groups of MDF 4 files: what records are made of, and columns of values out of them."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from recordings.readers.can_bits import words
from recordings.readers.mdf_blocks import FIRST, Block, Blocks, DamagedError, Stream

PART = 1 << 22
"""Bytes of records that are read at a time."""
_DATA_GROUP = struct.Struct("<B")
_GROUP = struct.Struct("<QQHHxxxxII")
_CHANNEL = struct.Struct("<BBBBIIII")
_CONVERSION = struct.Struct("<BBHHHdd")
_VARIABLE_LENGTH_GROUP = 1
_FIXED, _VARIABLE, _MASTER, _VIRTUAL_MASTER, _SYNC, _VIRTUAL = 0, 1, 2, 3, 4, 6
_ALL_INVALID, _HAS_INVALID_BIT = 1, 2
_TIME = 1
_UNSIGNED, _SIGNED, _FLOAT = (0, 1), (2, 3), (4, 5)
_BIG_ENDIAN = (1, 3, 5)
_FLOATS = {16: np.float16, 32: np.float32, 64: np.float64}
_LONGEST_VALUE = 1 << 12
"""Bytes of one value of variable length that are still taken."""


class UnsupportedError(ValueError):
    """Right MDF 4, but a part of it that is not read here."""


@dataclass(frozen=True)
class Conversion:
    """From stored numbers to physical ones (MDF 4.1, 5.19).

    Attributes:
        kind: 0 none, 1 linear, 2 rational, 4 and 5 tables with and without interpolation, 6
            ranges, 7 and 8 names of values.
        values: Its numbers.
        unit: Of what comes out; empty where it does not say.
        default: Of a conversion to names: how the values without one are scaled.
    """

    kind: int
    values: NDArray[np.float64]
    unit: str = ""
    default: Conversion | None = None

    @property
    def names_values(self) -> bool:
        """Whether it gives values names, and no scale."""
        return self.kind in (7, 8) and (self.default is None or self.default.kind == 0)

    def __call__(self, raw: NDArray[Any]) -> NDArray[np.float64]:  # noqa: PLR0911, one a kind
        """Return physical values of stored ones, shape (n,).

        Raises:
            UnsupportedError: It is a formula or a text.
            DamagedError: Numbers are missing.
        """
        x, v = raw.astype(np.float64), self.values
        try:
            if self.kind == 0:
                return x
            if self.kind == 1:
                return v[0] + v[1] * x
            if self.kind == 2:
                with np.errstate(divide="ignore", invalid="ignore"):
                    return np.polyval(v[:3], x) / np.polyval(v[3:6], x)
            if self.kind == 4:
                return np.interp(x, v[0::2], v[1::2])
            if self.kind == 5:
                between = (v[0:-2:2] + v[2::2]) / 2
                return v[1::2][np.searchsorted(between, x, side="left")]
            if self.kind == 6:
                return self._of_ranges(x)
        except (IndexError, ValueError) as error:
            raise DamagedError(f"a conversion of kind {self.kind} with {v.size} numbers") from error
        if self.kind in (7, 8):
            return x if self.default is None else self.default(raw)
        raise UnsupportedError(f"a conversion of kind {self.kind}")

    def _of_ranges(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        found = np.full(x.shape, self.values[-1] if self.values.size % 3 else np.nan)
        for k in range(self.values.size // 3):
            low, high, value = self.values[3 * k : 3 * k + 3]
            found[(x >= low) & (x <= high)] = value
        return found


@dataclass(frozen=True)
class Column:
    """A channel: where its values are in a record, and what they mean.

    Attributes:
        name: Its name.
        unit: Physical unit; empty where the file does not say.
        kind: 0 values, 1 of variable length, 2 the master, 3 a computed one, 4 to 6 others.
        sync: Of a master: 1 for time.
        type: 0 to 5: unsigned, signed, float; even for Intel byte order.
        byte: First byte in the record.
        bit: Bits that are skipped there.
        bits: Bits of the value.
        flags: 1: no value is valid; 2: each one has a bit that says when it is not.
        invalid_bit: Which of the group's.
        conversion: To physical values.
        data: Where values of variable length are: link to them.
    """

    name: str
    unit: str
    kind: int
    sync: int
    type: int
    byte: int
    bit: int
    bits: int
    flags: int
    invalid_bit: int
    conversion: Conversion
    data: int

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers in the records."""
        return self.kind in (_FIXED, _SYNC, _MASTER) and self.type <= 5 and 1 <= self.bits <= 64

    @property
    def is_master(self) -> bool:
        """Whether the others of its group are sampled along it."""
        return self.kind in (_MASTER, _VIRTUAL_MASTER)


@dataclass(frozen=True)
class Records:
    """Some records of a group.

    Attributes:
        first: Which one is the first.
        bytes: Shape (n, size).
    """

    first: int
    bytes: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Group:
    """A channel group.

    Attributes:
        name: What the file calls it; may be empty.
        columns: Its channels, those within structures included.
        count: How many records it has.
        size: Bytes of a record, without those of invalidation bits.
        invalid_size: Bytes of invalidation bits, which follow.
        number: Its number in unsorted records.
    """

    name: str
    columns: tuple[Column, ...]
    count: int
    size: int
    invalid_size: int
    number: int
    _blocks: Blocks
    _source: _Sorted | _Unsorted

    def records(self) -> Iterator[Records]:
        """Yield the records, in parts.

        Raises:
            DamagedError: The file has fewer.
        """
        yield from self._source.records(self)

    def master(self) -> Column | None:
        """Return the channel that the others are sampled along."""
        return next((column for column in self.columns if column.is_master), None)

    def raw(self, column: Column, records: Records) -> NDArray[Any]:
        """Return a channel's stored numbers, shape (n,).

        Raises:
            DamagedError: It lies outside the record.
        """
        if column.kind == _VIRTUAL_MASTER:
            return records.first + np.arange(len(records.bytes))
        end = column.byte + (column.bit + column.bits + 7) // 8
        if end > self.size or end - column.byte > 8:
            raise DamagedError(f"channel '{column.name}' lies outside its record")
        raw = words(records.bytes[:, column.byte : end], column.type not in _BIG_ENDIAN)
        if column.type in _BIG_ENDIAN:
            raw = raw >> np.uint64(8 * (8 - end + column.byte))
        raw = (raw >> np.uint64(column.bit)) & np.uint64((1 << column.bits) - 1)
        if column.type in _FLOAT:
            if column.bits not in _FLOATS:
                raise DamagedError(f"channel '{column.name}' is a float of {column.bits} bits")
            return raw.astype(f"u{column.bits // 8}").view(_FLOATS[column.bits])
        if column.type in _SIGNED:
            unused = np.int64(64 - column.bits)
            return (raw << np.uint64(unused)).view(np.int64) >> unused
        return raw

    def values(self, column: Column, records: Records) -> NDArray[np.float64]:
        """Return a channel's physical values, shape (n,); errors as `raw` and `Conversion`."""
        return column.conversion(self.raw(column, records))

    def valid(self, column: Column, records: Records) -> NDArray[np.bool_] | None:
        """Return which values are valid, shape (n,); None for all."""
        if column.flags & _ALL_INVALID:
            return np.zeros(len(records.bytes), np.bool_)
        if not column.flags & _HAS_INVALID_BIT:
            return None
        byte = self.size + column.invalid_bit // 8
        if byte >= self.size + self.invalid_size:
            raise DamagedError(f"channel '{column.name}' has no invalidation bit in its record")
        return (records.bytes[:, byte] >> np.uint8(column.invalid_bit % 8)) & 1 == 0

    def texts(
        self, column: Column, records: Records, most: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Return a channel's bytes, shape (n, most), filled up with zeros, and how many are used.

        Raises:
            DamagedError: They lie outside the record, or outside the data of variable length.
        """
        if column.kind != _VARIABLE:
            size = column.bits // 8
            if column.byte + size > self.size or column.bit:
                raise DamagedError(f"channel '{column.name}' lies outside its record")
            used = min(size, most)
            found = np.zeros((len(records.bytes), most), np.uint8)
            found[:, :used] = records.bytes[:, column.byte : column.byte + used]
            return found, np.full(len(found), used)
        offsets = words(records.bytes[:, column.byte : column.byte + 8], True)
        if column.byte + 8 > self.size:
            raise DamagedError(f"channel '{column.name}' lies outside its record")
        return self._source.texts(self._blocks, column, offsets, most)


def cut_texts(
    data: NDArray[np.uint8], offsets: NDArray[np.int64], most: int
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return values of variable length: at each offset a length of 4 bytes, then the bytes.

    Args:
        data: All of them.
        offsets: Where those wanted begin, shape (n,).
        most: Bytes of each that are returned.

    Raises:
        DamagedError: One lies outside the data.
    """
    if offsets.size and (offsets.min() < 0 or offsets.max() + 4 > data.size):
        raise DamagedError("a value of variable length lies outside its data")
    padded = np.pad(data, (0, 4 + most))
    found = sliding_window_view(padded, 4 + most)[offsets]
    length = np.ascontiguousarray(found[:, :4]).view("<u4")[:, 0].astype(np.int64)
    if np.any(length > _LONGEST_VALUE) or np.any(offsets + 4 + length > data.size):
        raise DamagedError("a value of variable length lies outside its data")
    return found[:, 4:], np.minimum(length, most)


class _Sorted:
    """Records of one group only, one behind the other."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._texts: dict[int, Stream] = {}

    def records(self, group: Group) -> Iterator[Records]:
        size = group.size + group.invalid_size
        if size * group.count > len(self._stream):
            raise DamagedError(f"{len(self._stream)} bytes of {group.count} records of {size}")
        step = max(PART // max(size, 1), 1)
        for first in range(0, group.count, step):
            count = min(step, group.count - first)
            content = self._stream.read(first * size, (first + count) * size)
            yield Records(first, np.frombuffer(content, np.uint8).reshape(count, size))

    def texts(
        self, blocks: Blocks, column: Column, offsets: NDArray[np.uint64], most: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        if column.data not in self._texts:
            self._texts[column.data] = blocks.stream(column.data)
        stream = self._texts[column.data]
        if not offsets.size:
            return np.zeros((0, most), np.uint8), np.zeros(0, np.int64)
        if int(offsets.max()) > len(stream):
            raise DamagedError("a value of variable length lies outside its data")
        begin = int(offsets.min())
        end = min(int(offsets.max()) + 4 + _LONGEST_VALUE, len(stream))
        data = np.frombuffer(stream.read(begin, end), np.uint8)
        return cut_texts(data, offsets.astype(np.int64) - begin, most)


@dataclass(eq=False)
class _Unsorted:
    """Records of several groups as they came, each after its group's number; sorted in memory."""

    stream: Stream
    id_size: int
    sizes: dict[int, int] = field(default_factory=dict[int, int])
    """Bytes of a record by group's number; -1 for values of variable length."""
    numbers: dict[int, int] = field(default_factory=dict[int, int])
    """Group's number by the link to its block."""
    _content: NDArray[np.uint8] | None = None
    _begins: dict[int, NDArray[np.int64]] = field(default_factory=dict[int, NDArray[np.int64]])
    _texts: dict[int, NDArray[np.uint8]] = field(default_factory=dict[int, NDArray[np.uint8]])

    def records(self, group: Group) -> Iterator[Records]:
        content = self._sorted()
        begins = self._begins[group.number]
        size = group.size + group.invalid_size
        step = max(PART // max(size, 1), 1)
        for first in range(0, begins.size, step):
            rows = begins[first : first + step]
            yield Records(first, sliding_window_view(content, size)[rows])

    def texts(
        self, blocks: Blocks, column: Column, offsets: NDArray[np.uint64], most: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        number = self.numbers.get(column.data)
        if number is None:
            return _Sorted(self.stream).texts(blocks, column, offsets, most)
        content = self._sorted()
        if number not in self._texts:
            spans = [
                content[at : at + 4 + int.from_bytes(content[at : at + 4].tobytes(), "little")]
                for at in self._begins[number].tolist()
            ]
            self._texts[number] = np.concatenate([np.zeros(0, np.uint8), *spans])
        return cut_texts(self._texts[number], offsets.astype(np.int64), most)

    def _sorted(self) -> NDArray[np.uint8]:
        """Return all records, and remember where those of each group begin."""
        if self._content is not None:
            return self._content
        content = self.stream.read(0, len(self.stream))
        begins: dict[int, list[int]] = {number: [] for number in self.sizes}
        at = 0
        while at < len(content):
            number = int.from_bytes(content[at : at + self.id_size], "little")
            at += self.id_size
            size = self.sizes.get(number)
            if size is None:
                raise DamagedError(f"a record of group {number}, which there is not")
            if size < 0:
                size = 4 + int.from_bytes(content[at : at + 4], "little")
            if at + size > len(content):
                raise DamagedError("the last record is not whole")
            begins[number].append(at)
            at += size
        self._begins = {number: np.array(found, np.int64) for number, found in begins.items()}
        self._content = np.frombuffer(content, np.uint8)
        return self._content


def read_groups(blocks: Blocks) -> list[Group]:
    """Return all channel groups of a file.

    Raises:
        DamagedError: A block is not right.
    """
    groups: list[Group] = []
    header = blocks.block(FIRST, b"##HD")
    for data_group in blocks.chain(header.link(0), b"##DG"):
        (id_size,) = blocks.unpack(data_group, _DATA_GROUP)
        stream = blocks.stream(data_group.link(2))
        members = list(blocks.chain(data_group.link(1), b"##CG"))
        if id_size not in (0, 1, 2, 4, 8) or (id_size == 0 and len(members) > 1):
            raise DamagedError(f"record numbers of {id_size} bytes at byte {data_group.at}")
        source = _Unsorted(stream, id_size) if id_size else _Sorted(stream)
        for member in members:
            group = _group(blocks, member, source)
            if group is not None:
                groups.append(group)
    return groups


def _group(blocks: Blocks, block: Block, source: _Sorted | _Unsorted) -> Group | None:
    """Return a channel group; None for one that only holds values of variable length."""
    number, count, flags, _, size, invalid_size = blocks.unpack(block, _GROUP)
    variable = bool(flags & _VARIABLE_LENGTH_GROUP)
    columns = () if variable else tuple(_columns(blocks, block.link(1), set()))
    if isinstance(source, _Unsorted):
        source.sizes[number] = -1 if variable else size + invalid_size
        source.numbers[block.at] = number
    if variable:
        return None
    if count and not size:
        raise DamagedError(f"records of no bytes at byte {block.at}")
    name = blocks.text(block.link(2))
    return Group(name, columns, count, size, invalid_size, number, blocks, source)


def _columns(blocks: Blocks, at: int, seen: set[int]) -> Iterator[Column]:
    """Yield the channels of a list, each followed by those it is made of."""
    for block in blocks.chain(at, b"##CN"):
        if block.at in seen:
            raise DamagedError(f"a channel that is part of itself at byte {block.at}")
        seen.add(block.at)
        kind, sync, form, bit, byte, bits, flags, invalid_bit = blocks.unpack(block, _CHANNEL)
        conversion = _conversion(blocks, block.link(4))
        yield Column(
            blocks.text(block.link(2)),
            blocks.text(block.link(6)) or conversion.unit,
            kind,
            sync,
            form,
            byte,
            bit,
            bits,
            flags,
            invalid_bit,
            conversion,
            block.link(5),
        )
        part = block.link(1)
        if blocks.is_kind(part, b"##CN"):
            yield from _columns(blocks, part, seen)


def _conversion(blocks: Blocks, at: int, depth: int = 0) -> Conversion:
    if not at:
        return Conversion(0, np.zeros(0))
    if depth > 4:
        raise DamagedError(f"a conversion of conversions at byte {at}")
    block = blocks.block(at, b"##CC")
    kind, _, _, references, count, _, _ = blocks.unpack(block, _CONVERSION)
    first = block.begin + _CONVERSION.size
    values = blocks.bytes(first, min(first + 8 * count, block.end))
    if len(values) != 8 * count:
        raise DamagedError(f"a short CC block at byte {at}")
    default = block.link(3 + references) if kind in (7, 8) and references else 0
    return Conversion(
        kind,
        np.frombuffer(values, "<f8").astype(np.float64),
        blocks.text(block.link(1)),
        _conversion(blocks, default, depth + 1) if blocks.is_kind(default, b"##CC") else None,
    )


def times(group: Group, records: Records) -> NDArray[np.float64]:
    """Return a group's time stamps, s, shape (n,).

    Raises:
        UnsupportedError: It is not sampled along time.
    """
    master = group.master()
    if master is None or master.sync != _TIME:
        raise UnsupportedError("channels that are not sampled along time")
    return group.values(master, records)


def numeric(columns: Sequence[Column]) -> list[Column]:
    """Return the channels whose values are numbers, without masters."""
    return [c for c in columns if c.is_number and not c.is_master]
