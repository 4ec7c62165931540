"""The whole story: a plant in the loop on its bus, and the service beside it, in virtual time.

The plant runs verified; friction appears; the service flags drift, closes the gate, names the
effect, adds it to the model, verifies the controller on the improved model, and opens the gate or
refuses with evidence; a browser shows it. `twinproof demo --live` is the same in real time.
"""

import json
import shutil
import time

import numpy as np
import pytest
from scripted import Clock, Silent

from hil.rig import run_scenario
from hil.scenario import read_scenario
from twin.api import make_app, served
from twin.pipeline import Pipeline
from twin.replay import log_frames
from twin.service import Service
from twin.tokens import Tokens
from twin.verification import verify
from twinproof.story import StoryFiles, Telling

END = 65.0


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """What went over the bus, and the files of the story."""
    folder = tmp_path_factory.mktemp("story")
    story = StoryFiles.bundled()
    story.scenario["run"] |= {"clock": "virtual", "duration": END}
    story.write(folder)
    recording = folder / "bus.log"
    run_scenario(read_scenario(folder / "scenario.toml"), recording=recording)
    return story, recording


class Story:
    """The service beside the bus, both on one clock."""

    def __init__(self, recording, folder):
        whole = list(log_frames(recording))
        self.frames = whole[0].joined(whole)
        self.zero = float(self.frames.nanoseconds[0] * 1e-9)
        self.clock = Clock(self.zero)
        self.telling = Telling()
        self.service = Service(
            folder / "config.toml",
            lambda twin, start, _: Pipeline(twin, start),
            Silent,
            clock=self.clock,
            steady=self.clock.steady,
            verification=lambda job: verify(job, self.clock, workers=0),
        )
        self.service.journal.listen(lambda entries: [self.telling.take(e) for e in entries])
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
def told(bench, tmp_path, monkeypatch):
    files, recording = bench
    monkeypatch.setattr("twin.service.apart", lambda _, function, *a, **k: function(*a, **k))
    stories = []

    def tell(most):
        files.study["criteria"][0]["most"] = most
        files.write(tmp_path)
        stories.append(Story(recording, tmp_path))
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


def test_friction_appears_and_the_controller_is_verified_on_the_improved_model(told, page, bench):
    appears, friction = bench[0].appears, bench[0].friction
    story = told(most=0.2)
    with served(make_app(story.service, Tokens())) as server:
        page.goto(f"{server.url}/pages/twin?name=arm")
        (opened,) = story.go_on(appears - 1)
        assert opened[0] < 6
        story.service.hub.publish("arm", json.dumps(story.service.view("arm")))
        page.locator("#gate-word").filter(has_text="open").wait_for()
        assert story.events("drift") == []

        ((closed_at, decision),) = story.go_on(appears + 10)
        assert not decision.allowed
        drift_at = story.events("drift")[0][0]
        assert appears < drift_at <= appears + 5
        # In the same update: the next look, a tenth of a second, at the latest.
        assert closed_at - drift_at < 0.15
        story.service.hub.publish("arm", json.dumps(story.service.view("arm")))
        page.locator("#gate-word").filter(has_text="closed").wait_for()
        page.locator("#gate-because").filter(has_text="drifted").wait_for()

        ((opened_at, decision),) = story.go_on(END)
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
        assert fitted["coulombFriction_joint.tau_c"] == pytest.approx(friction, rel=0.1)
        assert fitted["J"] == pytest.approx(0.185, rel=0.05)
        _, evidence = story.monitor.in_force
        assert evidence.detail["runs"] == evidence.detail["passed"] == 20
        assert opened_at - drift_at < 60
        assert story.telling.ending == "opened"
        assert not story.telling.awaited
        times = list(story.telling.chapters.values())
        assert times == sorted(times)
        assert times[-1] - story.zero == pytest.approx(opened_at, abs=0.2)
        assert "Worn" not in story.monitor.settings.plant.model
        story.service.hub.publish("arm", json.dumps(story.service.view("arm")))
        page.locator("#gate-word").filter(has_text="open").wait_for()
        page.locator('[data-parameter="coulombFriction_joint.tau_c"]').wait_for()
    assert story.service.store.audit().intact
    chain = story.service.store.lineage(f"approval:{decision.evidence}")
    assert {a["kind"] for a in chain} >= {"approval", "evidence", "parameters", "model", "study"}


def test_a_controller_that_friction_is_too_much_for_is_refused_with_evidence(told, bench):
    appears = bench[0].appears
    story = told(most=0.017)
    story.go_on(appears - 1)
    assert story.monitor.decide().allowed, story.monitor.decide().because
    story.go_on(END)
    decision = story.monitor.decide()
    assert not decision.allowed
    assert "of 20 runs" in decision.because
    last = story.events("verification")[-1][1]
    assert last["passed"] is False
    evidence = story.service.store.evidence(last["evidence"])
    assert "coulombFriction_joint.tau_c" in evidence.names
    assert evidence.detail["worst"][0]["failed"][0]["name"] == "tracking"
    assert story.monitor.in_force[1].passed
    assert story.telling.ending == "refused"
    assert "the gate is open again" not in story.telling.chapters
