"""A worker: the service for a share of the twins, whose frames come out of the stream.

The pipeline is a function of the frames and of the gateway's clock, which comes with them. So a
check-point, what the pipeline knows and behind which message it knows it, is all that another
worker needs to go on. It is written in the transaction of every event, and now and then between:
what is computed a second time after a kill is what no event came of.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import pickle
import time
import zlib
from collections.abc import Callable, Collection
from concurrent.futures import Executor
from importlib.metadata import version
from pathlib import Path
from typing import Any

from foundation.errors import InputError, StoreError, TwinproofError
from twin.follower import Follower
from twin.jetstream.connection import Connection
from twin.jetstream.frames import Place, StreamedFrames
from twin.jetstream.held import Held
from twin.monitor import Monitor
from twin.service import Running, Service, Verify
from twin.settings import Settings, TwinSettings
from twin.store.claims import Claim, Claims, OutpacedError
from twin.store.documents import ParameterSet
from twin.verification import Job
from twin.view import Averages, decision_document, line

_LOG = logging.getLogger("twinproof.twin")
_SHARE = 0.25
# What may be spent at once on taking up twins: those that run are not to wait for it [s].
_AT_ONCE = 0.25
_OTHERS = 1.0
# After which a twin that could not be run is tried again [s].
_REFUSED = 10.0
_PATIENCE = 3.0


class ElsewhereError(InputError):
    """Another worker runs this twin."""


class Worker(Service):
    """A service that runs its share of the twins.

    Args:
        path: CONFIG.toml, with `[jetstream]` and a store in PostgreSQL.
        pipeline: Makes a twin's pipeline; what it has to do in the background goes to the executor.
        name: Of this worker.
        clock: Time, in that of the gateways [s].
        steady: Time that nobody sets [s].
        verification: Runs a job; default: `twin.verification.verify` as the settings say.
        roots: Folders of further Modelica libraries.

    Raises:
        InputError: The settings are wrong, or the log's key is another.
        StoreError: The store cannot be opened.
        StreamError: There is no server, no JetStream, or no room for the stream.
    """

    # The gateways' clocks do.
    _finds_silence = False

    def __init__(
        self,
        path: Path,
        pipeline: Callable[[TwinSettings, ParameterSet, Executor], Follower],
        name: str,
        *,
        clock: Callable[[], float] = time.time,
        steady: Callable[[], float] = time.monotonic,
        verification: Verify | None = None,
        roots: tuple[Path, ...] = (),
    ) -> None:
        super().__init__(
            path,
            pipeline,
            _no_source,
            clock=clock,
            steady=steady,
            verification=verification,
            roots=roots,
            # What a store that fails does not take is computed again.
            room=0,
        )
        self.name = name
        self._held: dict[str, Held] = {}
        self._others: dict[str, dict[str, Any]] = {}
        self._refused: dict[str, float] = {}
        try:
            address = "http://{}:{}".format(*self.settings.service.address)
            self._claims = Claims(self.store.engine, name, address)
            if not self.store.has_key_of_log():
                raise InputError(
                    "the event log was written with another key",
                    where=str(path.parent / self.settings.service.key),
                    remedy="copy service.key from the machine of the first worker to all others",
                )
            self._connection = Connection(self.settings, name)
        except BaseException:
            self.store.close()
            raise

    # Life

    def close(self) -> None:
        """Stop in order: each twin's check-point is written, other workers go on from there."""
        super().close()
        self._claims.close()
        self._connection.close()

    def step(self) -> None:
        """Do one round: feed every twin of this worker; now and then see which those are."""
        super().step()
        with self._lock:
            if self.journal.failure:
                self._let_all_go(self.journal.failure)
            elif self._due("share", _SHARE):
                self._share()
            if self._due("others", _OTHERS):
                self._connection.start(self._ask_others())

    def _share(self) -> None:
        """Have as many twins as are this worker's share, none that another one has."""
        twins = sorted(self.settings.twins, key=lambda t: _rank(self.name, t.name))
        began = time.monotonic()
        try:
            share = math.ceil(len(twins) / self._claims.workers())
            for name in list(self._twins)[share:]:
                self._end(name)
            for twin in twins:
                if len(self._twins) >= share or time.monotonic() - began > _AT_ONCE:
                    return
                if twin.name in self._twins or began < self._refused.get(twin.name, 0.0):
                    continue
                claim = self._claims.claim(twin.name)
                if claim is not None:
                    self._try_to_take_up(twin, claim)
        except StoreError as error:
            # The locks were of a session that has ended: others may have the twins by now.
            self._let_all_go(str(error))

    def _begin_all(self, names: Collection[str]) -> None:
        """Leave it to the next rounds."""

    def _try_to_take_up(self, twin: TwinSettings, claim: Claim) -> None:
        try:
            self._take_up(twin, claim)
        except StoreError:
            raise
        except TwinproofError as error:
            # A twin that cannot be run is no reason to leave the others.
            self._refused[twin.name] = time.monotonic() + _REFUSED
            self._claims.release(twin.name)
            _LOG.error("not taken up", extra={"twin": twin.name, "because": str(error)})

    def _take_up(self, twin: TwinSettings, claim: Claim) -> None:
        place, state = self._restored(claim)
        streamed = StreamedFrames(self._connection, claim.twin, claim.generation, place)
        held = Held(claim, streamed, self._sealed)
        try:
            monitor = Monitor(
                twin,
                self._pipeline,
                self.journal,
                self.clock,
                roots=self._roots,
                kept=held.actions,
                resumed=None if state is None else state["monitor"],
            )
        except BaseException:
            held.close()
            raise
        held.running = Running(monitor, held, Averages())
        if state is not None:
            held.running.faults = state["faults"]
        held.answers = self._connection.answer(
            self._connection.question_to(claim.twin), lambda asked: self._answer(held, asked)
        )
        self._held[claim.twin], self._twins[claim.twin] = held, held.running
        _LOG.info("taken up", extra={"twin": claim.twin, "behind": place.position})

    def _end(self, name: str) -> None:
        running = self._twins[name]
        try:
            running.monitor.stop()
        except OutpacedError as error:
            _LOG.warning("not ended in order", extra={"twin": name, "because": str(error)})
        self._let_go(name)

    def _let_go(self, name: str) -> None:
        """Forget a twin: whoever runs it next begins at its last check-point."""
        self._twins.pop(name, None)
        held = self._held.pop(name, None)
        if held is None:
            return
        held.close()
        if held.answers is not None:
            self._connection.end(held.answers)
        try:
            self._claims.release(name)
        except TwinproofError as error:
            _LOG.warning("the session is gone", extra={"because": str(error)})

    def _let_all_go(self, because: str) -> None:
        if self._twins:
            _LOG.warning("all twins let go", extra={"because": because})
        self._claims.close()
        for name in list(self._twins):
            self._let_go(name)

    # Check-points

    def _of(self, name: str) -> str:
        return f"{version('twinproof')}:{self._fingerprints[name]}"

    def _sealed(self, name: str, stream: str, state: dict[str, Any]) -> bytes:
        head = json.dumps({"of": self._of(name), "stream": stream}).encode()
        content = pickle.dumps(state, pickle.HIGHEST_PROTOCOL)
        return self.store.sealed(name, head + b"\n" + zlib.compress(content, 1))

    def _restored(self, claim: Claim) -> tuple[Place, dict[str, Any] | None]:
        """Return where to go on, and with what; None: that is of another program or settings."""
        if claim.state is None:
            return Place(), None
        content = self.store.unsealed(claim.twin, claim.state)
        if content is None:
            # Nothing that was not sealed here is unpickled.
            _LOG.error("the check-point is not genuine", extra={"twin": claim.twin})
            return Place(), None
        line_, _, state = content.partition(b"\n")
        head = json.loads(line_)
        place = Place(claim.position, head["stream"])
        if head["of"] != self._of(claim.twin):
            return place, None
        return place, pickle.loads(zlib.decompress(state))

    # Rounds

    def _feed(self, running: Running) -> None:
        held = self._held.get(running.monitor.name)
        if held is None:
            return  # let go in this round
        try:
            held.feed(self.store)
        except OutpacedError as error:
            _LOG.warning("let go", extra={"twin": held.claim.twin, "because": str(error)})
            self._let_go(held.claim.twin)
        except TwinproofError as error:
            self._let_all_go(str(error))

    def _look_at(self, running: Running) -> None:
        if running.monitor.name not in self._held:
            return
        try:
            super()._look_at(running)
        except OutpacedError as error:
            _LOG.warning("let go", extra={"twin": running.monitor.name, "because": str(error)})
            self._let_go(running.monitor.name)

    def _verify(self, running: Running, job: Job, why: str) -> None:
        try:
            super()._verify(running, job, why)
        except OutpacedError as error:
            _LOG.warning("a verification came to nothing", extra={"because": str(error)})

    # Asking

    def monitor(self, name: str) -> Monitor:
        """Return a twin that runs here.

        Raises:
            UnknownNameError: There is none of that name.
            ElsewhereError: It runs elsewhere, or nowhere now.
        """
        self.known(name)
        found = self._twins.get(name)
        if found is None:
            owner = self._claims.owner(name)
            who, where = ("no worker", "") if owner is None else owner
            raise ElsewhereError(
                f"'{name}' does not run here, but was last taken up by {who}",
                where=where,
                remedy="ask there; what is only read is answered here as well",
            )
        return found.monitor

    def decide(self, name: str, controller: str) -> dict[str, Any]:
        """Return whether a controller (its hash) may be deployed on a twin's plant now, as JSON.

        Whoever runs the twin says it. Nobody does, or does not answer: closed.

        Raises:
            UnknownNameError: There is no twin of that name.
        """
        self.known(name)
        held = self._held.get(name)
        if held is not None:
            return self._decided(held, controller)
        found = self._asked(name, {"what": "gate", "controller": controller})
        return _closed("no worker that runs the twin answers") if found is None else found

    def _decided(self, held: Held, controller: str) -> dict[str, Any]:
        running = held.running
        try:
            if running is not None and self._claims.holds(held.claim):
                return decision_document(running.monitor.decide(controller))
        except TwinproofError as error:
            return _closed(f"the service is not whole: {error}")
        return _closed("another worker has taken over the twin")

    def view(self, name: str) -> dict[str, Any]:
        """Return what is to be seen of a twin, as JSON, wherever it runs.

        Raises:
            UnknownNameError: There is none of that name.
            ElsewhereError: It runs elsewhere, and there is no answer.
        """
        self.known(name)
        found = None if name in self._twins else self._asked(name, {"what": "view"})
        return super().view(name) if found is None else found

    def fleet(self) -> list[dict[str, Any]]:
        """Return a line about each twin, as JSON; of others' twins as of a second ago."""
        now, running = self.clock(), dict(self._twins)
        lines: list[dict[str, Any]] = []
        for twin in self.settings.twins:
            if twin.name in running:
                lines.append(line(running[twin.name].monitor, now))
            else:
                lines.append(self._others.get(twin.name) or self._unknown(twin))
        return lines

    def _unknown(self, twin: TwinSettings) -> dict[str, Any]:
        record = self.store.twin(twin.name)
        return {
            "name": twin.name,
            "model": record.model or twin.plant.model,
            "state": record.state,
            "since": record.since,
            "because": record.because,
            "verifying": False,
            "telemetry": None,
            "age": None,
            "gate": _closed("no worker that runs the twin answers"),
        }

    async def _ask_others(self) -> None:
        names = [twin.name for twin in self.settings.twins if twin.name not in self._twins]
        question = json.dumps({"what": "line"}).encode()
        found: dict[str, dict[str, Any]] = {}
        for name in names:
            subject = self._connection.question_to(name)
            answer = await self._connection.asked(subject, question, _OTHERS / 2)
            if answer is not None:
                found[name] = json.loads(answer)
        self._others = found

    def _asked(self, name: str, question: dict[str, str]) -> dict[str, Any] | None:
        work = self._connection.asked(
            self._connection.question_to(name), json.dumps(question).encode(), _PATIENCE
        )
        answer = self._connection.run(work)
        found = None if answer is None else json.loads(answer)
        return found if isinstance(found, dict) else None

    def _answer(self, held: Held, asked: bytes) -> bytes | None:
        question, running = json.loads(asked), held.running
        if running is None:
            return None
        what = question.get("what")
        if what == "gate":
            found = self._decided(held, str(question.get("controller", "")))
        elif what == "view":
            found = super().view(held.claim.twin)
        else:
            found = line(running.monitor, self.clock())
        return json.dumps(found, allow_nan=False).encode()


def _no_source(settings: Settings, twin: TwinSettings) -> Any:
    raise NotImplementedError(f"{settings.path}: {twin.name} is fed by the stream")


def _rank(worker: str, twin: str) -> bytes:
    """Return in which order a worker looks for twins: not all begin with the same."""
    return hashlib.sha256(f"{worker}/{twin}".encode()).digest()


def _closed(because: str) -> dict[str, Any]:
    return {"allowed": False, "because": because, "verified_at": None, "evidence": None}
