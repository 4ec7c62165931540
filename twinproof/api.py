"""What the commands do, as Python calls."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from fmus.in_series import model_of
from foundation.errors import InputError, UnsupportedModelError
from foundation.progress import Progress, silent
from identification import comparison
from identification.discovery import diagnosis as discovery
from identification.discovery import ladder
from identification.discovery.drift import missing_or_drifted
from identification.discovery.extension import (
    ExtendedModel,
    parse_addition,
)
from identification.discovery.extension import (
    extend as write_extension,
)
from identification.doubts import check_motion, with_doubts
from identification.estimators import estimator
from identification.estimators.output_error import OutputError
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.prediction import choose_horizon
from identification.priors import Prior
from identification.problem import Problem, match
from recordings import Recording
from recordings import load as load_recording
from twinproof.answers import Compared, Diagnosed, FittedRecord, Identified, Improved
from twinproof.model import Model

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

    Example:
        >>> import tempfile
        >>> from twinproof.pendulum_example import example
        >>> model, record, _ = example()
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     record.to_frame().to_csv(f"{folder}/swing.csv")
        ...     read = read_recording(f"{folder}/swing.csv", model)
        >>> read["theta"].unit, len(read)
        ('rad', 400)
    """
    return load_recording(
        data,
        variables=model.variables,
        channel_map=channel_map,
        dbc=dbc,
        inputs=[v.name for v in model.dae.inputs],
    )


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
    if not experiment.shooting.begins_anywhere:
        raise InputError(
            f"windows cannot be had: no state of {experiment.problem.dae.name} can be set",
            where="--horizon",
            remedy="write free: this FMU can only be run from its own start",
        )
    return seconds


def _common_horizon(horizon: Horizon, experiments: Sequence[Experiment]) -> float | None:
    """Return one horizon for all records: free only where every one stays bounded."""
    return next((s for s in (horizon_of(horizon, e) for e in experiments) if s is not None), None)


def identify(
    model: Model,
    recording: Recording | Sequence[Recording],
    *,
    method: str = "auto",
    free: Collection[str] | None = None,
    parameters: Mapping[str, float] | None = None,
    horizon: Horizon = "auto",
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> Identified:
    """Fit a model's parameters to one recording, or to several of one machine at once.

    Args:
        model: The model.
        recording: From `read_recording`; several share the parameters and keep their own initial
            states and weights, which is output error's (and `auto`'s) to do.
        method: A word of `identification.estimators.ESTIMATORS`.
        free: What to fit; None: everything tunable that is not declared known.
        parameters: Starting values, and values of what is held.
        horizon: For the errors reported, as in `compare`.
        priors: What is known of fitted parameters beforehand, (value, standard deviation); again
            for output error. The fit starts there unless `parameters` says otherwise.

    Raises:
        InputError: See `compare`; an estimator that does not suit the model says so.
        ChannelError: Several records have not the same channels.
        DivergenceError: No start led anywhere.

    Example:
        >>> from recordings import Channel
        >>> def pushed(volts):
        ...     t = np.arange(100) * 0.01
        ...     q = volts * (t + 0.5 * np.expm1(-2 * t)) / 6
        ...     channels = (Channel("vir", np.full(100, volts)), Channel("q", q))
        ...     return Recording(t, {c.name: c for c in channels})
        >>> model = Model.of("Twinproof.Plants.Positioner")
        >>> found = identify(model, [pushed(1.0), pushed(-1.0)], priors={"M": (95.0, 1.0)})
        >>> len(found.records), found.estimate.method
        (2, 'output-error')
    """
    recordings = _as_list(recording)
    known = {name: Prior(*numbers) for name, numbers in (priors or {}).items()}
    together = len(recordings) > 1 or bool(known)
    chosen = _for_output_error(method, known) if together else estimator(method)
    values = {**{name: prior.value for name, prior in known.items()}, **(parameters or {})}
    problems = [match(model.dae, r, free=free, values=values) for r in recordings]
    problem = problems[0]
    if not problem.free:
        raise InputError(
            f"{model.word} has no parameter to fit",
            where="MODEL",
            remedy="declare one tunable, or name it with --free",
        )
    for r, p in zip(recordings, problems, strict=True):
        check_motion(p, r.origin)
    if isinstance(chosen, OutputError):
        _refuse_copies(recordings, problems)
        estimate = chosen.estimate_together(problems)
    else:
        estimate = chosen.estimate(problem)
    for p in problems:
        estimate = with_doubts(p, estimate)
    first = Experiment.of(problem.with_values(estimate.values), through_fmi=True)
    records: list[FittedRecord] = []
    experiments = [first.beside(p.with_values(estimate.values)) for p in problems]
    length = _common_horizon(horizon, experiments)
    for r, experiment in zip(recordings, experiments, strict=True):
        fitted = experiment.problem
        prediction = experiment.predict(fitted.values, length)
        compared = comparison.compare(fitted, experiment.shooting, prediction)
        records.append(FittedRecord(r.origin, fitted, compared, length))
    return Identified(estimate, tuple(records))


def _for_output_error(method: str, priors: Mapping[str, Prior]) -> OutputError:
    """Return output error for what only it can do.

    Raises:
        InputError: Another method is asked for.
    """
    estimator(method)  # is there such a method at all?
    if method not in ("auto", OutputError.method):
        raise InputError(
            f"{method} takes one recording, and no priors",
            where="--method",
            remedy=f"use --method {OutputError.method}, or leave out --also and --prior",
        )
    return OutputError(priors=priors)


def _as_list(recording: Recording | Sequence[Recording]) -> list[Recording]:
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    if not recordings:
        raise InputError("there is no recording", where="DATA", remedy="give at least one")
    return recordings


def _refuse_copies(recordings: Sequence[Recording], problems: Sequence[Problem]) -> None:
    seen: set[str] = set()
    for recording, problem in zip(recordings, problems, strict=True):
        mark = fingerprint(problem)
        if mark in seen:
            raise InputError(
                "the same record is given twice",
                where=recording.origin,
                remedy="give each once: a copy tells nothing new, and standard deviations would "
                "come out too small",
            )
        seen.add(mark)


def diagnose(
    model: Model,
    recording: Recording | Sequence[Recording],
    *,
    parameters: Mapping[str, float] | None = None,
    free: Collection[str] | None = None,
    verified: Mapping[str, tuple[float, float]] | None = None,
    progress: Progress = silent,
) -> Diagnosed:
    """Fit a model and find out which physical effect it lacks.

    Args:
        model: The model.
        recording: From `read_recording`; several of one machine share the parameters.
        parameters: Starting values.
        free: What to fit.
        verified: Parameters as an earlier record gave them, (value, standard deviation): also asked
            is then whether these have moved.
        progress: Told what is being done.

    Raises:
        InputError: See `identify`.
        ChannelError: Several records have not the same channels.
    """
    recordings = _as_list(recording)
    source = model.extensible
    dae = model_of(source)
    problems = [match(dae, r, free=free, values=parameters) for r in recordings]
    _refuse_copies(recordings, problems)
    experiment = Experiment.together(problems)
    progress("fitting the model as it is")
    experiment, fit = experiment.followed(best_start(experiment).values)
    found = discovery.diagnose(write_extension(source, []), experiment, fit, progress=progress)
    records: list[FittedRecord] = []
    ny = len(problems[0].output_names)
    length = _common_horizon("auto", experiment.records)
    for k, (r, e) in enumerate(zip(recordings, experiment.records, strict=True)):
        prediction = e.predict(fit.values, length, sd=fit.sd[k * ny :])
        compared = comparison.compare(e.problem, e.shooting, prediction)
        records.append(FittedRecord(r.origin, e.problem, compared, length))
    moved = None
    if verified is not None:
        known = {name: Prior(*numbers) for name, numbers in verified.items()}
        moved = missing_or_drifted(source, problems, known, progress=progress)
    return Diagnosed(found, tuple(records), moved)


def extend(model: Model, additions: Collection[str], *, name: str | None = None) -> ExtendedModel:
    """Write the Modelica class that has effects added.

    Args:
        model: The model.
        additions: `EFFECT@PLACE[,P=V]…`.
        name: Class name.

    Raises:
        UnknownNameError: No such effect, place or parameter.
        ModelicaError: The result does not compile.

    Example:
        >>> model = Model.of("Twinproof.Plants.Pendulum")
        >>> better = extend(model, ["CoulombFriction@joint,tau_c=0.15"], name="Worn")
        >>> print(better.class_text.splitlines()[2])
          Twinproof.Effects.Rotational.CoulombFriction coulombFriction_joint(tau_c = 0.15)
        >>> Model.of(better).dae.parameter_values["coulombFriction_joint.tau_c"]
        0.15
    """
    if not additions:
        raise InputError(
            "nothing to add", where="--add", remedy="name an effect and a place: EFFECT@PLACE"
        )
    source = model.extensible
    extended = write_extension(
        source, [parse_addition(text, source) for text in additions], name=name
    )
    _ = extended.dae  # what is written must compile
    return extended


def improve(
    model: Model,
    recording: Recording | Sequence[Recording],
    holdout: Recording | None = None,
    *,
    max_effects: int = 4,
    parameters: Mapping[str, float] | None = None,
    free: Collection[str] | None = None,
    horizon: Horizon = "auto",
    progress: Progress = silent,
) -> Improved:
    """Compare, diagnose, extend, refit, step by step, and score on unseen data once at the end.

    Args:
        model: The model.
        recording: To fit; several of one machine share the parameters.
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
    recordings = _as_list(recording)
    source = model.extensible
    dae = model_of(source)
    problems = [match(dae, r, free=free, values=parameters) for r in recordings]
    _refuse_copies(recordings, problems)
    problem = problems[0]
    unseen: Problem | None = None
    if holdout is not None:
        unseen = match(dae, holdout, free=free, values=parameters)
        if fingerprint(unseen) in map(fingerprint, problems):
            raise InputError(
                "the hold-out is a fitted record itself",
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
        source, problems, unseen, max_effects=max_effects, horizon=length, progress=progress
    )
    return Improved(problem, unseen, found, tuple(r.origin for r in recordings[1:]))


def fingerprint(problem: Problem) -> str:
    """Return a hash of a record's numbers."""
    digest = hashlib.sha256()
    for array in (problem.inputs, problem.outputs):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
