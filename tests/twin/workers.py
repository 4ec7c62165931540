"""Twins on a stream: a gateway that publishes prepared frames, and worker processes."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from recordings.readers.can_frames import FrameList
from tests.twin import pendulum_bus as bus
from twin.events import EventKind
from twin.jetstream.gateway import Gateway
from twin.pipeline import Pipeline
from twin.settings import read_settings
from twin.store import Store

ROOT = Path(__file__).parents[2]
_TWIN = """
[[twin]]
name = "{name}"
rate = 100.0
stale = "{stale}"
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {{sd = 0.01}}
omega = {{sd = 0.03}}
[twin.bus]
channel = "{name}"
[twin.estimator]
disturbances = {{tau = 0.02}}
memory = 10.0
[twin.drift]
diagnose = 0.0
false_alarms_per_hour = 0.01
{more}
"""
SILENCE = 2.0
"""After the last frame, until a tape is over [s]."""
# Of a twin's service and not of its data.
_SERVICE = {
    EventKind.STARTED,
    EventKind.STOPPED,
    EventKind.GATE,
    EventKind.DEGRADED,
    EventKind.RECOVERED,
}


def write_config(
    folder,
    url,
    database,
    names,
    *,
    more="",
    file="config.toml",
    period=0.05,
    stale="0.5 s",
    limit=1e8,
):
    """Write a CONFIG.toml for gateways and workers; return its path."""
    bus.write_fit(folder)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    head = f"""
[service]
listen = "127.0.0.1:{port}"
store = "{database}"
[jetstream]
url = "{url}"
limit = {limit}
period = {period}
"""
    path = folder / file
    path.write_text(head + "".join(_TWIN.format(name=n, more=more, stale=stale) for n in names))
    return path


class Tape:
    """Frames that come some times faster than they were recorded; every twin has its own."""

    def __init__(self, tapes, speed):
        self.tapes, self.speed = tapes, speed
        self.begun = time.monotonic()

    def now(self):
        return bus.START + self.speed * (time.monotonic() - self.begun)

    def source(self, settings, twin):
        return _Reel(self, self.tapes[twin.name])

    def is_over(self):
        last = max(int(tape.nanoseconds[-1]) for tape in self.tapes.values())
        return self.now() > 1e-9 * last + SILENCE


class _Reel:
    def __init__(self, tape, frames):
        self.tape, self.frames, self.at = tape, frames, 0

    def read(self):
        upto = int(np.searchsorted(self.frames.nanoseconds, 1e9 * self.tape.now()))
        if upto == self.at:
            return FrameList().frames()
        found = bus.part(self.frames, self.at, upto)
        self.at = upto
        return found

    def faults(self):
        return {}

    def counts(self):
        return {"received": self.at}

    def close(self):
        pass


def play(path, tapes, speed):
    """Return a gateway that plays tapes, and the tapes' player; not started."""
    tape = Tape(tapes, speed)
    return Gateway(read_settings(path), "gateway", tape.source, tape.now), tape


class Process:
    """A worker, or a gateway, in a process of its own."""

    def __init__(self, path, command="worker"):
        self.log = path.parent / f"{path.stem}-{time.monotonic_ns()}.log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "twinproof", "twin", command, str(path)],
                stdout=log,
                stderr=log,
                cwd=path.parent,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(20)

    def stop(self):
        """End it in order."""
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(20) == 0, self.log.read_text()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.kill()


def open_store(path, database):
    return Store.open(database, Path("audit.key"), path.parent)


def told_by_data(store, name):
    """Return the events of a twin that its data told, as JSON, in order."""
    events = [e.document() for e in store.all_events() if e.twin == name]
    kinds = {kind.value for kind in _SERVICE}
    return [{k: e[k] for k in ("time", "kind", "detail")} for e in events if e["kind"] not in kinds]


def replayed(path, name, frames, chunk=3000):
    """Return what a pipeline says of the same frames, as JSON."""
    pipeline = Pipeline(read_settings(path).twin(name))
    events = []
    for k in range(0, len(frames), chunk):
        events += pipeline.feed(bus.part(frames, k, k + chunk))
    events += pipeline.idle(1e-9 * int(frames.nanoseconds[-1]) + SILENCE)
    documents = [json.loads(json.dumps(e.document())) for e in events]
    return [{k: e[k] for k in ("time", "kind", "detail")} for e in documents]


def same(found, expected):
    """Return whether two JSON values are the same, numbers up to rounding."""
    if isinstance(expected, dict):
        return found.keys() == expected.keys() and all(same(found[k], expected[k]) for k in found)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, float):
        # Sums come out otherwise where arrays begin elsewhere in memory.
        return math.isclose(found, expected, rel_tol=1e-9)
    return found == expected


def until(condition, seconds=30.0, every=0.05):
    """Wait for a condition; return what it returned and how long it took [s]."""
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        found = condition()
        if found:
            return found, time.monotonic() - began
        time.sleep(every)
    raise AssertionError(f"not within {seconds:g} s")
