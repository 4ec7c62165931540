"""Which worker runs a twin: a lock of PostgreSQL's says it, a number keeps out who missed it.

A worker holds an advisory lock for each of its twins, all in one session. The server gives them
back when the session ends, however it ends. A worker that has not noticed yet that its session is
gone must not write any more: every claim raises the twin's generation, and every write of a twin
(`Claim.keep`) changes a row of that generation, or fails with all that belongs to it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

from sqlalchemy import Connection, Engine, select, text, update
from sqlalchemy.orm import Session

from foundation.closing import Closing
from foundation.errors import ComputationError, InputError
from twin.store.actions import Action
from twin.store.database import said_plainly
from twin.store.tables import ClaimRow

# Marks the locks that workers hold to be counted.
_WORKERS = 0x74776E


class OutpacedError(ComputationError):
    """Another worker has taken over this twin."""


@dataclass(frozen=True)
class Claim:
    """The right to run a twin, until somebody else has it.

    Attributes:
        twin: Its name.
        generation: How often the twin has been claimed.
        position: In its stream, of the last check-point; 0: there is none.
        state: Of that check-point; None: there is none.
    """

    twin: str
    generation: int
    position: int
    state: bytes | None

    def keep(self, position: int, state: bytes | None) -> Action:
        """Return the action that keeps a check-point.

        Raises (the action):
            OutpacedError: Another worker has claimed the twin since.
        """

        def action(session: Session) -> None:
            kept = (
                update(ClaimRow)
                .where(ClaimRow.twin == self.twin, ClaimRow.generation == self.generation)
                .values(position=position, state=state)
                .returning(ClaimRow.twin)
            )
            if session.execute(kept).first() is None:
                raise OutpacedError(
                    f"another worker has taken over '{self.twin}'",
                    remedy="nothing is lost: it goes on there",
                )

        return action


class Claims(Closing):
    """A worker's claims.

    Args:
        engine: Of the store, a PostgreSQL database.
        worker: Name of this worker.
        address: Where its API is.

    Raises:
        InputError: The store is of another kind.
        StoreError: The database fails.
    """

    def __init__(self, engine: Engine, worker: str, address: str) -> None:
        if engine.dialect.name != "postgresql":
            raise InputError(
                "workers share twins through a PostgreSQL store; this one is SQLite",
                where="service.store",
                remedy='write store = "postgresql://user@host/database"',
            )
        self._engine, self._worker, self._address = engine, worker, address
        self._where = engine.url.render_as_string()
        self._session: Connection | None = None

    @contextmanager
    def _talking(self) -> Generator[Connection]:
        """Give the session that holds the locks; a failure ends it, and with it all claims."""
        with said_plainly(self._where):
            try:
                if self._session is None:
                    self._session = self._opened()
                yield self._session
            except BaseException:
                self.close()
                raise

    def _opened(self) -> Connection:
        # Its own, not the pool's: it lives as long as the worker, and nobody resets it.
        connection = self._engine.execution_options(isolation_level="AUTOCOMMIT").connect()
        connection.detach()
        mark = text("SELECT pg_advisory_lock(:kind, pg_backend_pid())")
        connection.execute(mark, {"kind": _WORKERS})
        return connection

    def close(self) -> None:
        """Give all claims back."""
        session, self._session = self._session, None
        if session is not None:
            session.close()

    def workers(self) -> int:
        """Return how many workers there are, this one among them.

        Raises:
            StoreError: The session is gone, and with it all claims.
        """
        query = text(
            "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND classid = :kind "
            "AND objsubid = 2 AND database = "
            "(SELECT oid FROM pg_database WHERE datname = current_database())"
        )
        with self._talking() as session:
            return int(session.execute(query, {"kind": _WORKERS}).scalar_one())

    def claim(self, twin: str) -> Claim | None:
        """Claim a twin; None: another worker has it.

        Raises:
            StoreError: The session is gone, and with it all claims.
        """
        with self._talking() as session:
            locked = text("SELECT pg_try_advisory_lock(:key)")
            if not session.execute(locked, {"key": _key(twin)}).scalar_one():
                return None
            with Session(self._engine) as other, other.begin():
                row = other.get(ClaimRow, twin, with_for_update=True)
                if row is None:
                    row = ClaimRow(twin=twin, generation=0, position=0)
                    other.add(row)
                row.generation += 1
                row.worker, row.address = self._worker, self._address
                return Claim(twin, row.generation, row.position, row.state)

    def release(self, twin: str) -> None:
        """Give a claim back.

        Raises:
            StoreError: The session is gone, and with it all claims.
        """
        with self._talking() as session:
            session.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": _key(twin)})

    def holds(self, claim: Claim) -> bool:
        """Return whether nobody has claimed a twin since.

        Raises:
            StoreError: The database fails.
        """
        with said_plainly(self._where), Session(self._engine) as session:
            query = select(ClaimRow.generation).where(ClaimRow.twin == claim.twin)
            return session.scalars(query).first() == claim.generation

    def owner(self, twin: str) -> tuple[str, str] | None:
        """Return the worker that last claimed a twin and its address; None: nobody did.

        Raises:
            StoreError: The database fails.
        """
        with said_plainly(self._where), Session(self._engine) as session:
            row = session.execute(
                select(ClaimRow.worker, ClaimRow.address).where(ClaimRow.twin == twin)
            ).first()
            return None if row is None else (row.worker, row.address)


def _key(twin: str) -> int:
    return int.from_bytes(hashlib.sha256(twin.encode()).digest()[:8], "big", signed=True)
