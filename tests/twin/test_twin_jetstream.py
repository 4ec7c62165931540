"""Twins of several workers: whatever is killed, they say what a plain replay says."""

import json
import signal
from contextlib import ExitStack

import pytest
from sqlalchemy import text

from foundation.errors import InputError
from tests.twin import pendulum_bus as bus
from tests.twin.jetstream_server import PROGRAM, Server
from tests.twin.scripted import CONTROLLER, STUDY, evidence_for
from tests.twin.workers import (
    Process,
    Tape,
    open_store,
    play,
    replayed,
    same,
    told_by_data,
    until,
    write_config,
)
from twin.jetstream.batch import unpacked
from twin.jetstream.connection import StreamError
from twin.jetstream.gateway import Gateway
from twin.jetstream.worker import ElsewhereError, Worker
from twin.pipeline import Pipeline
from twin.settings import read_settings
from twin.verification import controller_hash

SPEED = 3.0


@pytest.fixture
def server(tmp_path):
    if PROGRAM is None:
        pytest.skip("no nats-server")
    started = Server(tmp_path)
    started.start()
    yield started
    started.stop()


def shares(store):
    """Return how many twins each worker has a lock for, by PostgreSQL's own list."""
    query = (
        "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND objsubid = 1 GROUP BY pid"
    )
    with store.engine.connect() as connection:
        return sorted(connection.scalars(text(query)))


ALL_SESSIONS = (
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
    "WHERE datname = current_database() AND pid <> pg_backend_pid()"
)


def heavier(time):
    return {"J": 1.4 * bus.TRUE["J"]} if time > 12.0 else {}


def test_a_killed_workers_twins_go_on_elsewhere_and_nothing_is_lost_or_doubled(
    tmp_path, server, postgres_database
):
    names = ("arm-1", "arm-2", "arm-3", "arm-4")
    path = write_config(tmp_path, server.url, postgres_database, names)
    other = write_config(tmp_path, server.url, postgres_database, names, file="other.toml")
    with open_store(path, postgres_database) as store, ExitStack() as processes:
        first = processes.enter_context(Process(path))
        second = processes.enter_context(Process(other))
        frames = bus.frames(bus.motion(30.0, seed=1, change=heavier))
        tapes = {name: bus.part(frames, 300 * k, len(frames)) for k, name in enumerate(names)}
        expected = {name: replayed(path, name, tapes[name]) for name in names}
        until(lambda: shares(store) == [2, 2])
        gateway, tape = play(path, tapes, SPEED)
        with gateway:
            gateway.start()
            until(lambda: tape.now() > bus.START + 8)
            first.kill()
            _, seconds = until(lambda: shares(store) == [4])
            assert seconds < 10
            third = processes.enter_context(Process(path))
            until(lambda: shares(store) == [2, 2])
            server.stop(signal.SIGKILL)
            server.start()
            until(lambda: tape.now() > bus.START + 25)
            with store.engine.connect() as connection:
                connection.execute(text(ALL_SESSIONS))
            until(tape.is_over)
            until(lambda: all(len(told_by_data(store, n)) >= len(expected[n]) for n in names))
        for process in (second, third):
            process.stop()
        for name in names:
            found = told_by_data(store, name)
            assert [(e["time"], e["kind"]) for e in found] == [
                (e["time"], e["kind"]) for e in expected[name]
            ]
            assert same(found, expected[name]), (found, expected[name])
            assert any(e["kind"] == "drift" for e in expected[name])
        assert store.audit().intact


VERIFIED = """
[twin.verification]
study = "study.toml"
controller = "pid.toml"
settle = 1.0
"""


def worker_of(path, name, tape):
    return Worker(
        path,
        lambda twin, start, executor: Pipeline(twin, start, executor=executor),
        name,
        clock=tape.now,
        verification=lambda job: evidence_for(job, tape.now()),
    )


def test_every_worker_knows_the_gate_and_who_was_left_behind_says_no(
    tmp_path, server, postgres_database
):
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "pid.toml").write_text(CONTROLLER)
    names = ("arm", "leg")
    path = write_config(tmp_path, server.url, postgres_database, names, more=VERIFIED, stale="5 s")
    controller = controller_hash(tmp_path / "pid.toml")
    frames = bus.frames(bus.motion(60.0, seed=2))
    tape = Tape(dict.fromkeys(names, frames), 1.0)
    with (
        open_store(path, postgres_database) as store,
        Gateway(read_settings(path), "gateway", tape.source, tape.now) as gateway,
        worker_of(path, "a", tape) as a,
        worker_of(path, "b", tape) as b,
    ):

        def allowed(*workers):
            return [w.decide(n, controller)["allowed"] for w in workers for n in names]

        def stepped(condition, *workers):
            until(lambda: [w.step() for w in workers] and condition(), every=0.01)

        gateway.start()
        for worker in (a, b):
            worker.start(threads=False)
        stepped(lambda: sorted(a.monitors) == list(names), a)
        sessions = "SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'"
        stepped(lambda: len(a.monitors) == len(b.monitors) == 1, a, b)
        stepped(lambda: allowed(a, b) == [True] * 4, a, b)
        stepped(lambda: [t["gate"]["allowed"] for t in b.fleet()] == [True, True], a, b)
        (mine,) = a.monitors
        with pytest.raises(ElsewhereError, match="last taken up by a"):
            b.monitor(mine)
        assert b.view(mine)["name"] == mine

        # Its session ends, and it is stopped before it can notice.
        with store.engine.connect() as connection:
            connection.execute(text(sessions))
        stepped(lambda: sorted(b.monitors) == list(names), b)
        left = a.decide(mine, controller)
        assert not left["allowed"]
        assert left["because"] == "another worker has taken over the twin"
        stepped(lambda: allowed(b) == [True] * 2, b)
        gate = [e.document()["detail"]["allowed"] for e in store.all_events() if e.kind == "gate"]
        a.step()
        assert mine not in a.monitors
        stepped(lambda: len(a.monitors) == len(b.monitors) == 1, a, b)
        stepped(lambda: allowed(a, b) == [True] * 4, a, b)
        # Nobody had a reason to close it: what came meanwhile has been looked at.
        assert gate == [False, False, True, True]
        assert store.audit().intact


def test_frames_of_two_gateways_are_not_mixed(tmp_path, server):
    path = write_config(tmp_path, server.url, "sqlite:///twin.db", ("arm",))
    frames = bus.frames(bus.motion(6.0, seed=2))
    first, tape = play(path, {"arm": frames}, 2.0)
    second, _ = play(path, {"arm": frames}, 2.0)
    with first, second:
        first.start()
        until(lambda: first.counts("arm")["published"] > 0)
        second.start()
        until(tape.is_over)
        assert second.counts("arm")["published"] == 0

    async def published(js):
        state = (await js.stream_info("twinproof")).state
        numbers = range(state.first_seq, state.last_seq + 1)
        return [unpacked((await js.get_msg("twinproof", n)).data) for n in numbers]

    batches = server.do(published)
    stamps = [n for batch in batches for n in batch.frames.nanoseconds if batch.now < tape.now()]
    assert stamps[: len(frames)] == frames.nanoseconds.tolist()


def test_what_cannot_be_is_said_with_what_to_do(tmp_path, server, postgres_database):
    names = ("arm",)

    def gateway(url, **changes):
        path = write_config(tmp_path, url, postgres_database, names)
        text_ = path.read_text()
        for old, new in changes.items():
            text_ = text_.replace(f"{old} =", f"{new} #")
        path.write_text(text_)
        return Gateway(read_settings(path), "gateway", Tape({"arm": None}, 1.0).source)

    with pytest.raises(StreamError, match=r"cannot be reached(?s:.*)nats-server -js"):
        gateway("nats://127.0.0.1:9")
    with pytest.raises(StreamError, match=r"no stream between(?s:.*)twin serve"):
        gateway("")
    with pytest.raises(StreamError, match=r"lower jetstream\.limit"):
        gateway(server.url, limit="limit = 1e15")
    with pytest.raises(InputError, match="a stream"):
        gateway(server.url, limit='name = "a b"')
    plain = Server(tmp_path, jetstream=False)
    plain.start()
    try:
        with pytest.raises(StreamError, match=r"without JetStream(?s:.*)-js -sd"):
            gateway(plain.url)
    finally:
        plain.stop()

    async def another(js):
        await js.add_stream(name="twinproof", subjects=["others.*"])

    server.do(another)
    with pytest.raises(StreamError, match=r"somebody else's(?s:.*)jetstream\.name"):
        gateway(server.url)


def test_a_worker_needs_a_store_for_all(tmp_path, server):
    path = write_config(tmp_path, server.url, "sqlite:///twin.db", ("arm",))
    with pytest.raises(InputError, match=r"SQLite(?s:.*)postgresql://"):
        worker_of(path, "a", Tape({}, 1.0))


def test_a_gateway_from_the_command_line_ends_in_order(tmp_path, server):
    path = write_config(tmp_path, server.url, "sqlite:///twin.db", ("arm",))
    with Process(path, "gateway") as process:

        async def came(js):
            return (await js.stream_info("twinproof")).state.messages > 3

        until(lambda: "gateway started" in process.log.read_text())
        until(lambda: server.do(came))
        process.stop()
    for entry in process.log.read_text().splitlines():
        assert json.loads(entry)["level"] == "info"
