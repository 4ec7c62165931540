"""What a pipeline is made of, from the settings and the plant's model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from identification.online.scored_filter import ScoredFilter
from twin.drift import DriftMonitor
from twin.estimation import FilterFit, KalmanFit, OnlineFit
from twin.free_run import FreeRun, start_parameters
from twin.plant_model import PlantModel
from twin.settings import TwinSettings

Array = NDArray[np.float64]


def scored_filter(
    model: PlantModel, values: Mapping[str, float], sample_time: float
) -> ScoredFilter:
    """Return the filter that believes these values."""
    return ScoredFilter(
        model.dae,
        model.outputs,
        model.free,
        values,
        sample_time=sample_time,
        noise_sd=model.noise_sd,
        disturbances=model.disturbances,
    )


def drift_monitor(
    settings: TwinSettings, model: PlantModel, values: Mapping[str, float], covariance: Array
) -> DriftMonitor:
    """Return the tests of drift from these values, known with this covariance."""
    d = settings.drift
    return DriftMonitor(
        model.free,
        values,
        covariance,
        block=settings.estimator.block,
        window=d.window,
        false_alarms_per_hour=d.false_alarms_per_hour,
        margin=d.margin,
        channels=model.outputs,
    )


def online_fit(
    settings: TwinSettings,
    model: PlantModel,
    values: Mapping[str, float],
    covariance: Array,
    samples: int,
) -> OnlineFit:
    """Return what moves the estimate, as the settings' `estimator.kind` says."""
    e = settings.estimator
    fading = float(np.exp(-e.block / e.memory))
    if e.kind == "kalman":
        return KalmanFit(model.free, values, covariance, fading=fading, wanted=e.excitation)
    return FilterFit(
        model.dae,
        model.outputs,
        model.free,
        values,
        covariance,
        window=e.memory,
        block=samples,
        sample_time=1.0 / settings.rate,
        tau=e.tau,
        fading=fading,
        wanted=e.excitation,
    )


def free_run(
    settings: TwinSettings, model: PlantModel, filtered: ScoredFilter, sample_time: float
) -> FreeRun | None:
    """Return the FMU by itself; None: its states have no start parameters."""
    starts = start_parameters(filtered.state_names, model.dae.start_parameters)
    if starts is None:
        return None
    samples = round(settings.estimator.horizon * settings.rate)
    return FreeRun(
        settings.plant.fmu,
        model.inputs,
        model.outputs,
        starts,
        sample_time=sample_time,
        samples=samples,
    )
