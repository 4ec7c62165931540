"""One twin's data, from frames to events: the same for live data and for a replay.

Frames carry their own stamps, and nothing here looks at a clock: they are cut into slices by their
stamps, decoded, put on the model's grid in blocks, and every block goes through two filters. One
believes the verified parameters; its score is tested for drift. The other believes the present
estimate; it predicts, and its score moves the estimate.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foundation.errors import DivergenceError
from foundation.resumable import Resumable
from recordings.readers.can_frames import Frames
from twin.drift_watch import DriftWatch
from twin.estimate import Estimate
from twin.estimation import shares_filter
from twin.events import JSON, Event, EventKind
from twin.history import History, Predictions
from twin.ingest.decoder import Decoder
from twin.ingest.sampler import Block, Sampler
from twin.ingest.timeline import Slice, Timeline
from twin.parts import drift_monitor, free_run, online_fit, scored_filter
from twin.plant_model import plant_model, with_free_covariance
from twin.settings import TwinSettings
from twin.telemetry import Change, Telemetry

Array = NDArray[np.float64]

_SLICE = 50_000_000
_REPORT = 10.0
"""Between two events with the estimate [s]."""
_KEPT = 20.0
_RECOVERED = 5.0
"""So long must filters run that have diverged, before that is over [s]."""
_SECOND = 1e-9


class Parameters(Protocol):
    """Parameters to compare with; `twin.store.documents.ParameterSet` is one."""

    @property
    def names(self) -> tuple[str, ...]:
        """The k parameters that the covariance is of."""
        ...

    @property
    def values(self) -> Mapping[str, float]:
        """Parameter → value."""
        ...

    @property
    def covariance(self) -> tuple[tuple[float, ...], ...]:
        """k × k."""
        ...


@dataclass(frozen=True)
class Health:
    """How the data are.

    Attributes:
        counts: What was received, lost, refused, by reason.
        blocks: That went through the filters.
        restarts: Of the filters, after gaps and divergences.
        stale: Messages that are silent.
        noise: Output → innovations over their predicted standard deviation, of the last block.
        free: Output → root mean square error of the model by itself over the last horizon, its
            unit.
    """

    counts: Mapping[str, int]
    blocks: int
    restarts: int
    stale: tuple[str, ...]
    noise: Mapping[str, float]
    free: Mapping[str, float]


class Pipeline(Resumable):
    """From frames to events.

    Args:
        settings: Of the twin.
        parameters: The verified ones; None: those of `parameters_from`.
        roots: Folders of further Modelica libraries.
        executor: Runs diagnoses; None: here, while `feed` waits, as a replay wants it.

    Raises:
        TwinproofError: See `plant_model`.
    """

    _changes = (
        "_decoder",
        "_sampler",
        "_timeline",
        "_telemetry",
        "_believed",
        "_following",
        "_fit",
        "_trail",
        "_history",
        "_watch",
        "_free",
        "_excited",
        "_time",
        "_updated",
        "_begun",
        "_reported",
        "_blocks",
        "_restarts",
        "_diverged_at",
        "_noise",
    )

    def __init__(
        self,
        settings: TwinSettings,
        parameters: Parameters | None = None,
        *,
        roots: tuple[Path, ...] = (),
        executor: Executor | None = None,
    ) -> None:
        self.settings = settings
        self.plant = plant_model(settings, roots)
        model, e = self.plant, settings.estimator
        self._h = 1.0 / settings.rate
        n = round(e.block * settings.rate)
        self._decoder = Decoder(model.buses)
        self._sampler = Sampler(
            model.inputs, model.outputs, rate=settings.rate, length=n, delays=settings.delays
        )
        patience = round(1e9 * settings.stale)
        self._timeline = Timeline(_SLICE, patience)
        self._telemetry = Telemetry(self._decoder.messages, patience)
        start = dict(model.values)
        covariance = np.zeros((len(model.free), len(model.free)))
        fit = settings.plant.fit
        if parameters is not None:
            start |= parameters.values
            given = np.array(parameters.covariance, float)
            covariance = with_free_covariance(model.free, parameters.names, given)
        elif fit is not None:
            covariance = with_free_covariance(model.free, fit.names, fit.covariance)
        self._believed = scored_filter(model, start, self._h)
        self._following = scored_filter(model, start, self._h)
        self._fit = online_fit(settings, model, start, covariance, n)
        self._history = History(
            model.inputs,
            model.outputs,
            seconds=max(_KEPT, settings.drift.diagnose),
            block=e.block,
            sample_time=self._h,
        )
        self._watch = DriftWatch(
            settings,
            model,
            drift_monitor(settings, model, start, covariance),
            self._believed.values,
            covariance,
            self._history,
            roots=roots,
            executor=executor,
        )
        self._free = free_run(settings, model, self._following, self._h)
        self._tunable = {v.name for v in settings.plant.described.parameters}
        self._trail: deque[tuple[float, dict[str, float]]] = deque()
        self._excited: bool | None = None
        self._time: float | None = None
        self._updated: float | None = None
        self._begun: float | None = None
        self._reported = -np.inf
        self._blocks = self._restarts = 0
        self._diverged_at: float | None = None
        self._noise = dict.fromkeys(model.outputs, 0.0)
        self._known: tuple[object, Estimate] | None = None

    # What is known

    @property
    def estimate(self) -> Estimate | None:
        """The parameters as the data say, as of the last update; None before the first block.

        The same object until something of it has changed.
        """
        if self._updated is None:
            return None
        of = self._blocks, self._fit.updates, len(self._trail), self._believed.values
        if self._known is None or self._known[0] != of:
            self._known = of, self._estimated(self._updated)
        return self._known[1]

    def _estimated(self, updated: float) -> Estimate:
        fit = self._fit
        covariance = fit.covariance
        values = {**self._believed.values, **fit.values}
        known = {n: float(v) for n, v in values.items() if n in self.plant.values}
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
        found = Estimate(
            updated,
            fit.names,
            known,
            dict(zip(fit.names, sd, strict=True)),
            covariance,
            fit.excitation.level,
            self.plant.units,
        )
        return replace(found, moved=found.distance(self._trail[0][1])) if self._trail else found

    @property
    def newest(self) -> float | None:
        """Time of the newest good frame [s]."""
        newest = self._telemetry.newest
        return None if newest is None else newest * _SECOND

    @property
    def predictions(self) -> Predictions:
        """Measured and predicted, of the last while."""
        return self._history.last()

    @property
    def free(self) -> Predictions | None:
        """What the FMU does by itself from the filtered state on, over the last horizon.

        None: that is not known yet, or the model's states have no start parameters.
        """
        return None if self._free is None else self._free.last

    @property
    def drift(self) -> dict[str, JSON]:
        """The tests as they stand: `state`, `since`, `parameter`, `threshold`, `statistics`."""
        return self._watch.state

    @property
    def health(self) -> Health:
        """How the data are."""
        decoder, timeline = self._decoder, self._timeline
        counts = {**decoder.statistics.counts(), "stale": decoder.stale + timeline.refused}
        counts["missing"] = self._sampler.missing
        return Health(
            counts,
            self._blocks,
            self._restarts,
            tuple(sorted(self._telemetry.stale)),
            dict(self._noise),
            {} if self._free is None else dict(self._free.rms),
        )

    # What comes

    def feed(self, frames: Frames) -> list[Event]:
        """Take frames, as they come, from all buses; return what happened."""
        events: list[Event] = []
        for part in self._timeline.add(frames):
            events += self._slice(part)
        return events + self._diagnosed(wait=False)

    def finish(self) -> list[Event]:
        """Take it that no more frames come; waits for a diagnosis that is under way."""
        events: list[Event] = []
        for part in self._timeline.finish():
            events += self._slice(part)
        return events + self._diagnosed(wait=True)

    def idle(self, now: float) -> list[Event]:
        """Say what happened because nothing came until `now` [s, of the frames' clock]."""
        if self._telemetry.newest is None:
            return []
        events: list[Event] = []
        stamp = round(now * 1e9)
        for part in self._timeline.finish(stamp):
            events += self._slice(part)
        # While a slice is open, what came last is not known yet.
        if not self._timeline.is_open:
            for change in self._telemetry.silent(stamp):
                events += self._changed(change)
        return events + self._diagnosed(wait=False)

    def _diagnosed(self, *, wait: bool) -> list[Event]:
        events = self._watch.found(wait=wait)
        self._adopt()
        return events

    def _adopt(self) -> None:
        """Go on from the parameters that a diagnosis has fitted to its data."""
        fit = self._watch.fitted()
        if fit is None:
            return
        free = self._fit.names
        self._fit.adopt(fit.values, with_free_covariance(free, fit.names, fit.covariance))
        shares_filter(self._fit, self._following)
        self._following.restart()
        self._trail.clear()

    def close(self) -> None:
        """Let go of the FMU; nothing is fed after that."""
        if self._free is not None:
            self._free.close()

    def verify(self, parameters: Parameters) -> None:
        """Compare with these parameters from the next block on; a drift is over."""
        values = {**self._believed.values, **parameters.values}
        given = np.array(parameters.covariance, float)
        covariance = with_free_covariance(self.plant.free, parameters.names, given)
        self._believed.set_values(values)
        if self._watch.drifted:
            # Its state, and the disturbance in it, were those of another plant.
            self._believed.restart()
        else:
            self._believed.forget()
        self._watch.verify(self._believed.values, covariance)

    def _slice(self, part: Slice) -> list[Event]:
        events: list[Event] = []
        if part.step:
            because = f"the clock was set back by {part.step * _SECOND:.3f} s"
            where = part.end * _SECOND
            events += [
                self._event(EventKind.DEGRADED, where, {"what": "clock", "because": because}),
                self._event(EventKind.RECOVERED, where, {"what": "clock"}),
            ]
            self._decoder.restart()
            self._telemetry.restart()
            self._restart()
        decoded = self._decoder.decode(part.frames)
        changes = self._telemetry.take(decoded, part.end)
        for change in changes:
            events += self._changed(change)
        if self._telemetry.stale:
            return events
        self._sampler.add(decoded)
        for block in self._sampler.blocks():
            events += self._block(block)
        return events

    def _changed(self, change: Change) -> list[Event]:
        time, gap = change.time * _SECOND, change.gap * _SECOND
        self._restart()
        if change.stale:
            detail: dict[str, JSON] = {"message": change.message, "age": self.settings.stale}
            return [self._event(EventKind.TELEMETRY_STALE, time, detail)]
        detail = {"message": change.message, "gap": gap}
        return [self._event(EventKind.TELEMETRY_BACK, time, detail)]

    def _restart(self) -> None:
        """What was known of the plant's state is no longer true."""
        self._sampler.restart()
        self._believed.restart()
        self._following.restart()
        self._restarts += 1
        if self._free is not None:
            self._free.restart()

    def _block(self, block: Block) -> list[Event]:
        time = (block.start + len(block.outputs) * self._sampler.step) * _SECOND
        try:
            tested = self._believed.block(block.inputs, block.outputs)
            scored = self._following.block(block.inputs, block.outputs)
        except DivergenceError as error:
            return self._diverged(time, str(error))
        events = self._sound(time)
        self._time = time
        self._begun = time if self._begun is None else self._begun
        self._blocks += 1
        spread = np.sqrt(scored.variances)
        missing = np.isnan(block.outputs)
        predicted = np.where(missing, np.nan, block.outputs - scored.innovations)
        if self._free is not None:
            values = {**self._believed.values, **self._fit.values}
            known = {n: v for n, v in values.items() if n in self._tunable}
            y = block.outputs
            self._free.add(block.start, block.inputs[:-1], y, scored.states[0], known)
        self._history.add(block.start, block.inputs[:-1], block.outputs, predicted, spread)
        rms = np.sqrt(np.mean((scored.innovations / spread) ** 2, axis=0))
        self._noise = dict(zip(self.plant.outputs, rms.tolist(), strict=True))
        drifted = self._watch.drifted
        events += self._watch.take(tested, time)
        if self._watch.drifted and not drifted:
            self._fit.loosen()
        self._adopt()
        before = self._fit.updates
        self._fit.take(block.inputs, block.outputs, scored)
        if self._updated is None or self._fit.updates > before:
            self._updated = time
        self._trail.append((time, dict(self._fit.values)))
        while time - self._trail[0][0] > self.settings.verification.settle:
            self._trail.popleft()
        shares_filter(self._fit, self._following)
        return events + self._excitation(time) + self._report(time)

    def _diverged(self, time: float, because: str) -> list[Event]:
        self._restart()
        values = {n: self._believed.values[n] for n in self._fit.names}
        covariance = self._fit.covariance
        self._fit.start(values, covariance)
        shares_filter(self._fit, self._following)
        again, self._diverged_at = self._diverged_at is not None, time
        detail: dict[str, JSON] = {"what": "estimator", "because": because}
        return [] if again else [self._event(EventKind.DEGRADED, time, detail)]

    def _sound(self, time: float) -> list[Event]:
        """Say that filters which diverged are well again."""
        if self._diverged_at is None or time - self._diverged_at < _RECOVERED:
            return []
        self._diverged_at = None
        return [self._event(EventKind.RECOVERED, time, {"what": "estimator"})]

    def _excitation(self, time: float) -> list[Event]:
        monitor = self._fit.excitation
        suffices = monitor.suffices
        assert self._begun is not None
        if self._excited is None and not suffices:
            # At the start there is little data anyway.
            if time - self._begun < self.settings.estimator.memory:
                return []
        elif self._excited is None or suffices == self._excited:
            self._excited = suffices
            return []
        self._excited = suffices
        kind = EventKind.EXCITATION_BACK if suffices else EventKind.EXCITATION_LOW
        detail: dict[str, JSON] = {
            "level": monitor.level,
            "parameter": self._fit.names[monitor.weakest],
        }
        return [self._event(kind, time, detail)]

    def _report(self, time: float) -> list[Event]:
        if time - self._reported < _REPORT - 0.5 * self._h:
            return []
        self._reported = time
        found = self.estimate
        assert found is not None
        detail: dict[str, JSON] = {
            "values": {n: found.values[n] for n in found.names},
            "sd": {n: found.sd[n] for n in found.names},
            "excitation": found.excitation,
        }
        return [self._event(EventKind.PARAMETERS, time, detail)]

    def _event(self, kind: EventKind, time: float, detail: Mapping[str, JSON]) -> Event:
        return Event(time, self.settings.name, kind, detail)
