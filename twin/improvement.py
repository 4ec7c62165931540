"""A plant in which an effect has appeared: its model with that effect, fitted to new data."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.archive import describe
from fmus.frontend import load
from fmus.running import model_fmu
from foundation.errors import DivergenceError
from foundation.files import write_text
from hil.bus.dbc import bundled_dbc
from hil.plants import Fit
from identification.discovery.extension import extend, parse_addition
from identification.discovery.transfer import transfer_problem
from identification.estimators.kalman import most_likely
from twin.excerpt import Excerpt
from twin.settings import TwinBus, TwinSettings

Array = NDArray[np.float64]
_LIBRARY = "Twinproof.Plants."


@dataclass(frozen=True, eq=False)
class Improvement:
    """An effect, and the data to fit it to.

    Attributes:
        data: With MODEL without it, the parameters to fit beside its own, and where they start.
        effect: `EFFECT@PLACE`.
        effect_values: Its parameters, as far as they are known.
        folder: Where the improved model's text goes.
    """

    data: Excerpt
    effect: str
    effect_values: Mapping[str, float]
    folder: Path


@dataclass(frozen=True, eq=False)
class Improved:
    """A model with the effect.

    Attributes:
        model: MODEL.
        names: The k parameters that were fitted.
        values: Parameter → value, also of those that were held.
        covariance: (k, k).
    """

    model: str
    names: tuple[str, ...]
    values: Mapping[str, float]
    covariance: Array


def improve(wanted: Improvement) -> Improved:
    """Write the model that has an effect, and fit it by maximum likelihood.

    An unknown disturbance at every input is found beside the parameters, so that it does not pass
    for the effect.

    Raises:
        TwinproofError: The model cannot be extended, or the data do not tell its parameters.
    """
    source = wanted.data.source
    settings = "".join(f",{name}={value!r}" for name, value in wanted.effect_values.items())
    addition = parse_addition(f"{wanted.effect}{settings}", source)
    base, extended = extend(source, []), extend(source, [addition])
    added = {
        extended.parameter_of(addition, name): value for name, value in wanted.effect_values.items()
    }
    data = wanted.data
    problem = transfer_problem(data.problem(), extended, data.values, base, added=added)
    # What the effect's author declares free and what was free before; the rest stays.
    found = most_likely(problem, problem.values)
    covariance = np.asarray(found.covariance, dtype=float)
    if not np.all(np.isfinite(covariance)):
        raise DivergenceError(
            f"the data do not tell the parameters of {wanted.effect}",
            where=data.model,
            remedy="excite the plant more, and ask for a verification",
        )
    known = load(extended.source).parameter_values
    values = {n: float(v) for n, v in found.values.items() if n in known}
    return Improved(
        _written(extended.source.text, extended.name, wanted), found.free, values, covariance
    )


def _written(text: str, name: str, wanted: Improvement) -> str:
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = wanted.folder / f"{name}-{digest}.mo"
    write_text(path, text)
    return f"{path}:{name}"


def with_model(
    settings: TwinSettings, model: str, fit: Fit, roots: tuple[Path, ...] = ()
) -> TwinSettings:
    """Return a twin's settings for another model of the same plant: the same buses and sensors.

    Args:
        settings: Of the twin.
        model: MODEL, with the same inputs and outputs.
        fit: Its parameters.
        roots: Folders of further Modelica libraries.

    Raises:
        TwinproofError: As for every MODEL.
    """
    fmu = model_fmu(model, roots)
    described = describe(fmu)
    own = {n: v for n, v in settings.plant.parameters.items() if n in described.names}
    plant = replace(
        settings.plant,
        model=model,
        fmu=fmu,
        described=described,
        parameters={**own, **fit.values},
        fit=fit,
    )
    buses = tuple(_pinned(bus, settings.plant.model) for bus in settings.buses)
    estimator = replace(settings.estimator, free=fit.names)
    return replace(settings, plant=plant, buses=buses, estimator=estimator)


def _pinned(bus: TwinBus, model: str) -> TwinBus:
    """Name the DBC file that the plant's own class stood for."""
    if bus.dbc in ("", "bundled") and model.startswith(_LIBRARY):
        return replace(bus, dbc=str(bundled_dbc(model).resolve()))
    return bus
