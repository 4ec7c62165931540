"""A full bus received, recorded, decoded and estimated; replay; memory over ten million frames."""

from __future__ import annotations

import json
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np

from benchmarks.figures import Figure
from benchmarks.running import resident
from benchmarks.twin.fleet import NAMES, NOMINAL, ROBOT, STEP, Fleet
from hil.bus import bridged_terminals
from hil.bus.codec import Packer, layouts
from hil.bus.dbc import Port, bundled_dbc, read_dbc
from hil.bus.slcan import SlcanBus
from hil.clock import RealClock
from hil.settings import parse_toml
from recordings.readers.can_frames import Frames
from twin.ingest import FrameRecorder, Receiver, columns
from twin.pipeline import Pipeline
from twin.replay import replay
from twin.settings import TwinSettings, settings_of

MODEL = "Twinproof.Plants.WheeledPendulum"
FULL = 9009
"""Frames of 8 bytes a second on a classical bus of 1 Mbit/s."""
SECONDS = 20
BATCH = 0.05
LONG = float(os.environ.get("TWINPROOF_TWIN_FRAMES", "1e7"))
_PORTS = [Port("V", "V"), Port("theta_w", "rad"), Port("theta_p", "rad"), Port("omega_p", "rad/s")]
_STRANGER = 0x400
_CONFIG = f"""{ROBOT}omega_w = {{sd = "5 deg/s"}}
[twin.estimator]
disturbances = {{V = 0.02}}
[twin.drift]
diagnose = 0.0
"""


def twin(folder: Path) -> TwinSettings:
    """Return the settings of the twin; its parameters are known to 2 %."""
    fit = {n: {"value": v, "sd": 0.02 * v} for n, v in zip(NAMES, NOMINAL.tolist(), strict=True)}
    (folder / "fit.json").write_text(json.dumps({"parameters": fit}))
    return settings_of(parse_toml(_CONFIG, folder / "service.toml")).twins[0]


def telemetry(seconds: int, start: float, *, full: bool = True) -> list[can.Message]:
    """Return frames of a plant, and of strangers until the bus is full, in order."""
    database = read_dbc(bundled_dbc(MODEL))
    packers = [Packer(layout) for layout in layouts(database, _PORTS)]
    frames: list[can.Message] = []
    k = strangers = 0
    for volts, seen in Fleet(1, 5).seconds(seconds):
        for v, (w, p, rate) in zip(volts[:-1, 0].tolist(), seen[:, 0].tolist(), strict=True):
            now = start + k * STEP
            values = {"V": v, "theta_w": w, "theta_p": p, "omega_p": rate}
            frames += [packer.pack(values, time=now) for packer in packers]
            k += 1
            wanted = int((FULL - 1000 * len(packers)) * k * STEP) if full else 0
            for n in range(strangers, wanted):
                frames.append(
                    can.Message(
                        timestamp=now,
                        arbitration_id=_STRANGER + n % 64,
                        is_extended_id=False,
                        data=n.to_bytes(8, "little"),
                    )
                )
            strangers = wanted
    return frames


def run() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = telemetry(SECONDS, 1e9)
        yield from _load(folder, frames)
        yield from _replay(folder)
        yield from _memory(folder)


def _load(folder: Path, frames: list[can.Message]) -> Iterator[Figure]:
    options = {"interface": "virtual", "preserve_timestamps": True}
    with can.Bus("load", **options) as near, can.Bus("load", **options) as far:
        rate, lost, share = _received(folder, "recorded", near, far, frames)
    yield Figure("full bus: frames a second", rate, None, "1/s")
    yield Figure("  frames lost", lost, 0.0)
    yield Figure("  of one core, beside the sender", share, 25.0, "%")
    with bridged_terminals() as names, SlcanBus(names[0]) as near, SlcanBus(names[1]) as far:
        rate, lost, share = _received(folder, "serial", near, far, frames)
    yield Figure("the same over slcan on a bridge of terminals", rate, None, "1/s")
    yield Figure("  frames lost", lost, None)
    yield Figure("  of one core, beside the sender", share, None, "%")


def _received(
    folder: Path, name: str, near: can.BusABC, far: can.BusABC, frames: list[can.Message]
) -> tuple[float, float, float]:
    """Return frames a second, frames lost, and processor time beside the sender's [%]."""
    pipeline, recorder = Pipeline(twin(folder)), FrameRecorder(folder / name)
    sending: list[float] = []

    def send() -> None:
        clock = RealClock()
        for frame in frames:
            if (due := frame.timestamp - 1e9) > clock.now() + 1e-3:
                time.sleep(due - clock.now())
            far.send(frame)
        sending.append(time.thread_time())

    receiver, sender = Receiver(near), threading.Thread(target=send)
    began, cpu = time.perf_counter(), time.process_time()
    receiver.start()
    sender.start()
    while sender.is_alive() or receiver.waiting:
        time.sleep(BATCH)
        batch = receiver.drain()
        recorder.write(batch)
        pipeline.feed(batch)
    elapsed = time.perf_counter() - began
    used = time.process_time() - cpu - sending[0]
    receiver.stop()
    recorder.close()
    lost = len(frames) - recorder.written + receiver.dropped
    return recorder.written / elapsed, float(lost), 100 * used / elapsed


def _replay(folder: Path) -> Iterator[Figure]:
    began = time.process_time()
    found = replay(twin(folder), folder / "recorded")
    used = time.process_time() - began
    yield Figure("replay of a full bus, times real time", found.span / used, 20.0, at_least=True)
    yield Figure("  by the wall's clock", found.speed, None)


def _memory(folder: Path) -> Iterator[Figure]:
    """The same 15 s again and again: as many samples as the counters take to come round."""
    whole = columns(telemetry(15, 1e9, full=False))
    pipeline = Pipeline(twin(folder))
    recorder = FrameRecorder(folder / "long", part=300.0, limit=100e6)
    span, before, done, shift = 15_000_000_000, 0, 0, 0
    cpu = time.process_time()
    while done < LONG:
        for begin in range(0, len(whole), 2250):
            rows = np.arange(begin, min(begin + 2250, len(whole)))
            batch = _later(whole.ordered(rows), shift)
            recorder.write(batch)
            pipeline.feed(batch)
        done, shift = done + len(whole), shift + span
        if not before and done > 0.1 * LONG:
            before = resident()
    recorder.close()
    used = time.process_time() - cpu
    yield Figure(f"memory grown over the last 90 % of {done:.2g} frames",
                 (resident() - before) / 1e6, 5.0, "MB")  # fmt: skip
    yield Figure("  disk, of 100 MB and a file", _size(folder / "long") / 1e6, 200.0, "MB")
    yield Figure("  frames lost or refused", sum(
        pipeline.health.counts[n] for n in ("lost", "stale", "repeated", "wrong_sequence")
    ), None)  # fmt: skip
    yield Figure("  record, decode and estimate, a frame", 1e6 * used / done, None, "µs")


def _later(frames: Frames, shift: int) -> Frames:
    return Frames(
        frames.nanoseconds + shift, frames.identifier, frames.bus, frames.length, frames.payload
    )


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())
