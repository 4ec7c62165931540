"""Databases by URL: SQLite in a file, or a PostgreSQL server; brought to the newest revision."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import alembic.command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from foundation.errors import InputError, StoreError

_UPGRADING = 0x747775
WRITING = "twinproof_writing"
"""Execution option of connections that will write."""

# How long another process may hold the database before that counts as a failure [s].
_PATIENCE = 5.0
# So that a server notices within 5 s that a client's machine has vanished, with its locks.
_SILENCE = (
    "SET tcp_keepalives_idle = 2; SET tcp_keepalives_interval = 1; SET tcp_keepalives_count = 3"
)


@contextmanager
def said_plainly(where: str) -> Generator[None]:
    """Turn what a database says into a `StoreError`."""
    try:
        yield
    except SQLAlchemyError as error:
        said = str(getattr(error, "orig", None) or error).strip().splitlines()
        raise StoreError(
            f"the database fails: {said[0] if said else type(error).__name__}",
            where=where,
            remedy="see that it runs, has room, and that service.store is right",
        ) from error


def open_database(url: str, folder: Path = Path()) -> Engine:
    """Return the database of a URL, which need not exist yet.

    Args:
        url: `sqlite:///twin.db` or `postgresql://user@host/database`; SQLAlchemy's form.
        folder: That a relative file of SQLite starts from.

    Raises:
        InputError: It is no URL of a database that can be used.
    """
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise InputError(
            f"'{url}' is no URL of a database",
            where="service.store",
            remedy='write "sqlite:///twin.db" or "postgresql://user@host/database"',
        ) from error
    kind = parsed.get_backend_name()
    if kind == "postgresql":
        parsed = parsed.set(drivername="postgresql+psycopg")
        options: dict[str, Any] = {
            "pool_pre_ping": True,
            "connect_args": {"connect_timeout": int(_PATIENCE)},
        }
    elif kind == "sqlite" and parsed.database not in (None, "", ":memory:"):
        file = folder / str(parsed.database)
        file.parent.mkdir(parents=True, exist_ok=True)
        parsed = parsed.set(database=str(file))
        options = {"connect_args": {"timeout": _PATIENCE}}
    else:
        raise InputError(
            f"'{url}' cannot be the store",
            where="service.store",
            remedy="give a file of SQLite or a PostgreSQL database",
        )
    try:
        engine = create_engine(parsed, **options)
    except (NoSuchModuleError, ImportError) as error:
        raise InputError(str(error), where="service.store", remedy="correct the URL") from error
    if kind == "sqlite":
        _prepare_sqlite(engine)
    else:
        _prepare_postgresql(engine)
    return engine


def _prepare_postgresql(engine: Engine) -> None:
    def connected(connection: Any, _: Any) -> None:
        connection.autocommit = True
        connection.execute(_SILENCE)
        connection.autocommit = False

    event.listen(engine, "connect", connected)


def _prepare_sqlite(engine: Engine) -> None:
    """Set what SQLite needs to be shared between threads and to survive a kill."""

    def connected(connection: Any, _: Any) -> None:
        # Python's own handling of transactions would begin them too late to lock.
        connection.isolation_level = None
        cursor = connection.cursor()
        cursor.execute("PRAGMA journal_mode=WAL")
        cursor.execute("PRAGMA synchronous=FULL")
        cursor.close()

    def begun(connection: Connection) -> None:
        writing = connection.get_execution_options().get(WRITING)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writing else "BEGIN")

    event.listen(engine, "connect", connected)
    event.listen(engine, "begin", begun)


def _config(connection: Connection) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.attributes["connection"] = connection
    return config


def revision(connection: Connection) -> str | None:
    """Return the revision that a database is at; None: it is empty."""
    return MigrationContext.configure(connection).get_current_revision()


def upgrade(engine: Engine, target: str = "head") -> tuple[str | None, str | None]:
    """Bring a database to the newest revision, whole or not at all.

    Args:
        engine: Of the database; an empty one gets its tables.
        target: Another revision than the newest.

    Returns:
        The revision before and after.

    Raises:
        StoreError: The database fails, or a newer program has written it.
    """
    where = engine.url.render_as_string()
    with said_plainly(where), engine.execution_options(**{WRITING: True}).begin() as connection:
        if engine.dialect.name == "postgresql":
            # Several programs that start at once: the first one makes the tables.
            connection.execute(text(f"SELECT pg_advisory_xact_lock({_UPGRADING}, 0)"))
        config = _config(connection)
        before = revision(connection)
        known = {s.revision for s in ScriptDirectory.from_config(config).walk_revisions()}
        if before is not None and before not in known:
            raise StoreError(
                f"the database is at revision {before}, which this program does not know",
                where=where,
                remedy="run a newer twinproof, or restore a backup",
            )
        alembic.command.upgrade(config, target)
        return before, revision(connection)
