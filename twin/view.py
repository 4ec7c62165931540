"""What is to be seen of a twin, as JSON: for the API, the pages and the metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.estimate import Estimate
from twin.events import JSON
from twin.gate import Decision
from twin.monitor import Monitor
from twin.store.history import Span, down_sample

Array = NDArray[np.float64]
SPAN = 10.0
"""Length of the finest spans of the history [s]."""
_POINTS = 300
_DIGITS = 6
_MILLISECONDS = 3
"""Decimals of a signal's times."""


def finite(value: float | None) -> float | None:
    """Return a number that JSON has; None for others."""
    return None if value is None or not math.isfinite(value) else float(value)


def decision_document(decision: Decision) -> dict[str, Any]:
    """Return a decision as JSON."""
    return {
        "allowed": decision.allowed,
        "because": decision.because,
        "verified_at": decision.verified_at,
        "evidence": decision.evidence,
    }


def line(monitor: Monitor, now: float) -> dict[str, Any]:
    """Return what a fleet's page shows of a twin."""
    with monitor.lock:
        return _line(monitor, now)


def _line(monitor: Monitor, now: float) -> dict[str, Any]:
    newest = monitor.pipeline.newest
    life = monitor.life
    return {
        "name": monitor.name,
        "model": monitor.settings.plant.model,
        "state": life.record.state,
        "since": life.record.since,
        "because": life.record.because,
        "verifying": monitor.verifying,
        "telemetry": finite(newest),
        "age": finite(None if newest is None else now - newest),
        "gate": decision_document(monitor.decide()),
    }


def numbers(
    monitor: Monitor, now: float, counts: Mapping[str, int], faults: Mapping[str, str]
) -> dict[str, Any]:
    """Return everything that a twin's page shows but its signals."""
    with monitor.lock:
        return _numbers(monitor, now, counts, faults)


def _numbers(
    monitor: Monitor, now: float, counts: Mapping[str, int], faults: Mapping[str, str]
) -> dict[str, Any]:
    pipeline = monitor.pipeline
    estimate = pipeline.estimate
    return {
        **_line(monitor, now),
        "time": now,
        "excitation": None if estimate is None else finite(estimate.excitation),
        "parameters": _parameters(monitor, estimate),
        "drift": _drift(pipeline.drift),
        "counts": {**counts, **pipeline.health.counts},
        "faults": dict(faults),
    }


def signals(monitor: Monitor) -> dict[str, Any]:
    """Return every output over the last while."""
    with monitor.lock:
        found = monitor.pipeline.predictions
    return {
        name: _samples(found.time, found.measured[:, k], found.predicted[:, k])
        for k, name in enumerate(found.output_names)
    }


def _drift(tests: Mapping[str, JSON]) -> dict[str, Any]:
    statistics, threshold = tests.get("statistics"), tests.get("threshold")
    limit = finite(float(threshold)) if isinstance(threshold, int | float) else None
    if not isinstance(statistics, dict):
        return {}
    return {
        name: {"statistic": finite(float(value)), "threshold": limit}
        for name, value in statistics.items()
        if isinstance(value, int | float)
    }


def _parameters(monitor: Monitor, estimate: Estimate | None) -> dict[str, Any]:
    verified = monitor.in_force
    reference = monitor.reference
    values = reference.values if estimate is None else estimate.values
    found: dict[str, Any] = {}
    for name, value in values.items():
        found[name] = {
            "value": finite(value),
            "sd": None if estimate is None else finite(estimate.sd.get(name)),
            "unit": monitor.unit(name),
            "verified": None,
        }
        if verified is not None and name in verified[1].values:
            evidence = verified[1]
            place = evidence.names.index(name) if name in evidence.names else None
            sd = 0.0 if place is None else math.sqrt(evidence.covariance[place][place])
            found[name]["verified"] = {"value": evidence.values[name], "sd": sd}
    return found


def _samples(times: Array, measured: Array, predicted: Array) -> dict[str, list[float | None]]:
    every = max(1, math.ceil(len(times) / _POINTS))
    chosen = slice(None, None, -every)
    columns = {"measured": measured, "predicted": predicted, "residual": measured - predicted}
    return {
        "time": np.round(times[chosen][::-1], _MILLISECONDS).tolist(),
        **{name: _shortened(column[chosen][::-1]) for name, column in columns.items()},
    }


def _shortened(column: Array) -> list[float | None]:
    """Return a column for JSON, with as many digits as there are to be seen.

    All of them would triple what is sent to every reader, five times a second.
    """
    known = np.abs(column[np.isfinite(column)])
    largest = float(known.max()) if known.size else 0.0
    digits = _DIGITS - math.ceil(math.log10(largest)) if largest > 0 else 0
    return [finite(v) for v in np.round(column, digits).tolist()]


class Averages:
    """Collects estimates until a span of the history is full."""

    def __init__(self, length: float = SPAN) -> None:
        self._length = length
        self._time = -math.inf
        self._start: float | None = None
        self._spans: dict[str, list[Span]] = {}

    def take(self, estimate: Estimate | None) -> dict[str, Span]:
        """Take an estimate; return the spans that have ended with it."""
        if estimate is None or estimate.time <= self._time:
            return {}
        self._time = estimate.time
        start = math.floor(estimate.time / self._length) * self._length
        done: dict[str, Span] = {}
        if self._start is not None and start != self._start:
            done = {name: down_sample(s, self._length)[0] for name, s in self._spans.items()}
            self._spans = {}
        self._start = start
        for name in estimate.names:
            for key, value in ((name, estimate.values[name]), (f"{name}.sd", estimate.sd[name])):
                if math.isfinite(value):
                    span = Span(start, self._length, 1, value, value, value)
                    self._spans.setdefault(key, []).append(span)
        return done
