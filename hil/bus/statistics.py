"""What went over a bus, counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from hil.bus.e2e import Status


@dataclass
class Statistics:
    """Counts of one node; zero everywhere but in the first two is a quiet day.

    Attributes:
        sent: Frames handed to the bus.
        received: Data frames taken from it, whatever became of them.
        not_sent: Frames that the bus refused (no room, bus-off).
        error_frames: Reported by the adapter, and lines of a serial adapter that make no sense.
        unknown: Frames that the DBC does not describe.
        too_short: Frames with fewer bytes than the DBC says.
        wrong_checksum: Frames whose E2E checksum is wrong.
        lost: Frames that the counters show to be missing.
        repeated: Frames with the counter of the one before.
        wrong_sequence: Old frames, and frames after a gap too long.
        late: Frames that came after more than one and a half periods though none is lost between,
            and frames that were sent half a period late.
    """

    sent: int = 0
    received: int = 0
    not_sent: int = 0
    error_frames: int = 0
    unknown: int = 0
    too_short: int = 0
    wrong_checksum: int = 0
    lost: int = 0
    repeated: int = 0
    wrong_sequence: int = 0
    late: int = 0

    def note(self, status: Status, lost: int) -> None:
        """Count a checked frame, and the frames that it shows to be lost."""
        self.lost += lost
        if status is Status.WRONG_CHECKSUM:
            self.wrong_checksum += 1
        elif status is Status.REPEATED:
            self.repeated += 1
        elif status is Status.WRONG_SEQUENCE:
            self.wrong_sequence += 1

    @property
    def dropped(self) -> int:
        """Frames whose values could not be used, and frames that never came."""
        return (
            self.lost
            + self.too_short
            + self.wrong_checksum
            + self.repeated
            + self.wrong_sequence
            + self.not_sent
        )

    def counts(self) -> Mapping[str, int]:
        """Return all counts by name."""
        return asdict(self)
