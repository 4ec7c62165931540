"""Receiving, recording, decoding, resampling: against arithmetic, pandas and a killed process."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum_bus import START, frames, motion, part

from hil.bus.codec import layouts
from hil.bus.dbc import Port, bundled_dbc, read_dbc
from hil.bus.slcan import SlcanBus
from recordings.readers import reader_for
from recordings.readers.can_frames import Frames
from recordings.readers.can_log import CanReader
from twin.ingest import (
    Decoded,
    Decoder,
    FrameRecorder,
    Receiver,
    Reception,
    Sampler,
    Timeline,
    columns,
    convert,
)
from twin.replay import log_frames

PORTS = [Port("tau", "N.m"), Port("theta", "rad"), Port("omega", "rad/s")]


def _decoder() -> Decoder:
    return Decoder([layouts(read_dbc(bundled_dbc("Twinproof.Plants.Pendulum")), PORTS)])


def _same(a: Frames, b: Frames) -> bool:
    names = ("nanoseconds", "identifier", "length", "payload")
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in names)


def test_values_are_those_that_were_sent() -> None:
    rows = motion(2, seed=1)
    found = _decoder().decode(frames(rows))
    for k, name in enumerate(("tau", "theta", "omega"), 1):
        stamps, values = found.variables[name]
        assert np.allclose(stamps / 1e9 - START, rows[:, 0], atol=1e-6)
        assert np.allclose(values, rows[:, k], atol=0.51e-4)


def test_an_overfull_queue_drops_the_newest_and_counts_them() -> None:
    with (
        can.Bus("twin-a", interface="virtual") as near,
        can.Bus("twin-a", interface="virtual") as far,
    ):
        receiver = Receiver(near, 3, room=50)
        receiver.start()
        for k in range(80):
            far.send(can.Message(arbitration_id=k, is_extended_id=False, data=b"abc"))
        assert _await(lambda: receiver.received >= 80)
        receiver.stop()
        taken = receiver.drain()
        assert (receiver.received, receiver.dropped, receiver.waiting) == (80, 30, 0)
        assert taken.identifier.tolist() == list(range(50))
        assert set(taken.bus.tolist()) == {3}


def _await(condition: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + 5
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def test_a_bus_with_filters_gives_all_that_passes_them() -> None:
    wanted = {"can_id": 7, "can_mask": 0x7FF}
    with (
        can.Bus("twin-f", interface="virtual", can_filters=[wanted]) as near,
        can.Bus("twin-f", interface="virtual") as far,
    ):
        receiver = Receiver(near)
        receiver.start()
        for k in range(3000):
            far.send(can.Message(arbitration_id=k % 1000, is_extended_id=False))
        assert _await(lambda: receiver.received == 3)
        receiver.stop()


def _receiving() -> int:
    return sum(t.name == "receiver" for t in threading.enumerate())


@pytest.mark.skipif(os.name == "nt", reason="needs terminals")
def test_one_thread_receives_from_all_buses_and_outlives_those_that_go() -> None:
    before, reception = _receiving(), Reception()
    terminals = [os.openpty() for _ in range(3)]
    slcan = [SlcanBus(os.ttyname(theirs)) for _, theirs in terminals]
    with (
        can.Bus("twin-many", interface="virtual") as near,
        can.Bus("twin-many", interface="virtual") as far,
    ):
        buses = [*slcan, near]
        receivers = [Receiver(bus, k, reception=reception) for k, bus in enumerate(buses)]
        for receiver in receivers:
            receiver.start()
        assert _receiving() == before + 1
        sent = time.time()
        for ours, _ in terminals:
            os.write(ours, b"t0051AA\rt0061BB\r")
        far.send(can.Message(arbitration_id=5, data=b"\xaa"))
        assert _await(lambda: [r.received for r in receivers] == [2, 2, 2, 1])
        stamps = receivers[0].drain().nanoseconds / 1e9
        assert np.all(np.abs(stamps - sent) < 0.5)

        ours, theirs = terminals[0]
        os.close(ours)
        os.close(theirs)
        assert _await(lambda: receivers[0].error is not None)
        assert "gone" in str(receivers[0].error)
        receivers[1].stop()
        slcan[1].shutdown()
        os.write(terminals[2][0], b"t0071CC\r")
        far.send(can.Message(arbitration_id=5, data=b"\xaa"))
        assert _await(lambda: [r.received for r in receivers] == [2, 2, 3, 2])
        for receiver in receivers:
            receiver.stop()
        assert _receiving() == before
        # It begins again for the next bus.
        again = Receiver(near, reception=reception)
        again.start()
        far.send(can.Message(arbitration_id=5, data=b"\xaa"))
        assert _await(lambda: again.received == 1)
        again.stop()
        again.stop()
    for bus in slcan:
        bus.shutdown()
    for pair in terminals[1:]:
        for file in pair:
            os.close(file)


class _Broken(can.BusABC):
    """A driver with a fault of its own."""

    def __init__(self) -> None:
        self.channel_info = "broken"
        super().__init__("broken")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        raise RuntimeError("a fault of the driver")


def test_a_driver_that_fails_leaves_the_other_buses_alone() -> None:
    reception = Reception()
    with (
        _Broken() as broken,
        can.Bus("twin-b", interface="virtual") as near,
        can.Bus("twin-b", interface="virtual") as far,
    ):
        receivers = [Receiver(bus, reception=reception) for bus in (broken, near)]
        for receiver in receivers:
            receiver.start()
        assert _await(lambda: receivers[0].error is not None)
        far.send(can.Message(arbitration_id=5, data=b"\xaa"))
        assert _await(lambda: receivers[1].received == 1)
        for receiver in receivers:
            receiver.stop()


def test_frames_of_all_kinds_become_columns() -> None:
    mixed = [
        can.Message(timestamp=1.0000005, arbitration_id=5, is_extended_id=True, data=b"12"),
        can.Message(is_error_frame=True),
        can.Message(is_remote_frame=True, arbitration_id=2),
        can.Message(timestamp=2.0, arbitration_id=5, is_extended_id=False, is_fd=True,
                    data=bytes(12)),
    ]  # fmt: skip
    found = columns(mixed)
    assert (len(found), found.error_frames, found.remote_frames) == (2, 1, 1)
    assert found.identifier.tolist() == [5 | 1 << 31, 5]
    assert found.length.tolist() == [2, 12]
    assert found.nanoseconds[0] % 1000 == 0


def test_recordings_rotate_stay_within_their_limit_and_read_back(tmp_path: Path) -> None:
    whole = frames(motion(10, seed=2))
    everything = FrameRecorder(tmp_path / "all", part=2.0)
    limited = FrameRecorder(tmp_path / "few", part=1.0, limit=20_000)
    for begin in range(0, len(whole), 50):
        everything.write(part(whole, begin, begin + 50))
        limited.write(part(whole, begin, begin + 50))
    everything.close()
    limited.close()
    assert len(everything.files) == 5
    assert _same(Frames.joined(list(log_frames(tmp_path / "all"))), whole)
    assert limited.removed > 0
    longest = max(p.stat().st_size for p in limited.files)
    assert sum(p.stat().st_size for p in limited.files) <= 20_000 + longest
    newest = Frames.joined(list(log_frames(tmp_path / "few")))
    assert newest.nanoseconds[-1] == whole.nanoseconds[-1]


def test_python_can_reads_the_recordings(tmp_path: Path) -> None:
    recorder = FrameRecorder(tmp_path)
    recorder.write(frames(motion(0.5, seed=2)))
    recorder.close()
    with can.LogReader(recorder.files[0]) as log:
        read = columns(list(log))
    assert _same(read, frames(motion(0.5, seed=2)))


@pytest.mark.parametrize("suffix", [".mf4", ".blf", ".asc"])
def test_recordings_become_other_formats(tmp_path: Path, suffix: str) -> None:
    recorder = FrameRecorder(tmp_path)
    recorder.write(frames(motion(1, seed=2)))
    recorder.close()
    target = tmp_path / f"run{suffix}"
    assert convert(recorder.files[0], target) == 200
    with can.LogReader(target) as log:
        found = columns(list(log))
    original = frames(motion(1, seed=2))
    assert np.array_equal(found.payload, original.payload)
    assert np.array_equal(found.identifier, original.identifier)
    assert np.allclose(np.diff(found.nanoseconds), np.diff(original.nanoseconds), atol=2e4)


def test_what_cannot_be_converted_leaves_nothing(tmp_path: Path) -> None:
    recorder = FrameRecorder(tmp_path)
    recorder.write(frames(motion(1, seed=2)))
    recorder.close()
    with pytest.raises(ValueError, match=r"\.mf4"):
        convert(recorder.files[0], tmp_path / "run.txt")
    assert [p.suffix for p in tmp_path.iterdir()] == [".log"]


_WRITER = """
import sys
from pathlib import Path
sys.path[:0] = [{folder!r}]
from pendulum_bus import frames, motion, part
from twin.ingest import FrameRecorder
whole = frames(motion(60, seed=3))
recorder = FrameRecorder(Path({target!r}))
for k in range(0, len(whole), 20):
    recorder.write(part(whole, k, k + 20))
    print(k + 20, flush=True)
"""


def test_a_killed_writer_leaves_what_it_was_given(tmp_path: Path) -> None:
    script = _WRITER.format(folder=str(Path(__file__).parent), target=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        acknowledged = 0
        for line in run.stdout:
            acknowledged = int(line)
            if acknowledged >= 2000:
                break
        run.kill()
    found = Frames.joined(list(log_frames(tmp_path)))
    assert len(found) >= acknowledged
    whole = frames(motion(60, seed=3))
    assert _same(part(found, 0, acknowledged), part(whole, 0, acknowledged))


def test_a_line_cut_in_half_costs_only_itself(tmp_path: Path) -> None:
    recorder = FrameRecorder(tmp_path)
    recorder.write(frames(motion(1, seed=2)))
    recorder.close()
    path = recorder.files[0]
    path.write_bytes(path.read_bytes()[:-9])
    reader = reader_for(path)
    assert isinstance(reader, CanReader)
    found = Frames.joined(list(log_frames(tmp_path)))
    assert len(found) in (199, 200)


@given(
    jitter=st.lists(st.integers(-300_000, 300_000), min_size=200, max_size=200),
    cut=st.integers(1, 199),
)
def test_readings_land_on_the_nearest_sample(jitter: list[int], cut: int) -> None:
    ideal = 1_000_000 * np.arange(200)
    stamps = ideal + np.array(jitter) + 77_000_000
    values = np.arange(200.0)
    sampler = Sampler(["u"], ["y"], rate=1000.0, length=10)
    blocks = []
    for rows in (slice(0, cut), slice(cut, 200)):
        pair = (stamps[rows], values[rows])
        sampler.add(Decoded({"u": pair, "y": pair}))
        blocks += sampler.blocks()
    outputs = np.concatenate([b.outputs[:, 0] for b in blocks])
    inputs = np.concatenate([b.inputs[:-1, 0] for b in blocks])
    assert len(outputs) >= 180
    # The grid's phase is the mean of jittered stamps: a reading moves by one sample at most.
    seen = np.isfinite(outputs)
    assert np.all(np.abs(outputs[seen] - np.arange(len(outputs))[seen] - outputs[seen][0]) <= 1)
    assert np.all(np.abs(inputs - np.arange(len(inputs)) - inputs[0]) <= 1)


def test_many_commands_a_sample_are_averaged_as_pandas_does() -> None:
    rng = np.random.default_rng(5)
    stamps = np.arange(20_000) * 1_000_000 + 5_000_000_000
    values = rng.standard_normal(20_000)
    sampler = Sampler(["u"], ["y"], rate=100.0, length=10)
    sampler.add(Decoded({"u": (stamps, values), "y": (stamps[::10], values[::10])}))
    blocks = sampler.blocks()
    found = np.concatenate([b.inputs[:-1, 0] for b in blocks])
    index = pd.to_datetime(stamps)
    expected = pd.Series(values, index=index).resample("10ms").mean().to_numpy()
    assert np.allclose(found, expected[: len(found)])
    assert len(found) > 1900
    outputs = np.concatenate([b.outputs[:, 0] for b in blocks])
    assert np.array_equal(outputs, values[::10][: len(outputs)])


def test_a_known_delay_of_a_command_is_made_good() -> None:
    stamps = np.arange(100) * 1_000_000
    values = np.arange(100.0)
    pairs = {"u": (stamps, values), "y": (stamps, values)}
    sampler = Sampler(["u"], ["y"], rate=1000.0, length=10, delays={"u": 3e-3})
    sampler.add(Decoded(pairs))
    block = sampler.blocks()[1]
    assert np.array_equal(block.inputs[:-1, 0], block.outputs[:, 0] - 3)


@settings(deadline=None)  # a busy machine is no fault of the timeline
@given(cuts=st.lists(st.integers(1, 399), max_size=10))
def test_slices_do_not_depend_on_the_pieces(cuts: list[int]) -> None:
    whole = frames(motion(2, seed=1))
    whole = whole.ordered(np.r_[0:250, 100:110, 250:400])
    edges = [0, *sorted(set(cuts)), len(whole)]
    one, many = (Timeline(50_000_000, 300_000_000) for _ in range(2))
    expected = [*one.add(whole), *one.finish()]
    found = [
        s for begin, end in itertools.pairwise(edges) for s in many.add(part(whole, begin, end))
    ]
    found += list(many.finish())
    assert [s.end for s in found] == [s.end for s in expected]
    assert all(_same(a.frames, b.frames) for a, b in zip(found, expected, strict=True))
    assert many.refused == one.refused == 10


@pytest.mark.parametrize("word", ["limit", "part"])
def test_a_recorder_without_bounds_is_refused(tmp_path: Path, word: str) -> None:
    with pytest.raises(ValueError, match="positive"):
        FrameRecorder(tmp_path, **{word: 0.0})
