"""How verified parameters come into force: candidate, evidence, approval; what is kept of it."""

from __future__ import annotations

from foundation.errors import InputError
from twin.events import JSON, Event, EventKind
from twin.gate import is_ahead
from twin.lifecycle import Life
from twin.store import Store
from twin.store.actions import Action, promote, save_artifact
from twin.store.documents import Evidence, ParameterSet

AUTOMATIC = "service"
"""In place of a token's name: nobody was asked."""


def verification_event(parameters: ParameterSet, evidence: Evidence) -> Event:
    """Return the event that tells what a verification found."""
    detail: dict[str, JSON] = {
        "passed": evidence.passed,
        "runs": evidence.detail.get("runs"),
        "runs_passed": evidence.detail.get("passed"),
        "seconds": evidence.detail.get("seconds"),
        "evidence": evidence.id,
        "effect": parameters.origin.get("effect"),
        "parameters": parameters.id,
        "controller": evidence.controller,
    }
    return Event(evidence.time, parameters.twin, EventKind.VERIFICATION, detail)


def approvable(
    store: Store, twin: str, parameters: str, life: Life, now: float
) -> tuple[ParameterSet, Evidence]:
    """Return a set that a person may put into force, and its evidence.

    Args:
        store: Where they are.
        twin: Whose they are.
        parameters: Id of the set.
        life: Of the twin.
        now: [s].

    Raises:
        InputError: It did not pass, the plant has drifted since, or a clock was set back.
        UnknownNameError: There is no such evidence.
    """
    row = next((r for r in store.parameter_sets(twin) if r["id"] == parameters), None)
    found = None if row is None or row["evidence"] is None else row["evidence"]
    if row is None or found is None or row["state"] == "refused":
        raise InputError(
            f"parameter set {parameters[:12]} has not passed a verification",
            remedy="choose a candidate that has",
        )
    set_, evidence = ParameterSet.of(row), store.evidence(str(found))
    because = ""
    if life.drift is not None and (life.attempt is None or set_.time < life.drift):
        because = "the plant has drifted since"
    elif is_ahead(evidence.time, now):
        because = "a clock was set back to before the verification"
    if because:
        raise InputError(
            because,
            where=f"parameter set {parameters[:12]}",
            remedy="wait for the next verification",
        )
    return set_, evidence


def promotion(
    parameters: ParameterSet, evidence: Evidence, token: str, now: float
) -> tuple[list[Event], list[Action]]:
    """Return the events of a promotion, and what is done in their transaction.

    Args:
        parameters: That passed.
        evidence: Of it.
        token: Name of who approved, or `AUTOMATIC`.
        now: [s].
    """
    approval = f"approval:{evidence.id}"
    detail: dict[str, JSON] = {
        "token": token,
        "evidence": evidence.id,
        "parameters": parameters.id,
    }
    events = [
        Event(now, parameters.twin, kind, dict(detail))
        for kind in (EventKind.APPROVAL, EventKind.PROMOTED)
    ]
    return events, [
        promote(parameters.id, evidence.id, now),
        save_artifact(approval, "approval", token, now, [evidence.id]),
    ]
