"""The event log, twins, evidence and parameter sets."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Take the store one revision further."""
    op.create_table(
        "events",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("time", sa.Double(), nullable=False),
        sa.Column("logged", sa.Double(), nullable=False),
        sa.Column("twin", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.Column("code", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_events"),
    )
    op.create_index("ix_events_twin", "events", ["twin"])
    head = op.create_table(
        "head",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("code", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_head"),
    )
    # There from the start: what is to be locked must exist.
    op.bulk_insert(head, [{"id": 1, "number": 0, "code": "0" * 64}])
    op.create_table(
        "twins",
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("since", sa.Double(), nullable=False),
        sa.Column("because", sa.Text(), nullable=False),
        sa.Column("model", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("name", name="pk_twins"),
    )
    op.create_table(
        "evidence",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("twin", sa.String(), nullable=False),
        sa.Column("time", sa.Double(), nullable=False),
        sa.Column("passed", sa.Boolean(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_evidence"),
    )
    op.create_index("ix_evidence_twin", "evidence", ["twin"])
    op.create_table(
        "parameter_sets",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("twin", sa.String(), nullable=False),
        sa.Column("time", sa.Double(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("promoted", sa.Double(), nullable=True),
        sa.Column("evidence", sa.String(), nullable=True),
        sa.Column("document", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_parameter_sets"),
    )
    op.create_index("ix_parameter_sets_twin", "parameter_sets", ["twin"])


def downgrade() -> None:
    """Take it back."""
    for table in ("parameter_sets", "evidence", "twins", "head", "events"):
        op.drop_table(table)
