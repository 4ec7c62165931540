"""What must survive a restart: the event log, verified parameters, evidence, history, lineage."""

from twin.store.backup import back_up, restore
from twin.store.database import open_database, upgrade
from twin.store.documents import Evidence, ParameterSet, SetState, TwinRecord
from twin.store.history import Span, down_sample
from twin.store.store import Store

__all__ = [
    "Evidence",
    "ParameterSet",
    "SetState",
    "Span",
    "Store",
    "TwinRecord",
    "back_up",
    "down_sample",
    "open_database",
    "restore",
    "upgrade",
]
