"""History in growing spans; lineage."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Take the store one revision further."""
    op.create_table(
        "artifacts",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("time", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_artifacts"),
    )
    op.create_table(
        "links",
        sa.Column("child", sa.String(), nullable=False),
        sa.Column("parent", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("child", "parent", name="pk_links"),
    )
    op.create_table(
        "history",
        sa.Column("twin", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("span", sa.Double(), nullable=False),
        sa.Column("start", sa.Double(), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        sa.Column("mean", sa.Double(), nullable=False),
        sa.Column("low", sa.Double(), nullable=False),
        sa.Column("high", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("twin", "name", "span", "start", name="pk_history"),
    )
    op.create_index("ix_history_span_start", "history", ["span", "start"])


def downgrade() -> None:
    """Take it back."""
    for table in ("history", "links", "artifacts"):
        op.drop_table(table)
