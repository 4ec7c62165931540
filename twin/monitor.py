"""One twin: its pipeline, whether its plant is verified, and what must be done about it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from foundation.errors import InputError, TwinproofError
from recordings.readers.can_frames import Frames
from twin.candidates import arrived, identified, improvement, known_values
from twin.events import JSON, Event, EventKind
from twin.follower import Follower
from twin.gate import Decision, Situation, decide, is_ahead
from twin.gate_watch import GateWatch, limits, question
from twin.improvement import with_model
from twin.journal import Journal
from twin.lifecycle import Life, Pace, after, due, refused, rolled_back, verified
from twin.lineage import Recorded, lineage
from twin.promotion import AUTOMATIC, approvable, promotion, verification_event
from twin.settings import TwinSettings
from twin.store.actions import Action, roll_back, save_evidence, save_set, save_twin
from twin.store.documents import Evidence, ParameterSet
from twin.verification import Job, file_hash, fit_of


class Monitor:
    """A twin in service. Any thread may use it; what takes long is left to the caller.

    Args:
        settings: Of the twin.
        pipeline: Makes the pipeline, given the model's word and the parameters to compare with.
        journal: Where everything goes.
        clock: Says what time it is, in the frames' time [s].
        roots: Folders of further Modelica libraries.
        kept: What belongs into every transaction of this twin: of a worker, its check-point.
        resumed: The snapshot of another one, which this one takes up.

    Attributes:
        lock: Held while anything changes; hold it to look at the pipeline.
    """

    def __init__(
        self,
        settings: TwinSettings,
        pipeline: Callable[[TwinSettings, ParameterSet], Follower],
        journal: Journal,
        clock: Callable[[], float],
        *,
        roots: tuple[Path, ...] = (),
        kept: Callable[[], Sequence[Action]] = lambda: (),
        resumed: Mapping[str, Any] | None = None,
    ) -> None:
        self.settings = settings
        self._kept = kept
        self.journal = journal
        self._clock = clock
        self._roots = roots
        self.lock = threading.RLock()
        self._busy = False
        # Whether the plant has drifted since the parameters that are being verified.
        self._outdated = False
        self._asked = ""
        self._gate = GateWatch()
        self._make_pipeline = pipeline
        store = journal.store
        self._in_force = store.verified(settings.name)
        self._life = Life(store.twin(settings.name))
        self._resume_model()
        self._model = file_hash(self.settings.plant.fmu)
        self._new = not store.parameter_sets(settings.name, 1)
        if self._in_force is not None and self._in_force[0].model != self._model:
            self._in_force = None
            self._unverify(self._life.record.because or "the model was changed")
        if self._in_force is None:
            self._unverify(self._life.record.because or "nothing is verified")
        if self._in_force is None:
            self._start = identified(self.settings, self._model, clock())
        else:
            self._start = self._in_force[0]
        self.pipeline = pipeline(self.settings, self._start)
        if resumed is not None:
            self._resume(resumed)
        values = dict[str, JSON](self._start.values)
        detail: dict[str, JSON] = {"model": self.settings.plant.model, "parameters": values}
        started = Event(clock(), self.name, EventKind.STARTED, detail)
        self._write([started], save_twin(self._life.record))

    def _resume_model(self) -> None:
        """Follow the model that was in force, if an effect had been added to it."""
        model = self._life.record.model
        if not model or self._in_force is None:
            return
        try:
            fit = fit_of(self._in_force[0])
            self.settings = with_model(self.settings, model, fit, self._roots)
        except TwinproofError as error:
            record = replace(self._life.record, model="")
            self._life = replace(self._life, record=record)
            self._unverify(f"the improved model cannot be used: {error}")

    def snapshot(self) -> dict[str, Any]:
        """Return what another monitor of the same twin needs to go on; plain values, not copied."""
        with self.lock:
            return {
                "model": self._model,
                "in_force": self._verified_id,
                "life": self._life,
                "decision": self._gate.decision,
                "pipeline": self.pipeline.snapshot(),
            }

    def _resume(self, found: Mapping[str, Any]) -> None:
        if found["model"] != self._model:
            return  # the store has gone on: another model is followed
        self.pipeline.resume(found["pipeline"])
        record, life = self._life.record, found["life"]
        self._gate.decision = found["decision"]
        if found["in_force"] == self._verified_id:
            self._life = replace(life, record=record)
        else:
            # It was promoted, or rolled back, when this had been written down.
            self._life = Life(record, stale=life.stale, followed_since=life.followed_since)
            self.pipeline.verify(self.reference)

    @property
    def _verified_id(self) -> str | None:
        return None if self._in_force is None else self._in_force[0].id

    @property
    def name(self) -> str:
        """Of the twin."""
        return self.settings.name

    @property
    def life(self) -> Life:
        """What has happened so far."""
        return self._life

    @property
    def in_force(self) -> tuple[ParameterSet, Evidence] | None:
        """The verified parameters and their evidence."""
        return self._in_force

    @property
    def reference(self) -> ParameterSet:
        """What the plant is compared with: the verified parameters, or those of the start."""
        return self._start if self._in_force is None else self._in_force[0]

    def unit(self, parameter: str) -> str:
        """Return a parameter's unit."""
        described = self.settings.plant.described.parameters
        return next((v.unit for v in described if v.name == parameter), "")

    @property
    def verifying(self) -> bool:
        """Whether a verification is under way, its result not in the store yet."""
        with self.lock:
            return self._busy

    # What comes from the plant

    def feed(self, frames: Frames, now: float | None = None) -> list[Event]:
        """Take frames; return what happened. The gate has heard of it when this returns.

        Args:
            frames: As they come.
            now: Everything before it has come [s]; None: `tick` looks for silence.
        """
        with self.lock:
            events = self.pipeline.feed(frames)
            if now is not None:
                events = [*events, *self.pipeline.idle(now)]
            return self._take(events)

    def tick(self, *, silence: bool = True) -> list[Event]:
        """Look at what time alone changes: ages, and silence if that is wanted."""
        with self.lock:
            events = self.pipeline.idle(self._clock()) if silence else []
            return self._take(events, aged=True)

    def tell(self, events: list[Event]) -> None:
        """Write what happened around the twin."""
        with self.lock:
            self._write(events)

    def interrupted(self, now: float) -> None:
        """Forget that telemetry was followed: a clock was set, or frames were lost."""
        with self.lock:
            if self._life.followed_since is not None:
                self._life = replace(self._life, followed_since=now)

    def _take(self, events: list[Event], *, aged: bool = False) -> list[Event]:
        before = self._life
        newest = self.pipeline.newest
        if newest is not None and before.followed_since is None and not before.stale:
            self._life = replace(before, followed_since=newest)
        for event in events:
            self._life = after(self._life, event)
            self._outdated |= event.kind is EventKind.DRIFT
        self._doubt_a_clock()
        # Between two blocks of samples ages alone change, and `tick` looks at those.
        estimate = self.pipeline.estimate
        if aged or events or self._life is not before or not self._gate.is_of(estimate):
            # Files are read again when something has happened, once a second, and for who asks.
            events = [*events, *self._gate_moved(afresh=aged or bool(events))]
        changed = self._life.record != before.record
        if events or changed:
            self._write(events, *([save_twin(self._life.record)] if changed else []))
        return events

    def _doubt_a_clock(self) -> None:
        """Put the plant in doubt if it was verified in the future: how old that is is not known."""
        evidence = None if self._in_force is None else self._in_force[1]
        if evidence is None or not self._life.is_verified:
            return
        if is_ahead(evidence.time, self._clock()):
            self._unverify("a clock was set back to before the verification")

    # The gate

    def decide(self, controller: str | None = None) -> Decision:
        """Return whether a controller may be deployed now.

        Args:
            controller: Its hash (`twin.verification.controller_hash`); None: the deployed one's.
        """
        with self.lock:
            try:
                asked = question(self.settings, self._model, controller)
            except InputError as error:
                return Decision(False, str(error))
            return decide(asked, self._situation(), limits(self.settings))

    def _situation(self) -> Situation:
        estimate = self.pipeline.estimate
        life, failure = self._life, self.journal.failure
        return Situation(
            now=self._clock(),
            verified=life.is_verified,
            because=failure or life.record.because,
            healthy=not failure,
            telemetry=None if life.stale else self.pipeline.newest,
            followed_since=life.followed_since,
            estimate=None if estimate is None else estimate.time,
            values=None if estimate is None else known_values(estimate, self.reference),
            evidence=() if self._in_force is None else (self._in_force[1],),
        )

    def _gate_moved(self, *, afresh: bool = True) -> list[Event]:
        """Return the gate's event if its answer has become another; `afresh`: read all files."""
        known, estimate = self._situation(), self.pipeline.estimate
        return self._gate.look(self.settings, self._model, known, estimate, afresh=afresh)

    # Verification

    def ask_for_verification(self, who: str) -> None:
        """Have the plant verified now, whatever happened before."""
        with self.lock:
            self._asked = f"asked by {who}"

    def next_job(self) -> tuple[Job, str] | None:
        """Return what should be verified now and why; None: nothing.

        After that the twin is busy until `conclude` or `give_up`.
        """
        with self.lock:
            v = self.settings.verification
            if self._busy or self.journal.failure or not (v.study and v.controller):
                return None
            try:
                why = self._asked or self._due()
            except InputError:
                return None  # a file is gone: the gate is closed, and says so
            candidate = self._candidate() if why else None
            if candidate is None:
                return None
            self._busy, self._asked, self._outdated = True, "", False
            job = Job(
                candidate,
                self.settings.plant.model,
                self.settings.file(v.study),
                self.settings.file(v.controller),
                v.draws,
                v.widening,
                self._roots,
                improvement(self.settings, self._roots, self._life, self.pipeline, candidate),
            )
            return job, why

    def _due(self) -> str:
        v, span = self.settings.verification, self.settings.drift.diagnose
        pace = Pace(v.settle, v.settle + 3 * span if span else 0.0, v.settle, v.max_age)
        at = None if self._in_force is None else self._in_force[1].time
        asked = question(self.settings, self._model)
        decision = decide(asked, self._situation(), limits(self.settings))
        # A decision about evidence; one about silence or age of telemetry names none.
        left = decision.because if decision.evidence is not None and not decision.allowed else ""
        return due(self._life, pace, self._clock(), at, left)

    def _candidate(self) -> ParameterSet | None:
        """Return the parameters as the data say they are now; None: that is not known yet."""
        life = self._life
        if self._new and life.drift is None and life.attempt is None:
            return self._start  # as `identify` found them
        now, reference = self._clock(), self.reference
        return arrived(self.settings, self._model, life, self.pipeline, reference, now)

    def _follow(self, parameters: ParameterSet) -> None:
        """Follow the plant on the model that these parameters are of, if it is another."""
        model = str(parameters.origin.get("model", ""))
        if parameters.model == self._model or not model:
            return
        self.settings = with_model(self.settings, model, fit_of(parameters), self._roots)
        self._model = parameters.model
        newest = self.pipeline.newest
        self.pipeline = self._make_pipeline(self.settings, parameters)
        # The new filter knows nothing yet of the plant's state.
        record = replace(self._life.record, model=model)
        self._life = replace(self._life, record=record, followed_since=newest, effect=None)

    def conclude(
        self, job: Job, evidence: Evidence, recorded: Iterable[Recorded] = ()
    ) -> list[Event]:
        """Take the evidence of a verification: into force, or refused.

        Args:
            job: From `next_job`.
            evidence: Of it.
            recorded: What the parameters come from.
        """
        with self.lock:
            self._busy = False
            set_ = job.parameters
            events = [verification_event(set_, evidence)]
            actions = [
                save_set(set_),
                save_evidence(evidence),
                *lineage(job, evidence, recorded),
            ]
            if not evidence.passed:
                runs, passed = evidence.detail.get("runs"), evidence.detail.get("passed")
                because = f"the controller passed only {passed} of {runs} runs of its study"
                self._life = refused(self._life, self._clock(), because)
            elif self._outdated:
                # What was verified is no longer the plant.
                self._life = replace(self._life, attempt=None)
            elif self.settings.verification.approval == "automatic":
                return self._promote(set_, evidence, AUTOMATIC, events, actions)
            else:
                self._life = replace(
                    self._life,
                    attempt=self._clock(),
                    refused=True,
                    record=replace(self._life.record, because="passed, and waits for approval"),
                )
            return self._settle(events, actions)

    def give_up(self, job: Job, because: str) -> list[Event]:
        """Take it that a verification could not be carried out."""
        with self.lock:
            self._busy = False
            self._life = refused(self._life, self._clock(), f"verification failed: {because}")
            detail: dict[str, JSON] = {"passed": False, "because": because}
            detail["parameters"] = job.parameters.id
            event = Event(self._clock(), self.name, EventKind.VERIFICATION, detail)
            return self._settle([event], [])

    def approve(self, parameters: str, token: str) -> list[Event]:
        """Put a set that passed its verification into force, in a person's name.

        Raises:
            InputError: It did not pass, or the plant has drifted since.
            UnknownNameError: There is no such set or evidence.
        """
        with self.lock:
            store, now = self.journal.store, self._clock()
            set_, evidence = approvable(store, self.name, parameters, self._life, now)
            return self._promote(set_, evidence, token, [], [])

    def roll_back(self, token: str) -> list[Event]:
        """Put the set that was in force before the present one into force again.

        The plant stays unverified until its estimate is inside what was verified then.

        Raises:
            InputError: There was none.
        """
        with self.lock:
            store = self.journal.store
            to = store.earlier(self.name)
            if to is None:
                raise InputError(
                    "no earlier parameters were in force", where=self.name, remedy="verify anew"
                )
            self._outdated = True
            self._life = rolled_back(self._life, self._clock(), f"rolled back by {token}")
            event = Event(
                self._clock(), self.name, EventKind.ROLLED_BACK, {"parameters": to, "token": token}
            )
            store_first = [roll_back(self.name, to), save_twin(self._life.record)]
            self._write([event], *store_first)
            self._in_force = store.verified(self.name)
            if self._in_force is not None:
                self._follow(self._in_force[0])
                self.pipeline.verify(self._in_force[0])
            return [event, *self._settle([], [])]

    def _promote(
        self,
        set_: ParameterSet,
        evidence: Evidence,
        token: str,
        events: list[Event],
        actions: list[Action],
    ) -> list[Event]:
        self._follow(set_)
        now = self._clock()
        told, done = promotion(set_, evidence, token, now)
        events, actions = [*events, *told], [*actions, *done]
        life = verified(self._life, now, self.pipeline.newest)
        # In the store first: what is not there after a kill was never in force.
        if self._write(events, *actions, save_twin(life.record)):
            self._life, self._in_force = life, (set_, evidence)
            self.pipeline.verify(set_)
        else:
            self._unverify("the verification could not be stored")
        moved = self._gate_moved()
        if moved:
            self._write(moved)
        return [*events, *moved]

    def _settle(self, events: list[Event], actions: list[Action]) -> list[Event]:
        events = [*events, *self._gate_moved()]
        self._write(events, *actions, save_twin(self._life.record))
        return events

    def _unverify(self, because: str) -> None:
        record = replace(self._life.record, state="unverified", because=because)
        self._life = replace(self._life, record=record)

    def _write(self, events: list[Event], *also: Action) -> bool:
        return self.journal.write(events, *also, *self._kept())

    def stop(self) -> None:
        """End in order."""
        with self.lock:
            self._write([Event(self._clock(), self.name, EventKind.STOPPED)])
