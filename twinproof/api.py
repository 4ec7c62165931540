"""What the commands do, as Python calls."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foundation.errors import InputError, UnsupportedModelError
from identification import comparison
from identification.comparison import Comparison
from identification.discovery import diagnosis as discovery
from identification.discovery import ladder
from identification.discovery.diagnosis import Diagnosis
from identification.discovery.extension import (
    ExtendedModel,
    parse_addition,
)
from identification.discovery.extension import (
    extend as write_extension,
)
from identification.discovery.ladder import Improvement
from identification.doubts import check_motion, with_doubts
from identification.estimate import Estimate
from identification.estimators import estimator
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.prediction import choose_horizon
from identification.problem import Problem, match
from recordings import Recording
from recordings import load as load_recording
from twinproof.model import Model

Progress = Callable[[str], None]
Horizon = float | str | None


def read_recording(
    data: str | Path, model: Model, *, channel_map: Path | None = None, dbc: Path | None = None
) -> Recording:
    """Read a recording in a model's names and units.

    Args:
        data: A file, or the name of a registered data set.
        model: Whose inputs and outputs are wanted.
        channel_map: Which column or signal is which variable.
        dbc: Describes a CAN log.

    Raises:
        RecordingError: The data are not there, damaged, or do not fit the model.
    """
    return load_recording(
        data,
        variables=model.variables,
        channel_map=channel_map,
        dbc=dbc,
        inputs=[v.name for v in model.dae.inputs],
    )


@dataclass(frozen=True)
class Compared:
    """The outcome of `compare`.

    Attributes:
        problem: Model and record, matched.
        comparison: Errors, and where the model fails.
        horizon: Window length [s]; None for the free simulation.
    """

    problem: Problem
    comparison: Comparison
    horizon: float | None


def compare(
    model: Model,
    recording: Recording,
    *,
    parameters: Mapping[str, float] | None = None,
    horizon: Horizon = "auto",
) -> Compared:
    """Simulate a model with a recording's inputs and compare.

    Args:
        model: The model, with its declared parameter values.
        recording: From `read_recording`.
        parameters: Values that replace declared ones.
        horizon: `auto`: the free simulation where it stays bounded, else windows of 1 s;
            `free`; or a window length [s].

    Raises:
        InputError: See `read_recording` and `identification.problem.match`.
    """
    problem = match(model.dae, recording, free=(), values=parameters)
    experiment = Experiment.of(problem, through_fmi=True)
    chosen = horizon_of(horizon, experiment)
    prediction = experiment.predict(problem.values, chosen)
    if not np.any(np.isfinite(prediction.error)):
        raise UnsupportedModelError(
            f"{model.word} leaves the finite numbers at once",
            where=recording.origin,
            remedy="check units and signs of the inputs, or give values with --param",
        )
    return Compared(problem, comparison.compare(problem, experiment.shooting, prediction), chosen)


def horizon_of(horizon: Horizon, experiment: Experiment) -> float | None:
    """Return the window length that a user's word means; None for the free simulation."""
    if horizon is None or horizon == "free":
        return None
    if horizon == "auto":
        return choose_horizon(experiment.problem, experiment.shooting, experiment.problem.values)
    try:
        seconds = float(horizon)
    except ValueError:
        seconds = float("nan")
    if not seconds > 2 * experiment.problem.sample_time:
        raise InputError(
            f"the horizon '{horizon}' is not usable",
            where="--horizon",
            remedy="write auto, free, or a length in seconds",
        )
    return seconds


@dataclass(frozen=True)
class Identified:
    """The outcome of `identify`."""

    problem: Problem
    estimate: Estimate
    comparison: Comparison
    horizon: float | None


def identify(
    model: Model,
    recording: Recording,
    *,
    method: str = "auto",
    free: Collection[str] | None = None,
    parameters: Mapping[str, float] | None = None,
    horizon: Horizon = "auto",
) -> Identified:
    """Fit a model's parameters to a recording.

    Args:
        model: The model.
        recording: From `read_recording`.
        method: A word of `identification.estimators.ESTIMATORS`.
        free: What to fit; None: everything tunable that is not declared known.
        parameters: Starting values, and values of what is held.
        horizon: For the errors reported, as in `compare`.

    Raises:
        InputError: See `compare`; an estimator that does not suit the model says so.
        DivergenceError: No start led anywhere.
    """
    chosen = estimator(method)
    problem = match(model.dae, recording, free=free, values=parameters)
    if not problem.free:
        raise InputError(
            f"{model.word} has no parameter to fit",
            where="MODEL",
            remedy="declare one tunable, or name it with --free",
        )
    check_motion(problem)
    estimate = with_doubts(problem, chosen.estimate(problem))
    fitted = problem.with_values(estimate.values)
    experiment = Experiment.of(fitted, through_fmi=True)
    length = horizon_of(horizon, experiment)
    prediction = experiment.predict(fitted.values, length)
    return Identified(
        fitted, estimate, comparison.compare(fitted, experiment.shooting, prediction), length
    )


@dataclass(frozen=True)
class Diagnosed:
    """The outcome of `diagnose`."""

    problem: Problem
    diagnosis: Diagnosis
    comparison: Comparison
    horizon: float | None


def diagnose(
    model: Model,
    recording: Recording,
    *,
    parameters: Mapping[str, float] | None = None,
    free: Collection[str] | None = None,
    progress: Progress = lambda _: None,
) -> Diagnosed:
    """Fit a model and find out which physical effect it lacks.

    Args:
        model: The model.
        recording: From `read_recording`.
        parameters: Starting values.
        free: What to fit.
        progress: Told what is being done.

    Raises:
        InputError: See `identify`.
    """
    problem = match(model.dae, recording, free=free, values=parameters)
    experiment = Experiment.of(problem)
    progress("fitting the model as it is")
    fit = experiment.fit_stages(best_start(experiment).values)[-1]
    found = discovery.diagnose(
        write_extension(model.source, []), experiment, fit, progress=progress
    )
    length = horizon_of("auto", experiment)
    prediction = experiment.predict(fit.values, length, sd=fit.sd)
    return Diagnosed(
        problem, found, comparison.compare(problem, experiment.shooting, prediction), length
    )


def extend(model: Model, additions: Collection[str], *, name: str | None = None) -> ExtendedModel:
    """Write the Modelica class that has effects added.

    Args:
        model: The model.
        additions: `EFFECT@PLACE[,P=V]…`.
        name: Class name.

    Raises:
        UnknownNameError: No such effect, place or parameter.
        ModelicaError: The result does not compile.
    """
    if not additions:
        raise InputError(
            "nothing to add", where="--add", remedy="name an effect and a place: EFFECT@PLACE"
        )
    extended = write_extension(
        model.source, [parse_addition(text, model.source) for text in additions], name=name
    )
    _ = extended.dae  # what is written must compile
    return extended


@dataclass(frozen=True)
class Improved:
    """The outcome of `improve`."""

    problem: Problem
    holdout: Problem | None
    improvement: Improvement


def improve(
    model: Model,
    recording: Recording,
    holdout: Recording | None = None,
    *,
    max_effects: int = 4,
    parameters: Mapping[str, float] | None = None,
    free: Collection[str] | None = None,
    horizon: Horizon = "auto",
    progress: Progress = lambda _: None,
) -> Improved:
    """Compare, diagnose, extend, refit, step by step, and score on unseen data once at the end.

    Args:
        model: The model.
        recording: To fit.
        holdout: An unseen record of the same machine.
        max_effects: At most this many effects are added.
        parameters: Starting values.
        free: What to fit of the user's own parameters.
        horizon: As in `compare`.
        progress: Told what is being done.

    Raises:
        InputError: See `identify`; the hold-out is the fitted record.
    """
    if max_effects < 0:
        raise InputError(
            f"{max_effects} effects cannot be added", where="--max-effects", remedy="give 0 or more"
        )
    problem = match(model.dae, recording, free=free, values=parameters)
    unseen: Problem | None = None
    if holdout is not None:
        unseen = match(model.dae, holdout, free=free, values=parameters)
        if fingerprint(unseen) == fingerprint(problem):
            raise InputError(
                "the hold-out is the fitted record itself",
                where=holdout.origin,
                remedy="give another record: an error on data that the fit has seen proves nothing",
            )
        if unseen.output_names != problem.output_names:
            raise InputError(
                "the hold-out has other channels than the fitted record "
                f"({', '.join(unseen.output_names)} against {', '.join(problem.output_names)})",
                where=holdout.origin,
                remedy="map the same channels in both",
            )
    length: float | str | None = horizon
    if horizon != "auto":
        length = horizon_of(horizon, Experiment.of(problem))
    found = ladder.improve(
        model.source, problem, unseen, max_effects=max_effects, horizon=length, progress=progress
    )
    return Improved(problem, unseen, found)


def fingerprint(problem: Problem) -> str:
    """Return a hash of a record's numbers."""
    digest = hashlib.sha256()
    for array in (problem.inputs, problem.outputs):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
