"""When is a plant verified, and when must it be verified anew? Pure functions of what happened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from twin.events import Event, EventKind
from twin.store.documents import TwinRecord

VERIFIED, UNVERIFIED = "verified", "unverified"
# A share of the evidence's greatest age, after which it is renewed.
_RENEW = 0.8


@dataclass(frozen=True)
class Life:
    """What has happened to a twin, as far as it matters for what to do next.

    Attributes:
        record: Verified or not, since when, why.
        drift: Time of the newest drift [s]; None: none since the last verification.
        diagnosed: Whether that drift has been diagnosed.
        stale: Whether telemetry is stale.
        followed_since: Since when telemetry is followed [s]; None: it is not.
        attempt: Time of the last verification [s]; None: none since the last drift.
        refused: Whether that one failed.
        effect: Word for the effect that the diagnosis found, and its parameters.
    """

    record: TwinRecord
    drift: float | None = None
    diagnosed: bool = False
    stale: bool = False
    followed_since: float | None = None
    attempt: float | None = None
    refused: bool = False
    effect: tuple[str, Mapping[str, float]] | None = None

    @property
    def is_verified(self) -> bool:
        """Whether nothing puts the last verification in doubt."""
        return self.record.state == VERIFIED


def after(life: Life, event: Event) -> Life:
    """Return a twin's life after an event.

    Example:
        >>> life = Life(TwinRecord("robot", VERIFIED, 0.0, ""))
        >>> drift = Event(8.0, "robot", EventKind.DRIFT, {"parameter": "J"})
        >>> after(life, drift).record
        TwinRecord(name='robot', state='unverified', since=8.0, because='J drifted', model='')
    """
    changes: dict[EventKind, Callable[[Life, Event], Life]] = {
        EventKind.DRIFT: _drifted,
        EventKind.DIAGNOSIS: _diagnosed,
        EventKind.TELEMETRY_STALE: lambda life, _: replace(life, stale=True, followed_since=None),
        EventKind.TELEMETRY_BACK: lambda life, e: replace(life, stale=False, followed_since=e.time),
    }
    change = changes.get(event.kind)
    return life if change is None else change(life, event)


def _drifted(life: Life, event: Event) -> Life:
    name = event.detail.get("parameter")
    because = f"{name} drifted" if name else "the plant drifted"
    record = replace(life.record, state=UNVERIFIED, since=event.time, because=because)
    return Life(record, event.time, stale=life.stale, followed_since=life.followed_since)


def _diagnosed(life: Life, event: Event) -> Life:
    verdict, name = event.detail.get("verdict"), event.detail.get("name")
    said = f"{verdict}: {name}" if name else f"{verdict}"
    record = replace(life.record, because=f"{life.record.because.split(' (')[0]} ({said})")
    effect = life.effect
    if verdict == "effect":
        values = event.detail.get("parameters")
        known = values if isinstance(values, dict) else {}
        numbers = {n: float(v) for n, v in known.items() if isinstance(v, int | float)}
        effect = str(name), numbers
    record = life.record if life.is_verified else record
    return replace(life, diagnosed=True, record=record, effect=effect)


def verified(life: Life, time: float, newest: float | None) -> Life:
    """Return a twin's life after a verification that passed.

    Args:
        life: Before it.
        time: Of it [s].
        newest: Of the newest good frame [s]. After a drift its tests rest until something is
            verified, so that nobody has looked at the plant as it was verified until then.
    """
    record = replace(life.record, state=VERIFIED, since=time, because="")
    watched = life.drift is None or life.followed_since is None
    return replace(
        life,
        record=record,
        drift=None,
        diagnosed=False,
        refused=False,
        attempt=time,
        followed_since=life.followed_since if watched else newest,
    )


def refused(life: Life, time: float, because: str) -> Life:
    """Return a twin's life after a verification that failed."""
    record = replace(life.record, state=UNVERIFIED, since=time, because=because)
    return replace(life, record=record, refused=True, attempt=time)


def rolled_back(life: Life, time: float, because: str) -> Life:
    """Return a twin's life after its verified parameters were taken back."""
    record = replace(life.record, state=UNVERIFIED, since=time, because=because)
    return replace(life, record=record, drift=time, diagnosed=True)


@dataclass(frozen=True)
class Pace:
    """When a verification is made [s].

    Attributes:
        settle: After a drift, for the estimate to follow.
        diagnosis: How long to wait for a diagnosis at most; 0: none is made.
        pause: Between two attempts.
        evidence: Greatest age of evidence.
    """

    settle: float = 5.0
    diagnosis: float = 60.0
    pause: float = 60.0
    evidence: float = 86_400.0


def due(life: Life, pace: Pace, now: float, verified_at: float | None, uncovered: str = "") -> str:
    """Return why the plant should be verified now; empty if it should not.

    Args:
        life: Of the twin.
        pace: Of verifications.
        now: [s].
        verified_at: Of the evidence in force [s].
        uncovered: Why what was verified does not cover the present question; empty if it does.
    """
    # What lies ahead was before a clock was set back, however long ago that is.
    recent = life.attempt is not None and 0 <= now - life.attempt < pace.pause
    if life.drift is not None and (life.attempt is None or life.attempt < life.drift):
        waited = now - life.drift
        wanted = pace.settle if life.diagnosed else max(pace.settle, pace.diagnosis)
        if 0 <= waited < wanted:
            return ""
        return life.record.because
    if recent:
        return ""
    if verified_at is not None and life.is_verified:
        if now - verified_at > _RENEW * pace.evidence:
            return "the verification grows old"
        return uncovered
    # What was refused is refused again until the plant, or what is asked, has changed.
    return "" if life.refused else life.record.because
