"""Faults: of bus, sensors, actuators, controller and plant, one interface for each."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hil.faults.base import Fault, FrameFault, SignalFault
from hil.faults.frames import (
    BusOff,
    Corrupt,
    DeadController,
    Delay,
    Drop,
    Duplicate,
    LateController,
    Reorder,
)
from hil.faults.plant import ParameterChange
from hil.faults.signals import Bias, MotorFailure, Stuck, SupplySag

FAULTS: Mapping[str, type[Fault]] = MappingProxyType(
    {
        fault.kind: fault
        for fault in (
            *(Drop, Delay, Duplicate, Reorder, Corrupt, BusOff),
            *(Stuck, Bias),
            *(LateController, DeadController),
            *(MotorFailure, SupplySag),
            ParameterChange,
        )
    }
)
"""Every fault by its word in TOML."""

__all__ = [
    "FAULTS",
    "Bias",
    "BusOff",
    "Corrupt",
    "DeadController",
    "Delay",
    "Drop",
    "Duplicate",
    "Fault",
    "FrameFault",
    "LateController",
    "MotorFailure",
    "ParameterChange",
    "Reorder",
    "SignalFault",
    "Stuck",
    "SupplySag",
]
