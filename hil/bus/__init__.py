"""The CAN bus: opened by configuration, described by a DBC, protected end to end, counted."""

from hil.bus.bridge import bridged_terminals
from hil.bus.codec import Field, Layout, Packer, Reading, Unpacker, layouts
from hil.bus.dbc import Port, bundled_dbc, parse_dbc, plant_dbc, protection_of, read_dbc
from hil.bus.e2e import PROFILES, Checking, Counting, Profile, Protection, Status
from hil.bus.interface import BusSettings, open_bus
from hil.bus.sender import PeriodicSender, sends_to
from hil.bus.statistics import Statistics

__all__ = [
    "PROFILES",
    "BusSettings",
    "Checking",
    "Counting",
    "Field",
    "Layout",
    "Packer",
    "PeriodicSender",
    "Port",
    "Profile",
    "Protection",
    "Reading",
    "Statistics",
    "Status",
    "Unpacker",
    "bridged_terminals",
    "bundled_dbc",
    "layouts",
    "open_bus",
    "parse_dbc",
    "plant_dbc",
    "protection_of",
    "read_dbc",
    "sends_to",
]
