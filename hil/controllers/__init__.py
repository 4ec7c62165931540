"""Controllers, one a file, with one interface."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hil.controllers.base import Controller
from hil.controllers.fmu import FmuController
from hil.controllers.incremental import Incremental
from hil.controllers.on_line import OnLine
from hil.controllers.pid import PID
from hil.controllers.state_feedback import StateFeedback, optimal_gain
from hil.controllers.swing_up import SwingUp

CONTROLLERS: Mapping[str, type[Controller]] = MappingProxyType(
    {c.kind: c for c in (PID, StateFeedback, Incremental, SwingUp, OnLine, FmuController)}
)
"""Every controller by its word in TOML."""

__all__ = [
    "CONTROLLERS",
    "PID",
    "Controller",
    "FmuController",
    "Incremental",
    "OnLine",
    "StateFeedback",
    "SwingUp",
    "optimal_gain",
]
