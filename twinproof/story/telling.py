"""What the event log tells, as lines for people, and whether that is the whole story."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from twin.audit import Entry
from twin.events import EventKind

Detail: TypeAlias = Mapping[str, Any]

OPENED, REFUSED = "opened", "refused"


class Telling:
    """Follows a twin's event log through the story.

    Attributes:
        chapters: Name → when it was known [s], in order, as far as it has been told.
        ending: `opened`: the gate is open again, on the improved model; `refused`: the controller
            did not hold on it, and evidence says so; empty: that is not known yet.

    Example:
        >>> telling = Telling()
        >>> telling.take(Entry(1, 8.0, 8.0, "arm", "gate", '{"allowed": true, "because": "so"}'))
        'the gate is open: so'
        >>> telling.chapters, telling.ending
        ({'the gate is open': 8.0}, '')
    """

    def __init__(self) -> None:
        self.chapters: dict[str, float] = {}
        self.ending = ""
        self._effect = ""

    @property
    def awaited(self) -> str:
        """The next chapter; empty at the end."""
        left = [name for name in _CHAPTERS if name not in self.chapters]
        return left[0] if left and not self.ending else ""

    def take(self, entry: Entry) -> str:
        """Take an entry; return it in words, empty if it is not worth a line."""
        kind, detail = EventKind(entry.kind), entry.document()["detail"]
        chapter = self.awaited
        if chapter and _CHAPTERS[chapter](kind, detail) and self._is_ours(kind, detail):
            self.chapters[chapter] = entry.logged
            self._end(chapter, detail)
        words = _WORDS.get(kind)
        return "" if words is None else words(detail)

    def _is_ours(self, kind: EventKind, detail: Detail) -> bool:
        """Whether a verification was made on the model that has the named effect."""
        return kind is not EventKind.VERIFICATION or detail.get("effect") == self._effect

    def _end(self, chapter: str, detail: Detail) -> None:
        if chapter == NAMED:
            self._effect = str(detail["name"])
        if chapter == JUDGED and not detail["passed"]:
            self.ending = REFUSED
        if chapter == OPEN_AGAIN:
            self.ending = OPENED


OPEN, DRIFTED, CLOSED = "the gate is open", "drift is flagged", "the gate is closed"
NAMED, JUDGED = "the effect is named", "the controller is judged on the improved model"
OPEN_AGAIN = "the gate is open again"


def _gate(allowed: bool) -> Callable[[EventKind, Detail], bool]:
    return lambda kind, detail: kind is EventKind.GATE and detail["allowed"] is allowed


_CHAPTERS: Mapping[str, Callable[[EventKind, Detail], bool]] = {
    OPEN: _gate(True),
    DRIFTED: lambda kind, _: kind is EventKind.DRIFT,
    CLOSED: _gate(False),
    NAMED: lambda kind, detail: kind is EventKind.DIAGNOSIS and detail["verdict"] == "effect",
    JUDGED: lambda kind, detail: kind is EventKind.VERIFICATION and "evidence" in detail,
    OPEN_AGAIN: _gate(True),
}


def _drift(detail: Detail) -> str:
    name = detail["parameter"] or "no single parameter"
    size = (
        f"{abs(detail['statistic']):.1f} standard deviations of {detail['threshold']:.1f} allowed"
    )
    return f"drift: {size}; {name} would explain it best" + (
        ", with more data" if detail["named"] else ""
    )


def _diagnosis(detail: Detail) -> str:
    if detail["verdict"] == "undetermined":
        return f"diagnosis: {detail['because']}"
    values = ", ".join(f"{name} = {value:.3g}" for name, value in detail["parameters"].items())
    if detail["verdict"] == "parameter":
        return f"diagnosis: a parameter has moved: {values}"
    gain = f"{detail['evidence']:.0f} nats better than moved parameters"
    return f"diagnosis: an effect has appeared: {detail['name']} ({values}), {gain}"


def _verification(detail: Detail) -> str:
    if "evidence" not in detail:
        return f"verification failed: {detail['because']}"
    word = "passed" if detail["passed"] else "REFUSED"
    model = f" with {detail['effect']}" if detail["effect"] else ""
    runs = f"{detail['runs_passed']} of {detail['runs']} runs{model} kept the study's criteria"
    return f"verification {word}: {runs} (evidence {detail['evidence'][:12]})"


def _gate_moved(detail: Detail) -> str:
    return f"the gate is {'open' if detail['allowed'] else 'CLOSED'}: {detail['because']}"


_WORDS: Mapping[EventKind, Callable[[Detail], str]] = {
    EventKind.STARTED: lambda detail: f"the twin follows {detail['model']}",
    EventKind.DRIFT: _drift,
    EventKind.DIAGNOSIS: _diagnosis,
    EventKind.VERIFICATION: _verification,
    EventKind.PROMOTED: lambda _: "its parameters are the verified ones now",
    EventKind.GATE: _gate_moved,
    EventKind.TELEMETRY_STALE: lambda detail: f"telemetry is silent: {detail['message']}",
    EventKind.TELEMETRY_BACK: lambda _: "telemetry is back",
    EventKind.EXCITATION_LOW: lambda _: "too little motion: the estimate rests",
    EventKind.EXCITATION_BACK: lambda _: "motion again: the estimate goes on",
    EventKind.DEGRADED: lambda detail: f"degraded: {detail['what']}: {detail['because']}",
    EventKind.RECOVERED: lambda detail: f"recovered: {detail['what']}",
}
