"""Raw frames on disk, in a form that survives a kill: candump lines, flushed with every batch.

A BLF or MDF 4 writer keeps what it has not yet compressed in memory; a killed process leaves files
without it, or without anything. Lines of text that were handed to the system are there whatever
becomes of the process, and a last line cut in half is the only damage there can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import can
import numpy as np

from foundation.errors import InputError
from foundation.files import written_whole
from recordings.readers.can_frames import EXTENDED, Frames

SUFFIX = ".log"


class FrameRecorder:
    """Writes frames of a twin to files of bounded length in a folder of bounded size.

    Call `write` with every batch, at least every 100 ms: what it was given is then with the
    operating system. Stamps have microseconds, so that a replay sees what the pipeline saw.

    Args:
        folder: Made if it is not there.
        limit: Of all files in it [byte]; the oldest go first.
        part: After which span of stamps a new file is begun [s].
        buses: Names of the buses by number, as they stand in the file.

    Attributes:
        written: Frames.
        removed: Files that had to go.

    Raises:
        OSError: The folder cannot be made or written.
    """

    def __init__(
        self,
        folder: Path,
        *,
        limit: float = 20e9,
        part: float = 600.0,
        buses: Sequence[str] = ("bus0",),
    ) -> None:
        if not limit > 0 or not part > 0:
            raise InputError(
                f"a limit of {limit:g} bytes, parts of {part:g} s", remedy="give positive numbers"
            )
        self.folder, self.limit, self.part = folder, limit, part
        self._buses = list(buses)
        self.written = 0
        self.removed = 0
        self._file: BinaryIO | None = None
        self._until = 0
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def path(self) -> Path | None:
        """The file that is being written."""
        return None if self._file is None else Path(self._file.name)

    @property
    def files(self) -> list[Path]:
        """All recordings, oldest first."""
        return sorted(self.folder.glob(f"*{SUFFIX}"))

    def write(self, frames: Frames) -> None:
        """Write a batch and flush it.

        Raises:
            OSError: The disk is full, or gone; the next call begins a new file.
        """
        if not len(frames):
            return
        first = int(frames.nanoseconds[0])
        if self._file is None or not self._until - self._span <= first < self._until:
            self._open(first)
        assert self._file is not None
        try:
            self._file.write(_lines(frames, self._buses))
            self._file.flush()
        except OSError:
            self.close()
            raise
        self.written += len(frames)

    def close(self) -> None:
        """End the file."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    @property
    def _span(self) -> int:
        return int(1e9 * self.part)

    def _open(self, first: int) -> None:
        self.close()
        self._make_room()
        # Names sort by time; the number keeps two that begin in the same microsecond apart.
        number = 0
        while (path := self.folder / f"{first // 1000:020d}-{number}{SUFFIX}").exists():
            number += 1
        self._file = path.open("ab", buffering=1 << 16)
        self._until = first + self._span

    def _make_room(self) -> None:
        files = self.files
        sizes = [path.stat().st_size for path in files]
        while files and sum(sizes) > self.limit:
            files.pop(0).unlink(missing_ok=True)
            sizes.pop(0)
            self.removed += 1


def convert(recording: Path, target: Path) -> int:
    """Write a recording in another format, whole or not at all; return how many frames it has.

    Args:
        recording: Of a `FrameRecorder`, or any that python-can reads.
        target: `.mf4` (needs asammdf), `.blf`, `.asc`, `.trc`.

    Raises:
        InputError: The format cannot be written.
        OSError: A file cannot be read or written.
    """
    if target.suffix not in (".mf4", ".blf", ".asc", ".trc"):
        raise InputError(
            f"no CAN log of the kind '{target.suffix}' can be written",
            where=str(target),
            remedy="use .mf4, .blf, .asc or .trc",
        )
    count = 0
    with written_whole(target) as beside:
        # python-can chooses by the suffix, which the file beside has not got.
        named = beside.with_name(beside.name + target.suffix)
        try:
            with can.LogReader(recording) as read, can.Logger(named) as log:
                for frame in read:
                    log(frame)
                    count += 1
            named.replace(beside)
        except (ImportError, NotImplementedError) as error:
            raise InputError(
                f"{target.suffix} cannot be written: {error}",
                where=str(target),
                remedy="pip install asammdf, or convert to .blf",
            ) from error
        finally:
            named.unlink(missing_ok=True)
    return count


def _lines(frames: Frames, buses: Sequence[str]) -> bytes:
    micros = (frames.nanoseconds // 1000).tolist()
    names = buses[0] if len(buses) == 1 else None
    content = np.ascontiguousarray(frames.payload).tobytes().hex().upper()
    width = 2 * frames.payload.shape[1]
    rows: list[str] = []
    for k, (stamp, identifier, bus, length) in enumerate(
        zip(
            micros,
            frames.identifier.tolist(),
            frames.bus.tolist(),
            frames.length.tolist(),
            strict=True,
        )
    ):
        seconds, rest = divmod(stamp, 1_000_000)
        name = names or buses[bus]
        label = f"{identifier:03X}" if identifier < EXTENDED else f"{identifier - EXTENDED:08X}"
        data = content[k * width : k * width + 2 * length]
        mark = "#" if length <= 8 else "##0"
        rows.append(f"({seconds:010d}.{rest:06d}) {name} {label}{mark}{data}\n")
    return "".join(rows).encode()
