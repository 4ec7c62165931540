"""Which parameters to verify next: those of `identify`, then those that the data say."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from foundation.errors import InputError
from twin.estimate import Estimate
from twin.excerpt import Excerpt
from twin.follower import Follower
from twin.settings import TwinSettings
from twin.store.documents import ParameterSet


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
