"""Databases for the tests of the store: files of SQLite, and a PostgreSQL server of their own."""

import pytest
from sqlalchemy import create_engine, text

from tests.twin.postgres_server import postgres_server, program


@pytest.fixture(scope="session")
def postgres():
    """URL of a real server, without a database's name."""
    if program("initdb") is None or program("postgres") is None:
        pytest.skip("no PostgreSQL server")
    # It need not survive the machine: that it writes to the disk at once is not waited for.
    with postgres_server("-F") as url:
        yield url


@pytest.fixture
def postgres_database(postgres, request):
    """URL of an empty database on a real server."""
    name = f"db{abs(hash(request.node.nodeid)) % 10**12}"
    admin = create_engine(
        f"{postgres}/postgres".replace("postgresql:", "postgresql+psycopg:"),
        isolation_level="AUTOCOMMIT",
    )
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    yield f"{postgres}/{name}"
    with admin.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request):
    """URL of an empty database, of each kind there is."""
    if request.param == "sqlite":
        return "sqlite:///twin.db"
    return request.getfixturevalue("postgres_database")
