"""Many twins in one whole service: recording, filters, tests, gates, store, API, readers.

Frames come as a bus's receiver hands them over, with the plants' own stamps; receiving itself is
measured in `bus.py`. So a machine that is busy otherwise may be late, but sees no other plant.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.figures import Figure
from benchmarks.twin.service import READERS, read_live
from recordings.readers.can_frames import FrameList, Frames
from tests.twin import pendulum_bus as bus
from tests.twin.scripted import CONTROLLER, STUDY, evidence_for
from twin.api import make_app, served
from twin.ingest import FrameRecorder
from twin.pipeline import Pipeline
from twin.service import Service
from twin.settings import Settings, TwinSettings
from twin.tokens import Tokens

TWINS = 50
SECONDS = 30.0
_MOTION = 300.0
_MESSAGES = 2
"""A sample."""
_TWIN = f"""
[[twin]]
name = "{{name}}"
rate = {bus.RATE}
stale = 2.0
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {{{{sd = {bus.SD["theta"]}}}}}
omega = {{{{sd = {bus.SD["omega"]}}}}}
[twin.estimator]
disturbances = {{{{tau = {bus.DISTURBANCE}}}}}
disturbance_time = {bus.CORRELATION}
memory = 10.0
[twin.drift]
diagnose = 0.0
[twin.verification]
study = "study.toml"
controller = "pid.toml"
settle = 5.0
"""


def _prepare(folder: Path) -> Path:
    bus.write_fit(folder)
    (folder / "study.toml").write_text(STUDY)
    (folder / "pid.toml").write_text(CONTROLLER)
    path = folder / "config.toml"
    path.write_text("".join(_TWIN.format(name=f"arm-{k}") for k in range(TWINS)))
    return path


class _Played:
    """A source whose frames come when it is time; recorded first, as those of a bus are.

    Attributes:
        sent, most: Frames so far, and those that waited at most.
    """

    def __init__(self, frames: Frames, folder: Path) -> None:
        self._frames, self._recorder = frames, FrameRecorder(folder)
        self._begun = time.time_ns()
        self._offsets = frames.nanoseconds - frames.nanoseconds[0]
        self.sent = self.most = 0
        self.is_over = False

    def read(self) -> Frames:
        now = time.time_ns() - self._begun
        upto = self.sent if self.is_over else int(np.searchsorted(self._offsets, now))
        if upto == self.sent:
            return FrameList().frames()
        found = self._frames.ordered(np.arange(self.sent, upto))
        found.nanoseconds[:] = self._begun + self._offsets[self.sent : upto] // 1000 * 1000
        self.most, self.sent = max(self.most, upto - self.sent), upto
        self._recorder.write(found)
        return found

    def faults(self) -> dict[str, str]:
        return {}

    def counts(self) -> dict[str, int]:
        return {"received": self.sent}

    def recorded(self) -> list[tuple[Path, int]]:
        return []

    def close(self) -> None:
        self._recorder.close()


@dataclass
class Load:
    """What it took.

    Attributes:
        cores: Processor time a second.
        followed: Of the frames of that time, how many went through the pipelines.
        slowest: The longest the API took to answer [s].
    """

    cores: float
    followed: float
    slowest: float


def _measured(service: Service, url: str, is_over: Callable[[], bool]) -> Load:
    """Watch until it is over; the fleet and the metrics are asked for every second meanwhile."""

    def received() -> int:
        return sum(m.pipeline.health.counts["received"] for m in service.monitors.values())

    began, used, taken = time.monotonic(), time.process_time(), received()
    slowest = 0.0
    while not is_over():
        for path in ("/twins", "/metrics"):
            asked = time.monotonic()
            with urllib.request.urlopen(url + path, timeout=60) as answer:
                answer.read()
            slowest = max(slowest, time.monotonic() - asked)
        time.sleep(1.0)
    span = time.monotonic() - began
    share = (received() - taken) / (_MESSAGES * bus.RATE * len(service.monitors) * span)
    return Load((time.process_time() - used) / span, share, slowest)


def _await(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError("the twins do not come to rest")
        time.sleep(0.1)


def tell_readers(url: str, names: list[str]) -> None:
    """Read live data in this process, and say what came of it."""
    print(json.dumps(asyncio.run(read_live(url, names))))


def _run(service: Service, sources: list[_Played]) -> Iterator[Figure]:
    monitors = service.monitors
    with served(make_app(service, Tokens())) as server:
        _await(lambda: all(m.decide().allowed for m in monitors.values()))
        for source in sources:
            source.most = 0
        end = time.monotonic() + SECONDS
        quiet = _measured(service, server.url, lambda: time.monotonic() > end)
        queue = max(source.most for source in sources)
        watching = [next(iter(monitors))] * READERS
        code = f"from benchmarks.twin.load import tell_readers as t; t({server.url!r}, {watching})"
        command = [sys.executable, "-c", code]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            read = _measured(service, server.url, lambda: process.poll() is not None)
            assert process.stdout is not None
            rate, longest = json.loads(process.stdout.read())
        is_open = sum(m.decide().allowed for m in monitors.values())
    for source in sources:
        source.is_over = True

    def counted(name: str) -> int:
        return sum(int(m.pipeline.health.counts[name]) for m in monitors.values())

    # The last slice of each stays open until it is known to be over.
    last = _MESSAGES * bus.RATE * 0.1 * len(monitors)
    sent = sum(source.sent for source in sources)
    lost = max(0.0, sent - last - counted("received")) + counted("lost") + counted("stale")
    name = f"twin: {len(monitors)} twins at 100 Hz in one service"
    yield Figure(name, quiet.cores, 1.0, "cores")
    yield Figure("  followed, of real time", quiet.followed)
    yield Figure(f"  frames lost, of {sent}", lost, 0)
    yield Figure("  frames that a twin found waiting, at most", queue)
    yield Figure("  gates open at the end", is_open, len(monitors), "", at_least=True)
    yield Figure("  longest answer of the API", quiet.slowest, 1.0, "s")
    yield Figure(f"  with {READERS} readers beside it", read.cores, 2.0, "cores")
    yield Figure("    followed, of real time", read.followed)
    yield Figure("    live documents a second each", rate, 4.0, "1/s", at_least=True)
    yield Figure("    longest wait", longest, 1.0, "s")


def run() -> Iterator[Figure]:
    sources: list[_Played] = []
    frames = bus.frames(bus.motion(_MOTION, seed=1))
    with TemporaryDirectory() as name:
        folder = Path(name)

        def source(_: Settings, twin: TwinSettings) -> _Played:
            sources.append(_Played(frames, folder / "recordings" / twin.name))
            return sources[-1]

        with Service(
            _prepare(folder),
            lambda settings, start, executor: Pipeline(settings, start, executor=executor),
            source,
            # What a study finds is not the question here.
            verification=lambda job: evidence_for(job, time.time()),
        ) as service:
            service.start()
            yield from _run(service, sources)
