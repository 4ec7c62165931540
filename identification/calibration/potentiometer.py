"""Endless potentiometers: counts that wrap, with a blind zone that depends on the direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.errors import ExcitationError, InputError
from identification.calibration.measured import Vector, vector

_WRAP = 0.5
"""A step between samples of more than this share of a turn is a wrap, not a motion."""


@dataclass(frozen=True)
class Track:
    """Where the wiper of a potentiometer leaves its track and comes back, in counts.

    Attributes:
        counts_per_turn: Of a whole turn, the blind zone included.
        low: Smallest reading: held on the way down, first on the way up.
        high_up: Reading at which the wiper leaves the track on the way up.
        high_down: Reading at which it is back on the track on the way down.

    Raises:
        InputError: The readings do not fit into a turn.

    Example:
        >>> setup_1 = Track(1024, low=-306, high_up=717, high_down=640)
        >>> [round(57.2958 * zone, 1) for zone in (setup_1.blind_up, setup_1.blind_down)]
        [0.4, 27.4]
    """

    counts_per_turn: float
    low: float
    high_up: float
    high_down: float

    def __post_init__(self) -> None:
        for high in (self.high_up, self.high_down):
            if not self.low < high <= self.low + self.counts_per_turn:
                raise InputError(
                    f"a track from {self.low:g} to {high:g} in {self.counts_per_turn:g} counts",
                    remedy="low < high <= low + counts_per_turn",
                )

    @property
    def blind_up(self) -> float:
        """Angle that is not seen on the way up, rad."""
        return self._blind(self.high_up)

    @property
    def blind_down(self) -> float:
        """Angle that is not seen on the way down, rad."""
        return self._blind(self.high_down)

    def _blind(self, high: float) -> float:
        return (self.low + self.counts_per_turn - high) * 2 * np.pi / self.counts_per_turn


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """An angle made of counts.

    Attributes:
        angle: (n,) continuous over wraps [rad], zero at count 0; straight lines where blind.
        blind: (n,) true where the wiper was off its track, and the angle is a guess.
    """

    angle: Vector
    blind: NDArray[np.bool_]


def unwrap(counts: ArrayLike, track: Track) -> Unwrapped:
    """Return the angle from the counts of an endless potentiometer.

    While the wiper is off its track the last reading is held, so samples at the ends of the track
    say only that the angle is in the blind zone: they are marked, and filled with a straight line
    from the last to the first good sample. A motion that turns round inside the zone comes out
    right, since both ends of the zone are the same place.

    Args:
        counts: (n,) as read.
        track: See `find_track`, or the data sheet.

    Raises:
        InputError: A reading lies outside the track.
        ExcitationError: All samples are blind.

    Example:
        >>> track = Track(1024, low=-306, high_up=717, high_down=640)
        >>> found = unwrap([600, 700, 717, -306, -206], track)
        >>> np.round(np.diff(found.angle) * 1024 / (2 * np.pi)).tolist(), found.blind.tolist()
        ([100.0, 39.0, 39.0, 39.0], [False, False, True, True, False])
    """
    read = vector(counts, "counts")
    highest = max(track.high_up, track.high_down)
    outside = np.flatnonzero((read < track.low - 1) | (read > highest + 1))
    if outside.size:
        raise InputError(
            f"a reading of {read[outside[0]]:g} counts on a track from {track.low:g} to "
            f"{highest:g}",
            where=f"sample {outside[0]}",
            remedy="find the track anew with find_track, or check which sensor this is",
        )
    blind = (read <= track.low) | (read >= track.high_up)
    if blind.all():
        raise ExcitationError(
            "every sample lies in the blind zone", remedy="record where the wiper is on its track"
        )
    turned = np.unwrap(read, period=track.counts_per_turn)
    samples = np.arange(read.size)
    filled = np.interp(samples, samples[~blind], turned[~blind])
    return Unwrapped(filled * 2 * np.pi / track.counts_per_turn, blind)


def find_track(counts: ArrayLike, counts_per_turn: float) -> Track:
    """Return where the wiper leaves its track, from a record that turns over it in both directions.

    Args:
        counts: (n,) as read, of slow whole turns both ways: the ends are found to within the motion
            between two samples.
        counts_per_turn: From readings at known angles (`fit_scale`).

    Raises:
        ExcitationError: The record does not pass the wrap in both directions.

    Example:
        >>> up, down = [-306, 0, 400, 716, 717, -306, 0], [-306, -306, 640, 300]
        >>> find_track(up + down, 1024)
        Track(counts_per_turn=1024, low=-306.0, high_up=717.0, high_down=640.0)
    """
    read = vector(counts, "counts")
    change = np.diff(read)
    least = _WRAP * counts_per_turn
    upwards, downwards = np.flatnonzero(change < -least), np.flatnonzero(change > least)
    for passed, way in ((upwards, "up"), (downwards, "down")):
        if passed.size == 0:
            raise ExcitationError(
                f"the record does not pass the wrap on the way {way}",
                remedy="turn the shaft slowly through more than a turn in both directions",
            )
    low = min(float(read[upwards + 1].min()), float(read[downwards].min()))
    return Track(counts_per_turn, low, float(read[upwards].max()), float(read[downwards + 1].max()))
