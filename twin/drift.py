"""Has the plant moved away from what was verified, and which parameter has?

A filter that believes the verified parameters gives, block by block, the score r of its likelihood
and the information F (`identification.online.scored_filter`). Over a window, if the plant is the
verified one, r has mean zero and covariance S = F + F·P₀·F, where P₀ is how well the verified
parameters are known; if parameter j moved by δ, its mean is F·e_j·δ. The test of every parameter is
the matched filter for that,

    z_j = (F e_j)' S⁻¹ r / sqrt((F e_j)' S⁻¹ F e_j),

standard normal if nothing moved: the generalised likelihood ratio, which a change must pass
whatever its size and, over windows of growing length, whenever it began (M. Basseville,
I. V. Nikiforov, Detection of Abrupt Changes, 1993, sections 2.4 and 8.3). What is no single
parameter shows in r'S⁻¹r, and in innovations larger than predicted.

All tests share one threshold probability, the stated rate of false alarms divided by how many
tests an hour has (Bonferroni): a bound, since neighbouring windows share their data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from foundation.resumable import Resumable
from identification.online.scored_filter import Scored

Array = NDArray[np.float64]

SEVERAL = ""
"""In place of a parameter's name: no single one explains the change."""
_SHORTEST = 0.5
_NOISE_MARGIN = 0.5
"""Innovations may be larger than predicted by this share of their variance: data sheets do not know
a sensor's noise better, and the filter linearises."""


@dataclass(frozen=True)
class Alarm:
    """A change that chance does not explain.

    Attributes:
        parameter: The one whose change explains it best; `SEVERAL`: none does alone.
        statistic: z of that parameter, or of the test that rang.
        threshold: That was passed.
        window: Length of the window with the largest excess [s].
        change: Of the parameter, in its unit; NaN for several.
        channel: Output whose noise grew, if it was that which rang.
    """

    parameter: str
    statistic: float
    threshold: float
    window: float
    change: float
    channel: str = ""


class DriftMonitor(Resumable):
    """Tests blocks of samples against a verified set of parameters.

    Args:
        names: The k parameters.
        values: Verified.
        covariance: (k, k) of these.
        block: Length of a block [s].
        window: The longest window [s].
        false_alarms_per_hour: That may be expected at most.
        margin: Change, relative to a value, that is no drift.
        channels: Names of the outputs.

    Attributes:
        threshold: Of |z| of every test.
        statistics: Parameter → its |z| with the largest size over the windows, after each block.
        joint: The same of all parameters together, as a normal deviate.

    Example:
        >>> monitor = DriftMonitor(["J"], {"J": 1.0}, np.zeros((1, 1)), block=0.1, window=10.0,
        ...     false_alarms_per_hour=0.01)
        >>> 5 < monitor.threshold < 7
        True
    """

    _changes = (
        "scale",
        "_prior",
        "_rows",
        "_count",
        "statistics",
        "joint",
    )

    def __init__(
        self,
        names: Sequence[str],
        values: Mapping[str, float],
        covariance: Array,
        *,
        block: float,
        window: float,
        false_alarms_per_hour: float,
        margin: float = 0.0,
        channels: Sequence[str] = (),
    ) -> None:
        self.names, self.channels = tuple(names), tuple(channels)
        self.block = block
        self._lengths = _lengths(window, block)
        self._most = self._lengths[-1]
        kinds = len(self.names) + 1 + len(self.channels)
        tests = 3600.0 / block * len(self._lengths) * kinds
        self._chance = false_alarms_per_hour / tests
        self.threshold = float(stats.norm.isf(0.5 * self._chance))
        self._margin = margin
        self.verify(values, covariance)

    def verify(self, values: Mapping[str, float], covariance: Array) -> None:
        """Test against another verified set, from new data only."""
        self.scale = np.array([abs(values[n]) or 1.0 for n in self.names])
        relative = covariance / np.outer(self.scale, self.scale)
        self._prior = relative + self._margin**2 * np.eye(len(self.names))
        self.restart()

    def restart(self) -> None:
        """Forget the data."""
        k, ny = len(self.names), len(self.channels)
        # One row a block: score, information, squared innovations, their counts. Twice as many as
        # the longest window, so that the last blocks are always one piece.
        self._rows = np.zeros((2 * self._most, k + k * k + 2 * ny))
        self._count = 0
        self.statistics = dict.fromkeys(self.names, 0.0)
        self.joint = 0.0

    def take(self, scored: Scored) -> Alarm | None:
        """Take a block; return an alarm if a test rings."""
        k = len(self.names)
        if self._count == len(self._rows):
            self._rows[: self._most] = self._rows[self._most :]
            self._count = self._most
        row = self._rows[self._count]
        row[:k] = scored.score * self.scale
        row[k : k + k * k] = (scored.information * np.outer(self.scale, self.scale)).ravel()
        if self.channels:
            there = scored.innovations != 0.0
            squares = (scored.innovations**2 / scored.variances).sum(axis=0)
            row[k + k * k :] = [*squares, *there.sum(axis=0)]
        self._count += 1
        lengths = [n for n in self._lengths if n <= self._count]
        if not lengths:
            return None
        sums = self._sums(lengths)
        info = sums[:, k : k + k * k].reshape(-1, k, k)
        z, change, joint = self._tests(sums[:, :k], info)
        best = np.max(np.abs(z), axis=0)
        self.statistics = dict(zip(self.names, best.tolist(), strict=True))
        self.joint = float(np.max(joint))
        return self._judged(lengths, z, change, joint, self._noise(sums[:, k + k * k :]))

    def _sums(self, lengths: Sequence[int]) -> Array:
        """Return sums over the last n blocks, for each n, shortest first."""
        starts = self._count - np.array(lengths)[::-1]
        parts = np.add.reduceat(self._rows[: self._count], starts, axis=0)
        return np.cumsum(parts[::-1], axis=0)

    def _tests(self, score: Array, info: Array) -> tuple[Array, Array, Array]:
        """Return z and relative changes, each (windows, k), and the joint deviate (windows,)."""
        # S = F + F P F is as badly conditioned as F squared; with F = Q L Q' the directions that
        # the data do not show are left out instead.
        eigenvalues, vectors = np.linalg.eigh(info)
        kept = eigenvalues > 1e-10 * eigenvalues[:, -1:]
        root = np.where(kept, np.sqrt(np.where(kept, eigenvalues, 1.0)), 0.0)
        inverse = np.where(kept, 1.0 / np.where(kept, root, 1.0), 0.0)
        # In whitened coordinates w = L^-1/2 Q' r the covariance is I + L^1/2 Q' P Q L^1/2.
        white = inverse * np.einsum("wij,wi->wj", vectors, score)
        mixed = root[:, :, None] * np.swapaxes(vectors, 1, 2)
        covariance = np.eye(len(self.names)) + mixed @ self._prior @ np.swapaxes(mixed, 1, 2)
        solved = np.linalg.solve(covariance, np.concatenate([white[:, :, None], mixed], axis=2))
        w, columns = solved[:, :, 0], solved[:, :, 1:]
        matched = np.einsum("wij,wi->wj", columns, white)
        power = np.einsum("wij,wij->wj", columns, mixed)
        safe = np.where(power > 0, power, 1.0)
        z = np.where(power > 0, matched / np.sqrt(safe), 0.0)
        square = np.einsum("wi,wi->w", w, white)
        degrees = np.maximum(kept.sum(axis=1), 1)
        # Far out the tail probability underflows; Wilson and Hilferty's cube root does not.
        c = 2.0 / (9.0 * degrees)
        joint = (np.cbrt(square / degrees) - (1 - c)) / np.sqrt(c)
        return z, matched / safe, joint

    def _noise(self, square: Array) -> Array:
        """Return (windows, ny): how much larger than predicted innovations are, as deviates."""
        ny = len(self.channels)
        sums, counts = square[:, :ny], np.maximum(square[:, ny:], 1.0)
        c = 2.0 / (9.0 * counts)
        allowed = sums / (1 + _NOISE_MARGIN)
        return (np.cbrt(allowed / counts) - (1 - c)) / np.sqrt(c)

    def _judged(
        self, lengths: Sequence[int], z: Array, change: Array, joint: Array, noise: Array
    ) -> Alarm | None:
        size = np.abs(z)
        largest = max(size.max(initial=0.0), joint.max(), noise.max(initial=0.0))
        if not largest > self.threshold:
            return None
        if size.max(initial=0.0) > self.threshold:
            row, j = divmod(int(np.argmax(size)), size.shape[1])
            return Alarm(
                self.names[j],
                float(size[row, j]),
                self.threshold,
                lengths[row] * self.block,
                float(change[row, j] * self.scale[j]),
            )
        if joint.max() >= noise.max(initial=0.0):
            row = int(np.argmax(joint))
            length = lengths[row] * self.block
            return Alarm(SEVERAL, float(joint[row]), self.threshold, length, math.nan)
        row, i = divmod(int(np.argmax(noise)), noise.shape[1])
        length = lengths[row] * self.block
        return Alarm(
            SEVERAL, float(noise[row, i]), self.threshold, length, math.nan, self.channels[i]
        )


def _lengths(window: float, block: float) -> list[int]:
    """Return window lengths in blocks, each twice the one before, up to the longest."""
    longest = max(1, round(window / block))
    found = [longest]
    while found[-1] // 2 * block >= _SHORTEST:
        found.append(found[-1] // 2)
    return found[::-1]
