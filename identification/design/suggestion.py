"""An excitation that tells the parameters well, within what the plant and its user allow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from fmus.dae import Dae
from foundation.errors import ExcitationError, InputError, UnknownNameError
from foundation.progress import Progress, counted, silent
from identification.design.bound import (
    Bound,
    Criterion,
    bound_of_plan,
    plan,
    simulated,
    start_of,
)
from identification.problem import Matrix, Problem, Vector
from identification.shooting import Shooting


@dataclass(frozen=True)
class Limits:
    """What an experiment may do.

    Attributes:
        amplitude: (nu,) largest deviation of each input from `around`.
        band: Lowest and highest frequency of the excitation [Hz].
        duration: Of the experiment [s].
        step: Between samples [s].
        outputs: Output → lowest and highest value that may occur.
        around: (nu,) inputs at rest; zero if None.
    """

    amplitude: tuple[float, ...]
    band: tuple[float, float]
    duration: float
    step: float = 1e-3
    outputs: Mapping[str, tuple[float, float]] | None = None
    around: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        low, high = self.band
        if not (self.step > 0 and self.duration > 20 * self.step):
            raise InputError(
                f"an experiment of {self.duration:g} s in steps of {self.step:g} s",
                remedy="give a duration of some hundred steps at least",
            )
        if not 0 < low < high < 0.5 / self.step:
            raise InputError(
                f"a band from {low:g} to {high:g} Hz",
                remedy=f"give two frequencies up to {0.5 / self.step:g} Hz, the lower one first",
            )
        if not all(a > 0 for a in self.amplitude):
            raise InputError(
                f"amplitudes {self.amplitude}", remedy="give a positive one for every input"
            )

    @property
    def time(self) -> Vector:
        """(n,) samples [s]."""
        return np.arange(round(self.duration / self.step), dtype=np.float64) * self.step


@dataclass(frozen=True)
class Suggestion:
    """An excitation within the limits.

    Attributes:
        problem: The experiment: time, inputs, expected outputs.
        bound: What it can tell.
        family: What it began as: `flat`, `low`, `high`, `chirp` or `steps`, refined if a multisine.
        tried: Family → its cost before refinement, for comparison.
    """

    problem: Problem
    bound: Bound
    family: str
    tried: Mapping[str, float]


_LINES = 12
_TRIES = 150


def suggest(
    dae: Dae,
    limits: Limits,
    *,
    noise_sd: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
    free: Sequence[str] | None = None,
    values: Mapping[str, float] | None = None,
    criterion: Criterion = "D",
    tries: int = _TRIES,
    seed: int = 0,
    progress: Progress = silent,
) -> Suggestion:
    """Search for an input that tells the parameters well.

    Multisines with flat, falling and rising spectra, a chirp and random steps are compared; the
    best multisine's amplitudes and phases are then changed at random, keeping what helps, with all
    scaled to the limits. It is a local search: good, not the best there is.

    Args:
        dae: The model.
        limits: What the experiment may do.
        noise_sd, outputs, free, values: As for `plan`.
        criterion: `D`: the volume of the uncertainty (mean log relative deviation) is made small;
            `A`: the root mean square of the relative deviations.
        tries: Changes tried.
        seed: Of the changes.
        progress: Told how many excitations have been tried.

    Raises:
        ExcitationError: Even a faint input makes the plant run away or leave its limits.
        InputError: Limits that do not fit the model.
    """
    nu = len(dae.inputs)
    if nu == 0 or len(limits.amplitude) not in (1, nu):
        raise InputError(
            f"{len(limits.amplitude)} amplitudes for {nu} inputs of {dae.name}",
            remedy="give one for every input",
        )
    for name in limits.outputs or {}:
        if name not in [v.name for v in dae.outputs]:
            raise UnknownNameError("output", name, [v.name for v in dae.outputs], where=dae.name)
    search = _Search(dae, limits, noise_sd, outputs, free, values, criterion)
    judged = ((name, search.judge(make(search))) for name, make in _FAMILIES.items())
    found = dict(counted(progress, "trying families of excitations", judged, len(_FAMILIES)))
    tried = {name: cost for name, (cost, _, _) in found.items()}
    family = min(tried, key=lambda name: tried[name])
    if not np.isfinite(tried[family]):
        raise ExcitationError(
            f"{dae.name} leaves its limits under every input tried, however faint",
            remedy="widen the limits of the outputs; an unstable plant needs its controller",
        )
    best = found[family]
    spectrum = min((n for n in _SPECTRA), key=lambda name: tried[name])
    improved = search.refine(_SPECTRA[spectrum](search), tries, seed, progress)
    if improved[0] < best[0]:
        family, best = f"multisine from {spectrum}", improved
    return Suggestion(best[1], best[2], family, tried)


Judged: TypeAlias = "tuple[float, Problem, Bound]"


@dataclass(frozen=True)
class _Multisine:
    """Amplitudes and phases of the lines, (nu, lines) each."""

    amplitudes: Matrix
    phases: Matrix


def schroeder_phases(lines: int) -> Vector:
    """Return (lines,) phases that keep the peak of a multisine low.

    M. R. Schroeder, IEEE Trans. Information Theory 16 (1970) 85, for equal amplitudes.

    Example:
        >>> t = np.linspace(0, 1, 2000, endpoint=False)
        >>> turns = 2 * np.pi * np.outer(t, np.arange(1, 21))
        >>> bool(np.max(np.cos(turns + schroeder_phases(20)).sum(axis=1)) < 10)
        True
    """
    k = np.arange(lines)
    return -np.pi * k * (k + 1) / lines


class _Search:
    def __init__(
        self,
        dae: Dae,
        limits: Limits,
        noise_sd: Mapping[str, float] | None,
        outputs: Sequence[str] | None,
        free: Sequence[str] | None,
        values: Mapping[str, float] | None,
        criterion: Criterion,
    ) -> None:
        self.limits = limits
        self.criterion: Criterion = criterion
        self.nu = len(dae.inputs)
        self.time = limits.time
        self.amplitude = np.broadcast_to(np.array(limits.amplitude, dtype=float), (self.nu,))
        self.around = np.zeros(self.nu) if limits.around is None else np.array(limits.around)
        rest = np.tile(self.around, (len(self.time), 1))
        self.problem = plan(
            dae, self.time, rest, noise_sd=noise_sd, outputs=outputs, free=free, values=values
        )
        self.shooting = Shooting(dae, self.problem.output_names, self.problem.free)
        watched = [v.name for v in dae.outputs]
        self.watch = (
            Shooting(dae, watched, (), briefly=True)
            if set(limits.outputs or {}) - set(self.problem.output_names)
            else None
        )
        low, high = limits.band
        lines = np.geomspace(low, high, _LINES * self.nu)
        # Whole periods in the record, each line once, inputs taking turns.
        periods = np.unique(np.maximum(np.round(lines * limits.duration), 1))
        self.lines = [periods[i :: self.nu] / limits.duration for i in range(self.nu)]

    def signal(self, multisine: _Multisine) -> Matrix:
        """Return (n, nu) of unit peak."""
        columns = [
            np.cos(2 * np.pi * np.outer(self.time, lines) + phase[: len(lines)])
            @ amplitude[: len(lines)]
            for lines, amplitude, phase in zip(
                self.lines, multisine.amplitudes, multisine.phases, strict=True
            )
        ]
        return np.column_stack([c / np.max(np.abs(c)) for c in columns])

    def judge(self, signal: Matrix) -> Judged:
        """Scale a signal of unit peak to the limits; the cost is infinite if that cannot be."""
        scale, too_large, found = 1.0, 1.0, self._at(signal, 1.0)
        while found is None and scale > _FAINTEST:
            scale, too_large = 0.5 * scale, scale
            found = self._at(signal, scale)
        if found is None:
            return np.inf, self.problem, bound_of_plan(self.problem, self.shooting)
        for _ in range(_BISECTIONS if scale < 1 else 0):
            middle = 0.5 * (scale + too_large)
            larger = self._at(signal, middle)
            if larger is None:
                too_large = middle
            else:
                scale, found = middle, larger
        bound = bound_of_plan(found, self.shooting)
        return bound.cost(self.criterion), found, bound

    def _at(self, signal: Matrix, scale: float) -> Problem | None:
        inputs = self.around + scale * self.amplitude * signal
        try:
            problem = simulated(replace(self.problem, inputs=inputs), self.shooting)
        except ExcitationError:
            return None
        return problem if self._inside(problem) else None

    def _inside(self, problem: Problem) -> bool:
        allowed = self.limits.outputs or {}
        names, outputs = problem.output_names, problem.outputs
        if self.watch is not None:
            p = self.watch.parameter_vector(problem.values)
            inputs = self.watch.inputs_with_delays(problem.inputs, problem.sample_time, p)
            x0 = start_of(problem, self.watch)
            names = self.watch.output_names
            outputs = self.watch.run(x0, inputs, p, problem.sample_time).outputs
        low = np.array([allowed.get(n, (-np.inf, np.inf))[0] for n in names])
        high = np.array([allowed.get(n, (-np.inf, np.inf))[1] for n in names])
        return bool(np.all((outputs >= low) & (outputs <= high)))

    def refine(self, start: _Multisine, tries: int, seed: int, progress: Progress) -> Judged:
        """Change a multisine at random, keeping what helps; the steps adapt to success."""
        random = np.random.default_rng(seed)
        current, best = start, self.judge(self.signal(start))
        size = 0.5
        for _ in counted(progress, "changing the best one", range(tries), tries):
            shape = current.amplitudes.shape
            trial = _Multisine(
                current.amplitudes * np.exp(size * random.standard_normal(shape)),
                current.phases + size * random.standard_normal(shape),
            )
            judged = self.judge(self.signal(trial))
            if judged[0] < best[0]:
                current, best, size = trial, judged, min(1.0, 1.5 * size)
            else:
                size = max(0.02, 0.93 * size)
        return best

    def multisine(self, slope: float) -> _Multisine:
        """Return amplitudes f^slope with Schroeder's phases."""
        width = max(len(lines) for lines in self.lines)
        amplitudes, phases = np.ones((self.nu, width)), np.zeros((self.nu, width))
        for i, lines in enumerate(self.lines):
            amplitudes[i, : len(lines)] = lines**slope
            phases[i, : len(lines)] = schroeder_phases(len(lines))
        return _Multisine(amplitudes, phases)


_FAINTEST = 1e-5  # of the amplitude allowed
_BISECTIONS = 3


def _chirp(search: _Search) -> Matrix:
    low, high = search.limits.band
    t, end = search.time, search.limits.duration
    turns = low * t + 0.5 * (high - low) * t**2 / end
    return np.column_stack(
        [np.sin(2 * np.pi * (turns + i / search.nu / 2)) for i in range(search.nu)]
    )


def _steps(search: _Search) -> Matrix:
    """Random telegraph signal; held for at least half a period of the band's upper end."""
    random = np.random.default_rng(1)
    hold = max(1, round(0.5 / search.limits.band[1] / search.limits.step))
    count = -(-len(search.time) // hold)
    levels = random.choice([-1.0, 1.0], (count, search.nu))
    return np.repeat(levels, hold, axis=0)[: len(search.time)]


_SPECTRA: Mapping[str, Callable[[_Search], _Multisine]] = {
    "flat": lambda search: search.multisine(0.0),
    "low": lambda search: search.multisine(-1.0),
    "high": lambda search: search.multisine(1.0),
}
_FAMILIES: Mapping[str, Callable[[_Search], Matrix]] = {
    "flat": lambda search: search.signal(search.multisine(0.0)),
    "low": lambda search: search.signal(search.multisine(-1.0)),
    "high": lambda search: search.signal(search.multisine(1.0)),
    "chirp": _chirp,
    "steps": _steps,
}
