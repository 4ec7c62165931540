"""Steps of every parameter, a friction that appears, and hours in which nothing happens."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from benchmarks.figures import Figure
from benchmarks.twin.fleet import DISTURBANCE, NAMES, NOMINAL, RATE, SENSORS, STEP, Fleet
from fmus.frontend import load
from fmus.sources import library_class
from identification.innovations import Disturbance
from identification.online.scored_filter import ScoredFilter
from twin.diagnosis import diagnose
from twin.drift import Alarm, DriftMonitor
from twin.excerpt import Excerpt

Array = NDArray[np.float64]

MODEL = "Twinproof.Plants.WheeledPendulum"
BLOCK, WINDOW = 100, 20.0
FALSE_ALARMS = 0.01
"""Stated to the test, an hour: one in 100 hours."""
WITHIN = 5.0
_VERIFIED_BY = 60
"""Length of the record that the verified parameters are from [s]."""
_SETTLE = 15
_TRIES = 3
_NAMED_AFTER = 3.0
_FLEET = 120
_FRICTION = 5.0


class Watch:
    """Filters and monitors of a fleet."""

    def __init__(self, count: int, covariance: Array) -> None:
        dae = load(library_class(MODEL))
        self.filters = [
            ScoredFilter(
                dae,
                tuple(SENSORS),
                NAMES,
                dae.parameter_values,
                sample_time=STEP,
                noise_sd=list(SENSORS.values()),
                disturbances=[Disturbance(RATE, DISTURBANCE)],
            )
            for _ in range(count)
        ]
        values = dict(zip(NAMES, NOMINAL.tolist(), strict=True))
        self.monitors = [
            DriftMonitor(
                NAMES,
                values,
                covariance,
                block=BLOCK * STEP,
                window=WINDOW,
                false_alarms_per_hour=FALSE_ALARMS,
                channels=tuple(SENSORS),
            )
            for _ in range(count)
        ]

    def take(self, volts: Array, seen: Array) -> Iterator[tuple[int, int, Alarm | None]]:
        """Take a second; yield (block, plant, alarm)."""
        for i, (f, monitor) in enumerate(zip(self.filters, self.monitors, strict=True)):
            for b, k in enumerate(range(0, len(seen), BLOCK)):
                u, y = volts[k : k + BLOCK + 1, i : i + 1], seen[k : k + BLOCK, i]
                yield b, i, monitor.take(f.block(u, y))


def run() -> Iterator[Figure]:
    verified = np.linalg.inv(information(_VERIFIED_BY, seed=99))
    five = np.linalg.inv(information(int(WITHIN), seed=98))
    sd = np.sqrt(np.diag(five + verified))
    yield from _steps(verified, sd)
    yield from _friction(verified)
    hours = float(os.environ.get("TWINPROOF_TWIN_HOURS", "2"))
    if hours > 0:
        yield from _false_alarms(verified, hours)


def information(seconds: int, seed: int) -> Array:
    """Return the information of a record at nominal, after the start has died out."""
    watch = Watch(1, np.zeros((7, 7)))
    found = np.zeros((7, 7))
    for k, (volts, seen) in enumerate(Fleet(1, seed).seconds(_SETTLE + seconds)):
        scored = watch.filters[0].block(volts, seen[:, 0])
        if k >= _SETTLE:
            found += scored.information
    return found


def _steps(verified: Array, sd: Array) -> Iterator[Figure]:
    delays: list[float] = []
    named = tried = 0
    for j in range(len(NAMES)):
        for sign in (1, -1):
            size = sign * max(0.05 * NOMINAL[j], 6 * sd[j])
            moved = NOMINAL.copy()
            moved[j] += size
            if moved[j] <= 0:
                continue  # there is no such plant
            first, name = _detected(verified, 10 * j + sign, lambda moved=moved: moved)
            delays += first
            named += sum(n == NAMES[j] for n in name)
            tried += len(name)
    flagged = sum(d <= WITHIN for d in delays)
    yield Figure(f"steps of {tried // _TRIES} kinds: flagged within 5 s", 100 * flagged / tried,
                 100.0, "%", at_least=True)  # fmt: skip
    yield Figure("  the parameter that moved named within 5 s", 100 * named / tried, 100.0, "%",
                 at_least=True)  # fmt: skip
    yield Figure("  longest delay", max(delays), WITHIN, "s")


def _detected(
    verified: Array, seed: int, after: Callable[[], Array]
) -> tuple[list[float], list[str]]:
    """Return for each plant how long a step took to be flagged, and what was named in 5 s."""
    at = _SETTLE + 0.05
    fleet = Fleet(_TRIES, 1000 + seed, lambda t: after() if t >= at else NOMINAL)
    watch = Watch(_TRIES, verified)
    first, name = [math.inf] * _TRIES, [""] * _TRIES
    for second, (volts, seen) in enumerate(fleet.seconds(_SETTLE + int(WITHIN) + 1)):
        for b, i, alarm in watch.take(volts, seen):
            now = second + (b + 1) * BLOCK * STEP - at
            if alarm is None or now < 0 or now > WITHIN:
                continue
            first[i] = min(first[i], now)
            if now <= first[i] + _NAMED_AFTER + 0.05:
                name[i] = alarm.parameter
    return first, name


def _friction(verified: Array) -> Iterator[Figure]:
    """A Coulomb friction of 0.03 V appears; ten seconds later the diagnosis is made."""
    at, fleet = _SETTLE + 0.05, 1
    plants = Fleet(fleet, 7, friction=lambda t: _FRICTION if t >= at else 0.0)
    watch, first = Watch(fleet, verified), math.inf
    volts_since: list[Array] = []
    seen_since: list[Array] = []
    for second, (volts, seen) in enumerate(plants.seconds(_SETTLE + 11)):
        for b, _, alarm in watch.take(volts, seen):
            now = second + (b + 1) * BLOCK * STEP - at
            if alarm is not None and now > 0:
                first = min(first, now)
        if second > _SETTLE:
            volts_since.append(volts[:-1])
            seen_since.append(seen[:, 0])
    yield Figure(f"Coulomb friction of {_FRICTION:g} N.m: flagged after", first, WITHIN, "s")
    began = time.perf_counter()
    found = diagnose(
        Excerpt(
            MODEL,
            (),
            STEP,
            np.concatenate(volts_since),
            np.concatenate(seen_since),
            tuple(SENSORS),
            np.array(list(SENSORS.values())),
            NAMES,
            load(library_class(MODEL)).parameter_values,
        ),
        dict(zip(NAMES, np.sqrt(np.diag(verified)).tolist(), strict=True)),
    )
    right = found.verdict == "effect" and found.name == "CoulombFriction@wheel"
    yield Figure("  named as CoulombFriction@wheel", float(right), 1.0, "", at_least=True)
    size = found.parameters.get("tau_c", math.nan)
    yield Figure("  its size, found", size, None, "N.m")
    yield Figure("  the diagnosis of 10 s took", time.perf_counter() - began, None, "s")


def _false_alarms(verified: Array, hours: float) -> Iterator[Figure]:
    seconds = max(60, math.ceil(3600 * hours / _FLEET))
    watch = Watch(_FLEET, verified)
    alarms, largest = 0, 0.0
    rung = np.zeros(_FLEET, dtype=bool)
    began = time.process_time()
    for volts, seen in Fleet(_FLEET, 2026).seconds(seconds):
        for _, i, alarm in watch.take(volts, seen):
            alarms += alarm is not None and not rung[i]
            rung[i] = alarm is not None
            largest = max(largest, watch.monitors[i].joint, *watch.monitors[i].statistics.values())
    done = seconds * _FLEET / 3600
    # Exact interval of a Poisson rate (F. Garwood, 1936).
    low = float(stats.chi2.ppf(0.025, 2 * alarms)) / 2 if alarms else 0.0
    high = float(stats.chi2.ppf(0.975, 2 * alarms + 2)) / 2
    per_100 = 100.0 / done
    yield Figure(f"false alarms in {done:.4g} h, in 100 h", alarms * per_100, 1.0, "")
    yield Figure("  95 % interval from", low * per_100, None, "")
    yield Figure("  95 % interval to", high * per_100, None, "")
    yield Figure("  largest statistic", largest, watch.monitors[0].threshold, "")
    yield Figure("  processor time for an hour", (time.process_time() - began) / done, None, "s")
