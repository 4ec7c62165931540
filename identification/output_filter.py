"""The output filter: I(s) = 1 / ((τ1 s + 1)(τ2 s + 1)) with outputs I, s·I and s²·I.

An equation of motion, filtered by I, needs no acceleration: d²/dt² φ2 becomes s²·I applied to φ2.
The idea and its use here are those of C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12 (2023)
4569, equations (30) to (42). Their realisation holds misprints ((34), (35), rows 1 and 5 of (41));
here one pair of states

    τ1 x1' = u - x1,    τ2 x2' = x1 - x2

gives all three outputs: I u = x2, s·I u = (x1 - x2)/τ2, s²·I u = ((u - x1)/τ1 - (x1 - x2)/τ2)/τ2.
Both sections are of first order and nothing is divided by τ1 - τ2, so equal time constants are no
special case. The step from sample to sample is exact for signals that are straight lines between
samples (first-order hold) or constant (zero-order hold).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter, welch

from foundation.errors import InputError

Array = NDArray[np.float64]

_TINY = 1e-300
_CORRELATED = 8.0  # multiples of τ1 + τ2 after which a filtered residual is forgotten
_FEWEST_SAMPLES = 30  # τ in samples; (T/τ)²/12 is the error of straight lines
_LEAST_WINDOWS = 10  # record in units of τ
_ABOVE_FLOOR = 10.0  # a periodogram's scatter exceeds this rarely


@dataclass(frozen=True)
class OutputFilter:
    """The filter for one sample time.

    Args:
        tau1, tau2: Time constants [s], positive.
        sample_time: Step of the grid [s].

    Raises:
        InputError: A time is not positive and finite.

    Example:
        >>> t = np.arange(1000) * 0.01
        >>> low = OutputFilter(0.1, 0.1, 0.01).apply(np.ones_like(t))
        >>> bool(np.allclose(low, 1 - (1 + t / 0.1) * np.exp(-t / 0.1)))
        True
    """

    tau1: float
    tau2: float
    sample_time: float

    def __post_init__(self) -> None:
        for name in ("tau1", "tau2", "sample_time"):
            value = float(getattr(self, name))
            if not (np.isfinite(value) and value > 0):
                raise InputError(
                    f"{name} of the output filter is {value:g} s",
                    remedy="give a positive number of seconds",
                )

    def apply(self, start: Array, end: Array | None = None, *, order: int = 0) -> Array:
        """Return s^order · I applied to a signal, from rest.

        Args:
            start: (n,) or (n, m) values just after each sample.
            end: Values just before the next sample, the last of them unused: a signal that an input
                enters may jump at samples. None for a signal that is continuous, the straight line
                through `start`; pass `start` itself for one that is held (zero-order hold).
            order: 0, 1 or 2. For 1 and 2 the signal's first value is subtracted, which leaves its
                derivative as it is and avoids a spurious jump at the start: the output is
                L⁻¹{I·(s φ - φ(0))} and L⁻¹{I·(s² φ - s φ(0))}, from (33) without φ'(0).

        Returns:
            Like `start`, at the samples.
        """
        if order > 0:
            first = start[0]
            end = None if end is None else end - first
            start = start - first
        x1, x2 = self._states(start, end)
        if order == 0:
            return x2
        if order == 1:
            return (x1 - x2) / self.tau2
        return ((start - x1) / self.tau1 - (x1 - x2) / self.tau2) / self.tau2

    def apply_backwards(self, start: Array, end: Array, *, order: int = 0) -> Array:
        """Return s^order · I(-s) applied to a signal: the same filter, run from the end.

        A sample of the result depends on the signal from there on, where that of `apply` depends on
        it up to there. Arguments and result as for `apply`.
        """
        # In reversed time the interval before a sample comes first, and its ends are exchanged.
        turned_start = np.concatenate([end[-2::-1], start[:1]])
        turned_end = np.concatenate([start[-2::-1], start[:1]])
        return self.apply(turned_start, turned_end, order=order)[::-1] * (-1.0) ** order

    def transients(self, n: int) -> Array:
        """Return (n, 2) the two motions of the unforced filter, h and h' up to scale.

        What unknown initial values leave in each filtered equation is a combination of these two.
        """
        transition, _, _ = self.step
        steps = np.arange(n)
        # x2 started alone, and x2 driven by x1 started alone; both from the exact transition.
        alone = transition[1, 1] ** steps
        drive = np.concatenate([[0.0], transition[1, 0] * transition[0, 0] ** steps[:-1]])
        driven = _recursion(drive, transition[1, 1])
        return np.column_stack([alone, driven / max(float(np.max(driven)), _TINY)])

    @cached_property
    def step(self) -> tuple[Array, Array, Array]:
        """x[k+1] = Φ x[k] + Γ0 u(start) + Γ1 (u(end) - u(start)), by one matrix exponential.

        C. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic
        Control 23 (1978) 395-404.
        """
        a1, a2 = self.sample_time / self.tau1, self.sample_time / self.tau2
        block = np.array(
            [
                [-a1, 0.0, a1, 0.0],
                [a2, -a2, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [0.0, 0.0, 0.0, 0.0],
            ]
        )
        power: Array = np.asarray(expm(block), dtype=float)
        return power[:2, :2], power[:2, 2], power[:2, 3]

    def _states(self, start: Array, end: Array | None) -> tuple[Array, Array]:
        transition, gamma0, gamma1 = self.step
        before = start[:-1]
        after = start[1:] if end is None else end[:-1]
        drive1 = gamma0[0] * before + gamma1[0] * (after - before)
        drive2 = gamma0[1] * before + gamma1[1] * (after - before)
        zero = np.zeros_like(start[:1])
        x1 = _recursion(np.concatenate([zero, drive1]), transition[0, 0])
        drive2 = np.concatenate([zero, drive2 + transition[1, 0] * x1[:-1]])
        return x1, _recursion(drive2, transition[1, 1])


def _recursion(drive: Array, pole: float) -> Array:
    """x[k] = pole·x[k-1] + drive[k]."""
    filtered: Any = lfilter([1.0], [1.0, -pole], drive, axis=0)
    return filtered


def correlated_samples(tau: tuple[float, float], sample_time: float) -> int:
    """Return over how many samples filtered residuals are taken as correlated."""
    return int(np.ceil(_CORRELATED * sum(tau) / sample_time))


def choose_tau(positions: Sequence[Array], sample_time: float) -> tuple[float, float, float]:
    """Choose one time constant for both sections from how fast the recorded motion is.

    τ = 1/ω, where ω bounds nine tenths of the power of the slowest coordinate's acceleration. A
    shorter τ lets in noise beyond the motion's band and, below some tens of samples, the straight
    lines between samples no longer do; a longer one discards the band in which inertia shows, and
    columns become alike.

    Args:
        positions: (n,) record of each coordinate.
        sample_time: Step of the grid [s].

    Returns:
        τ, and the shortest and the longest that make sense for the record [s].

    Example:
        >>> t = np.arange(0, 20, 1e-3)
        >>> tau, shortest, longest = choose_tau([np.sin(10 * t)], 1e-3)
        >>> bool(0.07 < tau < 0.13)
        True
    """
    duration = len(positions[0]) * sample_time
    longest = duration / _LEAST_WINDOWS
    shortest = min(_FEWEST_SAMPLES * sample_time, longest)
    bands = [_acceleration_band(values, sample_time) for values in positions]
    slowest = min((band for band in bands if band > 0), default=1 / longest)
    return float(np.clip(1 / slowest, shortest, longest)), shortest, longest


def _acceleration_band(position: Array, sample_time: float) -> float:
    """Angular frequency [rad/s] below which 90 % of the acceleration's power lies; 0 at rest."""
    segment = max(len(position) // 2, min(len(position), 16))
    frequency, density = welch(position, 1 / sample_time, nperseg=segment, detrend="linear")
    omega = 2 * np.pi * frequency
    # Above half the band there is only sensor noise, which is flat.
    floor = float(np.median(density[len(density) // 2 :]))
    signal = np.where(density > _ABOVE_FLOOR * floor, density, 0.0)
    power = np.cumsum(signal * omega**4)
    if power[-1] <= 0:
        return 0.0
    return float(omega[np.searchsorted(power, 0.9 * power[-1])])
