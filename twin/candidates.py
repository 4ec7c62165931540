"""Which parameters to verify next: those of `identify`, then those that the data say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from foundation.errors import InputError
from twin.estimate import Estimate
from twin.excerpt import Excerpt
from twin.follower import Follower
from twin.gate import is_ahead
from twin.improvement import Improvement
from twin.lifecycle import Life
from twin.settings import TwinSettings
from twin.store.documents import ParameterSet

MODELS = "models"
"""Folder beside the settings, for models that effects were added to."""


def identified(settings: TwinSettings, model: str, now: float) -> ParameterSet:
    """Return what a twin starts from.

    Args:
        settings: Of the twin.
        model: Hash of its FMU.
        now: [s].

    Raises:
        InputError: The settings name no parameters.
    """
    fit = settings.plant.fit
    if fit is None:
        raise InputError(
            "the twin has no parameters to start from",
            where=f"{settings.path}, twin {settings.name}",
            remedy='write parameters_from = "fit.json" (of `twinproof identify --json`)',
        )
    values = {**fit.values, **settings.plant.parameters}
    covariance = fit.covariance.tolist()
    return _set(settings, model, now, fit.names, values, covariance, "identify")


def estimated(
    settings: TwinSettings, model: str, estimate: Estimate, reference: ParameterSet
) -> ParameterSet | None:
    """Return the parameters as the data say they are; None: not all are numbers.

    Args:
        settings: Of the twin.
        model: Hash of its FMU.
        estimate: The newest.
        reference: What the plant is compared with.
    """
    values = known_values(estimate, reference)
    matrix = np.asarray(estimate.covariance, dtype=float)
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(list(values.values())))):
        return None
    method = settings.estimator.kind
    time = float(estimate.time)
    return _set(settings, model, time, estimate.names, values, matrix.tolist(), method)


def known_values(estimate: Estimate, reference: ParameterSet) -> dict[str, float]:
    """Return what is followed, and what is held of what was verified.

    The rest are defaults of the model, which its hash covers.
    """
    known = {*estimate.names, *reference.values}
    return {n: float(v) for n, v in estimate.values.items() if n in known}


def arrived(
    settings: TwinSettings,
    model: str,
    life: Life,
    pipeline: Follower,
    reference: ParameterSet,
    now: float,
) -> ParameterSet | None:
    """Return the parameters of the plant as it is now; None: that is not known yet.

    Args:
        settings: Of the twin.
        model: Hash of its FMU.
        life: Of the twin.
        pipeline: With its estimate.
        reference: What the plant is compared with.
        now: [s].
    """
    estimate, newest, since = pipeline.estimate, pipeline.newest, life.followed_since
    if estimate is None or newest is None or since is None:
        return None
    # With an effect the parameters are fitted to the data, wherever the estimate may be.
    fits = life.effect is not None
    # Until then the estimate is still what it started from.
    until = newest if fits else estimate.time
    # A drift ahead was before a clock was set back; telemetry is followed since then.
    begun = since if life.drift is None or is_ahead(life.drift, now) else max(since, life.drift)
    if until - begun < settings.verification.settle:
        return None
    # On its way still it would be verified where the plant is not, and drift be flagged anew.
    if not fits and not estimate.rests:
        return None
    found = estimated(settings, model, estimate, reference)
    return None if found is None else replace(found, time=until)


def improvement(
    settings: TwinSettings,
    roots: tuple[Path, ...],
    life: Life,
    pipeline: Follower,
    candidate: ParameterSet,
) -> Improvement | None:
    """Return what must be added to the model before it is verified, if an effect was found.

    Args:
        settings: Of the twin.
        roots: Folders of further Modelica libraries.
        life: Of the twin.
        pipeline: With the data.
        candidate: To start from.
    """
    if life.effect is None:
        return None
    folder = settings.file(MODELS).resolve()
    # What was recorded before the effect appeared would make it smaller than it is.
    data = excerpt(settings, roots, pipeline, candidate, life.drift)
    return Improvement(data, *life.effect, folder)


def excerpt(
    settings: TwinSettings,
    roots: tuple[Path, ...],
    pipeline: Follower,
    parameters: ParameterSet,
    since: float | None,
) -> Excerpt:
    """Return what the plant did of late, to fit a model to.

    Args:
        settings: Of the twin.
        roots: Folders of further Modelica libraries.
        pipeline: With the data.
        parameters: To start from.
        since: Nothing before is taken [s]; None: all that is kept.
    """
    data, plant = pipeline.predictions, pipeline.plant
    begin = 0 if since is None else int(np.searchsorted(data.time, since))
    return Excerpt(
        settings.plant.model,
        roots,
        1.0 / settings.rate,
        data.inputs[begin:],
        data.measured[begin:],
        data.output_names,
        plant.noise_sd,
        plant.free,
        parameters.values,
    )


def _set(
    settings: TwinSettings,
    model: str,
    time: float,
    names: tuple[str, ...],
    values: Mapping[str, float],
    covariance: list[list[float]],
    method: str,
) -> ParameterSet:
    return ParameterSet(
        settings.name,
        time,
        model,
        names,
        {n: float(v) for n, v in values.items()},
        tuple(tuple(row) for row in covariance),
        {"method": method, "model": settings.plant.model},
    )
