"""The service: twins fed from their buses, verified in the background, seen by many readers.

One thread reads, records, decodes and estimates for all twins; one runs verifications, whose work
is done by processes of their own. Whatever fails around a twin is logged as `degraded`, and as
`recovered` when it works again; the twins go on meanwhile.
"""

from __future__ import annotations

import hashlib
import json
import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from foundation.closing import Closing
from foundation.errors import InputError, TwinproofError, UnknownNameError
from hil.settings import Table, read_toml
from recordings.readers.can_frames import Frames
from twin.apart import Apart, apart, prepare
from twin.audit import Entry, canonical
from twin.events import Event, EventKind
from twin.follower import Follower
from twin.hub import FLEET, Hub
from twin.improvement import improve
from twin.journal import ROOM, SERVICE, Journal
from twin.lineage import Recorded
from twin.monitor import Monitor
from twin.promptness import be_prompt
from twin.settings import Settings, TwinSettings, settings_of
from twin.store.documents import Evidence, ParameterSet
from twin.store.history import Retention
from twin.store.store import Store
from twin.verification import Job, improved, verify
from twin.view import Averages, decision_document, line, numbers, signals

_LOG = logging.getLogger("twinproof.twin")
_ROUND = 0.02
_LIVE = 0.2
_SECOND = 1.0
_RETENTION_EVERY = 3600.0
# A clock that moves otherwise than time does, by more than this, was set [s].
_CLOCK_STEP = 1.0
_ALIVE = 10.0


class Source(Protocol):
    """Where a twin's frames come from."""

    def read(self) -> Frames:
        """Return what has come since the last call, recorded already."""
        ...

    def faults(self) -> Mapping[str, str]:
        """Return what fails now, and why; tries to mend it."""
        ...

    def counts(self) -> Mapping[str, int]:
        """Return what has been counted: received, dropped, …"""
        ...

    def recorded(self) -> list[tuple[Path, int]]:
        """Return the newest recording and how many bytes of it there are."""
        ...

    def close(self) -> None:
        """End it."""
        ...


@dataclass(eq=False)
class Running:
    """A twin in service.

    Attributes:
        monitor, source: Of it.
        averages: What goes into the history.
        faults: That are known of already.
    """

    monitor: Monitor
    source: Source
    averages: Averages
    faults: dict[str, str] = field(default_factory=dict[str, str])


Verify = Callable[[Job], Evidence]


class Service(Closing):
    """The service. `start` it, `close` it; any thread may ask it.

    Args:
        path: CONFIG.toml.
        pipeline: Makes a twin's pipeline; what it has to do in the background goes to the executor.
        source: Opens a twin's buses.
        clock: Time, in that of the frames [s].
        steady: Time that nobody sets [s].
        verification: Runs a job; default: `twin.verification.verify` as the settings say.
        roots: Folders of further Modelica libraries.
        room: Of the journal.

    Raises:
        InputError: The settings are wrong.
        StoreError: The store cannot be opened.
    """

    _finds_silence = True
    """Whether this process' clock says that frames should have come."""

    def __init__(
        self,
        path: Path,
        pipeline: Callable[[TwinSettings, ParameterSet, Executor], Follower],
        source: Callable[[Settings, TwinSettings], Source],
        *,
        clock: Callable[[], float] = time.time,
        steady: Callable[[], float] = time.monotonic,
        verification: Verify | None = None,
        roots: tuple[Path, ...] = (),
        room: int = ROOM,
    ) -> None:
        self._path, self._roots = path, roots
        self._make_pipeline, self._open_source = pipeline, source
        self.clock, self._steady = clock, steady
        self.settings, self._fingerprints = self._read()
        service = self.settings.service
        self.store = Store.open(service.store, Path(service.key), path.parent)
        self.journal = Journal(self.store, clock, room)
        self.hub = Hub()
        self.started = clock()
        self._verification = verification or self._study
        self._twins: dict[str, Running] = {}
        self._lock = threading.RLock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="twins", daemon=True)
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="verification")
        self._diagnoses = Apart(self._stopping, "diagnosis")
        self._round_at = steady()
        self._clock_offset = clock() - steady()
        self._next: dict[str, float] = {}
        self.journal.listen(self._log)

    def _read(self) -> tuple[Settings, dict[str, str]]:
        table = read_toml(self._path)
        settings = settings_of(table, self._roots)
        prints = {
            twin.name: _fingerprint(sub, twin)
            for twin, sub in zip(settings.twins, table.subs("twin"), strict=True)
        }
        return settings, prints

    # Life

    def start(self, *, threads: bool = True) -> None:
        """Start all twins.

        Args:
            threads: False: nothing happens by itself; `step` does one round.
        """
        prepare()
        self._begin_all(self._fingerprints.keys())
        if threads:
            self._thread.start()
        _LOG.info("started", extra={"twins": list(self._twins), "store": self.store.where})

    def close(self) -> None:
        """Stop in order: what has been received is still taken, and the log says that it ended."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self.hub.close()
        if self._thread.is_alive():
            self._thread.join(_ALIVE)
        for executor in (self._executor, self._diagnoses):
            executor.shutdown(wait=False, cancel_futures=True)
        for name in list(self._twins):
            self._end(name)
        self.journal.retry()
        self.store.close()
        _LOG.info("stopped")

    def _begin_all(self, names: Collection[str]) -> None:
        wanted = [twin for twin in self.settings.twins if twin.name in names]
        # That takes long, and frames that came meanwhile would be stamped late.
        monitors = [
            Monitor(twin, self._pipeline, self.journal, self.clock, roots=self._roots)
            for twin in wanted
        ]
        be_prompt()
        for twin, monitor in zip(wanted, monitors, strict=True):
            source = self._open_source(self.settings, twin)
            self._twins[twin.name] = Running(monitor, source, Averages())

    def _pipeline(self, settings: TwinSettings, start: ParameterSet) -> Follower:
        return self._make_pipeline(settings, start, self._diagnoses)

    def _end(self, name: str) -> None:
        running = self._twins.pop(name)
        self._feed(running)
        running.source.close()
        running.monitor.stop()

    def reload(self) -> dict[str, list[str]]:
        """Read the settings again; begin, end or begin anew the twins that they change.

        Returns:
            Which twins were `added`, `removed`, `changed`.

        Raises:
            InputError: The settings are wrong; everything stays as it is.
        """
        with self._lock:
            settings, prints = self._read()
            now = self.settings
            keys = [
                *_differences("service", now.service, settings.service),
                *_differences("jetstream", now.stream, settings.stream),
            ]
            if keys:
                raise InputError(
                    f"what a reload cannot change has changed: {', '.join(keys)}",
                    where=str(self._path),
                    remedy="restart the service, or put it back: a reload is for twins",
                )
            before = self._fingerprints
            changed = {n for n in before.keys() & prints.keys() if prints[n] != before[n]}
            removed, added = before.keys() - prints.keys(), prints.keys() - before.keys()
            for name in (removed | changed) & self._twins.keys():
                self._end(name)
            self.settings, self._fingerprints = settings, prints
            self._begin_all(added | changed)
            return {
                "added": sorted(added),
                "removed": sorted(removed),
                "changed": sorted(changed),
            }

    # Asking

    def decide(self, name: str, controller: str) -> dict[str, Any]:
        """Return whether a controller (its hash) may be deployed on a twin's plant now, as JSON.

        Raises:
            UnknownNameError: There is no twin of that name.
        """
        return decision_document(self.monitor(name).decide(controller))

    @property
    def monitors(self) -> dict[str, Monitor]:
        """All twins by name."""
        return {name: running.monitor for name, running in list(self._twins.items())}

    def monitor(self, name: str) -> Monitor:
        """Return a twin.

        Raises:
            UnknownNameError: There is none of that name.
        """
        found = self._twins.get(name)
        if found is None:
            raise UnknownNameError("twin", name, list(self._twins))
        return found.monitor

    def view(self, name: str) -> dict[str, Any]:
        """Return what is to be seen of a twin, as JSON.

        Raises:
            UnknownNameError: There is none of that name.
        """
        return {**self.numbers(name), "channels": signals(self.monitor(name))}

    def numbers(self, name: str) -> dict[str, Any]:
        """Return the same without the signals.

        Raises:
            UnknownNameError: There is none of that name.
        """
        monitor = self.monitor(name)
        running = self._twins[name]
        return numbers(monitor, self.clock(), dict(running.source.counts()), dict(running.faults))

    def fleet(self) -> list[dict[str, Any]]:
        """Return a line about each twin, as JSON."""
        return [line(m, self.clock()) for m in self.monitors.values()]

    def known(self, name: str) -> TwinSettings:
        """Return a twin's settings.

        Raises:
            UnknownNameError: There is none of that name.
        """
        return self.settings.twin(name)

    @property
    def is_alive(self) -> bool:
        """Whether the twins are being fed."""
        return not self._stopping.is_set() and self._steady() - self._round_at < _ALIVE

    @property
    def faults(self) -> dict[str, str]:
        """What fails now, and why."""
        found = {"store": self.journal.failure} if self.journal.failure else {}
        for name, running in list(self._twins.items()):
            found |= {f"{name}: {what}": why for what, why in running.faults.items()}
        return found

    # The rounds

    def _run(self) -> None:
        while not self._stopping.is_set():
            began = time.monotonic()
            try:
                self.step()
            except Exception:
                # A fault of ours in one round must not end the watch over all plants.
                _LOG.exception("a round failed")
            self._stopping.wait(max(0.001, _ROUND - (time.monotonic() - began)))

    def step(self) -> None:
        """Do one round: feed every twin; now and then what is due."""
        self._round_at = self._steady()
        with self._lock:
            for running in list(self._twins.values()):
                self._feed(running)
            if self._due("live", _LIVE):
                self._publish()
            if self._due("second", _SECOND):
                self._look()
            if self._due("retention", _RETENTION_EVERY):
                self._thin_out()

    def _due(self, what: str, every: float) -> bool:
        now = self._steady()
        if now < self._next.get(what, 0.0):
            return False
        self._next[what] = now + every
        return True

    def _feed(self, running: Running) -> None:
        frames = running.source.read()
        if len(frames):
            running.monitor.feed(frames)

    def _look(self) -> None:
        self.journal.retry()
        self._watch_clock()
        for running in list(self._twins.values()):
            self._look_at(running)

    def _look_at(self, running: Running) -> None:
        running.monitor.tick(silence=self._finds_silence)
        self._compare_faults(running)
        job = running.monitor.next_job()
        if job is not None:
            self._executor.submit(self._verify, running, *job)
        spans = running.averages.take(running.monitor.pipeline.estimate)
        if spans and not self.journal.failure:
            self._keep(running.monitor.name, spans)

    def _keep(self, name: str, spans: Any) -> None:
        try:
            self.store.add_history(name, spans)
        except TwinproofError as error:
            _LOG.warning("history was not kept", extra={"because": str(error)})

    def _watch_clock(self) -> None:
        offset = self.clock() - self._steady()
        moved, self._clock_offset = offset - self._clock_offset, offset
        if abs(moved) > _CLOCK_STEP:
            for running in list(self._twins.values()):
                running.monitor.interrupted(self.clock())
            because = f"it was set by {moved:+.3f} s"
            told = self._degraded(SERVICE, "clock", because), self._recovered(SERVICE, "clock")
            self.journal.write(told)

    def _compare_faults(self, running: Running) -> None:
        name, before, now = running.monitor.name, running.faults, dict(running.source.faults())
        running.faults = now
        events = [
            self._degraded(name, what, why) for what, why in now.items() if what not in before
        ]
        events += [self._recovered(name, what) for what in before if what not in now]
        if events:
            running.monitor.tell(events)

    def _degraded(self, twin: str, what: str, because: str) -> Event:
        return Event(self.clock(), twin, EventKind.DEGRADED, {"what": what, "because": because})

    def _recovered(self, twin: str, what: str) -> Event:
        return Event(self.clock(), twin, EventKind.RECOVERED, {"what": what})

    def _publish(self) -> None:
        for name in self._twins:
            if self.hub.wanted(name):
                self.hub.publish(name, json.dumps(self.view(name), allow_nan=False))
        if self.hub.wanted(FLEET):
            self.hub.publish(FLEET, json.dumps({"twins": self.fleet()}, allow_nan=False))

    def _thin_out(self) -> None:
        try:
            saved = self.store.down_sample(self.clock(), Retention())
        except TwinproofError as error:
            _LOG.warning("history was not thinned out", extra={"because": str(error)})
        else:
            _LOG.info("history thinned out", extra={"rows": saved})

    # Verification

    def _study(self, job: Job) -> Evidence:
        scheduler = self.settings.service.scheduler or None
        # Without a cluster one process does it all: the other core is the twins'.
        found = apart(self._stopping, verify, job, time.time, scheduler=scheduler, workers=0)
        return replace(found, time=self.clock())

    def _verify(self, running: Running, job: Job, why: str) -> None:
        name = running.monitor.name
        _LOG.info("verification begins", extra={"twin": name, "because": why})
        try:
            recorded = [_recorded(path, size) for path, size in running.source.recorded()]
            if job.improvement is not None:
                job = improved(job, apart(self._stopping, improve, job.improvement))
            evidence = self._verification(job)
        except Exception as error:
            if self._stopping.is_set():
                return  # it is made again after the next start
            if not isinstance(error, TwinproofError):
                _LOG.exception("a verification failed", extra={"twin": name})
            running.monitor.give_up(job, str(error) or type(error).__name__)
            return
        running.monitor.conclude(job, evidence, recorded)

    def _log(self, entries: list[Entry]) -> None:
        for entry in entries:
            level = logging.WARNING if entry.kind in _LOUD else logging.INFO
            if entry.kind == EventKind.PARAMETERS.value:
                level = logging.DEBUG
            _LOG.log(level, entry.kind, extra={"event": entry.document()})


_LOUD = {k.value for k in (EventKind.DRIFT, EventKind.DEGRADED, EventKind.TELEMETRY_STALE)}


def _fingerprint(table: Table, twin: TwinSettings) -> str:
    digest = hashlib.sha256(canonical(table.values).encode())
    digest.update(twin.plant.fmu.read_bytes())
    fit = twin.plant.fit
    if fit is not None:
        digest.update(canonical(dict(fit.values)).encode() + fit.covariance.tobytes())
    return digest.hexdigest()


def _differences(table: str, before: object, after: object) -> list[str]:
    """Return the keys of a table that are not what they were."""
    old, new = vars(before), vars(after)
    return [f"{table}.{key}" for key in new if new[key] != old[key]]


def _recorded(path: Path, size: int) -> Recorded:
    digest, left = hashlib.sha256(), size
    with path.open("rb") as file:
        while left > 0 and (part := file.read(min(left, 1 << 20))):
            digest.update(part)
            left -= len(part)
    return Recorded(f"{path.name}[:{size}]", digest.hexdigest())
