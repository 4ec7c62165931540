"""`kill -9` at random moments: nothing acknowledged is lost, and the gate never opens unverified.

A process runs the service and a pendulum on a virtual bus; the pendulum's inertia changes now and
then. Another kills it, looks at what is left, and starts it again on the same folder.
`TWINPROOF_TWIN_KILLS` says how often (default 10; the figure asked for is 200).
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import can
import numpy as np

from benchmarks.figures import Figure
from hil.bus.codec import Packer, layouts
from hil.bus.dbc import Port, read_dbc
from twin.ingest.buses import BusSource
from twin.pipeline import Pipeline
from twin.service import Service
from twin.store import Store
from twin.verification import verify
from twinproof.story import StoryFiles

CHANNEL = "killed"
INERTIAS = (0.185, 0.28)
WEIGHT, FRICTION = 3.61, 0.05
_H = 0.01
# In which a drift must be flagged [s]; the figure of drift detection.
_DETECTION = 5.0
_LINE = re.compile(rb"\(\d{10}\.\d{6}\) bus0 [0-9A-F]{3}#[0-9A-F]+\n")


def prepare(folder: Path) -> None:
    """Write what the service is started with."""
    story = StoryFiles.bundled()
    twin = story.twin
    # Frames are stamped when they are sent, by a process with other things to do.
    twin["plant"]["sensors"] = {"theta": {"sd": 0.02}, "omega": {"sd": 0.1}}
    twin["bus"] = {**twin["bus"], "channel": CHANNEL}
    twin["estimator"] = {
        "disturbances": {"tau": 0.1},
        "disturbance_time": 0.1,
        "memory": 5.0,
    }
    twin["drift"] = {"diagnose": 0.0, "false_alarms_per_hour": 1e-3}
    # A plant that changed while nobody looked must be found before the gate opens.
    twin["verification"] |= {"draws": 4, "settle": _DETECTION}
    # What is verified matters less here than that it is, often.
    story.study["run"]["duration"] = 0.5
    story.fit["parameters"] = {
        "J": {"value": INERTIAS[0], "sd": 0.003},
        "mgl": {"value": WEIGHT, "sd": 0.03},
        "d": {"value": FRICTION, "sd": 0.01},
    }
    story.write(folder)
    (folder / "plant.json").write_text(json.dumps({"J": INERTIAS[0], "since": 0.0}))


# The process that is killed


def _say(*words: object) -> None:
    # One write: a line is there whole or not at all.
    os.write(1, (" ".join(map(str, words)) + "\n").encode())


@dataclass
class _Machine:
    """A pendulum on the bus, integrated here; what it is stands in a file before it is so."""

    folder: Path
    seed: int
    plant: dict[str, float] = field(default_factory=dict[str, float])

    def run(self) -> None:
        rng = np.random.default_rng(self.seed)
        ports = [Port("tau", "N.m"), Port("theta", "rad"), Port("omega", "rad/s")]
        packers = [Packer(p) for p in layouts(read_dbc(self.folder / "arm.dbc"), ports)]
        self.plant = json.loads((self.folder / "plant.json").read_text())
        changes = time.time() + rng.uniform(3.0, 12.0)
        x, k, began = [0.1, 0.0], 0, time.monotonic()
        with can.Bus(CHANNEL, interface="virtual") as bus:
            while True:
                now = time.time()
                if now > changes:
                    changes = math.inf
                    self._change(now)
                t = now % 1000.0
                u = 1.6 * math.sin(3.1 * t) + 1.2 * math.sin(5.3 * t + 1) + 0.8 * math.sin(1.3 * t)
                noise = rng.standard_normal(2) * [0.01, 0.03]
                values = {"tau": u, "theta": x[0] + noise[0], "omega": x[1] + noise[1]}
                for packer in packers:
                    bus.send(packer.pack(values, time=now))
                if k % 5 == 0:
                    _say("sent", f"{now:.6f}")
                for _ in range(20):
                    force = u - WEIGHT * math.sin(x[0]) - FRICTION * x[1]
                    x[1] += _H / 20 * force / self.plant["J"]
                    x[0] += _H / 20 * x[1]
                k += 1
                time.sleep(max(0.0, began + k * _H - time.monotonic()))

    def _change(self, now: float) -> None:
        other = INERTIAS[0] if self.plant["J"] == INERTIAS[1] else INERTIAS[1]
        changed = {"J": other, "since": now}
        (self.folder / "plant.json").write_text(json.dumps(changed))
        self.plant = changed


def victim(folder: Path, seed: int) -> None:
    """Run service and machine until the end, and say what can be relied on."""
    service = Service(
        folder / "config.toml",
        lambda settings, start, executor: Pipeline(settings, start, executor=executor),
        BusSource,
        verification=lambda job: verify(job, time.time, workers=0),
    )

    def acknowledged(entries: list) -> None:
        for entry in entries:
            _say("ack", entry.number, entry.code, entry.kind)

    service.journal.listen(acknowledged)
    service.start()
    machine = _Machine(folder, seed)
    threading.Thread(target=machine.run, daemon=True).start()
    _say("ready")
    monitor = service.monitor("arm")
    while True:
        truth, allowed = machine.plant, monitor.decide().allowed
        if truth:
            believed = monitor.reference.values["J"]
            old = time.time() - truth["since"]
            _say("gate", int(allowed), truth["J"], f"{believed:.6f}", f"{old:.3f}")
        time.sleep(0.02)


# The one that kills


@dataclass
class Kills:
    """What came of being killed again and again.

    Attributes:
        count: Kills.
        lost: Acknowledged events that were not there afterwards.
        torn: Lines of recordings that are damaged, but the last of a file.
        unrecorded: The longest time of frames that was missing at a recording's end [s].
        wrongly_open: Looks at which the gate was open though the plant was not verified.
        longest_open: After the plant had changed [s].
        open_looks, looks: How often it was open, of how often it was looked at.
        drifts, promotions: That were acknowledged.
        broken: Audits that failed.
    """

    count: int = 0
    lost: int = 0
    torn: int = 0
    unrecorded: float = 0.0
    wrongly_open: int = 0
    longest_open: float = 0.0
    open_looks: int = 0
    looks: int = 0
    drifts: int = 0
    promotions: int = 0
    broken: int = 0


def kill(times: int, seed: int, longest: float = 14.0) -> Kills:
    """Kill a service a number of times on one folder."""
    rng = np.random.default_rng(seed)
    found = Kills()
    acknowledged: dict[int, str] = {}
    doubted = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for k in range(times):
            lines = _until_killed(folder, int(rng.integers(1 << 30)), rng.uniform(0.2, longest))
            found.count = k + 1
            sent = 0.0
            for line in lines:
                word, *rest = line.split()
                if word == "ack":
                    acknowledged[int(rest[0])] = rest[1]
                    doubted = {"drift": True, "promoted": False}.get(rest[2], doubted)
                    found.drifts += rest[2] == "drift"
                    found.promotions += rest[2] == "promoted"
                elif word == "sent":
                    sent = float(rest[0])
                elif word == "gate":
                    look(found, rest, doubted=doubted)
            _examine(folder, found, acknowledged, sent)
    return found


def _until_killed(folder: Path, seed: int, seconds: float) -> list[str]:
    run_it = (
        f"from benchmarks.twin.kills import victim, Path; victim(Path({str(folder)!r}), {seed})"
    )
    command = [sys.executable, "-c", run_it]
    lines: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if line.startswith("ready"):
                threading.Timer(seconds, process.kill).start()
    if not any(line.startswith("ready") for line in lines):
        raise RuntimeError("the service did not start")
    return [line for line in lines if line.endswith("\n")]


def look(found: Kills, words: list[str], *, doubted: bool) -> None:
    """Count a look at the gate: allowed, true and believed inertia, age of the last change."""
    allowed, truth, believed, old = (float(word) for word in words)
    found.looks += 1
    if not allowed:
        return
    found.open_looks += 1
    other = abs(believed / truth - 1) > 0.15
    found.longest_open = max(found.longest_open, old if other else 0.0)
    # An acknowledged drift counts at once; one that nobody could know of yet, after some seconds.
    if doubted or (other and old > _DETECTION):
        found.wrongly_open += 1


def _examine(folder: Path, found: Kills, acknowledged: dict[int, str], sent: float) -> None:
    with Store.open("sqlite:///twin.db", folder / "audit.key", folder) as store:
        there = {e.number: e.code for e in store.all_events()}
        found.broken += not store.audit().intact
    found.lost += sum(there.get(number) != code for number, code in acknowledged.items())
    newest = 0.0
    for path in (folder / "recordings" / "arm").glob("*.log"):
        content = path.read_bytes()
        whole, _, _ = content.rpartition(b"\n")
        lines = [line + b"\n" for line in whole.split(b"\n") if line]
        found.torn += sum(_LINE.fullmatch(line) is None for line in lines)
        if lines:
            newest = max(newest, float(lines[-1][1:18]))
    if sent:
        found.unrecorded = max(found.unrecorded, sent - newest)


def run() -> Iterator[Figure]:
    times = int(os.environ.get("TWINPROOF_TWIN_KILLS", "10"))
    found = kill(times, seed=1)
    yield Figure("kill -9: kills", found.count)
    yield Figure("kill -9: acknowledged events lost", found.lost, 0)
    yield Figure("kill -9: event logs not whole", found.broken, 0)
    yield Figure("kill -9: damaged lines of recordings", found.torn, 0)
    yield Figure("kill -9: recording missing at the end", found.unrecorded, 0.1, "s")
    yield Figure("kill -9: gate open on an unverified plant", found.wrongly_open, 0)
    yield Figure("kill -9: gate open after a change, at most", found.longest_open, _DETECTION, "s")
    yield Figure("kill -9: looks at an open gate, of all", found.open_looks / max(found.looks, 1))
    yield Figure("kill -9: drifts flagged on the way", found.drifts)
