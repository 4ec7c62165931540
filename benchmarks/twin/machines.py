"""Fifty twins as two workers over JetStream, of which one is killed now and then.

A gateway, two workers, `nats-server` and PostgreSQL, each in processes of their own, here on one
machine. Every twin has a pendulum at 100 Hz, two protected messages a sample.
`TWINPROOF_TWIN_FAILOVERS` says how often a worker is killed (default 10), `TWINPROOF_TWIN_FLEET`
how many twins there are then (50; fewer on a machine that has something else to do).
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from types import FrameType
from typing import Any

import numpy as np

from benchmarks.figures import Figure
from recordings.readers.can_frames import FrameList, Frames
from tests.twin import pendulum_bus as bus
from tests.twin.jetstream_server import Server
from tests.twin.postgres_server import postgres_server, program
from tests.twin.workers import write_config
from twin.jetstream.gateway import Gateway
from twin.settings import Settings, TwinSettings, read_settings

TWINS, KILLS = 50, 10
_FRAMES = 200
"""That a twin has in a second."""
_LOAD = 30.0
_PERIOD = 24.0
"""Of the pendulum's motion [s]: the messages' counters begin anew with it."""
_FRESH = 0.5
_TICK = os.sysconf("SC_CLK_TCK")


# The gateway's process


class _Loop:
    """A motion that begins again and again, now."""

    def __init__(self, frames: Frames) -> None:
        self._frames, self._begun = frames, time.time_ns()
        self._offsets = frames.nanoseconds - frames.nanoseconds[0]
        self.sent = 0
        self.is_over = threading.Event()

    def read(self) -> Frames:
        if self.is_over.is_set():
            return FrameList().frames()
        period, n = round(1e9 * _PERIOD), len(self._frames)
        rounds, rest = divmod(time.time_ns() - self._begun, period)
        upto = rounds * n + int(np.searchsorted(self._offsets, rest, side="right"))
        if upto == self.sent:
            return FrameList().frames()
        rows = np.arange(self.sent, upto)
        self.sent = upto
        found = self._frames.ordered(rows % n)
        found.nanoseconds[:] = self._begun + self._offsets[rows % n] + rows // n * period
        return found

    def faults(self) -> dict[str, str]:
        return {}

    def counts(self) -> dict[str, int]:
        return {"received": self.sent}

    def close(self) -> None:
        pass


def gateway(path: str) -> None:
    """Publish until SIGTERM, then say how much that was."""
    frames, loops = bus.frames(bus.motion(_PERIOD, seed=1)), list[_Loop]()
    over = threading.Event()

    def source(_: Settings, __: TwinSettings) -> _Loop:
        loops.append(_Loop(frames))
        return loops[-1]

    settings = read_settings(Path(path))
    with Gateway(settings, "gateway", source) as running:

        def end(_signal: int, _frame: FrameType | None) -> None:
            over.set()

        signal.signal(signal.SIGTERM, end)
        running.start()
        over.wait()
        for loop in loops:
            loop.is_over.set()
        # Until its clock has told the workers that nothing else has come.
        time.sleep(2.0)
    print(json.dumps({t.name: running.counts(t.name) for t in settings.twins}))


# The one that measures


class _Worker:
    def __init__(self, folder: Path, number: int, names: list[str], store: str, url: str) -> None:
        file = f"worker-{number}.toml"
        self.path = write_config(folder, url, store, names, file=file, period=0.1, limit=1e9)
        self.port = read_settings(self.path).service.address[1]
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "twinproof", "twin", "worker", str(self.path)]
        with self.path.with_suffix(".log").open("ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)

    def ask(self, path: str) -> Any:
        """Return what it answers; None: it does not."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=5) as found:
                content = found.read().decode()
        except OSError:
            return None
        return content if path == "/metrics" else json.loads(content)

    def ages(self) -> list[float]:
        """Return how old the newest sample is of every twin that is known of [s]."""
        found = self.ask("/twins")
        twins = [] if found is None else found["twins"]
        return [t["age"] for t in twins if t["age"] is not None]

    def held(self) -> int:
        """Return how many twins it runs."""
        return (self.ask("/metrics") or "").count("twinproof_gate_open{")

    def received(self, twin: str) -> int:
        """Return how many frames a twin's pipeline has seen, wherever it runs."""
        view = self.ask(f"/twins/{twin}")
        return 0 if view is None else view["counts"]["received"]

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


def _seconds(process: subprocess.Popen[Any]) -> float:
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def _wait(condition: Callable[[], object], seconds: float = 120.0) -> float:
    """Wait for a condition; return how long it took [s]."""
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > seconds:
            raise RuntimeError("it does not come to rest")
        time.sleep(0.05)
    return time.monotonic() - began


@dataclass
class _Site:
    """Two workers, a gateway, a server."""

    workers: list[_Worker]
    gateway: subprocess.Popen[bytes]
    server: Server
    names: list[str]

    def end(self) -> dict[str, dict[str, int]]:
        """End the gateway; return what it has counted of every twin."""
        self.gateway.send_signal(signal.SIGTERM)
        return json.loads(self.gateway.communicate()[0])

    def is_shared(self) -> bool:
        return [w.held() for w in self.workers] == [len(self.names) // 2] * 2


@contextmanager
def _site(count: int) -> Generator[_Site]:
    with tempfile.TemporaryDirectory() as name, postgres_server() as postgres, ExitStack() as ends:
        folder = Path(name)
        server = Server(folder)
        server.start()
        ends.callback(server.stop)
        store, names = f"{postgres}/postgres", [f"arm-{k}" for k in range(count)]
        workers = [_Worker(folder, k, names, store, server.url) for k in range(2)]
        for worker in workers:
            ends.callback(worker.end)
        path = str(workers[0].path)
        run_it = f"from benchmarks.twin.machines import gateway; gateway({path!r})"
        publishing = subprocess.Popen([sys.executable, "-c", run_it], stdout=subprocess.PIPE)
        ends.callback(publishing.kill)
        site = _Site(workers, publishing, server, names)
        _wait(site.is_shared)
        _wait(lambda: len(workers[0].ages()) == count)
        yield site


def run() -> Iterator[Figure]:
    if program("postgres") is None or which("nats-server") is None:
        return
    with _site(TWINS) as site:
        yield from _load(site)
    count = int(os.environ.get("TWINPROOF_TWIN_FLEET", str(TWINS)))
    kills = int(os.environ.get("TWINPROOF_TWIN_FAILOVERS", str(KILLS)))
    with _site(count) as site:
        _wait(lambda: max(site.workers[0].ages()) < _FRESH)
        took = [_failover(site, k % 2) for k in range(kills)]
        name = f"twin: {kills} kills of a worker with {count // 2} twins"
        yield Figure(f"{name}: on after, at most", max(took), 10.0, "s")
        yield Figure(f"{name}: on after, mean", float(np.mean(took)), None, "s")
        sent = site.end()
        dropped = sum(c["dropped"] for c in sent.values())
        yield Figure(f"{name}: frames dropped", dropped, 0)
        yield Figure(f"{name}: frames lost or doubled", _missing(site.workers[0], sent), 0)


def _load(site: _Site) -> Iterator[Figure]:
    processes = [*(w.process for w in site.workers), site.gateway, site.server.process]

    def seen() -> int:
        return sum(site.workers[0].received(name) for name in site.names)

    used, frames, ages = [_seconds(p) for p in processes], seen(), list[float]()
    end = time.monotonic() + _LOAD
    while time.monotonic() < end:
        ages += site.workers[0].ages()
        time.sleep(1.0)
    used = [_seconds(p) - before for p, before in zip(processes, used, strict=True)]
    # On a machine that is busy otherwise less comes through in the time; what it costs is the same.
    span = (seen() - frames) / (_FRAMES * len(site.names))
    name = f"twin: {len(site.names)} twins over JetStream"
    yield Figure(f"{name}: two workers", sum(used[:2]) / span, None, "cores")
    yield Figure(f"{name}: gateway", used[2] / span, None, "cores")
    yield Figure(f"{name}: all but the database", sum(used) / span, 2.0, "cores")
    yield Figure(f"{name}: age of the newest sample", float(np.median(ages)), None, "s")
    yield Figure(f"{name}: followed, of real time", span / _LOAD)


def _failover(site: _Site, victim: int) -> float:
    """Kill a worker; return after which time all its twins are followed again, then mend it."""
    other = site.workers[1 - victim]
    site.workers[victim].end()
    seconds = _wait(lambda: other.held() == len(site.names) and max(other.ages()) < _FRESH)
    site.workers[victim].start()
    _wait(site.is_shared)
    return seconds


def _missing(worker: _Worker, sent: dict[str, dict[str, int]]) -> int:
    """Return how many frames the pipelines saw too few or too many."""
    end = time.monotonic() + 20.0
    while True:
        found = sum(abs(worker.received(n) - c["published"]) for n, c in sent.items())
        if not found or time.monotonic() > end:
            return found
        time.sleep(0.5)
