"""The gate of one twin: what it is asked, by the files as they are, and when its answer changes."""

from __future__ import annotations

from foundation.errors import InputError
from twin.estimate import Estimate
from twin.events import JSON, Event, EventKind
from twin.gate import Decision, Limits, Question, Situation, decide
from twin.settings import TwinSettings
from twin.verification import controller_hash, study_hash


def question(settings: TwinSettings, model: str, controller: str | None = None) -> Question:
    """Return what the gate is asked.

    Args:
        settings: Of the twin.
        model: Hash of the FMU that it follows.
        controller: Hash of a controller (`controller_hash`); None: the deployed one's.

    Raises:
        InputError: There is no study or no controller, or a file of theirs is gone.
    """
    v = settings.verification
    if not v.study or not v.controller:
        raise InputError(
            "the twin has no study or no controller to verify",
            where=f"{settings.path}, twin.verification",
            remedy="name both",
        )
    deployed = controller or controller_hash(settings.file(v.controller))
    return Question(deployed, model, study_hash(settings.file(v.study), v.draws, v.widening))


def limits(settings: TwinSettings) -> Limits:
    """Return what ages the gate accepts."""
    v = settings.verification
    return Limits(v.max_age, settings.stale, v.hold, v.settle)


class GateWatch:
    """What the gate last said about the deployed controller.

    Attributes:
        decision: That; None: it was not asked yet.
    """

    def __init__(self) -> None:
        self.decision: Decision | None = None
        self._estimate: Estimate | None = None
        self._asked: Question | Decision | None = None

    def is_of(self, estimate: Estimate | None) -> bool:
        """Whether that was said of this estimate: between two blocks only ages change."""
        return self.decision is not None and estimate is self._estimate

    def look(
        self,
        settings: TwinSettings,
        model: str,
        situation: Situation,
        estimate: Estimate | None,
        *,
        afresh: bool = True,
    ) -> list[Event]:
        """Ask again; return the event that belongs to it if the answer has become another.

        Args:
            settings: Of the twin.
            model: Hash of the FMU that it follows.
            situation: What is known of the plant.
            estimate: That the situation is of.
            afresh: Read all files.
        """
        self._estimate = estimate
        if afresh or self._asked is None:
            try:
                self._asked = question(settings, model)
            except InputError as error:
                self._asked = Decision(False, str(error))
        found, before = self._asked, self.decision
        if isinstance(found, Question):
            found = decide(found, situation, limits(settings))
        self.decision = found
        if before is not None and before.allowed == found.allowed:
            return []
        detail: dict[str, JSON] = {"allowed": found.allowed, "because": found.because}
        if found.evidence is not None:
            detail["evidence"] = found.evidence
        return [Event(situation.now, settings.name, EventKind.GATE, detail)]
