"""From one extension of a model to another: the same record, values and states under new names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fmus.dae import Role
from identification.discovery.extension import ExtendedModel
from identification.experiment import Experiment
from identification.problem import Matrix, Problem, fitted_by_default
from identification.simulator import Simulator
from identification.windows import Window, guess_states


def flat_name(model: ExtendedModel, previous: ExtendedModel, name: str) -> str:
    """Return the flat name that a variable of `previous` has in `model`."""
    return model.flat_name(previous.user_name(name))


def transfer_problem(
    problem: Problem,
    model: ExtendedModel,
    values: Mapping[str, float],
    previous: ExtendedModel,
    *,
    added: Mapping[str, float] | None = None,
) -> Problem:
    """Return the same record for another extension of the model.

    Args:
        problem: Of the previous model.
        model: The other extension.
        values: Of the previous model's parameters, by its own names.
        previous: The previous model.
        added: Values of new parameters, by the new model's names.
    """
    dae = model.dae
    independent = {
        v.name: dae.parameter_values[v.name]
        for v in dae.with_role(Role.PARAMETER)
        if v.name not in dae.dependent_parameters
    }
    carried = {flat_name(model, previous, name): value for name, value in values.items()}
    independent.update({k: v for k, v in carried.items() if k in independent})
    independent.update(added or {})
    # What the user asked to hold stays held; what is new is free.
    base_free = {flat_name(model, previous, name) for name in problem.free}
    known = {flat_name(model, previous, name) for name in problem.values}
    free = tuple(
        name
        for name in independent
        if name in base_free or (name in fitted_by_default(dae) and name not in known)
    )
    sensors = tuple(f"{a.instance}." for a in model.additions if a.place.kind == "output")
    following = tuple(v.name for v in dae.states if sensors and v.name.startswith(sensors))
    return replace(
        problem,
        dae=dae,
        free=free,
        values=independent,
        following=following,
        priors=model.priors,
    )


def transfer_problems(
    experiment: Experiment,
    model: ExtendedModel,
    values: Mapping[str, float],
    previous: ExtendedModel,
) -> list[Problem]:
    """Return all records of an experiment for another extension (see `transfer_problem`)."""
    return [transfer_problem(problem, model, values, previous) for problem in experiment.problems]


def transfer_all_states(
    larger: Experiment,
    model: ExtendedModel,
    experiment: Experiment,
    previous: ExtendedModel,
    x0: Matrix,
) -> Matrix:
    """Return (windows of all records, nx) initial states (see `transfer_states`).

    Args:
        larger, model: The other extension on the same records.
        experiment, previous: The previous model.
        x0: (windows of all records, nx) its initial states.
    """
    counts = np.cumsum([len(one.windows) for one in experiment.records])[:-1]
    return np.concatenate(
        [
            transfer_states(new.problem, new.shooting, model, old.windows, old, previous, own)
            for new, old, own in zip(
                larger.records, experiment.records, np.split(x0, counts), strict=True
            )
        ]
    )


def transfer_states(
    problem: Problem,
    shooting: Simulator,
    model: ExtendedModel,
    windows: Sequence[Window],
    experiment: Experiment,
    previous: ExtendedModel,
    x0: Matrix,
) -> Matrix:
    """Return (windows, nx) initial states: the previous model's, and guesses for new ones.

    Args:
        problem, shooting, model: The other extension.
        windows: Of both.
        experiment, previous: The previous model on the same record.
        x0: (windows, nx) its initial states.
    """
    states = guess_states(problem, shooting, windows)
    names = experiment.shooting.state_names
    old = {previous.user_name(name): i for i, name in enumerate(names)}
    for j, name in enumerate(shooting.state_names):
        i = old.get(model.user_name(name))
        if i is not None:
            states[:, j] = x0[:, i]
    return states
