"""What the store keeps about a plant: parameter sets, evidence, the twin's state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any

from twin.audit import content_hash
from twin.events import JSON


class SetState(Enum):
    """What became of a parameter set."""

    CANDIDATE = "candidate"
    """Estimated, not verified yet."""
    VERIFIED = "verified"
    """The one in force: at most one a twin."""
    RETIRED = "retired"
    """Was in force before."""
    REFUSED = "refused"
    """The controller failed on it, or it was rolled back."""


@dataclass(frozen=True)
class ParameterSet:
    """Parameters of a plant.

    Attributes:
        twin: Whose.
        time: Of the estimate [s].
        model: Hash of the FMU that they are of.
        names: The k parameters that the covariance is of.
        values: Parameter → value, also of those that are held.
        covariance: k × k.
        origin: What they come from: `recording`, `method`, …
    """

    twin: str
    time: float
    model: str
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: tuple[tuple[float, ...], ...]
    origin: Mapping[str, JSON] = field(default_factory=dict[str, JSON])

    def document(self) -> dict[str, Any]:
        """Return the set as JSON."""
        return {
            "twin": self.twin,
            "time": self.time,
            "model": self.model,
            "names": list(self.names),
            "values": dict(self.values),
            "covariance": [list(row) for row in self.covariance],
            "origin": dict(self.origin),
        }

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> ParameterSet:
        """Return the set that a document describes."""
        return cls(
            document["twin"],
            document["time"],
            document["model"],
            tuple(document["names"]),
            document["values"],
            tuple(tuple(row) for row in document["covariance"]),
            document["origin"],
        )

    @cached_property
    def id(self) -> str:
        """Hash of the content."""
        return content_hash(self.document())


@dataclass(frozen=True)
class Evidence:
    """What a verification found.

    Attributes:
        twin: Whose.
        time: When it ended [s].
        controller, model, study: Hashes of what was verified with what.
        parameters: Id of the parameter set.
        names, values, covariance: Of the distribution that the plants were drawn from.
        passed: Whether every run met every criterion.
        detail: Runs, rates, the worst runs.
    """

    twin: str
    time: float
    controller: str
    model: str
    study: str
    parameters: str
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: tuple[tuple[float, ...], ...]
    passed: bool
    detail: Mapping[str, JSON] = field(default_factory=dict[str, JSON])

    def document(self) -> dict[str, Any]:
        """Return the evidence as JSON."""
        return {
            "twin": self.twin,
            "time": self.time,
            "controller": self.controller,
            "model": self.model,
            "study": self.study,
            "parameters": self.parameters,
            "names": list(self.names),
            "values": dict(self.values),
            "covariance": [list(row) for row in self.covariance],
            "passed": self.passed,
            "detail": dict(self.detail),
        }

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Evidence:
        """Return the evidence that a document describes."""
        return cls(
            document["twin"],
            document["time"],
            document["controller"],
            document["model"],
            document["study"],
            document["parameters"],
            tuple(document["names"]),
            document["values"],
            tuple(tuple(row) for row in document["covariance"]),
            document["passed"],
            document["detail"],
        )

    @cached_property
    def id(self) -> str:
        """Hash of the content."""
        return content_hash(self.document())


@dataclass(frozen=True)
class TwinRecord:
    """What must outlive a restart of a twin.

    Attributes:
        name: Of the twin.
        state: `verified` or `unverified`.
        since: When that began [s].
        because: Why.
        model: MODEL that is followed now, if another than the settings'; else empty.
    """

    name: str
    state: str = "unverified"
    since: float = 0.0
    because: str = "not verified yet"
    model: str = ""
