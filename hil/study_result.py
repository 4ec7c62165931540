"""What came of a study: runs, pass rates with exact intervals, pairs, the worst."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import binomtest

from hil.criteria import Verdict
from hil.study import Case, Study

_WORST = 10


@dataclass(frozen=True)
class RunResult:
    """What came of one run.

    Attributes:
        case: Which.
        verdicts: Of criteria and margins.
        parameters: Of the plant.
    """

    case: Case
    verdicts: tuple[Verdict, ...]
    parameters: Mapping[str, float]

    @property
    def passed(self) -> bool:
        """Whether all is met."""
        return all(v.passed for v in self.verdicts)

    @property
    def badness(self) -> tuple[int, float]:
        """How bad it is: how many criteria are not met, and by how much, relative."""
        excess = [
            abs(v.value - v.limit) / max(abs(v.limit), 1e-9)
            for v in self.verdicts
            if not v.passed and np.isfinite(v.value)
        ]
        return sum(not v.passed for v in self.verdicts), max(excess, default=0.0)


@dataclass(frozen=True)
class Rate:
    """How many of how many, with the exact (Clopper–Pearson) interval."""

    passed: int
    runs: int
    low: float
    high: float


@dataclass(frozen=True)
class Pair:
    """Two controllers on the same plants.

    Attributes:
        first, second: Names.
        only_first, only_second: Runs that only one of them passed.
        p: Of the exact McNemar test that neither is better.
    """

    first: str
    second: str
    only_first: int
    only_second: int
    p: float


@dataclass(frozen=True, eq=False)
class StudyResult:
    """What came of a study.

    Attributes:
        study: Which.
        runs: All of them, by number.
        resumed: How many were there from before.
        seconds: That the others took.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from hil.study import read_study
        >>> from hil.whatif import run_study
        >>> text = '''
        ... [plant]
        ... model = "Twinproof.Plants.Pendulum"
        ... [plants]
        ... draws = 3
        ... [plants.ranges]
        ... mgl = [3.0, 4.5]
        ... [controllers.stiff]
        ... kind = "pid"
        ... measured = ["theta"]
        ... commanded = ["tau"]
        ... period = "5 ms"
        ... proportional = 20.0
        ... derivative = 1.0
        ... [controllers.none]
        ... kind = "pid"
        ... measured = ["theta"]
        ... commanded = ["tau"]
        ... period = "5 ms"
        ... proportional = 0.0
        ... [references.up.theta]
        ... kind = "step"
        ... at = 0.0
        ... after = "20 deg"
        ... [[criteria]]
        ... kind = "rms"
        ... signal = "theta"
        ... most = "10 deg"
        ... [run]
        ... duration = 1.0
        ... step = "1 ms"
        ... '''
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "lift.toml"
        ...     _ = path.write_text(text)
        ...     result = run_study(read_study(path), workers=0)
        >>> len(result.runs), result.passed
        (6, False)
        >>> result.rate("stiff").passed, result.rate("none").passed
        (3, 0)
        >>> [run.case.controller for run in result.worst(1)]
        ['none']
        >>> result.pairs()[0].only_first
        3
    """

    study: Study
    runs: tuple[RunResult, ...]
    resumed: int
    seconds: float
    notes: tuple[str, ...] = field(default=())

    def rate(self, controller: str | None = None, criterion: str | None = None) -> Rate:
        """Return a pass rate: of a controller or all, of a criterion or all."""
        chosen = [r for r in self.runs if controller in (None, r.case.controller)]
        if criterion is None:
            return rate([r.passed for r in chosen], self.study.run.confidence)
        met = [v.passed for r in chosen for v in r.verdicts if v.name == criterion]
        return rate(met, self.study.run.confidence)

    @property
    def passed(self) -> bool:
        """Whether every run passed."""
        return all(r.passed for r in self.runs)

    def worst(self, count: int = _WORST) -> list[RunResult]:
        """Return the worst runs, worst first; only those that failed."""
        failed = [r for r in self.runs if not r.passed]
        return sorted(failed, key=lambda r: r.badness, reverse=True)[:count]

    def pairs(self) -> list[Pair]:
        """Compare the controllers with one another."""
        by_controller = {
            name: {r.case.world: r.passed for r in self.runs if r.case.controller == name}
            for name in self.study.controllers
        }
        names = list(by_controller)
        found: list[Pair] = []
        for k, first in enumerate(names):
            for second in names[k + 1 :]:
                one, other = by_controller[first], by_controller[second]
                a = sum(one[w] and not other[w] for w in one)
                b = sum(other[w] and not one[w] for w in one)
                p = float(binomtest(a, a + b, 0.5).pvalue) if a + b else 1.0
                found.append(Pair(first, second, a, b, p))
        return found


def rate(met: Sequence[bool], confidence: float = 0.95) -> Rate:
    """Return a rate with its exact interval.

    Example:
        >>> found = rate([True] * 10)
        >>> found.passed, round(found.low, 4), found.high
        (10, 0.6915, 1.0)
    """
    if not met:
        return Rate(0, 0, 0.0, 1.0)
    interval = binomtest(sum(met), len(met)).proportion_ci(confidence, method="exact")
    return Rate(sum(met), len(met), float(interval.low), float(interval.high))
