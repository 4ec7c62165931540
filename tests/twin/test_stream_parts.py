"""Batches, outboxes, claims and what is sealed: the parts that gateways and workers are made of."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import select
from sqlalchemy.orm import Session

from foundation.errors import FormatError, InputError, StoreError
from recordings.readers.can_frames import EXTENDED, FrameList
from tests.twin import pendulum_bus as bus
from tests.twin.workers import until
from twin.events import Event, EventKind
from twin.jetstream.batch import Batch, packed, unpacked
from twin.jetstream.gateway import Outbox
from twin.store import Store
from twin.store.claims import Claims, OutpacedError
from twin.store.tables import ClaimRow

STAMPS = st.integers(0, 2**62)
FRAME = st.tuples(
    STAMPS, st.integers(0, 2**29 - 1), st.booleans(), st.integers(0, 3), st.binary(max_size=64)
)


def frames_of(rows, errors=0):
    listed = FrameList(error_frames=errors)
    for stamp, identifier, extended, number, payload in rows:
        listed.add(stamp, identifier | (EXTENDED if extended else 0), number, payload)
    return listed.frames()


@given(st.lists(FRAME, max_size=20), st.integers(0, 9))
def test_a_batch_comes_out_as_it_went_in(rows, errors):
    frames = frames_of(rows, errors)
    batch = Batch(frames, 12.5, "gate", {"received": 3}, {"bus can0": "gone"})
    found = unpacked(packed(batch))
    assert (found.now, found.gateway, found.counts, found.faults) == (
        12.5,
        "gate",
        {"received": 3},
        {"bus can0": "gone"},
    )
    assert found.frames.error_frames == errors
    for name in ("nanoseconds", "identifier", "bus", "length", "payload"):
        was, is_ = getattr(frames, name), getattr(found.frames, name)
        assert np.array_equal(was, is_), name
        assert was.dtype == is_.dtype, name


@pytest.mark.parametrize(
    "content", [b"", b"something else entirely", packed(Batch(frames_of([]), 0.0, "g"))[:-3]]
)
def test_what_is_no_batch_is_refused(content):
    with pytest.raises(FormatError, match="no batch"):
        unpacked(content)


def test_a_batch_that_was_cut_off_is_refused():
    content = packed(Batch(frames_of([(1, 2, False, 0, b"ab")]), 0.0, "g"))
    with pytest.raises(FormatError, match="no batch"):
        unpacked(content[:-1])


def test_an_outbox_keeps_order_bounds_what_waits_and_counts_what_has_to_go():
    tape = bus.frames(bus.motion(2.0, seed=1))
    outbox = Outbox(room=150)
    assert outbox.take() is None
    outbox.put(bus.part(tape, 0, 100), 1.0)
    outbox.put(bus.part(tape, 100, 200), 2.0)
    outbox.put(bus.part(tape, 200, 250), 3.0)
    assert (len(outbox), outbox.dropped) == (150, 100)
    frames, now = outbox.take()
    assert now == 3.0
    assert frames.nanoseconds.tolist() == [*tape.nanoseconds[:100], *tape.nanoseconds[200:250]]
    assert outbox.take() is None
    outbox.put(bus.part(tape, 0, 0), 4.0)
    frames, now = outbox.take()
    assert (len(frames), now) == (0, 4.0)


def test_an_outbox_does_not_say_that_all_has_come_before_it_has_sent_it():
    tape = bus.frames(bus.motion(60.0, seed=1))
    outbox = Outbox(room=100_000)
    for k in range(0, 10_000, 1000):
        outbox.put(bus.part(tape, k, k + 1000), 100.0 + k)
    first, now = outbox.take()
    assert now <= 1e-9 * first.nanoseconds[-1]
    parts = [first]
    while (taken := outbox.take()) is not None:
        parts.append(taken[0])
        last = taken[1]
    assert last == 100.0 + 9000
    assert [n for p in parts for n in p.nanoseconds] == tape.nanoseconds[:10_000].tolist()


@pytest.fixture
def store(tmp_path, postgres_database):
    with Store.open(postgres_database, tmp_path / "audit.key", tmp_path) as opened:
        yield opened


def claims(store, name):
    return Claims(store.engine, name, "http://127.0.0.1:1")


def test_one_worker_has_a_twin_and_its_end_gives_it_free(store):
    with claims(store, "a") as a, claims(store, "b") as b:
        assert a.workers() == 1
        first = a.claim("arm")
        assert (first.generation, first.position, first.state) == (1, 0, None)
        assert b.claim("arm") is None
        assert b.claim("leg") is not None
        assert a.workers() == b.workers() == 2
        store.do(first.keep(7, b"state"))
        assert a.owner("arm") == ("a", "http://127.0.0.1:1")
        a.close()
        # The server notices in its own time.
        second, _ = until(lambda: b.claim("arm"))
        assert (second.generation, second.position, second.state) == (2, 7, b"state")
        assert b.workers() == 1
        b.release("arm")
        assert a.claim("arm").generation == 3


def test_who_was_outpaced_writes_nothing_any_more(store):
    with claims(store, "a") as a, claims(store, "b") as b:
        first = a.claim("arm")
        # The session dies and the worker has not noticed.
        a.close()
        # The server notices in its own time.
        second, _ = until(lambda: b.claim("arm"))
        event = Event(1.0, "arm", EventKind.DRIFT, {"parameter": "J"})
        with pytest.raises(OutpacedError, match="taken over 'arm'"):
            store.append([event], lambda: 1.0, first.keep(9, b"old"))
        assert store.events() == []
        assert not a.holds(first)
        assert b.holds(second)
        store.append([event], lambda: 1.0, second.keep(3, b"new"))
        with Session(store.engine) as session:
            row = session.scalars(select(ClaimRow)).one()
            assert (row.position, row.state) == (3, b"new")
    assert store.audit().intact


def test_a_session_that_the_server_ended_is_an_error_once_and_then_a_new_one(store):
    with claims(store, "a") as a, claims(store, "b") as b:
        a.claim("arm")
        with store.engine.connect() as connection:
            connection.exec_driver_sql(
                "SELECT pg_terminate_backend(pid) FROM pg_locks "
                "WHERE locktype = 'advisory' AND objsubid = 1"
            )
        until(lambda: b.claim("arm"))
        with pytest.raises(StoreError):
            a.workers()
        assert a.workers() == 2


def test_workers_do_not_share_a_file(tmp_path):
    with (
        Store.open("sqlite:///twin.db", tmp_path / "audit.key", tmp_path) as store,
        pytest.raises(InputError, match="PostgreSQL"),
    ):
        claims(store, "a")


def test_what_was_sealed_elsewhere_is_not_opened(tmp_path):
    with Store.open("sqlite:///twin.db", tmp_path / "audit.key", tmp_path) as store:
        sealed = store.sealed("arm", b"state")
        assert store.unsealed("arm", sealed) == b"state"
        assert store.unsealed("leg", sealed) is None
        assert store.unsealed("arm", sealed[:-1] + b"x") is None
        assert store.unsealed("arm", b"") is None
    with Store.open("sqlite:///other.db", tmp_path / "other.key", tmp_path) as store:
        assert store.unsealed("arm", sealed) is None


def test_a_log_that_another_key_has_written_is_known(tmp_path):
    key = tmp_path / "audit.key"
    with Store.open("sqlite:///twin.db", key, tmp_path) as store:
        assert store.has_key_of_log()
        for k in range(3):
            store.append([Event(float(k), "arm", EventKind.STARTED)], lambda: 0.0)
            assert store.has_key_of_log()
    key.write_text("0" * 64)
    with Store.open("sqlite:///twin.db", key, tmp_path) as store:
        assert not store.has_key_of_log()
