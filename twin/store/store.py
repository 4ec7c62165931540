"""The store: all reading and writing of what must survive a restart."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from foundation.closing import Closing
from foundation.errors import InputError, StoreError, UnknownNameError
from twin.audit import (
    Audit,
    Entry,
    Head,
    KeyFile,
    canonical,
    check,
    code,
    content_hash,
    sealed,
    unsealed,
)
from twin.events import JSON, Event, EventKind
from twin.store.actions import Action, in_force
from twin.store.database import WRITING, open_database, said_plainly, upgrade
from twin.store.documents import Evidence, ParameterSet, SetState, TwinRecord
from twin.store.history import Retention, Span, down_sample
from twin.store.tables import (
    ArtifactRow,
    EventRow,
    EvidenceRow,
    HeadRow,
    HistoryRow,
    LinkRow,
    ParameterSetRow,
    TwinRow,
)

_BATCH = 1000


class Store(Closing):
    """The store. Any thread may use it; every call is one transaction.

    Args:
        engine: Of a database that is at the newest revision (`open_store` sees to that).
        key: Of the event log.

    Raises:
        StoreError: By every method: the database is gone or full. Nothing is half-written.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> store = Store.open("sqlite:///twin.db", folder / "audit.key", folder)
        >>> _ = store.append([Event(0.0, "robot", EventKind.STARTED)], lambda: 0.0)
        >>> store.audit()
        Audit(events=1, intact=True, because='')
        >>> store.close()
    """

    def __init__(self, engine: Engine, key: KeyFile) -> None:
        self.engine = engine
        self._key_file = key
        self._key = key.key(make=True)
        self._writing = engine.execution_options(**{WRITING: True})

    @classmethod
    def open(cls, url: str, key: Path, folder: Path = Path()) -> Store:
        """Open a store, making or upgrading it first.

        Args:
            url: Of the database, see `open_database`.
            key: File of the log's key, made if there is none and the log is empty.
            folder: That relative files start from.

        Raises:
            InputError: The URL is wrong, or the log has entries and its key is gone.
            StoreError: The database fails.
        """
        engine = open_database(url, folder)
        try:
            upgrade(engine)
            file = KeyFile(folder / key)
            with said_plainly(engine.url.render_as_string()), Session(engine) as session:
                begun = session.scalar(select(EventRow.number).limit(1)) is not None
            if begun and not file.path.exists():
                raise InputError(
                    "the log has entries, but its key is not there",
                    where=str(file.path),
                    remedy="bring the key back; without it nobody can tell whether the log is true",
                )
            return cls(engine, file)
        except BaseException:
            engine.dispose()
            raise

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

    @property
    def where(self) -> str:
        """The database, without password."""
        return self.engine.url.render_as_string()

    @contextmanager
    def _read(self) -> Generator[Session]:
        with said_plainly(self.where), Session(self.engine) as session:
            yield session

    @contextmanager
    def _write(self) -> Generator[Session]:
        with said_plainly(self.where), Session(self._writing) as session, session.begin():
            yield session

    # The event log

    def append(
        self, events: Sequence[Event], clock: Callable[[], float], *also: Action
    ) -> list[Entry]:
        """Append to the log. When this returns, the events outlive a kill.

        Args:
            events: In their order.
            clock: Says when they are written [s].
            also: Done in the same transaction (`save_…`): both are there, or neither.
        """
        if not events and not also:
            return []
        with self._write() as session:
            head = session.get(HeadRow, 1, with_for_update=True)
            if head is None:
                head = HeadRow(id=1, number=Head().number, code=Head().code)
                session.add(head)
            entries: list[Entry] = []
            for event in events:
                entry = _entry(event, head.number + 1, clock())
                entry = _coded(self._key, entry, head.code)
                head.number, head.code = entry.number, entry.code
                session.add(EventRow(**vars(entry)))
                entries.append(entry)
            for action in also:
                action(session)
            newest = Head(head.number, head.code)
        self._key_file.keep(newest)
        return entries

    def do(self, *actions: Action) -> None:
        """Do actions in one transaction, without a word in the log."""
        with self._write() as session:
            for action in actions:
                action(session)

    def events(
        self,
        *,
        twin: str | None = None,
        kind: EventKind | None = None,
        before: int | None = None,
        after: int | None = None,
        limit: int = 100,
    ) -> list[Entry]:
        """Return entries of the log: the newest first; with `after` the oldest first."""
        query = select(EventRow)
        if twin is not None:
            query = query.where(EventRow.twin == twin)
        if kind is not None:
            query = query.where(EventRow.kind == kind.value)
        if before is not None:
            query = query.where(EventRow.number < before)
        if after is not None:
            query = query.where(EventRow.number > after).order_by(EventRow.number)
        else:
            query = query.order_by(EventRow.number.desc())
        with self._read() as session:
            return [_of_row(row) for row in session.scalars(query.limit(limit))]

    def all_events(self) -> Iterator[Entry]:
        """Yield the whole log, oldest first."""
        newest = 0
        while batch := self.events(after=newest, limit=_BATCH):
            yield from batch
            newest = batch[-1].number

    def audit(self) -> Audit:
        """Return whether log, evidence and parameter sets are what was written."""
        found = check(self.all_events(), self._key, self._key_file.anchor())
        if not found.intact:
            return found
        with self._read() as session:
            for kind, table in (("evidence", EvidenceRow), ("parameter set", ParameterSetRow)):
                for row in session.scalars(select(table)):
                    if content_hash(json.loads(row.document)) != row.id:
                        return Audit(found.events, False, f"{kind} {row.id[:12]} was changed")
        return found

    def has_key_of_log(self) -> bool:
        """Return whether the log's newest entry was written with the key that is here."""
        entries = self.events(limit=2)
        if not entries:
            return True
        before = entries[1].code if len(entries) > 1 else Head().code
        return code(self._key, entries[0], before) == entries[0].code

    def sealed(self, about: str, content: bytes) -> bytes:
        """Return content with a code by the log's key, to be known again (`unsealed`)."""
        return sealed(self._key, about, content)

    def unsealed(self, about: str, found: bytes) -> bytes | None:
        """Return what was sealed; None: it was changed, or sealed with another key."""
        return unsealed(self._key, about, found)

    def begin_anew(self, clock: Callable[[], float], because: str) -> None:
        """Take the log's present end for its end, as after a restored backup; says so in it."""
        with self._read() as session:
            head = session.get(HeadRow, 1)
            newest = Head() if head is None else Head(head.number, head.code)
        self._key_file.keep(newest)
        detail: dict[str, JSON] = {"what": "store", "because": because}
        self.append([Event(clock(), "", EventKind.RECOVERED, detail)], clock)

    # Twins

    def twin(self, name: str) -> TwinRecord:
        """Return what is known of a twin; of one never seen, that it is not verified."""
        with self._read() as session:
            row = session.get(TwinRow, name)
            if row is None:
                return TwinRecord(name)
            return TwinRecord(row.name, row.state, row.since, row.because, row.model)

    # Parameter sets and evidence

    def parameter_set(self, id_: str) -> tuple[ParameterSet, SetState]:
        """Return a parameter set and what became of it.

        Raises:
            UnknownNameError: There is none of that id.
        """
        with self._read() as session:
            row = session.get(ParameterSetRow, id_)
            if row is None:
                raise UnknownNameError("parameter set", id_, [])
            return ParameterSet.of(json.loads(row.document)), SetState(row.state)

    def parameter_sets(self, twin: str, limit: int = 100) -> list[dict[str, Any]]:
        """Return a twin's parameter sets as JSON, the newest first."""
        query = (
            select(ParameterSetRow)
            .where(ParameterSetRow.twin == twin)
            .order_by(ParameterSetRow.time.desc(), ParameterSetRow.id)
            .limit(limit)
        )
        with self._read() as session:
            return [
                {
                    "id": row.id,
                    "state": row.state,
                    "promoted": row.promoted,
                    "evidence": row.evidence,
                    **json.loads(row.document),
                }
                for row in session.scalars(query)
            ]

    def verified(self, twin: str) -> tuple[ParameterSet, Evidence] | None:
        """Return the parameter set in force and the evidence for it."""
        with self._read() as session:
            row = next(iter(in_force(session, twin)), None)
            if row is None or row.evidence is None:
                return None
            evidence = session.get(EvidenceRow, row.evidence)
            if evidence is None:
                return None
            return (
                ParameterSet.of(json.loads(row.document)),
                Evidence.of(json.loads(evidence.document)),
            )

    def earlier(self, twin: str) -> str | None:
        """Return the id of the set that was in force before the present one."""
        query = (
            select(ParameterSetRow.id)
            .where(ParameterSetRow.twin == twin, ParameterSetRow.state == SetState.RETIRED.value)
            .order_by(ParameterSetRow.promoted.desc(), ParameterSetRow.id)
        )
        with self._read() as session:
            return session.scalars(query.limit(1)).first()

    def evidence(self, id_: str) -> Evidence:
        """Return evidence.

        Raises:
            UnknownNameError: There is none of that id.
        """
        with self._read() as session:
            row = session.get(EvidenceRow, id_)
            if row is None:
                raise UnknownNameError("evidence", id_, [])
            return Evidence.of(json.loads(row.document))

    # History

    def add_history(self, twin: str, values: Mapping[str, Span]) -> None:
        """Keep what some numbers did in a span; a span that is there already is joined with it."""
        with self._write() as session:
            for name, span in values.items():
                _merge(session, twin, name, span)

    def history(self, twin: str, name: str, start: float, end: float) -> list[Span]:
        """Return what a number did, by time; older spans are longer."""
        query = (
            select(HistoryRow)
            .where(
                HistoryRow.twin == twin,
                HistoryRow.name == name,
                HistoryRow.start < end,
                HistoryRow.start + HistoryRow.span > start,
            )
            .order_by(HistoryRow.start)
        )
        with self._read() as session:
            return [_span(row) for row in session.scalars(query)]

    def down_sample(self, now: float, retention: Retention) -> int:
        """Join what is old into longer spans and forget what is older still; return rows saved."""
        saved = 0
        for k, (length, kept) in enumerate(retention.steps):
            longer = retention.steps[k + 1][0] if k + 1 < len(retention.steps) else None
            # Whole longer spans only: one half joined would be joined again.
            limit = now - kept if longer is None else (now - kept) // longer * longer
            old = HistoryRow.span == length, HistoryRow.start + length <= limit
            with self._write() as session:
                rows = list(session.scalars(select(HistoryRow).where(*old)))
                groups: dict[tuple[str, str], list[Span]] = {}
                for row in rows:
                    groups.setdefault((row.twin, row.name), []).append(_span(row))
                session.execute(delete(HistoryRow).where(*old))
                session.expunge_all()
                saved += len(rows)
                if longer is not None:
                    for (twin, name), spans in groups.items():
                        for span in down_sample(spans, longer):
                            _merge(session, twin, name, span)
                            saved -= 1
        return saved

    # Lineage

    def lineage(self, id_: str) -> list[dict[str, Any]]:
        """Return what something was made from, all the way back, nearest first.

        Raises:
            UnknownNameError: Nothing has that id.
        """
        with self._read() as session:
            if session.get(ArtifactRow, id_) is None:
                raise UnknownNameError("artifact", id_, [])
            found: dict[str, dict[str, Any]] = {}
            waiting = [id_]
            while waiting:
                one = waiting.pop(0)
                row = session.get(ArtifactRow, one)
                if one in found or row is None:
                    continue
                parents = list(
                    session.scalars(
                        select(LinkRow.parent).where(LinkRow.child == one).order_by(LinkRow.parent)
                    )
                )
                found[one] = {
                    "id": row.id,
                    "kind": row.kind,
                    "name": row.name,
                    "time": row.time,
                    "parents": parents,
                }
                waiting += parents
            return list(found.values())

    def answers(self) -> bool:
        """Return whether the database answers."""
        try:
            with self._read() as session:
                session.execute(select(HeadRow.number)).first()
        except StoreError:
            return False
        return True


def _entry(event: Event, number: int, logged: float) -> Entry:
    detail = canonical(dict(event.detail))
    return Entry(number, float(event.time), float(logged), event.twin, event.kind.value, detail)


def _coded(key: bytes, entry: Entry, previous: str) -> Entry:
    return replace(entry, code=code(key, entry, previous))


def _of_row(row: EventRow) -> Entry:
    return Entry(row.number, row.time, row.logged, row.twin, row.kind, row.detail, row.code)


def _span(row: HistoryRow) -> Span:
    return Span(row.start, row.span, row.count, row.mean, row.low, row.high)


def _merge(session: Session, twin: str, name: str, span: Span) -> None:
    key = (twin, name, span.length, span.start)
    row = session.get(HistoryRow, key)
    if row is not None:
        span = down_sample([_span(row), span], span.length)[0]
    session.merge(
        HistoryRow(
            twin=twin,
            name=name,
            span=span.length,
            start=span.start,
            count=span.count,
            mean=span.mean,
            low=span.low,
            high=span.high,
        )
    )
