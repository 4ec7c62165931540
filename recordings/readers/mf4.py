"""ASAM MDF 4: measured channels as they are, and logged CAN frames by a DBC.

A file of a CAN logger holds frames (`CAN_DataFrame`, ASAM MDF bus logging); with a DBC they are
read as any other CAN log is. Without one, or if there are none, the file's channels are the
signals, each with the time stamps of its channel group.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ChannelError, FormatError, TimeError
from recordings.readers import mdf_groups
from recordings.readers.base import EVERYTHING, RawSignal, RawTable, Reader, Request, Scope
from recordings.readers.can_frames import EXTENDED, Frames
from recordings.readers.can_log import table_of
from recordings.readers.mdf_blocks import FIRST, Blocks, DamagedError
from recordings.readers.mdf_groups import Column, Group, Records, UnsupportedError

_FRAMES, _ERRORS, _REMOTES = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
_LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64], np.int64)
"""Bytes of payload by data length code (ISO 11898-1)."""
_LAST_SECOND = 9e9
"""Time stamps beyond this do not fit in 64 bits of nanoseconds."""


class Mf4Reader(Reader):
    """MDF 4 files."""

    suffixes = (".mf4",)

    def read(self, path: Path, *, dbc: Path | None = None, scope: Scope = EVERYTHING) -> RawTable:
        """Open the file; see `Reader.read`."""
        with _opened(path) as groups:
            logged = [group for group in groups if group.count and _has(group, _FRAMES)]
            if dbc is not None and logged:
                return table_of(_frames(groups, logged), dbc, scope, str(path))
            table = _ChannelTable([group for group in groups if group not in logged], path)
        if table.names:
            return table
        if logged:
            raise FormatError(
                "a log of CAN frames needs a DBC file that describes its messages",
                where=str(path),
                remedy="name one with --dbc",
            )
        raise FormatError("no sample in the file", where=str(path), remedy="record it again")

    def frames(self, path: Path) -> Frames:
        """Return all frames of bus logging, in the order of their stamps.

        These count from the first frame: the file's own count from when it was begun, which for a
        log that was converted is later than its frames.

        Raises:
            FormatError: There is none, or the file is damaged.
        """
        with _opened(path) as groups:
            logged = [group for group in groups if group.count and _has(group, _FRAMES)]
            if not logged:
                raise FormatError(
                    "no CAN frame in the file, only signals",
                    where=str(path),
                    remedy="replay a bus log; signals are for `twinproof identify`",
                )
            # Every bus, and every direction, has a group of its own.
            whole = Frames.joined(list(_frames(groups, logged)))
        whole = whole.ordered(np.argsort(whole.nanoseconds, kind="stable"))
        return replace(whole, nanoseconds=whole.nanoseconds - whole.nanoseconds[0])


class _ChannelTable(RawTable):
    """Channels of the channel groups; one whose name several groups have is `group.name`."""

    def __init__(self, groups: Sequence[Group], path: Path) -> None:
        self.origin = str(path)
        self._path = path
        found: dict[str, list[str]] = {}
        for long, _, column in _places(groups):
            found.setdefault(column.name, []).append(long)
        self._long = {
            name if len(longer) == 1 else long: long
            for name, longer in found.items()
            for long in longer
        }

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._long)

    def signals(self, requests: Sequence[Request]) -> list[RawSignal]:
        names = [self.plain(request) for request in requests]
        for name in names:
            if name not in self._long:
                raise self.missing(name, kind="channel")
        with _opened(self._path) as groups:
            places = {long: (group, column) for long, group, column in _places(groups)}
            return [self._signal(name, *places[self._long[name]]) for name in names]

    def _signal(self, name: str, group: Group, column: Column) -> RawSignal:
        times: list[NDArray[np.float64]] = []
        values: list[NDArray[np.float64]] = []
        invalid = 0
        for records in group.records():
            time, value = mdf_groups.times(group, records), group.values(column, records)
            there = np.isfinite(value)
            if (valid := group.valid(column, records)) is not None:
                there &= valid
            invalid += int(np.count_nonzero(~there))
            times.append(time[there])
            values.append(value[there])
        time, value = np.concatenate(times), np.concatenate(values)
        steps = np.diff(time)
        if not np.all(np.isfinite(time)) or np.any(steps < 0):
            sample = int(np.argmin(steps >= 0)) + 2
            raise TimeError(
                "time goes back",
                where=f"{self.origin}, channel '{name}', sample {sample}",
                remedy="cut the measurement there",
            )
        notes: list[str] = []
        if invalid:
            notes.append(f"{invalid} samples of '{name}' are marked invalid: left out")
        kept = np.append(steps > 0, True)[: time.size]
        if not np.all(kept):
            notes.append(f"{np.count_nonzero(~kept)} samples of '{name}' repeat a time stamp")
        if np.count_nonzero(kept) < 2:
            raise ChannelError(
                "; ".join([f"channel '{name}' has fewer than two values", *notes]),
                where=self.origin,
                remedy="leave it out, or record for longer",
            )
        return RawSignal(
            name,
            value[kept],
            time[kept],
            column.unit or None,
            _resolution(column),
            column.bits == 1 or column.conversion.names_values,
            tuple(notes),
        )


def _resolution(column: Column) -> float | None:
    """Return the step of a whole number, where its scale is the same everywhere."""
    if column.type > 3 or column.conversion.kind > 1:
        return None
    return 1.0 if column.conversion.kind == 0 else abs(float(column.conversion.values[1]))


def _places(groups: Sequence[Group]) -> Iterator[tuple[str, Group, Column]]:
    """Yield the channels of numbers, each with a name that no other has."""
    seen: dict[str, int] = {}
    for k, group in enumerate(groups):
        if not group.count:
            continue
        for column in mdf_groups.numeric(group.columns):
            long = f"{group.name or f'group{k}'}.{column.name}"
            seen[long] = seen.get(long, 0) + 1
            yield long if seen[long] == 1 else f"{long}#{seen[long]}", group, column


def _has(group: Group, name: str) -> bool:
    return any(column.name == name for column in group.columns)


def _frames(groups: Sequence[Group], logged: Sequence[Group]) -> Iterator[Frames]:
    """Yield the data frames of bus logging, group after group."""
    errors = sum(group.count for group in groups if _has(group, _ERRORS))
    remotes = sum(group.count for group in groups if _has(group, _REMOTES))
    for group in logged:
        fields = {c.name.removeprefix(f"{_FRAMES}."): c for c in group.columns}
        for name in ("ID", "DataBytes"):
            if name not in fields:
                raise UnsupportedError(f"CAN frames without {name}")
        for records in group.records():
            yield _part(group, records, fields, errors, remotes)
            errors = remotes = 0


def _part(
    group: Group, records: Records, fields: dict[str, Column], errors: int, remotes: int
) -> Frames:
    """Return some of a group's frames."""

    def whole(name: str) -> NDArray[np.int64] | None:
        column = fields.get(name)
        return None if column is None else group.raw(column, records).astype(np.int64)

    size = len(records.bytes)
    identifier = group.raw(fields["ID"], records).astype(np.int64)
    flag, bus, length, code = map(whole, ("IDE", "BusChannel", "DataLength", "DLC"))
    extended = identifier & EXTENDED != 0 if flag is None else flag != 0
    payload, there = group.texts(fields["DataBytes"], records, 64 if _is_long(group) else 8)
    if length is None:
        length = there if code is None else _LENGTHS[code & 15]
    length = np.minimum(np.minimum(length, there), payload.shape[1])
    used = np.arange(payload.shape[1]) < length[:, np.newaxis]
    seconds = mdf_groups.times(group, records)
    if not np.all(np.abs(seconds) < _LAST_SECOND):
        raise DamagedError("a time stamp that is no time")
    return Frames(
        np.rint(seconds * 1e9).astype(np.int64),
        ((identifier & 0x1FFFFFFF) | np.where(extended, EXTENDED, 0)).astype(np.uint32),
        np.zeros(size, np.int64) if bus is None else bus,
        length.astype(np.uint8),
        np.where(used, payload, np.uint8(0)),
        (),
        errors,
        remotes,
    )


def _is_long(group: Group) -> bool:
    """Return whether payloads may be longer than eight bytes."""
    data = next(c for c in group.columns if c.name == f"{_FRAMES}.DataBytes")
    return data.bits > 64 or _has(group, f"{_FRAMES}.EDL")


@contextmanager
def _opened(path: Path) -> Generator[list[Group]]:
    """Open a file and give its channel groups.

    Raises:
        FormatError: The file is empty, of another kind or version, not finalized, or damaged,
            or has what is not read here; also from the body.
    """
    with path.open("rb") as file:
        _check_identification(file.read(FIRST), path)
        try:
            yield mdf_groups.read_groups(Blocks(file))
        except DamagedError as error:
            raise FormatError(
                f"the MDF file is cut or damaged: {error}", where=str(path), remedy="copy it again"
            ) from error
        except UnsupportedError as error:
            raise FormatError(
                f"the MDF file has {error}, not read here",
                where=str(path),
                remedy="save it again as MDF 4.10, for example with asammdf",
            ) from error


def _check_identification(head: bytes, path: Path) -> None:
    if head[:8] == b"UnFinMF ":
        raise FormatError(
            "the MDF file was never finalized: the logger was switched off",
            where=str(path),
            remedy="finalize it with the logger's tool, or open and save it with asammdf",
        )
    if head[:8] != b"MDF     " or len(head) < FIRST:
        what = "the file is empty" if not head else "not an MDF file"
        raise FormatError(what, where=str(path), remedy="record or copy it again")
    if not head[8:].startswith(b"4."):
        version = head[8:16].decode("ascii", "replace").strip("\0 ")
        raise FormatError(
            f"an MDF file of version {version}",
            where=str(path),
            remedy="convert it to version 4, for example with asammdf",
        )
