"""What a gateway sends of a twin every tenth of a second: frames, its clock, its counts."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.errors import FormatError
from recordings.readers.can_frames import Frames

_MAGIC = b"TWF1"
_HEAD = struct.Struct("<4sIII")
"""Magic, bytes of the JSON that follows, frames, bytes of a payload."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames of a twin, from all of its buses.

    Attributes:
        frames: In the order in which they came; maybe none.
        now: The gateway's clock before they were fetched [s]: what is older has come.
        gateway: Which one.
        counts: What it has received, dropped, not recorded, not published.
        faults: What fails there now, and why.
    """

    frames: Frames
    now: float
    gateway: str
    counts: Mapping[str, int] = field(default_factory=dict[str, int])
    faults: Mapping[str, str] = field(default_factory=dict[str, str])


def packed(batch: Batch) -> bytes:
    """Return a batch as bytes."""
    frames = batch.frames
    n, width = frames.payload.shape
    about = {
        "now": batch.now,
        "gateway": batch.gateway,
        "counts": dict(batch.counts),
        "faults": dict(batch.faults),
        "error_frames": frames.error_frames,
        "remote_frames": frames.remote_frames,
    }
    text = json.dumps(about).encode()
    rows = np.zeros(n, _rows(width))
    rows["stamp"], rows["identifier"] = frames.nanoseconds, frames.identifier
    rows["bus"], rows["length"], rows["payload"] = frames.bus, frames.length, frames.payload
    return _HEAD.pack(_MAGIC, len(text), n, width) + text + rows.tobytes()


def unpacked(content: bytes) -> Batch:
    """Return the batch that bytes are.

    Raises:
        FormatError: They are none.
    """
    try:
        magic, length, n, width = _HEAD.unpack_from(content)
        if magic != _MAGIC:
            raise ValueError(magic)
        about = json.loads(content[_HEAD.size : _HEAD.size + length])
        rows = np.frombuffer(content, _rows(width), n, _HEAD.size + length)
        counts = {str(k): int(v) for k, v in about["counts"].items()}
        faults = {str(k): str(v) for k, v in about["faults"].items()}
        frames = _frames(rows, n, width, int(about["error_frames"]), int(about["remote_frames"]))
        return Batch(frames, float(about["now"]), str(about["gateway"]), counts, faults)
    except (struct.error, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            "a message in the stream is no batch of frames",
            remedy="give every CONFIG a stream of its own, and gateways and workers one version",
        ) from error


def _frames(rows: NDArray[Any], n: int, width: int, errors: int, remotes: int) -> Frames:
    return Frames(
        rows["stamp"].copy(),
        rows["identifier"].copy(),
        rows["bus"].astype(np.int64),
        rows["length"].copy(),
        rows["payload"].reshape(n, width).copy(),
        error_frames=errors,
        remote_frames=remotes,
    )


def _rows(width: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("stamp", "<i8"),
            ("identifier", "<u4"),
            ("bus", "u1"),
            ("length", "u1"),
            ("payload", "u1", (width,)),
        ]
    )
