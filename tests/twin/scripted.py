"""A twin whose pipeline says what a test tells it to, on a clock that a test moves."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from hil.settings import parse_toml
from twin.estimate import Estimate
from twin.events import Event, EventKind
from twin.settings import settings_of
from twin.store.documents import Evidence
from twin.verification import controller_hash, study_hash

STUDY = """
[plant]
model = "Twinproof.Plants.Pendulum"
[controllers.any]
kind = "pid"
measured = ["theta"]
commanded = ["tau"]
period = "10 ms"
proportional = 1.0
[references.step.theta]
kind = "constant"
value = 0.5
[[criteria]]
kind = "limit"
name = "stays in bounds"
signal = "theta"
low = -2.0
high = 2.0
[run]
duration = 0.5
step = "10 ms"
seed = 3
"""
CONTROLLER = """
kind = "pid"
measured = ["theta"]
commanded = ["tau"]
period = "10 ms"
proportional = 5.0
derivative = 2.0
"""
FIT = """{"parameters": {"J": {"value": 0.5, "sd": 0.01}, "mgl": {"value": 2.0, "sd": 0.1},
"d": {"value": 0.1, "sd": null}}}"""
CONFIG = """
[service]
listen = "127.0.0.1:{port}"
store = "{store}"
{service}
"""
TWIN = """
[[twin]]
name = "{name}"
rate = 100
stale = 0.5
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.bus]
interface = "virtual"
channel = "{name}"
[twin.drift]
diagnose = 0.0
[twin.verification]
study = "study.toml"
controller = "pid.toml"
draws = 8
settle = 5.0
{verification}
"""
NAMES = ("J", "mgl")
VALUES = {"J": 0.5, "mgl": 2.0, "d": 0.1}
COVARIANCE = np.diag([1e-4, 1e-2])


def write_config(folder, names=("robot",), *, verification="", service="", port=0, store=None):
    """Write a CONFIG.toml with all that it names; return its path."""
    (folder / "study.toml").write_text(STUDY)
    (folder / "pid.toml").write_text(CONTROLLER)
    (folder / "fit.json").write_text(FIT)
    text = CONFIG.format(port=port, store=store or "sqlite:///twin.db", service=service)
    text += "".join(TWIN.format(name=name, verification=verification) for name in names)
    path = folder / "config.toml"
    path.write_text(text)
    return path


def read_config(path):
    return settings_of(parse_toml(Path(path).read_text(), Path(path)))


class Clock:
    """A clock that a test moves."""

    def __init__(self, now=1000.0):
        self.now = now
        self.shift = 0.0

    def __call__(self):
        return self.now + self.shift

    def steady(self):
        return self.now


class Script:
    """A pipeline that says what it is told to: `feed` takes events instead of frames."""

    def __init__(self, settings, start, executor=None):
        self.settings = settings
        self.reference = start
        self.estimate = None
        self.newest = None
        self.drift = {"state": "stable", "threshold": 5.0, "statistics": {"J": 1.5}}
        self.health = SimpleNamespace(counts={"refused": 0})

    @property
    def predictions(self):
        times = np.linspace(0.0, 2.0, 201) + (self.newest or 0.0) - 2.0
        measured = np.sin(times)[:, None]
        return SimpleNamespace(
            time=times, output_names=("theta",), measured=measured, predicted=measured - 0.1
        )

    def at(self, time, **values):
        """Have an estimate at a time, with some parameters moved."""
        self.newest = time
        every = {**VALUES, **values}
        sd = dict(zip(NAMES, np.sqrt(np.diag(COVARIANCE)), strict=True))
        self.estimate = Estimate(time, NAMES, every, sd, COVARIANCE, 1.0, {"J": "kg.m2"})

    def feed(self, frames):
        return list(frames)

    def idle(self, now):
        return []

    def verify(self, parameters):
        self.reference = parameters


def event(time, kind, twin="robot", **detail):
    return Event(time, twin, kind, detail)


def drift(time, parameter="J", twin="robot"):
    return event(time, EventKind.DRIFT, twin, parameter=parameter, statistic=9.0, threshold=5.0)


def evidence_for(job, time, *, passed=True, **changes):
    """Return what a verification of a job would find, without running it."""
    fit = job.fit
    found = Evidence(
        job.parameters.twin,
        time,
        controller_hash(job.controller),
        job.parameters.model,
        study_hash(job.study, job.draws, job.widening),
        job.parameters.id,
        fit.names,
        dict(fit.values),
        tuple(tuple(float(v) for v in row) for row in fit.covariance),
        passed,
        {"runs": 8, "passed": 8 if passed else 3, "seconds": 0.1},
    )
    return replace(found, **changes)


class Silent:
    """A source that gives what a test puts into it."""

    def __init__(self, settings, twin):
        self.waiting = []
        self.failing = {}
        self.closed = False

    def read(self):
        waiting, self.waiting = self.waiting, []
        return waiting

    def faults(self):
        return dict(self.failing)

    def counts(self):
        return {"received": 7}

    def recorded(self):
        return []

    def close(self):
        self.closed = True


def scripted_service(
    folder, names=("robot",), *, verification=None, clock=None, settings="", **options
):
    """Return a service of scripted twins that does nothing by itself."""
    from twin.service import Service

    clock = clock or Clock()
    path = write_config(folder, names, verification=settings, **options)
    judge = verification or (lambda job: evidence_for(job, clock.now))
    service = Service(path, Script, Silent, clock=clock, steady=clock.steady, verification=judge)
    service.start(threads=False)
    return service


def settle(service, **values):
    """Bring all twins of a scripted service to where their gates are open."""
    wait_for_verification(service)
    for _ in range(2):
        service.clock.now += 6.0
        for monitor in service.monitors.values():
            monitor.pipeline.at(service.clock.now - 0.01, **values)
            monitor.feed([])
        service.step()


def wait_for_verification(service, seconds=20.0):
    import time

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        service._next.clear()
        service.step()
        lives = [m.life for m in service.monitors.values()]
        if all(life.attempt is not None for life in lives) and not any(
            m.verifying for m in service.monitors.values()
        ):
            return
        time.sleep(0.005)
    raise AssertionError("no verification came to an end")
