"""Any bus that python-can knows, opened by configuration."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import can

from foundation.errors import BusError

_BLOCK_READER = "slcan"


@dataclass(frozen=True)
class BusSettings:
    """Which bus to open.

    Attributes:
        interface: A name of python-can's: `virtual`, `slcan`, `socketcan`, `pcan`, `vector`, ….
        channel: The interface's name for the bus: `can0`, `/dev/ttyACM0`, `PCAN_USBBUS1`, ….
        bitrate: [bit/s]; None: as the bus is.
        options: Whatever else that interface takes.
    """

    interface: str = "virtual"
    channel: str = "twinproof"
    bitrate: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])


def open_bus(settings: BusSettings) -> can.BusABC:
    """Open a bus; `slcan` is read in blocks (`hil.bus.slcan`).

    Raises:
        BusError: python-can does not know the interface, or the bus is not there.

    Example:
        >>> with open_bus(BusSettings("virtual", "demo")) as one:
        ...     with open_bus(BusSettings("virtual", "demo")) as other:
        ...         one.send(can.Message(arbitration_id=5))
        ...         other.recv(0.0).arbitration_id
        5
    """
    where = f"bus.interface = '{settings.interface}', channel = '{settings.channel}'"
    options = dict(settings.options)
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    try:
        if settings.interface == _BLOCK_READER and sys.platform != "win32":
            from hil.bus.slcan import SlcanBus  # noqa: PLC0415 - needs terminals

            return SlcanBus(settings.channel, **options)
        return can.Bus(channel=settings.channel, interface=settings.interface, **options)
    except can.CanInterfaceNotImplementedError as error:
        raise BusError(
            f"this interface cannot be used: {_brief(error)}",
            where=where,
            remedy=f"use one of {', '.join(sorted(can.VALID_INTERFACES))}, or install its driver",
        ) from error
    except (can.CanError, OSError, ValueError, TypeError, ImportError, AttributeError) as error:
        raise BusError(
            f"the bus cannot be opened: {_brief(error)}",
            where=where,
            remedy="plug in and switch on the adapter, or correct the channel and its options",
        ) from error


def _brief(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
