"""What a run must do to pass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from foundation.errors import InputError, UnknownNameError
from hil.settings import OWN, unit

Array: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What criteria look at.

    Attributes:
        time: (n,) [s].
        columns: Name → (n,).
        safe: (n,) whether the plant was in its safe state.
        duration: That the run should have had [s].
        step: Between two rows [s].
        dropped: Frames that were lost or refused, on both ends.
        missed: Deadlines that were missed.
    """

    time: Array
    columns: Mapping[str, Array]
    safe: npt.NDArray[np.bool_]
    duration: float
    step: float
    dropped: int = 0
    missed: int = 0


@dataclass(frozen=True)
class Verdict:
    """What became of a criterion.

    Attributes:
        name: Of the criterion.
        kind: Its word.
        passed: Whether it is met.
        value, limit: What was found, and what it should keep.
        detail: In a sentence.
    """

    name: str
    kind: str
    passed: bool
    value: float
    limit: float
    detail: str


@dataclass(kw_only=True)
class Criterion(ABC):
    """Something that must hold.

    Attributes:
        name: In results; default: kind and signal.
        after: From when on [s].
        until: To when [s]; None: the end.
    """

    kind: ClassVar[str]

    name: str = ""
    after: float = unit("s", 0.0)
    until: float | None = unit("s", None)

    def check(self, columns: list[str], duration: float) -> None:
        """See to it that it can be evaluated.

        Raises:
            UnknownNameError: It is about a signal that there is not.
            InputError: It looks at a time beyond the run.
        """
        end = duration if self.until is None else self.until
        if not 0 <= self.after < end <= duration + 1e-9:
            raise InputError(
                f"a criterion from {self.after:g} s to {end:g} s in a run of {duration:g} s",
                remedy="let it begin before it ends, and end with the run",
            )
        for name in self.signals():
            if name not in columns:
                raise UnknownNameError("signal", name, columns)

    def signals(self) -> list[str]:
        """Return the columns that it looks at."""
        return []

    @abstractmethod
    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""

    def verdict(self, passed: bool, value: float, limit: float, detail: str) -> Verdict:
        """Return the verdict under this criterion's name."""
        name = self.name or " ".join([self.kind, *self.signals()[:1]])
        return Verdict(name, self.kind, bool(passed), float(value), float(limit), detail)

    def span(self, evidence: Evidence) -> slice:
        """Return the rows that it looks at."""
        end = evidence.duration if self.until is None else self.until
        first, last = np.searchsorted(evidence.time, [self.after - 1e-9, end + 1e-9])
        return slice(int(first), int(last))

    def is_whole(self, evidence: Evidence) -> bool:
        """Whether the run reached the end of what it looks at."""
        end = evidence.duration if self.until is None else self.until
        return len(evidence.time) > 0 and evidence.time[-1] >= end - 1.5 * evidence.step


@dataclass(kw_only=True)
class _Tracking(Criterion):
    """About the distance of a signal from its reference or a target.

    Attributes:
        signal: Output.
        target: What it should be; None: its reference.
        wraps: Distances are taken between minus and plus half a turn.
    """

    signal: str
    target: float | None = unit(OWN, None)
    wraps: bool = False

    def signals(self) -> list[str]:
        """Return the columns that it looks at."""
        return [self.signal, *([f"reference.{self.signal}"] if self.target is None else [])]

    def check(self, columns: list[str], duration: float) -> None:
        """See `Criterion.check`."""
        if self.target is None and f"reference.{self.signal}" not in columns:
            if self.signal not in columns:
                raise UnknownNameError("signal", self.signal, columns)
            raise InputError(
                f"'{self.signal}' has no reference to compare it with",
                remedy=f"give a target, or a reference: [references.{self.signal}]",
            )
        super().check(columns, duration)

    def error(self, evidence: Evidence) -> Array:
        """Return the distances (n,)."""
        rows = self.span(evidence)
        wanted: Array | float
        if self.target is None:
            wanted = evidence.columns[f"reference.{self.signal}"][rows]
        else:
            wanted = self.target
        error = evidence.columns[self.signal][rows] - wanted
        return (error + np.pi) % (2 * np.pi) - np.pi if self.wraps else error


@dataclass(kw_only=True)
class Settling(_Tracking):
    """Comes within a band of its reference in time, and stays there.

    Attributes:
        band: Half width.
        within: Of `after` [s].
    """

    kind: ClassVar[str] = "settling"

    band: float = unit(OWN)
    within: float = unit("s")

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        error = self.error(evidence)
        outside = np.flatnonzero(~(np.abs(error) <= self.band))
        first = outside[-1] + 1 if outside.size else 0
        settled = first < error.size and self.is_whole(evidence)
        value = first * evidence.step if settled else float("inf")
        detail = f"settled after {value:.4g} s" if settled else "did not settle"
        return self.verdict(value <= self.within, value, self.within, detail)


@dataclass(kw_only=True)
class Overshoot(_Tracking):
    """Goes beyond its target by no more than so much.

    The direction is that from the value at `after` to the target.

    Attributes:
        most: In the signal's unit.
    """

    kind: ClassVar[str] = "overshoot"

    most: float = unit(OWN)

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        error = self.error(evidence)
        if not error.size:
            return self.verdict(False, np.inf, self.most, "the run did not get so far")
        value = max(float(np.max(-np.sign(error[0]) * error)), 0.0)
        return self.verdict(
            value <= self.most and self.is_whole(evidence),
            value,
            self.most,
            f"beyond by {value:.4g}",
        )


@dataclass(kw_only=True)
class Rms(_Tracking):
    """Root mean square distance from the reference.

    Attributes:
        most: In the signal's unit.
    """

    kind: ClassVar[str] = "rms"

    most: float = unit(OWN)

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        error = self.error(evidence)
        value = float(np.sqrt(np.mean(error**2))) if error.size else np.inf
        return self.verdict(
            value <= self.most and self.is_whole(evidence), value, self.most, f"rms {value:.4g}"
        )


@dataclass(kw_only=True)
class Limit(Criterion):
    """Stays between two values.

    Attributes:
        signal: Any column.
        low, high: In its unit.
    """

    kind: ClassVar[str] = "limit"

    signal: str
    low: float = unit(OWN, float("-inf"))
    high: float = unit(OWN, float("inf"))

    def __post_init__(self) -> None:
        if not self.low < self.high or (np.isinf(self.low) and np.isinf(self.high)):
            raise InputError("the limits make no sense", remedy="give low, high, or both")

    def signals(self) -> list[str]:
        """Return the columns that it looks at."""
        return [self.signal]

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        values = evidence.columns[self.signal][self.span(evidence)]
        if not values.size:
            return self.verdict(False, np.inf, self.high, "the run did not get so far")
        lowest, highest = float(np.min(values)), float(np.max(values))
        passed = self.low <= lowest and highest <= self.high and self.is_whole(evidence)
        is_high = highest - self.high >= self.low - lowest
        value, limit = (highest, self.high) if is_high else (lowest, self.low)
        return self.verdict(passed, value, limit, f"between {lowest:.4g} and {highest:.4g}")


@dataclass(kw_only=True)
class Saturation(Criterion):
    """A command is at its limit for no more than a share of the time.

    Attributes:
        signal: Input.
        at: Absolute value that counts as the limit.
        most: Share, 0 to 1.
    """

    kind: ClassVar[str] = "saturation"

    signal: str
    at: float = unit(OWN)
    most: float

    def signals(self) -> list[str]:
        """Return the columns that it looks at."""
        return [f"command.{self.signal}"]

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        values = evidence.columns[f"command.{self.signal}"][self.span(evidence)]
        share = float(np.mean(np.abs(values) >= self.at * (1 - 1e-3))) if values.size else 1.0
        return self.verdict(
            share <= self.most and self.is_whole(evidence),
            share,
            self.most,
            f"{100 * share:.3g} % of the time",
        )


@dataclass(kw_only=True)
class MissedFrames(Criterion):
    """No more than so many frames are lost, damaged, doubled or refused."""

    kind: ClassVar[str] = "missed-frames"

    most: int

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        n = evidence.dropped
        return self.verdict(n <= self.most, n, self.most, f"{n} frames")


@dataclass(kw_only=True)
class Deadlines(Criterion):
    """No more than a share of the deadlines is missed."""

    kind: ClassVar[str] = "deadlines"

    most: float

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        share = evidence.missed / max(len(evidence.time), 1)
        return self.verdict(share <= self.most, share, self.most, f"{evidence.missed} missed")


@dataclass(kw_only=True)
class SafeState(Criterion):
    """The plant goes to its safe state, in time and back again; or never does.

    Attributes:
        within: After `after` [s]; None: it must never be there.
        back: It must be left again within so long after `until` [s]; None: that does not matter.
    """

    kind: ClassVar[str] = "safe-state"

    within: float | None = unit("s", None)
    back: float | None = unit("s", None)

    def judge(self, evidence: Evidence) -> Verdict:
        """Judge a run."""
        if self.within is None:
            n = int(np.count_nonzero(evidence.safe[self.span(evidence)]))
            detail = f"safe for {n * evidence.step:.4g} s" if n else "never safe"
            return self.verdict(n == 0 and self.is_whole(evidence), n * evidence.step, 0.0, detail)
        rows = self.span(evidence)
        safe = np.flatnonzero(evidence.safe[rows])
        value = float(safe[0]) * evidence.step if safe.size else float("inf")
        passed = value <= self.within + 1e-9
        detail = f"safe after {value:.4g} s" if safe.size else "never safe"
        if passed and self.back is not None:
            rest = np.flatnonzero(~evidence.safe[rows.stop :])
            back = float(rest[0]) * evidence.step if rest.size else float("inf")
            passed = back <= self.back + 1e-9
            detail += f", back after {back:.4g} s"
        return self.verdict(passed, value, self.within, detail)


CRITERIA: Mapping[str, type[Criterion]] = MappingProxyType(
    {
        c.kind: c
        for c in (Settling, Overshoot, Rms, Limit, Saturation, MissedFrames, Deadlines, SafeState)
    }
)
"""Every criterion by its word in TOML."""
