"""The whole story: a plant in the loop on its bus, and the service beside it, in virtual time.

The plant runs verified; friction appears; the service flags drift, closes the gate, names the
effect, adds it to the model, verifies the controller on the improved model, and opens the gate or
refuses with evidence; a browser shows it.
"""

import contextlib
import json
import re
import shutil
import time

import numpy as np
import pytest
from live_server import served
from scripted import Clock, Silent

import hil.rig
from fmus.sources import find_source
from hil.bus.dbc import bundled_dbc
from hil.scenario import scenario_of
from hil.settings import parse_toml
from identification.discovery.extension import extend, parse_addition
from twin.api import make_app
from twin.pipeline import Pipeline
from twin.replay import log_frames
from twin.service import Service
from twin.tokens import Tokens
from twin.verification import verify

PLANT = "Twinproof.Plants.Pendulum"
APPEARS, FRICTION = 30.0, 0.3
CONTROLLER = """
kind = "pid"
measured = ["theta"]
commanded = ["tau"]
period = "10 ms"
proportional = 6.0
derivative = 0.8
"""
REFERENCE = """
kind = "sines"
amplitudes = [1.6, 0.9, 0.5]
frequencies = [0.25, 0.6, 1.1]
"""
SCENARIO = f"""
[plant]
model = "Worn.mo:Worn"
[plant.sensors]
theta = {{sd = 0.01}}
omega = {{sd = 0.03}}
[bus]
dbc = "arm.dbc"
timeout = 0.1
[controller]{CONTROLLER}
[references.theta]{REFERENCE}
[disturbances.tau]
kind = "noise"
sd = 0.02
bandwidth = 3.0
[[criteria]]
kind = "limit"
signal = "theta"
low = -6
high = 6
[run]
duration = 75.0
step = "10 ms"
"""
STUDY = f"""
[plant]
model = "{PLANT}"
[controllers.any]{CONTROLLER}
# Where friction shows: small motions.
[references.fine.theta]
kind = "sines"
amplitudes = [0.05]
frequencies = [1.5]
[[criteria]]
kind = "rms"
name = "tracking"
signal = "theta"
most = {{most}}
[run]
duration = 8.0
step = "10 ms"
"""
CONFIG = f"""
[[twin]]
name = "arm"
rate = 100.0
[twin.plant]
model = "{PLANT}"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {{sd = 0.01}}
omega = {{sd = 0.03}}
[twin.bus]
dbc = "arm.dbc"
[twin.estimator]
disturbances = {{tau = 0.02}}
disturbance_time = 0.33
memory = 10.0
[twin.drift]
diagnose = 12.0
[twin.verification]
study = "study.toml"
controller = "pid.toml"
draws = 20
settle = 5.0
"""


class WearsOut:
    """A plant in which friction appears."""

    def __init__(self, plant):
        self._plant = plant
        self._time = 0.0

    def set(self, values):
        worn = {"coulombFriction_joint.tau_c": FRICTION} if self._time >= APPEARS else {}
        self._plant.set({**values, **worn})

    def step(self, length):
        self._plant.step(length)
        self._time += length

    def __getattr__(self, name):
        return getattr(self._plant, name)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with what went over the bus, and the settings of a twin."""
    folder = tmp_path_factory.mktemp("story")
    source = find_source(PLANT)
    worn = extend(source, [parse_addition("CoulombFriction@joint,tau_c=0", source)], name="Worn")
    (folder / "Worn.mo").write_text(worn.source.text)
    dbc = bundled_dbc(PLANT).read_bytes()
    (folder / "arm.dbc").write_bytes(re.sub(rb'(CycleTime" BO_ \d+) 1;', rb"\1 10;", dbc))
    (folder / "pid.toml").write_text(CONTROLLER)
    sd = {"J": 0.001, "mgl": 0.02, "d": 0.002}
    values = {"J": 0.185, "mgl": 3.61, "d": 0.006}
    fit = {"parameters": {n: {"value": v, "sd": sd[n]} for n, v in values.items()}}
    (folder / "fit.json").write_text(json.dumps(fit))
    opened = hil.rig.open_plant

    @contextlib.contextmanager
    def wearing(*args, **options):
        with opened(*args, **options) as plant:
            yield WearsOut(plant)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hil.rig, "open_plant", wearing)
        scenario = scenario_of(parse_toml(SCENARIO, folder / "scenario.toml"))
        hil.rig.run_scenario(scenario, recording=folder / "bus.log")
    return folder


class Story:
    """The service beside the bus, both on one clock."""

    def __init__(self, folder, most):
        (folder / "study.toml").write_text(STUDY.format(most=most))
        path = folder / "config.toml"
        path.write_text(CONFIG)
        for file in folder.glob("twin.db*"):
            file.unlink()
        whole = list(log_frames(folder / "bus.log"))
        self.frames = whole[0].joined(whole)
        self.zero = float(self.frames.nanoseconds[0] * 1e-9)
        self.clock = Clock(self.zero)
        self.service = Service(
            path,
            lambda twin, start, _: Pipeline(twin, start),
            Silent,
            clock=self.clock,
            steady=self.clock.steady,
            verification=lambda job: verify(job, self.clock, workers=0),
        )
        self.service.start(threads=False)
        self.monitor = self.service.monitor("arm")
        self.stamps = (self.frames.nanoseconds * 1e-9 - self.zero).astype(float)
        self.at = 0.0

    def go_on(self, until):
        """Let time go on; return when and why the gate's word changed."""
        changes = []
        before = self.monitor.decide().allowed
        source = self.service._twins["arm"].source
        while self.at < until:
            begin, self.at = self.at, self.at + 0.1
            rows = np.flatnonzero((self.stamps >= begin) & (self.stamps < self.at))
            source.waiting = self.frames.ordered(rows)
            self.clock.now = self.zero + self.at
            self.service.step()
            while self.monitor.verifying:
                time.sleep(0.002)
            if self.monitor.decide().allowed != before:
                before = not before
                changes.append((self.at, self.monitor.decide()))
        return changes

    def events(self, kind):
        found = [e for e in self.service.store.all_events() if e.kind == kind]
        return [(e.time - self.zero, json.loads(e.detail)) for e in found]


@pytest.fixture
def told(bench, monkeypatch):
    monkeypatch.setattr("twin.service.apart", lambda _, function, *a, **k: function(*a, **k))
    stories = []

    def tell(most):
        stories.append(Story(bench, most))
        return stories[-1]

    monkeypatch.setattr(Silent, "waiting", None, raising=False)
    monkeypatch.setattr(Silent, "read", _read)
    yield tell
    for story in stories:
        story.service.close()


def _read(self):
    waiting, self.waiting = self.waiting, []
    return waiting if waiting is not None else []


@pytest.fixture
def page():
    if shutil.which("chromium") is None:
        pytest.skip("no chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        found = browser.new_page()
        found.set_default_timeout(15_000)
        yield found
        browser.close()


def test_friction_appears_and_the_controller_is_verified_on_the_improved_model(told, page):
    story = told(most=0.2)
    with served(make_app(story.service, Tokens())) as (base, _):
        page.goto(f"{base}/pages/twin?name=arm")
        (opened,) = story.go_on(APPEARS - 1)
        assert opened[0] < 6
        story.service.hub.publish("arm", json.dumps(story.service.view("arm")))
        page.locator("#gate-word").filter(has_text="open").wait_for()
        assert story.events("drift") == []

        ((closed_at, decision),) = story.go_on(APPEARS + 10)
        assert not decision.allowed
        drift_at = story.events("drift")[0][0]
        assert APPEARS < drift_at <= APPEARS + 5
        # In the same update: the next look, a tenth of a second, at the latest.
        assert closed_at - drift_at < 0.15
        story.service.hub.publish("arm", json.dumps(story.service.view("arm")))
        page.locator("#gate-word").filter(has_text="closed").wait_for()
        page.locator("#gate-because").filter(has_text="drifted").wait_for()

        ((opened_at, decision),) = story.go_on(75.0)
        assert decision.allowed
        _, diagnosis = story.events("diagnosis")[0]
        assert (diagnosis["verdict"], diagnosis["name"]) == ("effect", "CoulombFriction@joint")
        # What the improved model was fitted to be, when the effect had just been named.
        sets = story.service.store.parameter_sets("arm")
        fitted = next(
            s["values"]
            for s in reversed(sets)
            if s["origin"].get("method") == "kalman"
            and s["origin"].get("effect") == "CoulombFriction@joint"
        )
        assert fitted["coulombFriction_joint.tau_c"] == pytest.approx(FRICTION, rel=0.1)
        assert fitted["J"] == pytest.approx(0.185, rel=0.05)
        _, evidence = story.monitor.in_force
        assert evidence.detail["runs"] == evidence.detail["passed"] == 20
        assert opened_at - drift_at < 60
        assert "Worn" not in story.monitor.settings.plant.model
        story.service.hub.publish("arm", json.dumps(story.service.view("arm")))
        page.locator("#gate-word").filter(has_text="open").wait_for()
        page.locator('[data-parameter="coulombFriction_joint.tau_c"]').wait_for()
    assert story.service.store.audit().intact
    chain = story.service.store.lineage(f"approval:{decision.evidence}")
    assert {a["kind"] for a in chain} >= {"approval", "evidence", "parameters", "model", "study"}


def test_a_controller_that_friction_is_too_much_for_is_refused_with_evidence(told):
    story = told(most=0.017)
    story.go_on(APPEARS - 1)
    assert story.monitor.decide().allowed, story.monitor.decide().because
    story.go_on(75.0)
    decision = story.monitor.decide()
    assert not decision.allowed
    assert "of 20 runs" in decision.because
    last = story.events("verification")[-1][1]
    assert last["passed"] is False
    evidence = story.service.store.evidence(last["evidence"])
    assert "coulombFriction_joint.tau_c" in evidence.names
    assert evidence.detail["worst"][0]["failed"][0]["name"] == "tracking"
    assert story.monitor.in_force[1].passed
