"""The service: verification in the background, faults said and recovered from, reload, apart."""

import json
import logging
import threading
import time
from pathlib import Path

import errands
import pytest
from scripted import drift, scripted_service, settle, write_config

from foundation.errors import ComputationError, InputError, StoreError
from twin.apart import apart
from twin.logs import set_up
from twin.store import Store


@pytest.fixture
def service(tmp_path):
    with scripted_service(tmp_path, ("robot", "crane")) as found:
        yield found


def kinds(service, twin=None):
    return [e.kind for e in reversed(service.store.events(twin=twin, limit=1000))]


def step(service):
    service._next.clear()
    service.step()


def test_twins_are_verified_in_the_background_and_their_gates_open(service):
    assert all(m.decide().allowed is False for m in service.monitors.values())
    settle(service)
    assert all(m.decide().allowed for m in service.monitors.values())
    assert kinds(service, "crane") == [
        *("started", "gate", "verification", "approval", "promoted", "gate")
    ]
    assert service.store.audit().intact


def test_a_drift_of_one_twin_is_no_matter_of_another(service):
    settle(service)
    twin = service._twins["robot"]
    twin.source.waiting = [drift(service.clock.now)]
    step(service)
    assert not service.monitor("robot").decide().allowed
    assert service.monitor("crane").decide().allowed


def test_a_verification_that_breaks_down_is_no_pass(tmp_path):
    def broken(job):
        raise RuntimeError("out of memory")

    with scripted_service(tmp_path, verification=broken) as service:
        settle(service)
        assert "out of memory" in service.monitor("robot").decide().because


def test_faults_around_a_twin_are_said_once_and_so_is_their_end(service):
    twin = service._twins["robot"]
    twin.source.failing = {"bus can0": "it was unplugged"}
    for _ in range(3):
        step(service)
    assert service.faults == {"robot: bus can0": "it was unplugged"}
    twin.source.failing = {}
    for _ in range(3):
        step(service)
    found = [e for e in kinds(service, "robot") if e in ("degraded", "recovered")]
    assert found == ["degraded", "recovered"]
    assert service.faults == {}


def test_a_clock_that_is_set_closes_the_gates_until_the_plants_are_seen_again(service):
    settle(service)
    step(service)
    service.clock.shift = 3600.0
    for m in service.monitors.values():
        m.pipeline.at(service.clock())
    step(service)
    assert "followed" in service.monitor("robot").decide().because
    assert [k for k in kinds(service, "") if k != "started"][-2:] == ["degraded", "recovered"]
    for _ in range(2):
        service.clock.now += 6.0
        for m in service.monitors.values():
            m.pipeline.at(service.clock())
            m.feed([])
    assert service.monitor("robot").decide().allowed


def test_a_store_that_is_gone_and_comes_back(service, monkeypatch):
    settle(service)

    def fail(*_):
        raise StoreError("the database fails: gone")

    with monkeypatch.context() as patch:
        patch.setattr(service.store, "append", fail)
        patch.setattr(service.store, "answers", lambda: False)
        service._twins["robot"].source.waiting = [drift(service.clock.now)]
        step(service)
        assert "gone" in service.faults["store"]
        assert not service.monitor("crane").decide().allowed
    step(service)
    assert service.faults == {}
    assert service.monitor("crane").decide().allowed
    assert not service.monitor("robot").decide().allowed
    assert [k for k in kinds(service) if k in ("drift", "degraded", "recovered")] == [
        *("degraded", "drift", "recovered")
    ]


def test_reload_begins_ends_and_renews_only_what_changed(service, tmp_path):
    settle(service)
    before = service.monitors
    write_config(tmp_path, ("robot", "mill"))
    config = tmp_path / "config.toml"
    assert service.reload() == {"added": ["mill"], "removed": ["crane"], "changed": []}
    assert service.monitors["robot"] is before["robot"]
    config.write_text(config.read_text().replace("draws = 8", "draws = 9", 1))
    assert service.reload()["changed"] == ["robot"]
    assert service.monitors["robot"] is not before["robot"]
    # What cannot be is refused, and everything stays as it is.
    after = service.monitors
    config.write_text(config.read_text().replace("rate = 100", "rate = -1", 1))
    with pytest.raises(InputError):
        service.reload()
    write_config(tmp_path, ("robot", "mill"), service='recordings = "elsewhere"')
    with pytest.raises(InputError, match="restart") as refused:
        service.reload()
    assert refused.value.what.endswith("has changed: service.recordings")
    config.write_text(
        config.read_text().replace("sqlite:///twin.db", "sqlite:///new.db")
        + '[jetstream]\nurl = "nats://127.0.0.1:4222"\n'
    )
    with pytest.raises(InputError) as refused:
        service.reload()
    said = refused.value.what.partition("has changed: ")[2]
    assert said == "service.store, service.recordings, jetstream.url"
    assert service.monitors == after


def test_a_study_that_is_gone_closes_one_gate_and_stops_nothing(service, tmp_path):
    settle(service)
    (tmp_path / "study.toml").unlink()
    step(service)
    assert "cannot be read" in service.monitor("robot").decide().because
    service._twins["crane"].source.waiting = [drift(service.clock.now, "mgl", "crane")]
    step(service)
    assert kinds(service, "crane")[-1] == "drift"
    assert not service.monitor("crane").verifying


def test_it_can_be_looked_at_while_it_is_fed(service):
    settle(service)
    stop = threading.Event()
    faults = []

    def look():
        while not stop.is_set():
            try:
                service.view("robot")
                service.fleet()
            except Exception as error:
                faults.append(error)

    threads = [threading.Thread(target=look) for _ in range(3)]
    for thread in threads:
        thread.start()
    for k in range(30):
        service._twins["robot"].source.waiting = [drift(service.clock.now + k)]
        step(service)
    stop.set()
    for thread in threads:
        thread.join()
    assert faults == []


def test_logs_are_lines_of_json_with_what_was_given(capsys):
    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    try:
        set_up()
        log = logging.getLogger("twinproof.test")
        log.warning("a word", extra={"twin": "robot", "value": 1.5})
        try:
            raise ValueError("broken")
        except ValueError:
            log.exception("failed")
    finally:
        root.handlers[:] = before
        root.setLevel(level)
    first, second = map(json.loads, capsys.readouterr().err.splitlines())
    assert first["message"] == "a word"
    assert (first["level"], first["twin"], first["value"]) == ("warning", "robot", 1.5)
    assert "ValueError: broken" in second["exception"]


def test_it_ends_in_order_and_takes_what_had_come(tmp_path):
    service = scripted_service(tmp_path)
    source = service._twins["robot"].source
    source.waiting = [drift(service.clock.now)]
    service.close()
    assert source.closed
    with Store.open("sqlite:///twin.db", tmp_path / "audit.key", tmp_path) as store:
        assert [e.kind for e in store.all_events()] == ["started", "drift", "gate", "stopped"]
        assert store.twin("robot").state == "unverified"
    service.close()


def test_history_is_kept_in_spans(service):
    settle(service)
    for k in range(25):
        service.clock.now += 1.0
        service.monitor("robot").pipeline.at(service.clock.now, J=0.5 + 0.001 * k)
        step(service)
    spans = service.store.history("robot", "J", 0, 1e12)
    assert [s.length for s in spans] == [10.0] * len(spans)
    assert sum(s.count for s in spans) >= 15
    assert all(0.5 <= s.low <= s.mean <= s.high <= 0.525 for s in spans)
    assert service.store.history("robot", "J.sd", 0, 1e12)[0].mean == pytest.approx(0.01)


def test_a_fault_in_a_round_does_not_end_the_watch(tmp_path, caplog):
    service = scripted_service(tmp_path)
    source = service._twins["robot"].source
    calls = []

    def broken():
        calls.append(1)
        if len(calls) == 1:
            raise RuntimeError("a fault of ours")
        return []

    source.read = broken
    service._thread.start()
    end = time.monotonic() + 10
    while len(calls) < 3 and time.monotonic() < end:
        time.sleep(0.01)
    assert len(calls) >= 3
    assert "a round failed" in caplog.text
    service.close()


def test_work_apart_gives_results_errors_and_can_be_stopped():
    never = threading.Event()
    assert apart(never, errands.double, 21) == 42
    with pytest.raises(InputError, match="nonsense") as caught:
        apart(never, errands.refuse)
    assert caught.value.remedy == "think"
    with pytest.raises(ComputationError, match="status 7"):
        apart(never, errands.die)
    stop = threading.Event()
    threading.Timer(1.0, stop.set).start()
    began = time.monotonic()
    with pytest.raises(ComputationError, match="stopped"):
        apart(stop, errands.sleep)
    assert time.monotonic() - began < 10


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks at processes in /proc")
def test_what_work_apart_has_started_ends_with_it(tmp_path, caplog):
    file, stop = tmp_path / "pid", threading.Event()

    def wait():
        while not file.is_file() or not file.read_text():
            time.sleep(0.05)
        stop.set()

    threading.Thread(target=wait, daemon=True).start()
    with caplog.at_level(logging.INFO), pytest.raises(ComputationError, match="stopped"):
        apart(stop, errands.have_another_sleep, str(file))
    assert [r.work for r in caplog.records if r.message == "abandoned"] == ["have_another_sleep"]
    stat = Path(f"/proc/{file.read_text()}/stat")
    end = time.monotonic() + 10
    # Killed, it may be there for as long as nobody has taken note of it.
    while stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < end
        time.sleep(0.05)
