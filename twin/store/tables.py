"""The tables of the store. A change here needs a migration (`migrations/versions`)."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    Double,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

CLAIMS = "claims"
_NAMES = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}


class Base(DeclarativeBase):
    """Base of all tables."""

    metadata = MetaData(naming_convention=_NAMES)
    type_annotation_map = {float: Double(), int: Integer(), bool: Boolean(), str: String()}  # noqa: RUF012 - SQLAlchemy's


class EventRow(Base):
    """The event log, chained (`twin.audit`)."""

    __tablename__ = "events"
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    time: Mapped[float]
    logged: Mapped[float]
    twin: Mapped[str] = mapped_column(index=True)
    kind: Mapped[str]
    detail: Mapped[str] = mapped_column(Text())
    code: Mapped[str]


class HeadRow(Base):
    """The one row that says where the log ends; locked while an entry is appended."""

    __tablename__ = "head"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    number: Mapped[int]
    code: Mapped[str]


class TwinRow(Base):
    """What must outlive a restart of a twin."""

    __tablename__ = "twins"
    name: Mapped[str] = mapped_column(primary_key=True)
    state: Mapped[str]
    since: Mapped[float]
    because: Mapped[str] = mapped_column(Text())
    model: Mapped[str] = mapped_column(Text())


class EvidenceRow(Base):
    """Results of verifications; the id is the hash of the document."""

    __tablename__ = "evidence"
    id: Mapped[str] = mapped_column(primary_key=True)
    twin: Mapped[str] = mapped_column(index=True)
    time: Mapped[float]
    passed: Mapped[bool]
    document: Mapped[str] = mapped_column(Text())


class ParameterSetRow(Base):
    """Parameter sets and what became of them; the id is the hash of the document."""

    __tablename__ = "parameter_sets"
    id: Mapped[str] = mapped_column(primary_key=True)
    twin: Mapped[str] = mapped_column(index=True)
    time: Mapped[float]
    state: Mapped[str]
    promoted: Mapped[float | None]
    evidence: Mapped[str | None]
    document: Mapped[str] = mapped_column(Text())


class ArtifactRow(Base):
    """Whatever has a place in the lineage."""

    __tablename__ = "artifacts"
    id: Mapped[str] = mapped_column(primary_key=True)
    kind: Mapped[str]
    name: Mapped[str] = mapped_column(Text())
    time: Mapped[float]


class LinkRow(Base):
    """What was made from what."""

    __tablename__ = "links"
    child: Mapped[str] = mapped_column(primary_key=True)
    parent: Mapped[str] = mapped_column(primary_key=True)


class HistoryRow(Base):
    """Numbers over time, in spans that grow with age."""

    __tablename__ = "history"
    twin: Mapped[str] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(primary_key=True)
    span: Mapped[float] = mapped_column(primary_key=True)
    start: Mapped[float] = mapped_column(primary_key=True)
    count: Mapped[int]
    mean: Mapped[float]
    low: Mapped[float]
    high: Mapped[float]
    __table_args__ = (Index("ix_history_span_start", "span", "start"),)


class ClaimRow(Base):
    """Which worker runs a twin, and its last check-point (`twin.store.claims`)."""

    __tablename__ = CLAIMS
    twin: Mapped[str] = mapped_column(primary_key=True)
    generation: Mapped[int]
    worker: Mapped[str]
    address: Mapped[str]
    position: Mapped[int] = mapped_column(BigInteger())
    state: Mapped[bytes | None] = mapped_column(LargeBinary())
