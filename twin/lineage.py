"""Where a verification comes from: recording → parameters → model → study."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from twin.store.actions import Action, save_artifact
from twin.store.documents import Evidence
from twin.verification import Job


@dataclass(frozen=True)
class Recorded:
    """Recorded frames that an estimate comes from.

    Attributes:
        name: File and how much of it.
        sha256: Of that much.
    """

    name: str
    sha256: str


def lineage(job: Job, evidence: Evidence, recorded: Iterable[Recorded]) -> list[Action]:
    """Return what gives a verification its place."""
    set_, recorded = job.parameters, list(recorded)
    return [
        *(save_artifact(r.sha256, "recording", r.name, set_.time) for r in recorded),
        save_artifact(set_.id, "parameters", set_.twin, set_.time, [r.sha256 for r in recorded]),
        save_artifact(evidence.model, "model", job.model, set_.time),
        save_artifact(evidence.controller, "controller", job.controller.name, set_.time),
        save_artifact(evidence.study, "study", job.study.name, set_.time),
        save_artifact(
            evidence.id,
            "evidence",
            set_.twin,
            evidence.time,
            [set_.id, evidence.model, evidence.study, evidence.controller],
        ),
    ]
