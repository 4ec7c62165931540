"""CAN frames as columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

EXTENDED = 1 << 31
"""Flag that tells a 29-bit identifier from an 11-bit one of the same number."""
WORD = 8
"""Least width of payloads in bytes: signals are cut out of words of 64 bits."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Data frames in the order of the log, as columns of n.

    Attributes:
        nanoseconds: Time stamps, ns, int64: exact where a float of seconds since 1970 is not.
        identifier: CAN identifiers, uint32; those of 29 bits have the flag `EXTENDED`.
        bus: Number of the bus, int64.
        length: Bytes of payload, uint8.
        payload: Bytes, shape (n, width), filled up with zeros; width is 8 or more.
        bus_names: Names of the buses by number; empty where the log has numbers only.
        error_frames: How many error frames were left out.
        remote_frames: How many remote frames were left out.
        passed_over: How many lines, or objects, of the log were not understood.
    """

    nanoseconds: NDArray[np.int64]
    identifier: NDArray[np.uint32]
    bus: NDArray[np.int64]
    length: NDArray[np.uint8]
    payload: NDArray[np.uint8]
    bus_names: Sequence[str] = ()
    error_frames: int = 0
    remote_frames: int = 0
    passed_over: int = 0

    def __len__(self) -> int:
        return self.identifier.size

    def ordered(self, rows: NDArray[np.integer[Any]]) -> Frames:
        """Return the frames in another order."""
        return replace(
            self,
            nanoseconds=self.nanoseconds[rows],
            identifier=self.identifier[rows],
            bus=self.bus[rows],
            length=self.length[rows],
            payload=self.payload[rows],
        )

    @staticmethod
    def joined(parts: Sequence[Frames], error_frames: int = 0) -> Frames:
        """Return the frames of all parts, one part after the other, and some error frames more."""
        if len(parts) == 1:
            return replace(parts[0], error_frames=parts[0].error_frames + error_frames)
        parts = parts or [FrameList().frames()]
        width = max(part.payload.shape[1] for part in parts)
        return Frames(
            np.concatenate([part.nanoseconds for part in parts]),
            np.concatenate([part.identifier for part in parts]),
            np.concatenate([part.bus for part in parts]),
            np.concatenate([part.length for part in parts]),
            np.concatenate([_wide(part.payload, width) for part in parts]),
            parts[-1].bus_names,
            error_frames + sum(part.error_frames for part in parts),
            sum(part.remote_frames for part in parts),
            sum(part.passed_over for part in parts),
        )


def _wide(payload: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    short = width - payload.shape[1]
    return np.pad(payload, ((0, 0), (0, short))) if short else payload


@dataclass
class FrameList:
    """Collects frames one by one; `frames` makes columns of them."""

    error_frames: int = 0
    remote_frames: int = 0
    passed_over: int = 0
    _nanoseconds: list[int] = field(default_factory=list[int])
    _identifiers: list[int] = field(default_factory=list[int])
    _buses: list[int] = field(default_factory=list[int])
    _payloads: list[bytes] = field(default_factory=list[bytes])

    def __len__(self) -> int:
        return len(self._payloads)

    def add(self, nanoseconds: int, identifier: int, bus: int, payload: bytes) -> None:
        """Add a data frame; `identifier` has the flag `EXTENDED` where it has 29 bits."""
        self._nanoseconds.append(nanoseconds)
        self._identifiers.append(identifier)
        self._buses.append(bus)
        self._payloads.append(payload)

    def frames(self, bus_names: Sequence[str] = ()) -> Frames:
        """Return what was added."""
        length = np.array([len(payload) for payload in self._payloads], np.uint8)
        width = max(int(length.max(initial=0)), WORD)
        filled = b"".join(payload.ljust(width, b"\0") for payload in self._payloads)
        return Frames(
            np.array(self._nanoseconds, np.int64),
            np.array(self._identifiers, np.uint32),
            np.array(self._buses, np.int64),
            length,
            np.frombuffer(filled, np.uint8).reshape(len(length), width),
            bus_names,
            self.error_frames,
            self.remote_frames,
            self.passed_over,
        )
