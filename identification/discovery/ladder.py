"""The whole journey: fit, diagnose, add, refit, step by step, scored on unseen data once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from fmus.sources import ModelicaSource
from foundation.errors import DivergenceError
from foundation.progress import Progress, silent
from identification.comparison import Comparison, compare
from identification.discovery.climb import Rung, climb
from identification.discovery.crossvalidation import Verdict
from identification.discovery.diagnosis import Diagnosis, Outcome
from identification.discovery.extension import Addition, ExtendedModel, extend
from identification.discovery.transfer import transfer_problem
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.gauss_newton import Fit
from identification.prediction import WINDOW, Prediction, choose_horizon, noise_estimate
from identification.problem import Problem, Vector


@dataclass(frozen=True)
class Step:
    """One rung: a model, fitted, with its errors.

    Attributes:
        number: 0 is the user's model.
        model: With its fitted parameters and starts as defaults.
        added: What this step added; None at step 0.
        verdict: The cross-validation that let it in.
        fit: Parameters with covariance.
        train: Prediction of the fitted record, the first of several.
        also: Predictions of the further fitted records.
        holdout: Prediction of the unseen record; None if there is none.
        diagnosis: What this model still lacks.
        contradicted: The unseen record got worse by this step, over one-second windows.
        removed: Earlier effects that this step made needless.
    """

    number: int
    model: ExtendedModel
    added: Addition | None
    verdict: Verdict | None
    fit: Fit
    experiment: Experiment
    train: Comparison
    holdout: Comparison | None
    diagnosis: Diagnosis
    contradicted: bool = False
    removed: tuple[Addition, ...] = ()
    also: tuple[Comparison, ...] = ()


@dataclass(frozen=True)
class Improvement:
    """The finished ladder.

    Attributes:
        outcome: What remains, as a diagnosis of the last model.
        steps: From the user's model up.
        horizon: Window length [s]; None for the free simulation.
        noise_floor: Channel → error that a perfect model would show at this horizon: the sensors'
            noise, and what initial states estimated from noisy samples make of it.
        sensor_noise: Channel → standard deviation of the sensor's noise alone.
    """

    outcome: Outcome
    steps: tuple[Step, ...]
    horizon: float | None
    noise_floor: Mapping[str, float]
    sensor_noise: Mapping[str, float]

    @property
    def added(self) -> tuple[Addition, ...]:
        """The effects added, with their fitted parameters, in order."""
        return self.steps[-1].model.additions


def improve(
    source: ModelicaSource,
    problem: Problem | Sequence[Problem],
    holdout: Problem | None = None,
    *,
    max_effects: int = 4,
    horizon: float | str | None = "auto",
    progress: Progress = silent,
) -> Improvement:
    """Find the missing effects of a model, one by one.

    The hold-out is looked at only after the last step has been decided.

    Args:
        source: The user's model.
        problem: The record to fit, or several of the same machine.
        holdout: An unseen record of the same machine.
        max_effects: At most this many effects.
        horizon: `auto`, None for the free simulation, or a window length [s].
        progress: Told what is being done.

    Raises:
        UnsupportedModelError: The model cannot be simulated with sensitivities.
        DivergenceError: The model cannot be fitted from any start.
        ChannelError: Several records have not the same channels.
    """
    model = extend(source, [])
    problems = [problem] if isinstance(problem, Problem) else list(problem)
    problem = problems[0]
    experiment = Experiment.together(problems)
    progress(f"fitting {source.short_name}")
    experiment, fit = experiment.followed(best_start(experiment).values)
    rungs = climb(model, experiment, fit, max_effects=max_effects, progress=progress)
    progress("scoring all steps, the unseen record for the first time")
    last = rungs[-1]
    if horizon == "auto":
        lengths = [
            choose_horizon(e.problem, e.shooting, last.fit.values) for e in last.experiment.records
        ]
        chosen_horizon = next((length for length in lengths if length is not None), None)
    else:
        assert not isinstance(horizon, str)
        chosen_horizon = horizon
    steps = _score(rungs, problem, holdout, chosen_horizon)
    floor = dict(zip(problem.output_names, steps[-1].train.prediction.floor.tolist(), strict=True))
    noise = dict(zip(problem.output_names, noise_estimate(problem).tolist(), strict=True))
    return Improvement(last.diagnosis.outcome, steps, chosen_horizon, floor, noise)


def _score(
    rungs: list[Rung], problem: Problem, holdout: Problem | None, horizon: float | None
) -> tuple[Step, ...]:
    steps: list[Step] = []
    user = rungs[0].model
    before: Prediction | None = None
    for number, rung in enumerate(rungs):
        fit, train = _best_stage(rung, horizon, whole=rung is rungs[-1])
        model = fitted_model(rung, fit, train.x0[0], number)
        unseen: Comparison | None = None
        contradicted = False
        if holdout is not None:
            record = transfer_problem(
                replace(holdout, free=problem.free), rung.model, fit.values, user
            )
            other = rung.experiment.on(record)
            unseen = compare(
                record,
                other.shooting,
                other.predict(fit.values, horizon, sd=fit.sd),
                user_name=rung.model.user_name,
            )
            # Judged over short windows, like the cross-validation that let the step in: a free
            # simulation of a plant that integrates may drift further with a better model.
            short = other.predict(fit.values, other.short, sd=fit.sd)
            contradicted = before is not None and short.total_nrmse > before.total_nrmse
            before = short
        steps.append(
            Step(
                number,
                model,
                rung.added,
                rung.verdict,
                fit,
                rung.experiment,
                compare(
                    rung.experiment.problem,
                    rung.experiment.shooting,
                    train,
                    user_name=rung.model.user_name,
                ),
                unseen,
                rung.diagnosis,
                contradicted,
                rung.removed,
                tuple(_further(rung, fit, horizon)),
            )
        )
    return tuple(steps)


def _further(rung: Rung, fit: Fit, horizon: float | None) -> Iterator[Comparison]:
    """Compare with the further fitted records."""
    predictions = _predictions(rung.experiment, fit, horizon)
    for record, found in zip(rung.experiment.records, predictions, strict=True):
        if record is not rung.experiment:
            yield compare(record.problem, record.shooting, found, user_name=rung.model.user_name)


def _best_stage(rung: Rung, horizon: float | None, *, whole: bool) -> tuple[Fit, Prediction]:
    """Return the fit that predicts the fitted records best at the horizon, and the first of them.

    Windows of growing length are fitted, and the best fit is kept. The free simulation itself is
    only fitted with all that was found in the model: one that lacks its friction has minima with a
    friction of zero (EMPS). Then whole records are weighted by their channels' deviations, as they
    are scored: by their misfits, one record would be followed to the last digit, another given up.

    Args:
        rung: A step.
        horizon: At which to judge.
        whole: Also fit the free simulation, if that is the horizon.
    """
    experiment, fits = rung.experiment, [rung.fit]
    if horizon is None:
        fits += experiment.fit_stages(rung.fit.values)
    if horizon is None and whole:
        spread = np.concatenate([np.std(p.outputs, axis=0) for p in experiment.problems])
        longest = max(float(p.time[-1]) for p in experiment.problems)
        with suppress(DivergenceError):
            free = experiment.fit_stages(
                fits[-1].values, fixed_sd=spread, stages=(2 * longest / WINDOW,)
            )[-1]
            # How sure the values are is what windows say: residuals of one long simulation
            # correlate all along, and nothing tells how far they scatter.
            last = fits[-1]
            fits.append(replace(free, sd=last.sd, covariance=last.covariance, held=last.held))
    predictions = [list(_predictions(rung.experiment, f, horizon)) for f in fits]
    # A diverged prediction has NaN and never wins.
    errors = [np.linalg.norm([p.total_nrmse for p in every]) for every in predictions]
    best = int(np.argmin(np.nan_to_num(errors, nan=np.inf)))
    return fits[best], predictions[best][0]


def _predictions(experiment: Experiment, fit: Fit, horizon: float | None) -> Iterator[Prediction]:
    """Predict every fitted record."""
    ny = len(experiment.problem.output_names)
    for k, record in enumerate(experiment.records):
        yield record.predict(fit.values, horizon, sd=fit.sd[k * ny :])


def fitted_model(rung: Rung, fit: Fit, x0: Vector, number: int) -> ExtendedModel:
    """Write a rung's model with its fitted parameters and starts as defaults."""
    model = rung.model
    additions = list(model.additions)
    declared = model.dae.parameter_values
    # What the user set by hand belongs to the model as scored, like what was fitted.
    values = {n: v for n, v in fit.values.items() if n in fit.free or v != declared[n]}
    values.update(start_values(rung.experiment, x0))
    by_user = {model.user_name(name): value for name, value in values.items()}
    for k, addition in enumerate(additions):
        prefix = f"{addition.instance}."
        own = {
            name.removeprefix(prefix): by_user.pop(name)
            for name in list(by_user)
            if name.startswith(prefix)
        }
        parameters = {p.name for p in addition.effect.parameters}
        # What is known of it, such as the range of a curve, is not among what was fitted.
        fitted = {name: value for name, value in own.items() if name in parameters}
        additions[k] = replace(
            addition,
            values={**addition.values, **fitted},
            starts={name: value for name, value in own.items() if name not in parameters},
        )
    return extend(model.base, additions, values=by_user, name=f"{model.base.short_name}_{number}")


def start_values(experiment: Experiment, x0: Vector) -> dict[str, float]:
    """Return what gives an initial state: a start parameter, or `<variable>.start`."""
    dae = experiment.problem.dae
    # A state may have the name of one variable and the start of another that equals it.
    declared = {a.of: a for a in dae.aliases.values() if a.declared.fixed}
    parameter_of = {
        state: parameter
        for parameter, state in dae.start_parameters.items()
        if parameter not in dae.dependent_parameters
    }
    found: dict[str, float] = {}
    for state, value in zip(experiment.shooting.state_names, x0, strict=True):
        alias = declared.get(state)
        if state in parameter_of:
            found[parameter_of[state]] = float(value)
        elif alias is not None:
            found[f"{alias.name}.start"] = alias.sign * float(value)
        else:
            found[f"{state}.start"] = float(value)
    return found
