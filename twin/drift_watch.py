"""The course of a drift: flagged, its parameter named again with more data, then diagnosed."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.resumable import Resumable
from hil.plants import Fit
from identification.online.scored_filter import Scored
from twin.diagnosis import Finding, diagnose
from twin.drift import Alarm, DriftMonitor
from twin.events import JSON, Event, EventKind
from twin.excerpt import Excerpt
from twin.history import History
from twin.plant_model import PlantModel
from twin.settings import TwinSettings

Array = NDArray[np.float64]

_NAMING = 3.0
"""After a drift is flagged, which parameter it was is said again with more data [s]."""


@dataclass
class _Drift:
    """A drift that has been flagged.

    Attributes:
        since: [s].
        alarm: The last one.
        named: Whether the parameter was said again.
        asked: Whether a diagnosis was begun.
        finding: Under way.
        asked_at: Time of the diagnosis' data [s].
    """

    since: float
    alarm: Alarm
    named: bool = False
    asked: bool = False
    finding: Future[Finding] | None = field(default=None, repr=False)
    asked_at: float = 0.0


class DriftWatch(Resumable):
    """Watches a filter that believes the verified parameters.

    Args:
        settings: Of the twin.
        plant: Its model.
        monitor: The tests.
        values: Parameter → value, as verified.
        covariance: (k, k) of the free ones, in the order of the plant's.
        history: Samples of the last while, for a diagnosis.
        roots: Folders of further Modelica libraries.
        executor: Runs diagnoses; None: here, while `take` waits.
    """

    _changes = ("_values", "_covariance", "_monitor", "_drift")

    def __init__(
        self,
        settings: TwinSettings,
        plant: PlantModel,
        monitor: DriftMonitor,
        values: Mapping[str, float],
        covariance: Array,
        history: History,
        *,
        roots: tuple[Path, ...] = (),
        executor: Executor | None = None,
    ) -> None:
        self._settings, self._plant, self._monitor = settings, plant, monitor
        self._values, self._covariance, self._history = dict(values), covariance, history
        self._roots, self._executor = roots, executor
        self._drift: _Drift | None = None
        self._fitted: Fit | None = None

    def snapshot(self) -> dict[str, Any]:
        """Return what it knows; a diagnosis that is under way is made again by who takes it up."""
        drift = self._drift
        if drift is not None and drift.finding is not None:
            drift = replace(drift, asked=False, finding=None)
        return {**super().snapshot(), "_drift": drift}

    @property
    def drifted(self) -> bool:
        """Whether a drift was flagged since the last verification."""
        return self._drift is not None

    @property
    def state(self) -> dict[str, JSON]:
        """The tests as they stand: `state`, `since`, `parameter`, `threshold`, `statistics`."""
        drift = self._drift
        return {
            "state": "stable" if drift is None else "drifted",
            "since": None if drift is None else drift.since,
            "parameter": None if drift is None else drift.alarm.parameter,
            "threshold": self._monitor.threshold,
            "statistics": {**self._monitor.statistics, "all": self._monitor.joint},
        }

    def verify(self, values: Mapping[str, float], covariance: Array) -> None:
        """Compare with these parameters from now on; a drift is over."""
        self._values, self._covariance = dict(values), covariance
        self._monitor.verify(values, covariance)
        self._drift = self._fitted = None

    def take(self, tested: Scored, time: float) -> list[Event]:
        """Take what a block says, which ends at `time` [s]; return what happened."""
        alarm, drift = self._monitor.take(tested), self._drift
        if drift is None:
            if alarm is None:
                return []
            self._drift = _Drift(time, alarm)
            return [self._flagged(alarm, time, named=False)]
        events: list[Event] = []
        if alarm is not None:
            drift.alarm = alarm
        if not drift.named and time - drift.since >= _NAMING:
            drift.named = True
            events.append(self._flagged(drift.alarm, time, named=True))
        wanted = self._settings.drift.diagnose
        if wanted > 0 and not drift.asked and time - drift.since >= wanted:
            drift.asked, drift.asked_at = True, time
            spread = np.sqrt(np.maximum(np.diag(self._covariance), 0.0)).tolist()
            since, sd = self._since(), dict(zip(self._plant.free, spread, strict=True))
            if self._executor is None:
                events.append(self._diagnosis(diagnose(since, sd), time))
            else:
                drift.finding = self._executor.submit(diagnose, since, sd)
        return events

    def found(self, *, wait: bool) -> list[Event]:
        """Return the diagnosis that has come to an end, if any; `wait`: for one under way."""
        drift = self._drift
        if drift is None or drift.finding is None or not (wait or drift.finding.done()):
            return []
        finding, drift.finding = drift.finding, None
        try:
            return [self._diagnosis(finding.result(), drift.asked_at)]
        except Exception as error:  # the process of its own died
            failed = Finding("undetermined", because=f"the diagnosis failed: {error}")
            return [self._diagnosis(failed, drift.asked_at)]

    def fitted(self) -> Fit | None:
        """Return, once, the parameters that a diagnosis has fitted to its data."""
        found, self._fitted = self._fitted, None
        return found

    def _since(self) -> Excerpt:
        blocks = round(self._settings.drift.diagnose / self._settings.estimator.block)
        data, plant = self._history.last(blocks), self._plant
        return Excerpt(
            self._settings.plant.model,
            self._roots,
            1.0 / self._settings.rate,
            data.inputs,
            data.measured,
            plant.outputs,
            plant.noise_sd,
            plant.free,
            {n: v for n, v in self._values.items() if n in plant.values},
            np.array([d.sd for d in plant.disturbances]),
        )

    def _diagnosis(self, finding: Finding, time: float) -> Event:
        self._fitted = finding.fit
        return Event(time, self._settings.name, EventKind.DIAGNOSIS, finding.detail())

    def _flagged(self, alarm: Alarm, time: float, *, named: bool) -> Event:
        change = alarm.change if np.isfinite(alarm.change) else None
        detail: dict[str, JSON] = {
            "parameter": alarm.parameter,
            "statistic": alarm.statistic,
            "threshold": alarm.threshold,
            "window": alarm.window,
            "change": change,
            "verified": self._values.get(alarm.parameter),
            "channel": alarm.channel,
            "named": named,
        }
        return Event(time, self._settings.name, EventKind.DRIFT, detail)
