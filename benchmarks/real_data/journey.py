"""From a model that lacks something and two stretches of measured data to the finished ladder."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import twinproof
from benchmarks.figures import Figure
from identification.problem import Vector

HERE = Path(__file__).parent


def as_logged(recording: twinproof.Recording) -> twinproof.Recording:
    """Return a record as it is."""
    return recording


@dataclass(frozen=True)
class Stretch:
    """Part of a registered data set, from `begin` to `end` [s]."""

    data: str
    begin: float
    end: float


@dataclass(frozen=True)
class Journey:
    """A model, what it is fitted to, and what judges it.

    Attributes:
        name: Of the benchmark and its page.
        title: Of the page.
        model: File and class in this folder.
        channel_map: File in this folder; None: the data set's own.
        fitted: What is fitted.
        unseen: What is only scored, once, at the end.
        output: The output whose error is shown.
        expected: Effects that are to be added, in this order.
        limit: Largest error on the unseen stretch, a share of the measurement's deviation.
        source: Of the data, in a sentence.
        free: What is fitted of the model's own parameters; None: all.
        max_effects: At most this many are added.
        also: Further stretches that are fitted at once.
        prepare: What is done to the whole record before it is cut.
    """

    name: str
    title: str
    model: str
    channel_map: str | None
    fitted: Stretch
    unseen: Stretch
    output: str
    expected: tuple[str, ...]
    limit: float
    source: str
    free: Collection[str] | None = None
    max_effects: int = 4
    also: tuple[Stretch, ...] = ()
    prepare: Callable[[twinproof.Recording], twinproof.Recording] = as_logged

    def load(self) -> twinproof.Model:
        """Return the model."""
        return twinproof.Model.of(f"{HERE / self.model}")

    def record(self, stretch: Stretch) -> twinproof.Recording:
        """Read a stretch."""
        chosen = None if self.channel_map is None else HERE / self.channel_map
        whole = twinproof.read_recording(stretch.data, self.load(), channel_map=chosen)
        return self.prepare(whole).between(stretch.begin, stretch.end)

    def walk(self) -> Walked:
        """Do it."""
        model, fitted, unseen = self.load(), self.record(self.fitted), self.record(self.unseen)
        further = [self.record(stretch) for stretch in self.also]
        given = twinproof.compare(model, fitted).comparison
        began = time.perf_counter()
        found = twinproof.improve(
            model, [fitted, *further], unseen, free=self.free, max_effects=self.max_effects
        ).improvement
        return Walked(self, given, found, time.perf_counter() - began)


@dataclass(frozen=True)
class Walked:
    """A journey's outcome.

    Attributes:
        journey: What was done.
        given: The fitted stretch by the model with its declared parameters.
        found: The ladder.
        seconds: How long it took.
    """

    journey: Journey
    given: twinproof.Comparison
    found: twinproof.Improvement
    seconds: float

    @property
    def both(self) -> tuple[float, ...]:
        """Each step's error on both stretches together, over the deviation of both together."""
        name = self.journey.output
        shares: list[float] = []
        for step in self.found.steps:
            assert step.holdout is not None
            error: list[Vector] = []
            measured: list[Vector] = []
            for comparison in (step.train, step.holdout):
                prediction = comparison.prediction
                k = list(comparison.channels).index(name)
                error.append(prediction.error[prediction.scored, k])
                measured.append((prediction.error + prediction.simulated)[:, k])
            rms = np.sqrt(np.mean(np.concatenate(error) ** 2))
            shares.append(float(rms / np.std(np.concatenate(measured))))
        return tuple(shares)

    def figures(self, *, whole: bool = False) -> Iterator[Figure]:
        """Return the figures beside their limits.

        Args:
            whole: The limit is for both stretches together.
        """
        journey, steps = self.journey, self.found.steps
        for step, both in zip(steps, self.both, strict=True):
            assert step.holdout is not None
            label = "as given" if step.added is None else "+ " + step.added.label
            for part, comparison in (("fitted", step.train), ("unseen", step.holdout)):
                nrmse = comparison.channels[journey.output].nrmse
                yield Figure(f"{journey.name} {label}, {part}", 100 * nrmse, None, "%")
            if whole:
                yield Figure(f"{journey.name} {label}, both", 100 * both, None, "%")
        names = [a.effect.name for a in self.found.added]
        right = 0
        for name, wanted in zip(names, journey.expected, strict=False):
            if name not in wanted.split("|"):
                break
            right += 1
        yield Figure(
            f"{journey.name} effects found in order", right, len(journey.expected), "", True
        )
        last = steps[-1].holdout
        assert last is not None
        end = self.both[-1] if whole else last.channels[journey.output].nrmse
        what = "both" if whole else "unseen"
        yield Figure(f"{journey.name} {what}, last step", 100 * end, 100 * journey.limit, "%")
        yield Figure(f"{journey.name} improve, whole", self.seconds, None, "s")
