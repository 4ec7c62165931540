"""From drift flagged to verified anew: the whole service beside a balancing robot, in real time."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import can
import numpy as np

from benchmarks.figures import Figure
from benchmarks.twin.drift import information
from benchmarks.twin.fleet import DISTURBANCE, NAMES, NOMINAL, RATE, ROBOT, STEP, Fleet
from benchmarks.twin.service import CONTROLLER, DRAWS, STUDY
from hil.bus.codec import Packer, layouts
from hil.bus.dbc import Port, parse_dbc, plant_dbc
from twin.audit import Entry
from twin.events import EventKind
from twin.live import live_service

_INPUTS = [Port("V", "V")]
_OUTPUTS = [Port("theta_w", "rad"), Port("theta_p", "rad"), Port("omega_p", "rad/s")]
_VERIFIED_BY = 60
"""Length of the record that the first parameters are from [s]."""
_CHANGES = 35
"""The plant does, so many seconds after the start."""
_PATIENCE = 90
_LIMIT = 60.0
_AFTERWARDS = 20
"""It is looked on for so many seconds after that: what was verified is the plant."""
_CONFIG = f"""{ROBOT}[twin.bus]
interface = "virtual"
channel = "robot"
dbc = "robot.dbc"
[twin.estimator]
disturbances = {{V = {DISTURBANCE}}}
disturbance_time = {1 / RATE}
[twin.verification]
study = "study.toml"
controller = "pid.toml"
draws = {DRAWS}
"""


def _prepare(folder: Path) -> None:
    covariance = np.linalg.inv(information(_VERIFIED_BY, seed=99))
    sd = np.sqrt(np.diag(covariance)).tolist()
    known = zip(NAMES, NOMINAL.tolist(), sd, strict=True)
    fit = {n: {"value": v, "sd": s} for n, v, s in known}
    document = {"parameters": fit, "covariance": {"names": NAMES, "matrix": covariance.tolist()}}
    (folder / "fit.json").write_text(json.dumps(document))
    (folder / "robot.dbc").write_text(plant_dbc(_INPUTS, _OUTPUTS))
    (folder / "study.toml").write_text(STUDY)
    (folder / "pid.toml").write_text(CONTROLLER)
    (folder / "config.toml").write_text(_CONFIG)


class _Robot:
    """A plant on the bus, computed before and sent when it is time."""

    def __init__(self, folder: Path, plant: Fleet) -> None:
        database = parse_dbc((folder / "robot.dbc").read_text())
        packers = [Packer(layout) for layout in layouts(database, [*_INPUTS, *_OUTPUTS])]
        self._messages: list[can.Message] = []
        self._each = len(packers)
        parts = list(plant.seconds(_CHANGES + _PATIENCE + _AFTERWARDS))
        volts = np.concatenate([u[:-1, 0] for u, _ in parts])
        seen = np.concatenate([y[:, 0] for _, y in parts])
        # The wheel rolls away, and a signal of 24 bits spans 1678 rad; where it began is no matter.
        seen[:, 0] -= 0.5 * (seen[:, 0].max() + seen[:, 0].min())
        for v, (w, p, rate) in zip(volts.tolist(), seen.tolist(), strict=True):
            values = {"V": v, "theta_w": w, "theta_p": p, "omega_p": rate}
            self._messages += [packer.pack(values) for packer in packers]
        self.is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> _Robot:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.is_over.set()
        self._thread.join()

    def _run(self) -> None:
        began, steady = time.time(), time.monotonic()
        with can.Bus("robot", interface="virtual", preserve_timestamps=True) as bus:
            for k, message in enumerate(self._messages):
                due = k // self._each * STEP
                while (early := steady + due - time.monotonic()) > 0:
                    time.sleep(early)
                    if self.is_over.is_set():
                        return
                message.timestamp = began + due
                bus.send(message)


class _Course:
    """When what was told, on this machine's clock; times of the newest of each kind."""

    def __init__(self) -> None:
        self.flagged: float | None = None
        self.closed: float | None = None
        self.diagnosed: float | None = None
        self.named = ""
        self.verified: float | None = None
        self.passed = False
        self.study = 0.0
        self.again = 0
        self.is_open = False
        self.is_over = threading.Event()

    def hear(self, entries: list[Entry]) -> None:
        now = time.monotonic()
        for entry in entries:
            detail, kind = entry.document()["detail"], entry.kind
            if kind == EventKind.GATE.value:
                self.is_open = bool(detail["allowed"])
                if self.flagged is not None and not self.is_open:
                    self.closed = self.closed or now
            elif kind == EventKind.DRIFT.value:
                self.flagged = self.flagged or now
                self.again += self.verified is not None
            elif kind == EventKind.DIAGNOSIS.value:
                self.diagnosed = self.diagnosed or now
                self.named = str(detail["name"])
            elif kind == EventKind.VERIFICATION.value and self.flagged and not self.verified:
                self.verified, self.passed = now, bool(detail["passed"])
                self.study = float(detail["seconds"])
                self.is_over.set()


def _after(plant: Fleet) -> _Course:
    course = _Course()
    with TemporaryDirectory() as name:
        folder = Path(name)
        _prepare(folder)
        robot = _Robot(folder, plant)
        with live_service(folder / "config.toml") as service:
            service.journal.listen(course.hear)
            service.start()
            with robot:
                course.is_over.wait(_CHANGES + _PATIENCE)
                time.sleep(_AFTERWARDS)
    return course


def _figures(name: str, expected: str, course: _Course) -> Iterator[Figure]:
    if course.flagged is None or course.closed is None or course.verified is None:
        raise RuntimeError("the gate was not open before, or nothing was verified anew")
    began = course.flagged
    for what, at, limit in (
        ("gate closed", course.closed, 0.1),
        ("diagnosed", course.diagnosed, None),
        (f"verified anew with {DRAWS} draws", course.verified, _LIMIT),
    ):
        if at is not None:
            yield Figure(f"twin: {name}: from drift flagged to {what}", at - began, limit, "s")
    yield Figure("  of which the study", course.study, None, "s")
    yield Figure("  the study passed", float(course.passed))
    yield Figure("  flagged again afterwards", course.again, 0)
    yield Figure("  gate open at the end", float(course.is_open), 1.0, "", at_least=True)
    yield Figure(f"  named {expected}", float(course.named == expected), 1.0, "", at_least=True)


def moved(time_: float) -> np.ndarray:
    """Return parameters of which one moves."""
    found = NOMINAL.copy()
    if time_ >= _CHANGES:
        found[3] *= 1.15
    return found


def run() -> Iterator[Figure]:
    cases: list[tuple[str, str, Callable[[], Fleet]]] = [
        ("a parameter moved", "X4", lambda: Fleet(1, 11, moved)),
        (
            "an effect appeared",
            "CoulombFriction@wheel",
            lambda: Fleet(1, 12, friction=lambda t: 5.0 if t >= _CHANGES else 0.0),
        ),
    ]
    for name, expected, plant in cases:
        yield from _figures(name, expected, _after(plant()))
