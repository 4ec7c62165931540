"""The store on SQLite and on a real PostgreSQL server."""

import itertools
import json
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import create_engine, text

from foundation.errors import FormatError, InputError, StoreError, UnknownNameError
from twin.events import Event, EventKind
from twin.journal import Journal
from twin.store import (
    Evidence,
    ParameterSet,
    SetState,
    Span,
    Store,
    TwinRecord,
    back_up,
    down_sample,
    open_database,
    restore,
    upgrade,
)
from twin.store.actions import (
    promote,
    roll_back,
    save_artifact,
    save_evidence,
    save_set,
    save_twin,
)
from twin.store.history import Retention
from twin.store.tables import Base

SET = ParameterSet(
    "robot", 12.5, "fmu", ("J",), {"J": 0.1 + 0.2, "g": 9.81}, ((1e-300,),), {"recording": "r"}
)
EVIDENCE = Evidence(
    "robot", 13.0, "c", "fmu", "s", SET.id, SET.names, SET.values, SET.covariance, True, {"runs": 3}
)


@pytest.fixture
def store(database, tmp_path):
    with Store.open(database, Path("audit.key"), tmp_path) as found:
        yield found


def event(number, kind=EventKind.DRIFT, twin="robot"):
    return Event(float(number), twin, kind, {"number": number, "text": "λ 95 %"})


def append(store, *events, also=()):
    return store.append(events, lambda: 99.5, *also)


def test_events_come_back_as_they_were_in_order(store):
    entries = append(store, event(1), event(2, EventKind.GATE), event(3, twin="other"))
    assert [e.number for e in entries] == [1, 2, 3]
    assert store.events() == entries[::-1]
    assert store.events(twin="robot", limit=1) == [entries[1]]
    assert store.events(kind=EventKind.GATE) == [entries[1]]
    assert store.events(before=3, limit=1) == [entries[1]]
    assert store.events(after=1) == entries[1:]
    assert json.loads(entries[0].detail) == {"number": 1, "text": "λ 95 %"}
    assert list(store.all_events()) == entries


def test_threads_append_to_one_unbroken_chain(store):
    def write(start):
        for k in range(10):
            append(store, event(start + k))

    threads = [threading.Thread(target=write, args=(100 * n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = store.audit()
    assert (found.events, found.intact) == (40, True)


TAMPERING = {
    "detail": "UPDATE events SET detail = '{}' WHERE number = 3",
    "time": "UPDATE events SET time = 0 WHERE number = 3",
    "twin": "UPDATE events SET twin = 'another' WHERE number = 3",
    "kind": "UPDATE events SET kind = 'started' WHERE number = 3",
    "code": "UPDATE events SET code = 'x' WHERE number = 3",
    "removed": "DELETE FROM events WHERE number = 3",
    "first": "DELETE FROM events WHERE number = 1",
    "end": "DELETE FROM events WHERE number > 3",
    "all": "DELETE FROM events",
    "swapped": "UPDATE events SET number = CASE number WHEN 2 THEN -3 ELSE -2 END "
    "WHERE number IN (2, 3); UPDATE events SET number = -number WHERE number < 0",
    "evidence": "UPDATE evidence SET document = replace(document, '\"runs\":3', '\"runs\":4')",
    "set": "UPDATE parameter_sets SET document = replace(document, '9.81', '9.80')",
}


@pytest.mark.parametrize("how", TAMPERING)
def test_whatever_is_changed_in_the_database_is_seen(store, how):
    for k in range(5):
        append(store, event(k), also=(save_set(SET), save_evidence(EVIDENCE)))
    assert store.audit().intact
    with store.engine.begin() as connection:
        changed = 0
        for statement in TAMPERING[how].split(";"):
            changed += connection.exec_driver_sql(statement).rowcount
        assert changed
    found = store.audit()
    assert not found.intact
    assert found.because


def test_the_chain_cannot_be_written_anew_without_the_key(database, tmp_path):
    with Store.open(database, Path("one.key"), tmp_path) as store:
        append(store, event(1))
        with store.engine.begin() as connection:
            for table in ("events", "head"):
                connection.execute(text(f"DELETE FROM {table}"))
    with Store.open(database, Path("other.key"), tmp_path) as forged:
        append(forged, event(2))
        assert forged.audit().intact
    with Store.open(database, Path("one.key"), tmp_path) as store:
        assert not store.audit().intact


def test_a_log_without_its_key_is_not_gone_on_with(database, tmp_path):
    with Store.open(database, Path("audit.key"), tmp_path) as store:
        append(store, event(1))
    assert (tmp_path / "audit.key").stat().st_mode & 0o077 == 0
    (tmp_path / "audit.key").unlink()
    with pytest.raises(InputError, match="its key is not there"):
        Store.open(database, Path("audit.key"), tmp_path)


def test_promotion_and_roll_back(store):
    assert store.verified("robot") is None
    with pytest.raises(InputError, match="no passed verification"):
        append(store, also=(save_set(SET), promote(SET.id, EVIDENCE.id, 14.0)))
    with pytest.raises(UnknownNameError):
        store.parameter_set(SET.id)  # the whole transaction was undone
    append(store, also=(save_set(SET), save_evidence(EVIDENCE)))
    assert store.parameter_set(SET.id) == (SET, SetState.CANDIDATE)
    append(store, also=(promote(SET.id, EVIDENCE.id, 14.0),))
    assert store.verified("robot") == (SET, EVIDENCE)
    assert store.earlier("robot") is None

    second = replace(SET, time=20.0)
    passed = replace(EVIDENCE, parameters=second.id, time=21.0)
    also = (save_set(second), save_evidence(passed), promote(second.id, passed.id, 21.0))
    append(store, also=also)
    assert store.verified("robot") == (second, passed)
    assert store.earlier("robot") == SET.id
    assert store.parameter_set(SET.id)[1] is SetState.RETIRED

    failed = replace(SET, time=30.0)
    evidence = replace(EVIDENCE, parameters=failed.id, passed=False)
    append(store, also=(save_set(failed), save_evidence(evidence)))
    assert store.parameter_set(failed.id)[1] is SetState.REFUSED
    with pytest.raises(InputError, match="no passed verification"):
        append(store, also=(promote(failed.id, evidence.id, 31.0),))

    append(store, also=(roll_back("robot", SET.id),))
    assert store.verified("robot") == (SET, EVIDENCE)
    assert store.parameter_set(second.id)[1] is SetState.REFUSED
    with pytest.raises(InputError, match="never in force"):
        append(store, also=(roll_back("robot", failed.id),))
    assert store.verified("robot") == (SET, EVIDENCE)
    states = {row["id"]: row["state"] for row in store.parameter_sets("robot")}
    assert states == {SET.id: "verified", second.id: "refused", failed.id: "refused"}
    assert store.evidence(EVIDENCE.id) == EVIDENCE


def test_a_twin_that_was_never_seen_is_not_verified(store):
    assert store.twin("robot").state == "unverified"
    record = TwinRecord("robot", "verified", 5.0, "", "improved.mo:Improved")
    append(store, also=(save_twin(record),))
    assert store.twin("robot") == record


def test_lineage_goes_back_to_the_recording(store):
    append(
        store,
        also=(
            save_artifact("rec", "recording", "a.blf", 1.0),
            save_artifact("set", "parameters", "", 2.0, ["rec"]),
            save_artifact("fmu", "model", "Plant", 2.0, ["set"]),
            save_artifact("ev", "study", "robust", 3.0, ["fmu", "set", "ctl"]),
            save_artifact("ctl", "controller", "pid.toml", 0.0),
            save_artifact("ok", "approval", "maria", 4.0, ["ev"]),
        ),
    )
    found = store.lineage("ok")
    assert [a["kind"] for a in found] == [
        *("approval", "study", "controller", "model", "parameters", "recording")
    ]
    assert found[1]["parents"] == ["ctl", "fmu", "set"]
    with pytest.raises(UnknownNameError):
        store.lineage("nothing")


@given(
    st.lists(st.tuples(st.floats(0, 500), st.floats(-1e6, 1e6)), min_size=1, max_size=40),
    st.sampled_from([10.0, 60.0]),
)
def test_down_sampling_keeps_count_mean_and_extremes(values, length):
    found = down_sample([Span(t, 1.0, 1, v, v, v) for t, v in values], length)
    frame = pd.DataFrame(values, columns=["t", "v"])
    groups = frame.groupby(frame.t // length * length).v.agg(["count", "mean", "min", "max"])
    assert [s.start for s in found] == list(groups.index)
    assert [s.count for s in found] == list(groups["count"])
    np.testing.assert_allclose([s.mean for s in found], groups["mean"], rtol=1e-9, atol=1e-6)
    assert [(s.low, s.high) for s in found] == list(zip(groups["min"], groups["max"], strict=True))


def test_old_history_grows_coarse_and_is_forgotten(store):
    keep = Retention(((1.0, 100.0), (60.0, 1000.0)))
    for t in range(0, 600, 4):
        store.add_history("robot", {"J": Span(t, 1.0, 1, t, t, t)})
    everything = store.history("robot", "J", 0, 1e9)
    assert len(everything) == 150
    saved = store.down_sample(600.0, keep)
    found = store.history("robot", "J", 0, 1e9)
    assert saved == 150 - len(found)
    assert {s.length for s in found} == {1.0, 60.0}
    assert sum(s.count for s in found) == 150
    # Nothing overlaps, and all that is younger than it may be is still fine.
    assert all(a.start + a.length <= b.start for a, b in itertools.pairwise(found))
    assert all(s.length == 1.0 for s in found if s.start >= 500)
    total = sum(s.count * s.mean for s in found)
    assert total == pytest.approx(sum(s.mean for s in everything))
    assert store.down_sample(600.0, keep) == 0
    store.add_history("robot", {"J": Span(0, 60.0, 1, -5.0, -5.0, -5.0)})
    assert store.history("robot", "J", 0, 1)[0].low == -5.0
    store.down_sample(5000.0, keep)
    assert store.history("robot", "J", 0, 1e9) == []


def test_migrations_make_the_tables_that_the_program_expects(database, tmp_path):
    engine = open_database(database, tmp_path)
    assert upgrade(engine) == (None, "0003")
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    engine.dispose()


def test_several_programs_make_the_tables_at_once(postgres_database, tmp_path):
    engines = [open_database(postgres_database, tmp_path) for _ in range(6)]
    with ThreadPoolExecutor(len(engines)) as pool:
        found = list(pool.map(upgrade, engines))
    assert {after for _, after in found} == {"0003"}
    assert [before for before, _ in found].count(None) == 1
    for engine in engines:
        engine.dispose()


def test_an_old_database_is_upgraded_and_keeps_what_it_has(database, tmp_path):
    with Store.open(database, Path("audit.key"), tmp_path) as store:
        append(store, event(1), also=(save_set(SET),))
        with store.engine.begin() as connection:
            for table in ("artifacts", "links", "history", "claims"):
                connection.execute(text(f"DROP TABLE {table}"))
            connection.execute(text("UPDATE alembic_version SET version_num = '0001'"))
    with Store.open(database, Path("audit.key"), tmp_path) as store:
        assert store.audit().intact
        assert store.parameter_set(SET.id)[0] == SET
        assert store.history("robot", "J", 0, 1) == []


def test_a_database_of_a_newer_program_is_left_alone(database, tmp_path):
    engine = open_database(database, tmp_path)
    upgrade(engine)
    with engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(StoreError, match="9999"):
        upgrade(engine)
    engine.dispose()


def test_backup_moves_between_kinds_of_databases(store, tmp_path, postgres_database):
    append(store, event(1), event(2), also=(save_set(SET), save_evidence(EVIDENCE)))
    append(store, also=(promote(SET.id, EVIDENCE.id, 14.0),))
    store.add_history("robot", {"J": Span(0.0, 1.0, 1, 0.1, 0.1, 0.1)})
    rows = back_up(store.engine, tmp_path / "store.gz")
    other = "sqlite:///other.db"
    if store.engine.dialect.name == "sqlite":
        other = postgres_database
    engine = open_database(other, tmp_path)
    assert restore(engine, tmp_path / "store.gz") == rows
    with pytest.raises(InputError, match="not empty"):
        restore(engine, tmp_path / "store.gz")
    engine.dispose()
    with Store.open(other, Path("audit.key"), tmp_path) as copy:
        assert copy.audit() == store.audit()
        assert list(copy.all_events()) == list(store.all_events())
        assert copy.verified("robot") == store.verified("robot")
        assert copy.history("robot", "J", 0, 1) == store.history("robot", "J", 0, 1)
        append(copy, event(3))
        assert copy.audit().events == 3


@pytest.mark.parametrize("cut", [0, 1, 100, -1])
def test_a_torn_backup_is_refused_and_nothing_is_restored(store, tmp_path, cut):
    append(store, event(1))
    back_up(store.engine, tmp_path / "whole.gz")
    content = (tmp_path / "whole.gz").read_bytes()
    (tmp_path / "torn.gz").write_bytes(content[:cut])
    engine = open_database("sqlite:///new.db", tmp_path)
    with pytest.raises(FormatError, match="no whole backup"):
        restore(engine, tmp_path / "torn.gz")
    restore(engine, tmp_path / "whole.gz")
    engine.dispose()


def test_a_full_disk_leaves_nothing_half_written(tmp_path):
    with Store.open("sqlite:///twin.db", Path("audit.key"), tmp_path) as store:
        append(store, event(1))
        with store.engine.connect() as connection:
            pages = connection.execute(text("PRAGMA page_count")).scalar_one()
            # What a full disk does, SQLite does at this limit: SQLITE_FULL.
            connection.execute(text(f"PRAGMA max_page_count = {pages + 2}"))
        many = [event(k) for k in range(2, 2000)]
        with pytest.raises(StoreError, match="full"):
            append(store, *many)
        last = store.events(limit=1)[0].number
        with store.engine.connect() as connection:
            connection.execute(text("PRAGMA max_page_count = 100000"))
        append(store, event(1000))
        found = store.audit()
        assert (found.events, found.intact) == (last + 1, True)


def test_a_database_that_is_held_by_another_is_a_failure_that_passes(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.store.database._PATIENCE", 0.1)
    with Store.open("sqlite:///twin.db", Path("audit.key"), tmp_path) as store:
        append(store, event(1))
        other = sqlite3.connect(tmp_path / "twin.db")
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreError, match="locked"):
            append(store, event(2))
        assert store.answers()
        other.close()
        append(store, event(3))
        assert store.audit().events == 2


def test_a_server_that_goes_away_and_comes_back(postgres, postgres_database, tmp_path):
    name = postgres_database.rpartition("/")[2]
    admin = create_engine(
        f"{postgres}/postgres".replace("postgresql:", "postgresql+psycopg:"),
        isolation_level="AUTOCOMMIT",
    )

    def allow(word):
        with admin.connect() as connection:
            connection.execute(text(f"ALTER DATABASE {name} WITH ALLOW_CONNECTIONS {word}"))
            connection.execute(
                text(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = :name"
                ),
                {"name": name},
            )

    with Store.open(postgres_database, Path("audit.key"), tmp_path) as store:
        journal = Journal(store, lambda: 99.5)
        assert journal.write([event(1)])
        allow("false")
        assert not journal.write([event(2)])
        assert journal.failure
        assert not journal.retry()
        allow("true")
        assert journal.retry()
        kinds = [e.kind for e in store.all_events()]
        assert kinds == ["drift", "degraded", "drift", "recovered"]
        assert store.audit().intact
    admin.dispose()


@pytest.mark.parametrize("url", ["", "nonsense", "mysql://x/y", "sqlite://", "sqlite:///:memory:"])
def test_what_is_no_store_is_refused(url, tmp_path):
    with pytest.raises(InputError, match=r"service\.store"):
        open_database(url, tmp_path)
