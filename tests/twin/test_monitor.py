"""A twin's life: drift, verification, promotion, restart; and a store that fails meanwhile."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from scripted import Clock, Script, drift, event, evidence_for, read_config, write_config

from foundation.errors import InputError, StoreError
from twin.events import EventKind
from twin.journal import Journal
from twin.lineage import Recorded
from twin.monitor import Monitor
from twin.store import SetState, Store
from twin.verification import controller_hash

KINDS = EventKind


class House:
    """A monitor with its store, which can be killed and started again."""

    def __init__(self, folder, **options):
        self.folder = Path(folder)
        self.clock = Clock()
        self.config = write_config(self.folder, **options)
        self.start()

    def start(self):
        self.settings = read_config(self.config)
        self.store = Store.open("sqlite:///twin.db", Path("audit.key"), self.folder)
        self.journal = Journal(self.store, self.clock)
        self.monitor = Monitor(self.settings.twins[0], Script, self.journal, self.clock)

    @property
    def pipeline(self):
        return self.monitor.pipeline

    def kill(self):
        self.store.engine.dispose()

    def run(self, seconds, **values):
        """Let time and telemetry go on."""
        self.clock.now += seconds
        self.pipeline.at(self.clock.now - 0.01, **values)
        return self.monitor.feed([])

    def verify(self, *, passed=True, **changes):
        job, _ = self.monitor.next_job()
        return self.monitor.conclude(
            job, evidence_for(job, self.clock.now, passed=passed, **changes)
        )

    def kinds(self):
        return [e.kind for e in self.store.all_events()]

    def verified(self):
        """Bring the twin to where its gate is open."""
        self.run(0.0)
        self.verify()
        self.run(6.0)
        assert self.monitor.decide().allowed, self.monitor.decide().because
        return self


@pytest.fixture
def house(tmp_path):
    found = House(tmp_path)
    yield found
    found.kill()


def test_first_the_parameters_of_the_fit_are_verified_and_then_the_gate_opens(house):
    assert "not verified" in house.monitor.decide().because
    house.run(0.1)
    job, why = house.monitor.next_job()
    assert why == "not verified yet"
    assert job.parameters.values == {"J": 0.5, "mgl": 2.0, "d": 0.1}
    assert house.monitor.next_job() is None  # one at a time
    events = house.monitor.conclude(job, evidence_for(job, house.clock.now))
    assert [e.kind for e in events] == [KINDS.VERIFICATION, KINDS.APPROVAL, KINDS.PROMOTED]
    # Telemetry has not been followed for long enough yet.
    assert "followed" in house.monitor.decide().because
    events = house.run(5.0)
    assert [e.kind for e in events] == [KINDS.GATE]
    assert events[0].detail["allowed"]
    assert house.monitor.decide().evidence == evidence_for(job, 1000.1).id
    assert not house.monitor.decide("0" * 64).allowed


def test_an_estimate_on_its_way_is_not_verified(house):
    """It would be verified where the plant is not, and drift be flagged anew."""
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    house.run(6.0, J=0.6)
    pipeline = house.monitor.pipeline
    arrived = pipeline.estimate
    pipeline.estimate = replace(arrived, moved=9.0)
    assert house.monitor.next_job() is None
    pipeline.estimate = replace(arrived, moved=1.0)
    job, _ = house.monitor.next_job()
    assert job.parameters.values["J"] == 0.6


def test_drift_closes_the_gate_in_the_same_update(house):
    house.verified()
    events = house.monitor.feed([drift(house.clock.now)])
    assert [e.kind for e in events] == [KINDS.DRIFT, KINDS.GATE]
    assert not house.monitor.decide().allowed
    assert "J drifted" in house.monitor.decide().because
    assert house.kinds()[-2:] == ["drift", "gate"]


def test_the_drifted_plant_is_verified_when_the_estimate_has_followed(house):
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    house.run(4.9, J=0.6)
    assert house.monitor.next_job() is None
    house.run(1.0, J=0.6)
    job, why = house.monitor.next_job()
    assert why == "J drifted"
    assert job.parameters.values["J"] == 0.6
    before = house.monitor.in_force[0]
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    assert house.pipeline.reference == job.parameters
    assert "followed" in house.monitor.decide().because
    house.run(5.1, J=0.6)
    assert house.monitor.decide().allowed
    assert house.store.parameter_set(before.id)[1] is SetState.RETIRED


def test_after_a_drift_the_gate_does_not_open_before_the_plant_was_looked_at_again(house):
    """The tests rest from a drift until something is verified; an estimate may rest, too."""
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    house.run(6.0, J=0.6)
    job, _ = house.monitor.next_job()
    # Low excitation: the estimate stays what it was, whatever the plant does.
    house.clock.now += 30.0
    house.pipeline.newest = house.clock.now
    events = house.monitor.conclude(job, evidence_for(job, house.clock.now))
    assert [e.kind for e in events] == [KINDS.VERIFICATION, KINDS.APPROVAL, KINDS.PROMOTED]
    assert "followed" in house.monitor.decide().because
    house.clock.now += 2.0
    house.pipeline.newest = house.clock.now
    house.monitor.feed([drift(house.clock.now, "mgl")])
    house.clock.now += 4.0
    house.pipeline.newest = house.clock.now
    assert "mgl drifted" in house.monitor.decide().because


def test_evidence_that_is_renewed_does_not_close_the_gate(house):
    """No drift: the plant has been looked at all the time."""
    house.verified()
    house.run(80_000.0)
    events = house.verify()
    assert KINDS.GATE not in [e.kind for e in events]
    assert house.monitor.decide().allowed


def set_back(house, seconds):
    """Set the clock back as the service does that notices, and follow the plant from there."""
    house.clock.now -= seconds
    house.monitor.interrupted(house.clock.now)
    house.pipeline.at(house.clock.now)
    house.monitor.tick()


def test_what_was_verified_before_a_clock_was_set_back_is_never_taken_for_fresh(house):
    """It would be believed for as much longer as the clock was set back by."""
    house.verified()
    set_back(house, 3600.0)
    assert "a clock was set back" in house.monitor.decide().because
    assert house.store.twin("robot").state == "unverified"
    house.run(3700.0)
    assert not house.monitor.decide().allowed
    house.verify()
    assert house.monitor.decide().allowed


def test_after_a_clock_was_set_back_the_plant_is_verified_at_once(house):
    house.verified()
    set_back(house, 3600.0)
    house.run(5.1)
    _, why = house.monitor.next_job()
    assert "a clock was set back" in why


def test_a_drift_before_a_clock_was_set_back_is_verified_after_it(house):
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    set_back(house, 3600.0)
    house.run(5.1, J=0.6)
    house.verify()
    house.run(5.1, J=0.6)
    assert house.monitor.decide().allowed


def test_drift_and_a_clock_set_back_during_a_verification_make_it_worthless(house):
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    house.run(6.0, J=0.6)
    job, _ = house.monitor.next_job()
    set_back(house, 3600.0)
    house.monitor.feed([drift(house.clock.now, "mgl")])
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    house.run(6.0, J=0.6)
    assert "mgl drifted" in house.monitor.decide().because


@pytest.mark.parametrize("drifted", [False, True])
def test_what_passed_before_a_clock_was_set_back_is_not_approved(tmp_path, drifted):
    house = House(tmp_path, verification='approval = "token"')
    house.run(0.1)
    job, _ = house.monitor.next_job()
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    set_back(house, 600.0)
    if drifted:
        house.monitor.feed([drift(house.clock.now)])
        house.run(700.0)
    with pytest.raises(InputError, match="drifted since" if drifted else "set back"):
        house.monitor.approve(job.parameters.id, "maria")
    house.kill()


def test_a_refused_controller_keeps_the_gate_closed_and_is_not_tried_forever(house):
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    house.run(6.0, J=0.9)
    house.verify(passed=False)
    house.run(1.0, J=0.9)
    assert "3 of 8 runs" in house.monitor.decide().because
    for _ in range(5):
        house.run(100.0, J=0.9)
        assert house.monitor.next_job() is None
    house.monitor.ask_for_verification("maria")
    assert house.monitor.next_job()[1] == "asked by maria"


def test_drift_during_a_verification_makes_it_worthless(house):
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    house.run(6.0, J=0.6)
    job, _ = house.monitor.next_job()
    house.run(1.0, J=0.6)
    house.monitor.feed([drift(house.clock.now, "mgl")])
    house.run(1.0, J=0.6)
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    assert not house.monitor.decide().allowed
    house.run(6.0, J=0.6, mgl=2.5)
    job, why = house.monitor.next_job()
    assert why == "mgl drifted"
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    house.run(5.1, J=0.6, mgl=2.5)
    assert house.monitor.decide().allowed


def test_an_estimate_that_wanders_off_closes_the_gate_and_is_verified(house):
    house.verified()
    house.run(10.0, J=0.55)  # widened by 2: 2.5 standard deviations
    assert not house.monitor.decide().allowed
    job, why = house.monitor.next_job()
    assert "has left what was verified" in why
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    assert house.monitor.decide().allowed


def test_evidence_is_renewed_before_it_is_too_old(house):
    house.verified()
    house.run(0.7 * 86400)
    assert house.monitor.next_job() is None
    house.run(0.12 * 86400)
    job, why = house.monitor.next_job()
    assert "grows old" in why
    house.monitor.give_up(job, "no Dask")
    assert "no Dask" in house.monitor.decide().because


def test_defaults_of_the_model_are_covered_by_its_hash_but_nothing_else_is(house):
    house.verified()
    estimate = house.pipeline.estimate
    more = {**estimate.values, "theta_start": 0.0}
    house.pipeline.estimate = replace(estimate, values=more)
    assert house.monitor.decide().allowed
    # One more that is followed was not verified.
    house.pipeline.estimate = replace(estimate, values=more, names=(*estimate.names, "theta_start"))
    assert not house.monitor.decide().allowed
    less = {n: v for n, v in estimate.values.items() if n != "d"}
    house.pipeline.estimate = replace(estimate, values=less)
    assert not house.monitor.decide().allowed


def test_silence_closes_the_gate_and_what_comes_after_is_looked_at_first(house):
    house.verified()
    house.monitor.feed([event(house.clock.now, KINDS.TELEMETRY_STALE)])
    assert "telemetry" in house.monitor.decide().because
    house.clock.now += 100
    house.pipeline.at(house.clock.now)
    house.monitor.feed([event(house.clock.now, KINDS.TELEMETRY_BACK)])
    assert "followed" in house.monitor.decide().because
    house.run(5.0)
    assert house.monitor.decide().allowed
    # Without any event, too: nothing came.
    house.clock.now += 1.0
    assert "telemetry" in house.monitor.decide().because


def test_a_service_that_starts_again_has_to_see_the_plant_first(house):
    house.verified()
    house.kill()
    house.start()
    assert not house.monitor.decide().allowed
    house.run(1.0)
    assert "followed" in house.monitor.decide().because
    house.run(5.0)
    assert house.monitor.decide().allowed
    house.monitor.feed([drift(house.clock.now)])
    house.kill()
    house.start()
    house.run(1.0)
    house.run(60.0)
    assert "J drifted" in house.monitor.decide().because


def test_a_changed_controller_or_study_is_another_question(house):
    house.verified()
    deployed = controller_hash(house.folder / "pid.toml")
    assert house.monitor.decide(deployed).allowed
    controller = (house.folder / "pid.toml").read_text()
    (house.folder / "pid.toml").write_text(controller.replace("5.0", "6.0"))
    assert "another controller" in house.monitor.decide().because
    job, why = house.monitor.next_job()
    assert "another controller" in why
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    assert house.monitor.decide().allowed
    assert not house.monitor.decide(deployed).allowed
    (house.folder / "study.toml").write_text((house.folder / "study.toml").read_text() + "\n#\n")
    assert "another study" in house.monitor.decide().because
    (house.folder / "study.toml").unlink()
    assert "cannot be read" in house.monitor.decide().because


def test_a_changed_file_is_logged_within_a_second_and_not_read_with_every_batch(house):
    house.verified()
    controller = house.folder / "pid.toml"
    controller.write_text(controller.read_text().replace("5.0", "6.0"))
    assert house.run(0.02) == []
    events = house.monitor.tick()
    assert [e.kind for e in events] == [KINDS.GATE]
    assert "another controller" in events[0].detail["because"]


def test_rolling_back_brings_the_earlier_parameters_and_needs_a_new_look(house):
    house.verified()
    first = house.monitor.in_force[0]
    with pytest.raises(InputError, match="no earlier"):
        house.monitor.roll_back("maria")
    house.monitor.feed([drift(house.clock.now)])
    house.run(6.0, J=0.6)
    house.verify()
    house.run(6.0, J=0.6)
    assert house.monitor.decide().allowed
    house.monitor.roll_back("maria")
    assert house.monitor.in_force[0] == first
    assert house.pipeline.reference == first
    assert "rolled back by maria" in house.monitor.decide().because
    told = next(e for e in house.store.all_events() if e.kind == "rolled_back")
    assert json.loads(told.detail)["token"] == "maria"


def test_where_a_person_must_approve_nothing_is_in_force_before(tmp_path):
    house = House(tmp_path, verification='approval = "token"')
    house.run(0.1)
    job, _ = house.monitor.next_job()
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    house.run(6.0)
    assert "waits for approval" in house.monitor.decide().because
    assert house.monitor.next_job() is None
    with pytest.raises(InputError, match="has not passed"):
        house.monitor.approve("0" * 64, "maria")
    house.monitor.approve(job.parameters.id, "maria")
    assert house.monitor.decide().allowed
    approval = next(e for e in house.store.all_events() if e.kind == "approval")
    assert json.loads(approval.detail)["token"] == "maria"
    # What waits for approval while the plant drifts cannot be approved any more.
    house.monitor.feed([drift(house.clock.now)])
    with pytest.raises(InputError, match="drifted since"):
        house.monitor.approve(job.parameters.id, "maria")
    house.kill()


def test_lineage_leads_from_the_approval_to_the_recording(house):
    house.run(0.1)
    job, _ = house.monitor.next_job()
    evidence = evidence_for(job, house.clock.now)
    house.monitor.conclude(job, evidence, [Recorded("robot-1.log[:4096]", "ab" * 32)])
    found = house.store.lineage(f"approval:{evidence.id}")
    assert [a["kind"] for a in found][:2] == ["approval", "evidence"]
    assert {a["kind"] for a in found} == {
        *("approval", "evidence", "parameters", "model", "study", "controller", "recording")
    }
    assert next(a for a in found if a["kind"] == "recording")["name"] == "robot-1.log[:4096]"


def failing(store, monkeypatch):
    def fail(*_):
        raise StoreError("the database fails: gone")

    monkeypatch.setattr(store, "append", fail)
    monkeypatch.setattr(store, "answers", lambda: False)


def test_while_the_store_fails_the_gate_is_closed_and_nothing_is_lost(house, monkeypatch):
    house.verified()
    count = len(house.kinds())
    with monkeypatch.context() as patch:
        failing(house.store, patch)
        house.monitor.feed([drift(house.clock.now)])
        assert "not whole" in house.monitor.decide().because
        assert not house.journal.retry()
        assert house.monitor.next_job() is None
    assert house.journal.retry()
    assert house.kinds()[count:] == ["degraded", "drift", "gate", "recovered"]
    assert house.store.twin("robot").state == "unverified"
    assert house.store.audit().intact


def test_a_promotion_that_cannot_be_stored_does_not_open_the_gate(house, monkeypatch):
    house.run(0.1)
    job, _ = house.monitor.next_job()
    house.run(6.0)
    with monkeypatch.context() as patch:
        failing(house.store, patch)
        house.monitor.conclude(job, evidence_for(job, house.clock.now))
        assert not house.monitor.decide().allowed
    assert house.journal.retry()
    house.run(1.0)
    assert not house.monitor.decide().allowed


def test_the_journal_forgets_estimates_first_when_there_is_no_room(house, monkeypatch):
    journal = Journal(house.store, house.clock, room=3)
    with monkeypatch.context() as patch:
        failing(house.store, patch)
        for k in range(4):
            journal.write([event(k, KINDS.PARAMETERS), drift(float(k))])
        assert journal.waiting == 3
        assert journal.lost == 5
    count = len(house.kinds())
    assert journal.retry()
    assert house.kinds()[count:] == ["degraded", *["drift"] * 3, "recovered"]


class Life(RuleBasedStateMachine):
    """Whatever happens in whatever order: the gate is never open on an unverified plant."""

    @initialize()
    def begin(self):
        self._folder = tempfile.TemporaryDirectory()
        self.house = House(self._folder.name)
        self.job = None
        # Plants there have been, as drifts tell them apart; which one was verified.
        self.plant = 0
        self.verified = None

    def teardown(self):
        self.house.kill()
        self._folder.cleanup()

    @rule(
        seconds=st.sampled_from([0.1, 1.0, 6.0, 50_000.0]), jump=st.sampled_from([0.5, 0.505, 0.6])
    )
    def telemetry(self, seconds, jump):
        self.house.run(seconds, J=jump)

    @rule()
    def silence(self):
        self.house.clock.now += 1.0
        self.house.monitor.feed([event(self.house.clock.now, KINDS.TELEMETRY_STALE)])

    @rule()
    def again(self):
        self.house.pipeline.at(self.house.clock.now)
        self.house.monitor.feed([event(self.house.clock.now, KINDS.TELEMETRY_BACK)])

    @rule()
    def plant_drifts(self):
        self.house.monitor.feed([drift(self.house.clock.now)])
        self.plant += 1

    @rule()
    def verification_begins(self):
        found = self.house.monitor.next_job()
        if found is not None:
            assert self.job is None
            self.job = found[0], self.plant

    @rule(passed=st.booleans())
    def verification_ends(self, passed):
        if self.job is not None:
            job, plant = self.job
            self.house.monitor.conclude(job, evidence_for(job, self.house.clock.now, passed=passed))
            self.verified = plant if passed else None
            self.job = None

    @rule()
    def killed(self):
        self.house.kill()
        self.house.start()
        self.job = None

    @rule()
    def rolled_back(self):
        try:
            self.house.monitor.roll_back("maria")
        except InputError:
            return
        self.plant += 1

    @rule(seconds=st.sampled_from([-100.0, 10.0]), noticed=st.booleans())
    def clock_is_set(self, seconds, noticed):
        self.house.clock.now += seconds
        if noticed:
            self.house.monitor.interrupted(self.house.clock.now)

    @invariant()
    def never_open_on_an_unverified_plant(self):
        if hasattr(self, "house") and self.house.monitor.decide().allowed:
            assert self.verified == self.plant
            assert self.house.store.twin("robot").state == "verified"


TestLife = Life.TestCase
TestLife.settings = settings(
    max_examples=40,
    stateful_step_count=25,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)


def test_the_state_machine_can_reach_an_open_gate():
    life = Life()
    life.begin()
    life.telemetry(0.1, 0.5)
    life.verification_begins()
    life.verification_ends(True)
    life.telemetry(6.0, 0.5)
    assert life.house.monitor.decide().allowed
    life.never_open_on_an_unverified_plant()
    life.plant += 1
    with pytest.raises(AssertionError):
        life.never_open_on_an_unverified_plant()
    life.teardown()
