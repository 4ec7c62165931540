"""Values at other times than they were sampled, by what kind of signal they are.

A measured quantity moves between its samples; straight lines are the least that can be said of
it, and before it is put on a coarser grid everything above the grid's Nyquist frequency is
filtered off, since it would come back as a slow motion that never was. A command holds until the
next one; on a coarser grid its mean over each step keeps what it did to the plant. A state (a
gear, a switch) has no values in between at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal as filters

Vector = NDArray[np.float64]

PASS_BAND = 0.8
"""End of the anti-alias filter's pass band over the new Nyquist frequency."""
COARSER = 1.5
"""A grid whose step is longer than this, in steps of the signal, is a coarser one."""
_STOP_BAND_DB = 80.0
_SAME_INSTANT = 1e-6
"""Stamps nearer than this, in steps of the grid, are the same: decimals are rounded in files."""


class Kind(StrEnum):
    """What happens to a signal between its samples."""

    MEASURED = "measured"
    """A physical quantity: straight lines; low-passed before a coarser grid."""
    COMMAND = "command"
    """Holds until the next value; its mean over each step of a grid as coarse or coarser."""
    STATE = "state"
    """Holds until the next value, and is never averaged: gears, switches, counters."""


@dataclass(frozen=True, eq=False)
class Resampled:
    """A signal on a grid.

    Attributes:
        values: Shape (m,), at the grid's times.
        noise_gain: White noise of the samples comes through multiplied by this.
        what: What was done, as words for a note; empty if the values are the samples.
    """

    values: Vector
    noise_gain: float = 1.0
    what: str = ""


def resample(time: Vector, values: Vector, grid: Vector, kind: Kind) -> Resampled:
    """Put a signal on a grid.

    Args:
        time: Shape (n,), s, increasing.
        values: Shape (n,).
        grid: Shape (m,), s, increasing, within the span of `time`.
        kind: What the signal does between its samples.

    Example:
        >>> time, grid = np.array([0.0, 1.0, 2.0]), np.array([0.5, 1.5])
        >>> resample(time, np.array([0.0, 2.0, 4.0]), grid, Kind.MEASURED).values.tolist()
        [1.0, 3.0]
        >>> resample(time, np.array([0.0, 2.0, 4.0]), grid, Kind.STATE).values.tolist()
        [0.0, 2.0]
        >>> resample(time, np.array([0.0, 2.0, 4.0]), grid, Kind.COMMAND).values.tolist()
        [1.0, 3.0]
    """
    if np.array_equal(time, grid):
        return Resampled(values)
    own, step = float(np.median(np.diff(time))), float(np.median(np.diff(grid)))
    if kind is Kind.STATE:
        return Resampled(held(time, values, grid), what="held")
    if kind is Kind.COMMAND:
        if COARSER * step < own:
            return Resampled(held(time, values, grid), what="held")
        return Resampled(step_means(time, values, grid), what="held, and averaged over each step")
    if step > COARSER * own:
        smooth, gain = low_passed(time, values, PASS_BAND / (2 * step))
        return Resampled(
            np.interp(grid, *smooth), gain, f"low-passed at {PASS_BAND / (2 * step):.4g} Hz"
        )
    return Resampled(np.interp(grid, time, values), what="interpolated")


def held(time: Vector, values: Vector, grid: Vector) -> Vector:
    """Return at each time of the grid the latest value; before the first, the first."""
    slack = _SAME_INSTANT * float(np.median(np.diff(grid))) if grid.size > 1 else 0.0
    latest = np.searchsorted(time, grid + slack, side="right") - 1
    return values[np.maximum(latest, 0)]


def step_means(time: Vector, values: Vector, grid: Vector) -> Vector:
    """Return the mean of the held signal over each step of the grid, from its time to the next.

    Held again over those steps, it has the same integral as the original. The step after the last
    time is as long as the usual one.

    Example:
        >>> step_means(np.array([0.0, 0.5]), np.array([0.0, 4.0]), np.array([0.0, 1.0])).tolist()
        [2.0, 4.0]
    """
    integral = np.concatenate([[0.0], np.cumsum(np.diff(time) * values[:-1])])
    ends = np.append(grid, grid[-1] + np.median(np.diff(grid)))
    # Beyond the last sample its value holds; np.interp would stop there.
    at = np.interp(ends, time, integral) + np.maximum(ends - time[-1], 0.0) * values[-1]
    return np.diff(at) / np.diff(ends)


def low_passed(time: Vector, values: Vector, cutoff: float) -> tuple[tuple[Vector, Vector], float]:
    """Return times and values of a signal without what is faster than `cutoff`, not shifted.

    A symmetric (zero-phase) Kaiser-window FIR filter on equal steps, 80 dB down from 1.25 times
    the cutoff on (A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed.,
    section 7.5.3). The ends are continued as odd reflections, so that a ramp stays a ramp.

    Args:
        time: Shape (n,), s, increasing; uneven steps are first put on equal ones by straight lines.
        values: Shape (n,).
        cutoff: End of the pass band, Hz.

    Returns:
        Times and values, each of shape (k,), and what white noise is multiplied by.
    """
    step = float(np.median(np.diff(time)))
    count = max(round(float(time[-1] - time[0]) / step), 1) + 1
    even = np.linspace(time[0], time[-1], count)
    nyquist = 0.5 / float(even[1] - even[0])
    stop = cutoff / PASS_BAND
    taps, beta = filters.kaiserord(_STOP_BAND_DB, (stop - cutoff) / nyquist)
    # An odd number of taps has its middle on a sample; more taps than samples would be reflections.
    taps = min(taps | 1, 2 * count - 1)
    window: Any = ("kaiser", beta)
    edge = 0.5 * (stop + cutoff) / nyquist
    kernel = np.asarray(filters.firwin(taps, edge, window=window), np.float64)
    padded = np.pad(np.interp(even, time, values), taps // 2, "reflect", reflect_type="odd")
    smooth = filters.oaconvolve(padded, kernel, mode="valid")
    return (even, np.asarray(smooth, np.float64)), float(np.sqrt(np.sum(kernel**2)))
