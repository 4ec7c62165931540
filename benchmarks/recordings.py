"""Reading CAN logs by columns beside reading them frame by frame, and the memory of a long one."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import cantools
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure
from recordings.readers import Request, reader_for

FRAMES = 200_000
MESSAGES = 10
DBC = 'VERSION ""\nBU_: X\n' + "".join(
    f"BO_ {256 + k} M{k}: 8 X\n"
    f' SG_ a{k} : 0|16@1- (0.01,0) [0|0] "rad" X\n'
    f' SG_ b{k} : 23|16@0- (0.1,0) [0|0] "rad/s" X\n'
    f' SG_ c{k} : 32|12@1+ (0.5,-40) [0|0] "V" X\n'
    f' SG_ d{k} : 44|20@1+ (0.001,0) [0|0] "A" X\n'
    for k in range(MESSAGES)
)
LONG_FRAMES = 36_000_000
"""Ten hours at 1000 frames a second."""


def run() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        dbc = Path(folder, "bus.dbc")
        dbc.write_text(DBC)
        for suffix in (".log", ".blf"):
            path = Path(folder, f"run{suffix}")
            write(path)
            yield from _beside_frame_by_frame(path, dbc)
        yield from _ten_hours(Path(folder, "long.log"), dbc)


def write(path: Path) -> None:
    """Write frames that all carry signals of the DBC."""
    payloads = np.random.default_rng(1).integers(0, 256, (FRAMES, 8), np.uint8)
    with can.Logger(path) as log:
        for k, payload in enumerate(payloads):
            log(
                can.Message(
                    timestamp=1.7e9 + k / 1000,
                    arbitration_id=256 + k % MESSAGES,
                    is_extended_id=False,
                    data=bytes(payload),
                    channel=0,
                )
            )


def _beside_frame_by_frame(path: Path, dbc: Path) -> Iterator[Figure]:
    messages = {m.frame_id: m for m in cantools.database.load_file(dbc).messages}
    frames = list(can.LogReader(path))

    def decode_frames() -> dict[str, list[float]]:
        found: dict[str, list[float]] = {}
        for frame in frames:
            decoded = messages[frame.arbitration_id].decode(frame.data)
            for name, value in decoded.items():
                found.setdefault(name, []).append(value)
        return found

    def read_and_decode_frames() -> None:
        found: dict[str, list[float]] = {}
        for frame in can.LogReader(path):
            for name, value in messages[frame.arbitration_id].decode(frame.data).items():
                found.setdefault(name, []).append(value)

    def read() -> list[NDArray[np.float64]]:
        table = reader_for(path).read(path, dbc=dbc)
        return [s.values for s in table.signals([Request(name) for name in table.names])]

    table = reader_for(path).read(path, dbc=dbc)
    requests = [Request(name) for name in table.names]
    expected = decode_frames()
    for request, signal in zip(requests, table.signals(requests), strict=True):
        assert np.allclose(signal.values, expected[request.name], rtol=1e-12, atol=1e-12)
    slow, slow_all = _seconds(decode_frames, 2), _seconds(read_and_decode_frames, 2)
    # A table keeps what signals of one message share, so each is asked only once.
    fresh = iter([reader_for(path).read(path, dbc=dbc) for _ in range(5)])
    fast = _seconds(lambda: next(fresh).signals(requests), 5)
    fast_all = _seconds(read, 5)
    kind = path.suffix
    yield Figure(f"recordings {kind}: decode, times frame by frame", slow / fast, 50, "", True)
    yield Figure(
        f"recordings {kind}: read and decode, times frame by frame",
        slow_all / fast_all,
        10,
        "",
        True,
    )
    yield Figure(f"recordings {kind}: decode, a frame", 1e9 * fast / FRAMES, None, "ns")
    yield Figure(
        f"recordings {kind}: read and decode, a frame", 1e9 * fast_all / FRAMES, None, "ns"
    )


def _seconds(call: Callable[[], object], times: int) -> float:
    """Return the shortest processor time: other programs on the machine do not count."""
    best = float("inf")
    for _ in range(times):
        began = time.process_time()
        call()
        best = min(best, time.process_time() - began)
    return best


_CHILD = """
import resource, sys, time
from pathlib import Path
from recordings import load
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
began = time.perf_counter()
run = load(sys.argv[1], dbc=Path(sys.argv[2]), variables={"a3": "rad", "b3": "rad/s", "c7": "V"})
seconds = time.perf_counter() - began
print(len(run), seconds, before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def _ten_hours(path: Path, dbc: Path) -> Iterator[Figure]:
    """Read three signals of two messages out of ten hours at 1000 frames a second."""
    write_long(path)
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, str(path), str(dbc)],
        capture_output=True,
        text=True,
        check=True,
    )
    rows, seconds, before, after = map(float, done.stdout.split())
    size = path.stat().st_size / 2**20
    yield Figure("recordings: ten hours, size of the log", size, None, "MB")
    yield Figure(
        "recordings: ten hours, peak memory above the start", (after - before) / 1024, 600, "MB"
    )
    yield Figure("recordings: ten hours, samples a signal", rows, None)
    yield Figure("recordings: ten hours, time to read", seconds, 60, "s")


def write_long(path: Path) -> None:
    """Write ten hours of candump at 1000 frames a second, ten messages in turn."""
    block = 100_000
    rng = np.random.default_rng(2)
    line = np.frombuffer(b"(1700000000.000000) can0 100#0000000000000000\n", np.uint8)
    lines = np.tile(line, (block, 1))
    digits = np.frombuffer(b"0123456789ABCDEF", np.uint8)
    lines[:, 29:45] = digits[rng.integers(0, 16, (block, 16))]
    lines[:, 27] = digits[np.arange(block) % MESSAGES]
    with path.open("wb") as file:
        for first in range(0, LONG_FRAMES, block):
            milliseconds = 1_700_000_000_000 + first + np.arange(block)
            for k, column in enumerate((14, 13, 12, *range(10, 0, -1))):
                lines[:, column] = digits[milliseconds // 10**k % 10]
            file.write(lines.tobytes())
