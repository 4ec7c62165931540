"""A recorded log through the very pipeline that live data go through, as fast as it goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from foundation.errors import FormatError, InputError
from recordings.readers import reader_for
from recordings.readers.can_frames import Frames
from recordings.readers.can_log import CanReader
from recordings.readers.mf4 import Mf4Reader
from twin.estimate import Estimate
from twin.events import JSON, Event
from twin.ingest.recorder import SUFFIX
from twin.pipeline import Health, Pipeline
from twin.settings import TwinSettings


@dataclass(frozen=True, eq=False)
class Replay:
    """What came of a log.

    Attributes:
        state: `stable`, `drifted`, `stale`, or `waiting` where the log was too short.
        events: In order.
        estimate: At the end; None: too little data.
        drift: The tests at the end; see `Pipeline.drift`.
        health: Of the data.
        span: From the first to the last frame [s].
        seconds: That the replay took.
    """

    state: str
    events: tuple[Event, ...]
    estimate: Estimate | None
    drift: dict[str, JSON]
    health: Health
    span: float
    seconds: float

    @property
    def speed(self) -> float:
        """How many times faster than it was recorded."""
        return self.span / self.seconds if self.seconds > 0 else float("inf")


def replay(
    settings: TwinSettings,
    data: Path,
    *,
    roots: tuple[Path, ...] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Replay:
    """Send a log through a twin's pipeline.

    Args:
        settings: Of the twin.
        data: A CAN log, or a folder with a recorder's files.
        roots: Folders of further Modelica libraries.
        progress: Told what is being done.

    Raises:
        FormatError: It is no CAN log, or damaged.
        TwinproofError: See `Pipeline`.
    """
    progress("preparing the filters")
    pipeline = Pipeline(settings, roots=roots)
    events: list[Event] = []
    first = last = None
    began = time.perf_counter()
    for frames in log_frames(data, len(settings.buses)):
        if not len(frames):
            continue
        first = int(frames.nanoseconds[0]) if first is None else first
        last = int(frames.nanoseconds[-1])
        events += pipeline.feed(frames)
        progress(f"{(last - first) / 1e9:.0f} s, {len(events)} events")
    events += pipeline.finish()
    if first is None or last is None:
        raise FormatError("no frame in the log", where=str(data), remedy="record it again")
    drift, health = pipeline.drift, pipeline.health
    pipeline.close()
    state = str(drift["state"])
    if health.stale:
        state = "stale"
    elif pipeline.estimate is None:
        state = "waiting"
    seconds = time.perf_counter() - began
    span = (last - first) / 1e9
    return Replay(state, tuple(events), pipeline.estimate, drift, health, span, seconds)


def log_frames(data: Path, buses: int = 1) -> Iterator[Frames]:
    """Yield the frames of a CAN log, or of all in a folder, in order of their names.

    Buses that a log knows by our recorder's names keep their numbers; others are numbered as they
    appear, up to `buses`.

    Raises:
        InputError: There is nothing.
        FormatError: A file is no CAN log, or damaged.
    """
    files: Sequence[Path] = [data]
    if data.is_dir():
        files = sorted(data.glob(f"*{SUFFIX}"))
        if not files:
            raise InputError(
                f"no recording in {data}", remedy=f"name a folder with *{SUFFIX} files"
            )
    numbers: dict[str, int] = {}
    for path in files:
        reader = reader_for(path)
        if isinstance(reader, Mf4Reader):
            parts: Iterable[Frames] = [reader.frames(path)]
        elif isinstance(reader, CanReader):
            parts = reader.frames(path)
        else:
            raise FormatError(
                "not a CAN log", where=str(path), remedy="replay .log, .blf, .asc, .trc or .mf4"
            )
        for frames in parts:
            yield _numbered(frames, numbers, buses)


def _numbered(frames: Frames, numbers: dict[str, int], buses: int) -> Frames:
    if not frames.bus_names:
        # Logs that number their buses begin with 0 or with 1; a single bus is ours in any case.
        return replace(frames, bus=np.zeros_like(frames.bus)) if buses == 1 else frames
    for name in frames.bus_names:
        ours = name.removeprefix("bus")
        numbers.setdefault(name, int(ours) if ours.isdigit() else len(numbers))
    table = np.array([numbers[name] for name in frames.bus_names])
    return replace(frames, bus=table[frames.bus] if buses > 1 else np.zeros_like(frames.bus))
