"""Backup of a store as one file, which any kind of database can be restored from."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, MetaData, delete, insert, select
from sqlalchemy.orm import Session

from foundation.errors import FormatError, InputError, StoreError
from foundation.files import written_whole
from twin.store.database import WRITING, revision, said_plainly, upgrade
from twin.store.tables import CLAIMS, Base

_FORMAT = "twinproof/store/1"
_BATCH = 1000


def back_up(engine: Engine, path: Path) -> int:
    """Write all of a store to a file (JSON lines, gzip), as of one moment; return the rows.

    The service may go on meanwhile. The key of the log is not in it: keep it elsewhere.

    Raises:
        StoreError: The database fails.
        OSError: The file cannot be written; it is whole or not there.
    """
    rows = 0
    where = engine.url.render_as_string()
    frozen = engine
    if engine.dialect.name == "postgresql":
        frozen = engine.execution_options(isolation_level="REPEATABLE READ")
    with (
        said_plainly(where),
        frozen.connect() as connection,
        written_whole(path) as beside,
        gzip.open(beside, "wt", encoding="utf-8") as file,
    ):
        head = {"format": _FORMAT, "revision": revision(connection)}
        file.write(json.dumps(head) + "\n")
        # Who runs a twin now, and how far it has come in a stream, is true of no other time.
        for table in (t for t in Base.metadata.sorted_tables if t.name != CLAIMS):
            for row in (
                connection.execution_options(yield_per=_BATCH).execute(select(table)).mappings()
            ):
                file.write(json.dumps([table.name, dict(row)]) + "\n")
                rows += 1
        file.write(json.dumps({"rows": rows}) + "\n")
    return rows


def restore(engine: Engine, path: Path) -> int:
    """Fill an empty database from a backup, whole or not at all; return the rows.

    Raises:
        FormatError: The file is no backup, or torn.
        InputError: The file cannot be read, or the database is not empty.
        StoreError: The database fails, or the backup is of a newer program.
    """
    where = engine.url.render_as_string()
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            lines = [json.loads(line) for line in file]
        head, rows, end = lines[0], lines[1:-1], lines[-1]
        if head["format"] != _FORMAT or end["rows"] != len(rows):
            raise ValueError(head)
    except OSError as error:
        if isinstance(error, gzip.BadGzipFile):
            raise _no_backup(path) from error
        raise InputError(
            f"the backup cannot be read: {error.strerror}", where=str(path), remedy="correct it"
        ) from error
    except (ValueError, KeyError, TypeError, IndexError, EOFError) as error:
        raise _no_backup(path) from error
    with said_plainly(where), engine.connect() as connection:
        if revision(connection) is not None:
            raise InputError(
                "the database is not empty", where=where, remedy="restore into a new one"
            )
    upgrade(engine, head["revision"])
    # The tables as they were at that revision, not as they are now.
    reflected = MetaData()
    with said_plainly(where):
        reflected.reflect(engine)
    tables = reflected.tables
    groups: dict[str, list[dict[str, Any]]] = {}
    for name, row in rows:
        groups.setdefault(name, []).append(row)
    with said_plainly(where), Session(engine.execution_options(**{WRITING: True})) as session:
        if set(groups) - set(tables):
            raise StoreError(
                "the backup has tables that this program does not know",
                where=str(path),
                remedy="run a newer twinproof",
            )
        for name in groups:
            session.execute(delete(tables[name]))
        for name, group in groups.items():
            for k in range(0, len(group), _BATCH):
                session.execute(insert(tables[name]), group[k : k + _BATCH])
        session.commit()
    upgrade(engine)
    return len(rows)


def _no_backup(path: Path) -> FormatError:
    return FormatError(
        "this is no whole backup of a store", where=str(path), remedy="take an earlier one"
    )
