"""Many twins in one whole service: recording, filters, tests, gates, store, API, readers.

Once frames come as a bus's receiver hands them over, with the plants' own stamps, so that a machine
that is busy otherwise may be late, but sees no other plant; and once from as many serial adapters
(`slcan`), which another process plays on pseudo-terminals, received and stamped by the service.
"""

from __future__ import annotations

import asyncio
import json
import os
import select
import subprocess
import sys
import time
import tty
import urllib.request
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from benchmarks.figures import Figure
from benchmarks.twin.service import READERS, read_live
from foundation.closing import Closing
from hil.bus.slcan import line_of
from recordings.readers.can_frames import FrameList, Frames
from tests.twin import pendulum_bus as bus
from tests.twin.scripted import CONTROLLER, STUDY, evidence_for
from twin.api import make_app, served
from twin.ingest import FrameRecorder, Reception
from twin.ingest.buses import BusSource
from twin.pipeline import Pipeline
from twin.service import Service, Source
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


_BUS = """
[twin.bus]
interface = "slcan"
channel = "{channel}"
"""


def _prepare(folder: Path, channels: Sequence[str] = ()) -> Path:
    bus.write_fit(folder)
    (folder / "study.toml").write_text(STUDY)
    (folder / "pid.toml").write_text(CONTROLLER)
    path = folder / "config.toml"
    buses = [_BUS.format(channel=channel) for channel in channels] or [""] * TWINS
    twins = [_TWIN.format(name=f"arm-{k}") for k in range(TWINS)]
    path.write_text("".join(map("".join, zip(twins, buses, strict=True))))
    return path


class _Counts(Protocol):
    """A source that counts how many frames waited at most."""

    most: int


S = TypeVar("S", bound=_Counts)


class _Feed(ABC, Generic[S]):
    """Where all twins' frames come from.

    Attributes:
        path: Of the service's settings.
        refused: Frames that could not be sent, known at the end.
    """

    path: Path
    refused = 0

    def __init__(self) -> None:
        self._sources: list[S] = []

    @abstractmethod
    def source(self, settings: Settings, twin: TwinSettings) -> Source:
        """Return one twin's."""

    @abstractmethod
    def end(self) -> int:
        """Send no more; return how many frames were sent."""

    def begin(self) -> None:
        """Count from now on."""
        for source in self._sources:
            source.most = 0

    @property
    def most(self) -> int:
        """Frames that waited for a twin since then, at most."""
        return max(source.most for source in self._sources)


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


class _Playing(_Feed[_Played]):
    """The same motion, played for every twin."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._frames = bus.frames(bus.motion(_MOTION, seed=1))
        self._folder = folder
        self.path = _prepare(folder)

    def source(self, settings: Settings, twin: TwinSettings) -> Source:  # noqa: ARG002 -- a bus has some
        played = _Played(self._frames, self._folder / "recordings" / twin.name)
        self._sources.append(played)
        return played

    def end(self) -> int:
        for source in self._sources:
            source.is_over = True
        return sum(source.sent for source in self._sources)


class _Counting(BusSource):
    """A bus of which it is counted how many frames waited at most."""

    most = 0

    def read(self) -> Frames:
        found = super().read()
        self.most = max(self.most, len(found))
        return found


class _Adapters(_Feed[_Counting], Closing):
    """The same motion from serial adapters: pseudo-terminals that another process writes to."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._pairs = [os.openpty() for _ in range(TWINS)]
        ours = [ours for ours, _ in self._pairs]
        # Kept open here: a terminal whose last user leaves hangs up for good.
        theirs = [theirs for _, theirs in self._pairs]
        for file in theirs:
            tty.setraw(file)
        self.path = _prepare(folder, [os.ttyname(file) for file in theirs])
        self._reception = Reception()
        code = f"from benchmarks.twin.load import write_lines as w; w({ours})"
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True, pass_fds=ours
        )

    def source(self, settings: Settings, twin: TwinSettings) -> Source:
        self._sources.append(_Counting(settings, twin, self._reception))
        return self._sources[-1]

    def end(self) -> int:
        said, _ = self._process.communicate("end")
        sent, self.refused = json.loads(said)
        return sent

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for file in (file for pair in self._pairs for file in pair):
            os.close(file)


def write_lines(files: list[int]) -> None:
    """Be all adapters until something is said; tell how many frames were sent and refused."""
    lines = [line_of(message) for message in bus.messages(bus.motion(_MOTION, seed=1))]
    samples = [b"".join(lines[k : k + _MESSAGES]) for k in range(0, len(lines), _MESSAGES)]
    for file in files:
        os.set_blocking(file, False)
    sent = refused = 0
    began = time.monotonic()
    # One after the other, as machines that know nothing of each other would.
    apart = 1 / bus.RATE / len(files)
    for count in range(len(samples) * len(files)):
        sample, which = divmod(count, len(files))
        early = began + apart * count - time.monotonic()
        if early > apart and select.select([sys.stdin], [], [], early)[0]:
            break
        try:
            os.write(files[which], samples[sample])
            sent += _MESSAGES
        except BlockingIOError:
            refused += _MESSAGES
    print(json.dumps([sent, refused]))


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


def _open(service: Service) -> int:
    return sum(m.decide().allowed for m in service.monitors.values())


def tell_readers(url: str, names: list[str]) -> None:
    """Read live data in this process, and say what came of it."""
    print(json.dumps(asyncio.run(read_live(url, names))))


def _run(service: Service, feed: _Feed[Any], name: str) -> Iterator[Figure]:
    monitors = service.monitors

    def counted(name: str) -> int:
        return sum(int(m.pipeline.health.counts[name]) for m in monitors.values())

    with served(make_app(service, Tokens())) as server:
        _await(lambda: all(m.decide().allowed for m in monitors.values()))
        feed.begin()
        end = time.monotonic() + SECONDS
        quiet = _measured(service, server.url, lambda: time.monotonic() > end)
        most, is_open = feed.most, [_open(service)]
        watching = [next(iter(monitors))] * READERS
        code = f"from benchmarks.twin.load import tell_readers as t; t({server.url!r}, {watching})"
        command = [sys.executable, "-c", code]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            read = _measured(service, server.url, lambda: process.poll() is not None)
            assert process.stdout is not None
            rate, longest = json.loads(process.stdout.read())
        is_open.append(_open(service))
        sent = feed.end()
        taken = -1
        while taken < (taken := counted("received")):
            time.sleep(1.0)
    # The last slice of each stays open until it is known to be over.
    last = _MESSAGES * bus.RATE * 0.1 * len(monitors)
    lost = max(0.0, sent - last - counted("received")) + counted("lost") + counted("stale")
    yield Figure(
        f"twin: {len(monitors)} twins at 100 Hz in one service{name}", quiet.cores, 2.0, "cores"
    )
    yield Figure("  followed, of real time", quiet.followed)
    yield Figure(f"  frames lost, of {sent}", lost, 0)
    yield Figure("  frames for which an adapter had no room", feed.refused, 0)
    yield Figure("  frames that a twin found waiting, at most", most)
    yield Figure("  gates open after that", is_open[0], len(monitors), "", at_least=True)
    yield Figure("  longest answer of the API", quiet.slowest, 1.0, "s")
    yield Figure(f"  with {READERS} readers beside it", read.cores, 2.0, "cores")
    yield Figure("    followed, of real time", read.followed)
    yield Figure("    live documents a second each", rate, 4.0, "1/s", at_least=True)
    yield Figure("    longest wait", longest, 1.0, "s")
    yield Figure("    gates open after that", is_open[1], len(monitors), "", at_least=True)


def _serve(feed: _Feed[Any], name: str) -> Iterator[Figure]:
    with Service(
        feed.path,
        lambda settings, start, executor: Pipeline(settings, start, executor=executor),
        feed.source,
        # What a study finds is not the question here.
        verification=lambda job: evidence_for(job, time.time()),
    ) as service:
        service.start()
        yield from _run(service, feed, name)


def run() -> Iterator[Figure]:
    with TemporaryDirectory() as name:
        yield from _serve(_Playing(Path(name)), "")
    with TemporaryDirectory() as name, _Adapters(Path(name)) as adapters:
        yield from _serve(adapters, ", received from 50 adapters")
