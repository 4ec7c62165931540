"""The service with everything real: buses, pipelines, the machine's clock."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

from twin.ingest import Reception
from twin.ingest.buses import BusSource
from twin.pipeline import Pipeline
from twin.service import Service
from twin.settings import TwinSettings
from twin.store.documents import ParameterSet


def live_service(path: Path, roots: tuple[Path, ...] = ()) -> Service:
    """Return the service that CONFIG.toml describes, not started yet.

    Args:
        path: CONFIG.toml.
        roots: Folders of further Modelica libraries.

    Raises:
        InputError: The settings are wrong; says where.
        StoreError: The store cannot be opened.
    """
    source = partial(BusSource, reception=Reception())
    return Service(path, _pipeline(roots), source, roots=roots)


def live_worker(path: Path, roots: tuple[Path, ...] = ()) -> Service:
    """Return a worker for the twins that CONFIG.toml describes, not started yet.

    Args:
        path: CONFIG.toml, with `[jetstream]` and a store in PostgreSQL.
        roots: Folders of further Modelica libraries.

    Raises:
        InputError: The settings are wrong; says where.
        StoreError: The store cannot be opened.
        StreamError: There is no server, no JetStream, or no room for the stream.
    """
    # A client of NATS is not needed where one process does all.
    from twin.jetstream.connection import process_name  # noqa: PLC0415
    from twin.jetstream.worker import Worker  # noqa: PLC0415

    return Worker(path, _pipeline(roots), process_name(), roots=roots)


def _pipeline(
    roots: tuple[Path, ...],
) -> Callable[[TwinSettings, ParameterSet, Executor], Pipeline]:
    return lambda twin, start, executor: Pipeline(twin, start, roots=roots, executor=executor)
