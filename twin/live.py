"""The service with everything real: buses, pipelines, the machine's clock."""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path

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

    def pipeline(twin: TwinSettings, start: ParameterSet, executor: Executor) -> Pipeline:
        return Pipeline(twin, start, roots=roots, executor=executor)

    return Service(path, pipeline, BusSource, roots=roots)
