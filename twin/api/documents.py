"""What the API returns, for its description."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

Name = Annotated[str, Field(min_length=1, max_length=200)]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Problem(BaseModel):
    """Why a request was refused."""

    detail: str


class Health(BaseModel):
    """Whether the service can do its work."""

    ok: bool
    faults: dict[str, str] = Field(description="What fails, and why.")


class Gate(BaseModel):
    """May this controller be deployed on this plant now?"""

    allowed: bool
    because: str
    verified_at: float | None = Field(description="When what covers it was verified [s].")
    evidence: str | None = Field(description="Its id.")


class TwinLine(BaseModel):
    """A twin in brief."""

    name: str
    model: str
    state: Literal["verified", "unverified"]
    since: float = Field(description="Since when [s].")
    because: str
    verifying: bool
    telemetry: float | None = Field(description="Time of the newest good frame [s].")
    age: float | None = Field(description="Of that [s].")
    gate: Gate


class Reference(BaseModel):
    """A parameter as verified."""

    value: float
    sd: float = Field(description="Of the distribution that was verified.")


class Parameter(BaseModel):
    """A parameter as estimated."""

    value: float | None
    sd: float | None
    unit: str
    verified: Reference | None


class Test(BaseModel):
    """A test for drift."""

    statistic: float | None
    threshold: float | None


class Samples(BaseModel):
    """An output over the last seconds."""

    time: list[float | None]
    measured: list[float | None]
    predicted: list[float | None]
    residual: list[float | None]


class TwinView(TwinLine):
    """A twin in full."""

    time: float
    excitation: float | None
    parameters: dict[str, Parameter]
    drift: dict[str, Test]
    channels: dict[str, Samples]
    counts: dict[str, int]
    faults: dict[str, str]


class Fleet(BaseModel):
    """All twins."""

    twins: list[TwinLine]


class LoggedEvent(BaseModel):
    """An entry of the event log."""

    number: int
    time: float
    logged: float
    twin: str
    kind: str
    detail: dict[str, Any]


class Events(BaseModel):
    """Entries of the event log."""

    events: list[LoggedEvent]


class AuditResult(BaseModel):
    """Whether the event log is whole."""

    events: int
    intact: bool
    because: str


class Sets(BaseModel):
    """Parameter sets, newest first."""

    sets: list[dict[str, Any]]


class EvidenceDocument(BaseModel):
    """What a verification found."""

    id: str
    evidence: dict[str, Any]


class Lineage(BaseModel):
    """What something was made from."""

    artifacts: list[dict[str, Any]]


class SpanDocument(BaseModel):
    """What a number did for a while."""

    start: float
    length: float
    count: int
    mean: float
    low: float
    high: float


class History(BaseModel):
    """A number over time."""

    spans: list[SpanDocument]


class Approve(BaseModel):
    """Which parameter set to put into force."""

    parameters: Hash


class Happened(BaseModel):
    """What a request led to."""

    events: list[dict[str, Any]]


class Reloaded(BaseModel):
    """Twins that a reload touched."""

    added: list[str]
    removed: list[str]
    changed: list[str]
