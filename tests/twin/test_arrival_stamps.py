"""Times of sending from times of reading: against senders and readers that are simulated here."""

from __future__ import annotations

import os
import time
import tty
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hil.bus import slcan
from hil.settings import parse_toml
from recordings.readers.can_frames import Frames
from tests.twin import pendulum_bus as bus
from twin.ingest import ArrivalStamps
from twin.ingest.buses import BusSource
from twin.replay import log_frames
from twin.settings import settings_of

Times = NDArray[np.int64]

MS = 1_000_000
PERIOD = 10 * MS
START = 1_700_000_000 * 10**9
_ADAPTER = f"""
[[twin]]
name = "arm"
rate = {bus.RATE}
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {{{{sd = 0.01}}}}
omega = {{{{sd = 0.03}}}}
[twin.bus]
interface = "slcan"
channel = "{{}}"
"""
SETTLED = 200
"""Frames after which the clock must be known; on a busy machine some windows show none."""


def _ticks(count: int, period: float = PERIOD, start: int = 0) -> Times:
    return START + start + np.round(period * np.arange(count)).astype(np.int64)


def _read(sent: Times, seed: int, busy: float = 0.0, stall: float = 10 * MS) -> Times:
    """Return when a process reads frames that is held up for a share of the time.

    It wakes up 60 to 150 µs after a frame; held up, it reads all that waits at the end of it.
    """
    rng = np.random.default_rng(seed)
    read = sent + rng.integers(60_000, 150_000, len(sent))
    time, end = int(sent[0]), int(sent[-1])
    while busy and time < end:
        begin = time + int(rng.exponential(stall * (1 - busy) / busy))
        time = begin + int(rng.exponential(stall))
        read[(read >= begin) & (read < time)] = time
    order = 1000 * np.arange(len(read))
    return np.maximum.accumulate(read // 1000 * 1000 - order) + order


def _corrected(read: Times, identifier: Times | None = None, batch: int = 50 * MS) -> Times:
    """Return what comes out if frames are handed over every 50 ms; nothing may be out of order."""
    names = np.full(len(read), 0x123) if identifier is None else identifier
    edges = np.flatnonzero(np.diff(read // batch)) + 1
    stamps = ArrivalStamps()
    parts = zip(np.split(read, edges), np.split(names, edges), strict=True)
    found = np.concatenate([stamps.corrected(r, n) for r, n in parts])
    assert np.all(found <= read)
    assert np.all(np.diff(found)[np.diff(read) > 0] > 0)
    return found


def _rms(errors: Times) -> float:
    return float(np.sqrt(np.mean((errors[SETTLED:] / MS) ** 2)))


@pytest.mark.parametrize("skew", [0.0, 200e-6, -200e-6])
@pytest.mark.parametrize(("busy", "stall"), [(0.3, 10 * MS), (0.5, 15 * MS), (0.5, 60 * MS)])
def test_late_frames_are_given_the_time_at_which_they_were_sent(
    busy: float, stall: float, skew: float
) -> None:
    """Two messages a sample, as a plant sends them; a process that is held up reads several."""
    one = _ticks(6000, PERIOD * (1 + skew))
    sent = np.stack([one, one + 150_000], 1).ravel()
    read = _read(sent, 1, busy, stall)
    found = _corrected(read, np.tile([1, 2], 6000))
    assert _rms(read - sent) > 5.0
    assert _rms(found - sent) < 0.15 * _rms(read - sent)
    # What counts is whether a reading lands in its own sample.
    assert np.mean(np.abs(found - sent)[SETTLED:] > PERIOD / 2) < 0.01


def test_nothing_is_changed_where_the_reader_is_in_time() -> None:
    sent = _ticks(3000, PERIOD * (1 + 200e-6))
    read = _read(sent, 2)
    assert np.array_equal(_corrected(read), read)


@pytest.mark.parametrize("jitter", [0.2, 0.4, 0.8])
def test_a_sender_that_jitters_keeps_its_jitter(jitter: float) -> None:
    rng = np.random.default_rng(3)
    sent = np.sort(_ticks(3000) + (jitter * PERIOD * rng.random(3000)).astype(np.int64))
    read = _read(sent, 3)
    assert np.array_equal(_corrected(read), read)


@pytest.mark.parametrize("busy", [0.0, 0.3])
def test_a_message_without_a_period_is_left_alone(busy: float) -> None:
    sent = START + np.cumsum(np.random.default_rng(4).exponential(PERIOD, 3000)).astype(np.int64)
    read = _read(sent, 4, busy)
    assert np.array_equal(_corrected(read), read)


def test_what_came_before_a_late_frame_was_sent_before_it() -> None:
    """A message of no period is between two late ones: it must not hold the later one back."""
    sent = _ticks(400)
    read = sent.copy()
    read[300:303] = sent[302] + 4 * MS + 1000 * np.array([0, 2, 3])
    event = read[300] + 1000
    every = np.insert(read, 301, event)
    names = np.insert(np.full(400, 1), 301, 2)
    found = _corrected(every, names)
    assert np.array_equal(np.delete(found, 301), sent)
    assert found[301] == sent[301] - 1000


@pytest.mark.parametrize(
    ("loss", "busy", "least"), [(0.01, 0.0, 0.0), (0.05, 0.0, 0.0), (0.01, 0.3, 0.3)]
)
def test_lost_frames_do_not_shift_those_that_come(loss: float, busy: float, least: float) -> None:
    kept = np.random.default_rng(5).random(6000) >= loss
    sent = _ticks(6000)[kept]
    read = _read(sent, 5, busy)
    found = _corrected(read)
    if busy:
        assert _rms(found - sent) < least * _rms(read - sent)
    else:
        assert np.array_equal(found, read)


@pytest.mark.parametrize("phase", [0, 3 * MS, 7_770_000])
def test_a_pause_is_a_pause(phase: int) -> None:
    """The sender goes on in step or not; nothing that comes after is put into the pause."""
    sent = np.concatenate([_ticks(1000), _ticks(1000, start=12_000 * MS + phase)])
    read = _read(sent, 6)
    assert np.array_equal(_corrected(read), read)
    late = _read(sent, 6, 0.3)
    after = slice(1000 + SETTLED, None)
    assert np.mean(np.abs(_corrected(late) - sent)[after] > PERIOD / 2) < 0.01


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.003, 1.05, 1.5, 2.0])
def test_another_period_is_followed(factor: float) -> None:
    first = _ticks(1000)
    sent = np.concatenate([first, first[-1] + _ticks(1001, factor * PERIOD)[1:] - START])
    read = _read(sent, 7)
    found = _corrected(read)
    assert np.abs(found - sent)[:1000].max() < MS
    # While it is not known yet, no frame is taken for more than two ticks late.
    assert (sent - found)[1000 : 1000 + SETTLED].max() < 2.01 * PERIOD
    assert np.array_equal(found[1000 + SETTLED :], read[1000 + SETTLED :])


@pytest.mark.parametrize("step", [-3_600_000 * MS, -35 * MS, -3 * MS, 35 * MS, 3_600_000 * MS])
def test_a_clock_that_is_set_is_followed(step: int) -> None:
    sent = _ticks(2000)
    sent[1000:] += step
    read = sent + _read(_ticks(2000), 8) - _ticks(2000)
    found = _corrected(read)
    assert np.array_equal(found[:1000], read[:1000])
    assert np.array_equal(found[1000 + SETTLED :], read[1000 + SETTLED :])


@settings(deadline=None, max_examples=100)
@given(
    gaps=st.lists(st.integers(-50 * MS, 50 * MS), min_size=1, max_size=300),
    names=st.lists(st.integers(1, 3), min_size=1, max_size=5),
    batch=st.integers(1, 400 * MS),
)
def test_whatever_comes_no_frame_is_later_than_it_was_read(
    gaps: list[int], names: list[int], batch: int
) -> None:
    """After a stretch with a period, so that there is a clock; order is asked in `_corrected`."""
    steady = _ticks(150)
    read = np.concatenate([steady, steady[-1] + np.cumsum(gaps) // 1000 * 1000])
    identifier = np.resize(np.array([1, *names]), len(read))
    identifier[:150] = 1
    _corrected(read, identifier, batch)


@pytest.mark.skipif(os.name == "nt", reason="needs terminals")
def test_what_is_recorded_is_what_was_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples that waited in a serial line come out a period apart, and so they stand on disk."""
    bus.write_fit(tmp_path)
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    config = settings_of(parse_toml(_ADAPTER.format(os.ttyname(theirs)), tmp_path / "twin.toml"))
    clock = SimpleNamespace(now=0.0, monotonic=time.monotonic)
    clock.time = lambda: clock.now
    monkeypatch.setattr(slcan, "time", clock)
    sent = [bus.messages(row[None, :]) for row in bus.motion(3.0, seed=1)]
    found: list[Frames] = []
    waiting = b""
    with BusSource(config, config.twins[0]) as source:
        for k, sample in enumerate(sent):
            waiting += b"".join(map(slcan.line_of, sample))
            if k % 10 < 7:
                clock.now = sample[-1].timestamp
                os.write(ours, waiting)
                waiting = b""
                count = 2 * k + 2
                end = time.monotonic() + 10
                while sum(map(len, found)) < count and time.monotonic() < end:
                    found.append(source.read())
                assert sum(map(len, found)) == count
        folder = tmp_path / "recordings" / "arm"
    os.close(ours)
    os.close(theirs)
    used = Frames.joined(found)
    replayed = Frames.joined(list(log_frames(folder)))
    assert np.array_equal(replayed.nanoseconds, used.nanoseconds)
    truth = np.array([m.timestamp for sample in sent for m in sample])[: len(used)]
    late = used.nanoseconds / 1e9 - truth
    assert late[:100].max() > 0.02
    assert np.abs(late[150:]).max() < 1e-4
