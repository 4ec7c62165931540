"""May this controller be deployed on this plant now? A pure function of what is known.

The gate opens only if a passed verification covers the present plant; whatever is missing, old,
unknown or not a number closes it. It knows no clock, no database and no service.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from twin.store.documents import Evidence

Array: TypeAlias = npt.NDArray[np.float64]

# A time stamp may be this much ahead of the clock that asks [s].
_AHEAD = 1.0
# Directions in which the verified distribution has no width, relative to its widest.
_FLAT = 1e-12
_ON_THE_FLAT = 1e-6


@dataclass(frozen=True)
class Question:
    """What is to be deployed where.

    Attributes:
        controller, model, study: Hashes: of the controller's file, of the FMU that the twin
            follows now, of the study that it must pass.
    """

    controller: str
    model: str
    study: str


@dataclass(frozen=True)
class Limits:
    """What ages are accepted [s], and how sure the ellipsoid is.

    Attributes:
        evidence: Of a verification.
        telemetry: Of the newest good frame.
        estimate: Of the estimate: how long it holds while excitation is low.
        settle: How long telemetry must have been followed since the start: the time in which the
            drift tests find what happened while nobody looked.
        confidence: Of the ellipsoid around the verified parameters.
    """

    evidence: float = 86_400.0
    telemetry: float = 0.5
    estimate: float = 3600.0
    settle: float = 5.0
    confidence: float = 0.95


@dataclass(frozen=True)
class Situation:
    """What is known of the plant; None is unknown.

    Attributes:
        now: [s]; all times are of the same clock.
        verified: Whether nothing has happened since the verification that puts it in doubt.
        because: Why not.
        healthy: Whether the service can do its work: its store answers, its clock runs evenly.
        telemetry: Time of the newest good frame [s].
        followed_since: Since when telemetry has been followed without a break [s].
        estimate: Time of the newest data in the estimate [s].
        values: Parameter → value, as estimated.
        evidence: Of the parameter set in force.
    """

    now: float
    verified: bool
    because: str
    healthy: bool
    telemetry: float | None
    followed_since: float | None
    estimate: float | None
    values: Mapping[str, float] | None
    evidence: Sequence[Evidence]


@dataclass(frozen=True)
class Decision:
    """The gate's answer.

    Attributes:
        allowed: Whether the controller may be deployed.
        because: Why, or why not.
        verified_at: When what covers it was verified [s].
        evidence: Its id.
    """

    allowed: bool
    because: str
    verified_at: float | None = None
    evidence: str | None = None


def is_ahead(time: float, now: float) -> bool:
    """Return whether a time lies in the future: a clock was set back since."""
    return time - now > _AHEAD


def decide(question: Question, situation: Situation, limits: Limits) -> Decision:
    """Return whether a controller may be deployed.

    Example:
        >>> nothing = Situation(0.0, False, "no verification yet", True, None, None, None, None, ())
        >>> decide(Question("c", "m", "s"), nothing, Limits()).because
        'the plant is not verified: no verification yet'
    """
    return _closed_by_state(situation, limits) or _covered(question, situation, limits)


def _closed_by_state(s: Situation, limits: Limits) -> Decision | None:
    if not s.healthy:
        return Decision(False, f"the service is not whole: {s.because}")
    if not s.verified:
        return Decision(False, f"the plant is not verified: {s.because}")
    ages = (
        ("telemetry", s.telemetry, limits.telemetry),
        ("the estimate", s.estimate, limits.estimate),
    )
    for name, time, limit in ages:
        fault = _too_old(name, time, s.now, limit)
        if fault:
            return Decision(False, fault)
    if s.followed_since is None or not s.now - s.followed_since >= limits.settle:
        return Decision(
            False,
            f"telemetry has not been followed for {limits.settle:g} s yet: "
            "what happened before is not known",
        )
    return None


def _covered(question: Question, s: Situation, limits: Limits) -> Decision:
    if not question.controller:
        return Decision(False, "no controller is named")
    refused = Decision(False, "no verification is in force")
    for evidence in sorted(s.evidence, key=lambda e: e.time, reverse=True):
        fault = _mismatch(question, evidence) or _too_old(
            "the verification", evidence.time, s.now, limits.evidence
        )
        if not fault:
            distance = _distance(evidence, s.values)
            most = _radius(limits.confidence, max(1, len(evidence.names)))
            if distance is None:
                fault = "the parameters are not all known"
            elif not distance <= most:
                fault = (
                    f"the plant has left what was verified: {distance:.3g} standard deviations, "
                    f"{most:.3g} at most"
                )
        if not fault:
            return Decision(True, "a passed verification covers it", evidence.time, evidence.id)
        refused = Decision(False, fault, evidence.time, evidence.id)
    return refused


@lru_cache
def _radius(confidence: float, size: int) -> float:
    """Return how far the ellipsoid reaches, in standard deviations."""
    return math.sqrt(float(chi2.ppf(confidence, size)))


def _mismatch(question: Question, evidence: Evidence) -> str:
    if not evidence.passed:
        return "the controller did not pass its verification"
    for name in ("controller", "model", "study"):
        asked, verified = getattr(question, name), getattr(evidence, name)
        if not asked or asked != verified:
            return f"another {name} was verified: {verified[:12]}, not {asked[:12] or 'unknown'}"
    return ""


def _too_old(name: str, time: float | None, now: float, limit: float) -> str:
    if time is None or not (math.isfinite(time) and math.isfinite(now)):
        return f"{name} has no known age"
    age = now - time
    if is_ahead(time, now):
        return f"{name} is from the future, by {-age:.3g} s: a clock was set"
    if not age <= limit:
        return f"{name} is {age:.3g} s old, {limit:g} s at most"
    return ""


def _distance(evidence: Evidence, values: Mapping[str, float] | None) -> float | None:
    """Return how far values are from the verified ones, in standard deviations; None: unknown."""
    if values is None or set(values) != set(evidence.values):
        return None
    names = evidence.names
    apart = np.array([values[n] - evidence.values[n] for n in names], dtype=float)
    covariance = np.array(evidence.covariance, dtype=float).reshape(len(names), len(names))
    if not (np.all(np.isfinite(apart)) and np.all(np.isfinite(covariance))):
        return None
    # A parameter without uncertainty was verified at one value only.
    held = any(values[n] != evidence.values[n] for n in values if n not in names)
    return math.inf if held else _standardised(apart, covariance)


def _standardised(apart: Array, covariance: Array) -> float:
    scale = np.sqrt(np.diag(covariance))
    wide = scale > 0
    if np.any(apart[~wide] != 0):
        return math.inf
    if not np.any(wide):
        return 0.0
    # In units of the standard deviations: parameters differ by many powers of ten.
    correlation = covariance[np.ix_(wide, wide)] / np.outer(scale[wide], scale[wide])
    eigenvalues, vectors = np.linalg.eigh(correlation)
    along = vectors.T @ (apart[wide] / scale[wide])
    flat = eigenvalues <= _FLAT * eigenvalues[-1]
    if np.any(np.abs(along[flat]) > _ON_THE_FLAT):
        return math.inf
    return float(np.sqrt(np.sum(along[~flat] ** 2 / eigenvalues[~flat])))
