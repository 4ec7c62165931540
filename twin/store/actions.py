"""What goes into the same transaction as the events that tell it: both are there, or neither."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from foundation.errors import InputError
from twin.audit import canonical
from twin.store.documents import Evidence, ParameterSet, SetState, TwinRecord
from twin.store.tables import ArtifactRow, EvidenceRow, LinkRow, ParameterSetRow, TwinRow

Action = Callable[[Session], None]
"""Something done in the transaction that appends to the log."""


def save_twin(record: TwinRecord) -> Action:
    """Return the action that keeps a twin's state."""

    def action(session: Session) -> None:
        session.merge(TwinRow(**vars(record)))

    return action


def save_set(parameters: ParameterSet) -> Action:
    """Return the action that keeps a candidate; one that is there keeps its state."""

    def action(session: Session) -> None:
        _add_once(
            session,
            ParameterSetRow(
                id=parameters.id,
                twin=parameters.twin,
                time=parameters.time,
                state=SetState.CANDIDATE.value,
                document=canonical(parameters.document()),
            ),
        )

    return action


def save_evidence(evidence: Evidence) -> Action:
    """Return the action that keeps evidence; its set is refused if it did not pass."""

    def action(session: Session) -> None:
        _add_once(
            session,
            EvidenceRow(
                id=evidence.id,
                twin=evidence.twin,
                time=evidence.time,
                passed=evidence.passed,
                document=canonical(evidence.document()),
            ),
        )
        row = session.get(ParameterSetRow, evidence.parameters)
        if row is not None and row.state == SetState.CANDIDATE.value:
            row.evidence = evidence.id
            if not evidence.passed:
                row.state = SetState.REFUSED.value

    return action


def promote(id_: str, evidence: str, time: float) -> Action:
    """Return the action that puts a set into force.

    Raises (the action):
        InputError: The evidence is not kept, is of another set, or did not pass.
    """

    def action(session: Session) -> None:
        row = session.get(ParameterSetRow, id_)
        kept = session.get(EvidenceRow, evidence)
        found = None if kept is None else Evidence.of(json.loads(kept.document))
        if row is None or found is None or found.parameters != id_ or not found.passed:
            raise InputError(
                f"no passed verification is about parameter set {id_[:12]}",
                remedy="verify it first",
            )
        for other in in_force(session, row.twin):
            if other.id != id_:
                other.state = SetState.RETIRED.value
        row.state, row.promoted, row.evidence = SetState.VERIFIED.value, time, evidence

    return action


def roll_back(twin: str, to: str) -> Action:
    """Return the action that refuses the set in force and puts an earlier one in its place."""

    def action(session: Session) -> None:
        for row in in_force(session, twin):
            row.state = SetState.REFUSED.value
        row = session.get(ParameterSetRow, to)
        if row is None or row.twin != twin or row.state != SetState.RETIRED.value:
            raise InputError(
                f"parameter set {to[:12]} was never in force", remedy="choose a retired one"
            )
        row.state = SetState.VERIFIED.value

    return action


def save_artifact(
    id_: str, kind: str, name: str, time: float, parents: Iterable[str] = ()
) -> Action:
    """Return the action that gives something its place in the lineage."""
    listed = [p for p in dict.fromkeys(parents) if p != id_]

    def action(session: Session) -> None:
        _add_once(session, ArtifactRow(id=id_, kind=kind, name=name, time=time))
        for parent in listed:
            session.merge(LinkRow(child=id_, parent=parent))

    return action


def in_force(session: Session, twin: str) -> Sequence[ParameterSetRow]:
    """Return the set in force: one, or none."""
    query = select(ParameterSetRow).where(
        ParameterSetRow.twin == twin, ParameterSetRow.state == SetState.VERIFIED.value
    )
    return session.scalars(query).all()


def _add_once(session: Session, row: ParameterSetRow | EvidenceRow | ArtifactRow) -> None:
    """Add what has the hash of its content for a name; what is there stays."""
    if session.get(type(row), row.id) is None:
        session.add(row)
