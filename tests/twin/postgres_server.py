"""A PostgreSQL server of the tests' own, in a folder that goes away."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import create_engine


def program(name):
    """Return where a program of PostgreSQL is; None: it is not installed."""
    found = shutil.which(name)
    if found:
        return found
    places = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(places[-1]) if places else None


@contextmanager
def postgres_server(*options_of_server):
    """Give the URL of a server, without a database's name."""
    initdb, server = program("initdb"), program("postgres")
    # Not in pytest's folder, which every run of pytest closes to all users but its own.
    folder = Path(tempfile.mkdtemp(prefix="twin-postgres-"))
    options = {}
    if os.getuid() == 0:  # the server refuses to run as root
        user = pwd.getpwnam("postgres")
        os.chown(folder, user.pw_uid, user.pw_gid)
        options = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
    data = folder / "data"
    command = [initdb, "-D", data, "-U", "twin", "-A", "trust", "-E", "UTF8", "--no-sync"]
    subprocess.run(command, check=True, capture_output=True, cwd="/", **options)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [server, "-D", data, "-p", str(port), "-h", "127.0.0.1", "-k", "", *options_of_server],
            stdout=log,
            stderr=log,
            cwd="/",
            **options,
        )
    url = f"postgresql://twin@127.0.0.1:{port}"
    try:
        _wait(url)
        yield url
    finally:
        process.terminate()
        process.wait(30)
        shutil.rmtree(folder, ignore_errors=True)


def _wait(url):
    engine = create_engine(f"{url}/postgres".replace("postgresql:", "postgresql+psycopg:"))
    for _ in range(300):
        try:
            with engine.connect():
                break
        except Exception:
            time.sleep(0.1)
    else:
        raise RuntimeError("the PostgreSQL server does not start")
    engine.dispose()
