"""What happens to a twin, as values that can be stored, sent and compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TypeAlias

JSON: TypeAlias = "bool | int | float | str | list[JSON] | dict[str, JSON] | None"


class EventKind(Enum):
    """Kinds of events; the value is the word in the store and in JSON."""

    STARTED = "started"
    """A twin begins: `model`, `parameters`."""
    STOPPED = "stopped"
    """A twin ends in order."""
    PARAMETERS = "parameters"
    """The estimate, at times: `values`, `sd`, `excitation`."""
    DRIFT = "drift"
    """The plant is no longer what was verified: `parameter`, `statistic`, `threshold`, `delay`."""
    DIAGNOSIS = "diagnosis"
    """What changed: `verdict` (`parameter`, `effect`, `undetermined`), `name`, `ranking`."""
    EXCITATION_LOW = "excitation_low"
    """The data cannot support an update: the estimate rests."""
    EXCITATION_BACK = "excitation_back"
    """Updates go on."""
    VERIFICATION = "verification"
    """A study of the deployed controller on the present plant: its result and evidence."""
    GATE = "gate"
    """The gate's decision changed: `controller`, `allowed`, `because`."""
    APPROVAL = "approval"
    """A person approved: `controller`, `token`."""
    PROMOTED = "promoted"
    """Candidate parameters became the verified ones."""
    ROLLED_BACK = "rolled_back"
    """Earlier verified parameters are in force again."""
    TELEMETRY_STALE = "telemetry_stale"
    """Data stopped, or is refused as stale or replayed: `message`, `age`."""
    TELEMETRY_BACK = "telemetry_back"
    """Good data comes again: `gap`."""
    DEGRADED = "degraded"
    """Something around the twin fails, the twin goes on: `what`, `because`."""
    RECOVERED = "recovered"
    """What failed works again: `what`."""


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes:
        time: When [s]: of the frame that told it, so that a replay gives the same.
        twin: Name of the twin.
        kind: What sort of thing.
        detail: What else is known; see `EventKind`.

    Example:
        >>> Event(1.5, "line-3", EventKind.STARTED, {"model": "M"}).document()["kind"]
        'started'
    """

    time: float
    twin: str
    kind: EventKind
    detail: Mapping[str, JSON] = field(default_factory=dict[str, JSON])

    def document(self) -> dict[str, JSON]:
        """Return the event as JSON."""
        return {
            "time": self.time,
            "twin": self.twin,
            "kind": self.kind.value,
            "detail": dict(self.detail),
        }
