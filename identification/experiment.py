"""A model compiled for one record, and its fit through windows of growing length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fmus.black_box import BlackBox, black_box
from fmus.frontend import with_values
from fmus.in_series import SeriesModel
from fmus.package import cached_fmu
from foundation.errors import ChannelError, DivergenceError, UnsupportedModelError
from identification.fmu_shooting import FmuShooting
from identification.gauss_newton import ITERATIONS, Fit, fit_together
from identification.linearisation import Part
from identification.prediction import WINDOW, Prediction, noise_estimate, predict
from identification.priors import NO_PRIORS, Prior
from identification.problem import Matrix, Problem, Vector
from identification.series_shooting import SeriesShooting
from identification.shooting import Shooting
from identification.simulator import Simulator
from identification.windows import Window, cut, fitting_length, guess_states

STAGES = (0.25, 0.5, 1.0)
"""Window lengths of the continuation, as shares of `WINDOW`: short windows forgive a bad start."""


@dataclass(frozen=True)
class Experiment:
    """A problem with its model compiled for simulation with sensitivities.

    Attributes:
        problem: Model and record.
        shooting: The model, with sensitivities of the free parameters.
        also: Further records of the same machine, which are fitted at once with this one.
        window: Length of the windows that are fitted [s].
    """

    problem: Problem
    shooting: Simulator
    also: tuple[Experiment, ...] = ()
    window: float = WINDOW

    @classmethod
    def of(cls, problem: Problem, *, through_fmi: bool = False) -> Experiment:
        """Compile a problem's model.

        Args:
            problem: Model and record.
            through_fmi: Run a model that has no exact sensitivities here, because it changes its
                state at events or solves nonlinear equations, as an FMU instead.

        Raises:
            UnsupportedModelError: The model cannot be simulated with sensitivities.
            FmuError: It is an FMU that does not load.
        """
        model, outputs, free = problem.dae, problem.output_names, problem.free
        if isinstance(model, BlackBox) and not isinstance(model, SeriesModel):
            return cls(problem, FmuShooting(model, outputs, free))
        try:
            return cls(problem, simulator_of(problem))
        except UnsupportedModelError:
            if not through_fmi:
                raise
        return cls(problem, FmuShooting(black_box(_compiled(problem)), outputs, free))

    @classmethod
    def together(cls, problems: Sequence[Problem], *, through_fmi: bool = False) -> Experiment:
        """Compile the model of several records of one machine, which are to be fitted at once.

        Args:
            problems: Of the same model; the first is what pictures and free simulations are of.
            through_fmi: As in `of`.

        Raises:
            ChannelError: They have not the same channels.
            UnsupportedModelError: See `of`.
        """
        first = cls.of(problems[0], through_fmi=through_fmi)
        return replace(first, also=tuple(first.beside(other) for other in problems[1:]))

    @property
    def records(self) -> tuple[Experiment, ...]:
        """Every record that is fitted, this one first."""
        return (self, *self.also)

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Of every record."""
        return tuple(e.problem for e in self.records)

    def parts(self, seconds: float | None = None) -> list[Part]:
        """Return every record, cut into windows to fit, or of another length [s]."""
        length = self.window if seconds is None else seconds
        return [Part(e.problem, e.shooting, e.cut(length)) for e in self.records]

    def lasting(self, seconds: float) -> Experiment:
        """Return the same experiment with windows of another length [s]."""
        also = tuple(other.lasting(seconds) for other in self.also)
        return replace(self, window=seconds, also=also)

    def fit(
        self,
        x0: Matrix,
        values: Mapping[str, float],
        *,
        free: Sequence[str] | None = None,
        fixed_sd: Vector | None = None,
        iterations: int = ITERATIONS,
    ) -> Fit:
        """Fit all records over their windows (see `gauss_newton.fit_together`)."""
        return fit_together(
            self.parts(), x0, values, free=free, fixed_sd=fixed_sd, iterations=iterations
        )

    def noise(self) -> Vector:
        """Return (channels of all records,) standard deviations of the sensors' noise."""
        return np.concatenate([noise_estimate(problem) for problem in self.problems])

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """The record in windows to fit, or as long as it is."""
        return self.cut(self.window)

    @property
    def short(self) -> float | None:
        """Length of the windows over which steps are judged [s]; None if none can begin."""
        anywhere = self.shooting.begins_anywhere
        return fitting_length(WINDOW, self.problem.sample_time) if anywhere else None

    def cut(self, seconds: float) -> tuple[Window, ...]:
        """Cut the record into windows to fit, longer where they would hold too few samples.

        A model of which no state can be set, such as a foreign FMU, is run over the whole record:
        in windows it would start anew from its own start each time.
        """
        h = self.problem.sample_time
        length = fitting_length(seconds, h) if self.shooting.begins_anywhere else None
        return cut(len(self.problem.time), h, length)

    def guess(self, windows: Sequence[Window]) -> Matrix:
        """Return (windows, nx) initial states from the measurement alone."""
        return guess_states(self.problem, self.shooting, windows)

    def fit_stages(
        self,
        values: Mapping[str, float] | None = None,
        *,
        fixed_sd: Vector | None = None,
        stages: Sequence[float] | None = None,
    ) -> tuple[Fit, ...]:
        """Fit with windows of growing length, each stage from the one before.

        Args:
            values: To start from; what is not given is the first problem's.
            fixed_sd: (channels of all records,) weights.
            stages: Window lengths as shares of `WINDOW`; default: up to this experiment's own.

        Raises:
            DivergenceError: No stage stayed finite.
        """
        if stages is None:
            stages = [s for s in STAGES if s * WINDOW <= self.window] or STAGES[:1]
        return fit_stages(self.records, values, fixed_sd=fixed_sd, stages=stages)

    def followed(self, values: Mapping[str, float]) -> tuple[Experiment, Fit]:
        """Fit with windows of growing length, up to the longest over which a fit converges.

        An unstable machine's model that lacks something is carried off within a second, and what it
        lacks no longer shows in where it ends: there the fit finds no way down, and shorter windows
        are kept.

        Returns:
            The experiment with these windows, and its fit.

        Raises:
            DivergenceError: No stage stayed finite.
        """
        fits = self.fit_stages(values, stages=STAGES)
        kept = next((f for f in reversed(fits) if f.converged), fits[-1])
        # A stage whose windows are those of a shorter one was left out.
        lengths = (self.lasting(share * WINDOW) for share in reversed(STAGES))
        return next(e for e in lengths if _count(e) == len(kept.x0)), kept

    def predict(
        self,
        values: Mapping[str, float],
        horizon: float | None,
        *,
        sd: Vector | None = None,
        windows: Sequence[Window] | None = None,
    ) -> Prediction:
        """Predict this record (see `identification.prediction.predict`).

        Args:
            sd: (channels of all records,) as a fit has them: the first record's are used.
        """
        if sd is not None:
            sd = sd[: len(self.problem.output_names)]
        return predict(self.problem, self.shooting, values, horizon, sd=sd, windows=windows)

    def on(self, problem: Problem) -> Experiment:
        """Return the same compiled model on another record."""
        return Experiment(problem, self.shooting, window=self.window)

    def beside(self, problem: Problem) -> Experiment:
        """Return another record of the same machine, with a model of its own if it needs one.

        Raises:
            ChannelError: It has other channels.
        """
        if problem.output_names != self.problem.output_names:
            raise ChannelError(
                f"the records have other channels ({', '.join(problem.output_names)} against "
                f"{', '.join(self.problem.output_names)})",
                remedy="map the same channels in all",
            )
        # An FMU takes all inputs alike.
        same = problem.measured_inputs == self.problem.measured_inputs
        if same or not isinstance(self.shooting, Shooting):
            return self.on(problem)
        return Experiment(problem, self.shooting.with_measured(problem.measured_inputs))


def _count(experiment: Experiment) -> int:
    return sum(len(record.windows) for record in experiment.records)


def simulator_of(
    problem: Problem, sensitive: Sequence[str] | None = None, *, briefly: bool = False
) -> Simulator:
    """Compile a problem's model, or the blocks around an FMU (see `Shooting.of`).

    Raises:
        UnsupportedModelError: It cannot be simulated with sensitivities.
        FmuError: The FMU does not load.
    """
    if isinstance(problem.dae, SeriesModel):
        return SeriesShooting.of(problem, problem.dae, sensitive, briefly=briefly)
    return Shooting.of(problem, sensitive, briefly=briefly)


def fit_stages(
    experiments: Sequence[Experiment],
    values: Mapping[str, float] | None = None,
    *,
    fixed_sd: Vector | None = None,
    priors: Mapping[str, Prior] = NO_PRIORS,
    stages: Sequence[float] = STAGES,
) -> tuple[Fit, ...]:
    """Fit one model to one or several records, with windows of growing length.

    Args:
        experiments: Of the same model, with the same channels and free parameters.
        values: To start from; what is not given is the first problem's.
        fixed_sd: (channels of all records,) weights.
        priors: What is known of parameters beforehand.
        stages: Window lengths as shares of `WINDOW`.

    Raises:
        DivergenceError: No stage stayed finite.
    """
    problem = experiments[0].problem
    current = {**problem.values, **(values or {})}
    fits: list[Fit] = []
    # Longer windows begin where shorter ones did, in the states found there.
    known: dict[tuple[int, int], Vector] = {}
    for share in stages:
        parts = [Part(e.problem, e.shooting, e.cut(share * WINDOW)) for e in experiments]
        begins = [(k, w.begin) for k, part in enumerate(parts) for w in part.windows]
        if fits and len(begins) == len(fits[-1].x0):
            continue
        guesses = np.concatenate(
            [e.guess(part.windows) for e, part in zip(experiments, parts, strict=True)]
        )
        x0 = np.array([known.get(at, x) for at, x in zip(begins, guesses, strict=True)])
        found = fit_together(parts, x0, current, fixed_sd=fixed_sd, priors=priors)
        if np.isfinite(found.at.cost):
            fits.append(found)
            current = dict(found.values)
            known = dict(zip(begins, found.x0, strict=True))
    if not fits:
        raise DivergenceError(
            f"the simulation of {problem.dae.name} leaves the finite numbers from every start",
            remedy="give better starting values with --param",
        )
    return tuple(fits)


def _compiled(problem: Problem) -> Path:
    """Return the FMU of a problem's model; what it will not let be set is put in."""
    model = problem.dae
    declared = model.parameter_values
    baked = {
        name: value
        for name, value in problem.values.items()
        if not model.variables[name].tunable and value != declared[name]
    }
    return cached_fmu(with_values(model, baked))
