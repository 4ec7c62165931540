"""What a pipeline must know of its plant: equations, what is measured and how well, what to fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray

from fmus.dae import Dae
from fmus.frontend import load
from fmus.sources import find_source
from foundation.errors import BusError, InputError, UnsupportedModelError
from hil.bus.codec import Layout, layouts
from hil.bus.dbc import bundled_dbc, parse_dbc, plant_dbc, read_dbc
from identification.innovations import Disturbance
from identification.problem import fitted_by_default
from twin.settings import TwinBus, TwinSettings

Array = NDArray[np.float64]

BUNDLED, PLANT = "bundled", "plant"


@dataclass(frozen=True, eq=False)
class PlantModel:
    """The plant as a pipeline sees it.

    Attributes:
        dae: Its equations.
        buses: Messages wanted from each bus.
        inputs: In the model's order.
        outputs: Those that are measured.
        noise_sd: (ny,) of their sensors.
        disturbances: At every input.
        free: Parameters that are followed.
        values: Every independent parameter, to begin with.
    """

    dae: Dae
    buses: tuple[tuple[Layout, ...], ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    noise_sd: Array
    disturbances: tuple[Disturbance, ...]
    free: tuple[str, ...]
    values: Mapping[str, float]

    @property
    def units(self) -> dict[str, str]:
        """Of the free parameters."""
        return {n: self.dae.variables[n].unit for n in self.free}


def plant_model(settings: TwinSettings, roots: tuple[Path, ...] = ()) -> PlantModel:
    """Read model and DBC files of a twin and see that they fit.

    Raises:
        UnsupportedModelError: The model is an FMU without equations.
        BusError, UnknownNameError: A DBC does not carry what is needed.
        InputError: Nothing is known of a sensor's noise, or there is nothing to fit.
    """
    plant, where = settings.plant, f"{settings.path}, twin {settings.name}"
    if plant.model.endswith(".fmu"):
        raise UnsupportedModelError(
            "a twin needs the model's equations, which an FMU does not carry",
            where=where,
            remedy="give the Modelica source, as file.mo:Class.Name",
        )
    dae = load(find_source(plant.model, roots))
    buses = _layouts(settings, where)
    carried = {f.variable: f for bus in buses for layout in bus for f in layout.fields}
    missing = [p.name for p in plant.inputs if p.name not in carried]
    outputs = tuple(p.name for p in plant.outputs if p.name in carried)
    if missing or not outputs:
        raise BusError(
            f"no bus carries {', '.join(missing) or 'any output'}",
            where=where,
            remedy="name the signals: [twin.bus.signals]",
        )
    estimator = settings.estimator
    rate = 1.0 / estimator.disturbance_time
    return PlantModel(
        dae=dae,
        buses=buses,
        inputs=tuple(v.name for v in dae.inputs),
        outputs=outputs,
        noise_sd=_noise(settings, outputs, buses, where),
        disturbances=tuple(
            Disturbance(rate, estimator.disturbances.get(v.name, 0.0)) for v in dae.inputs
        ),
        free=_free(settings, dae, where),
        values={**dae.parameter_values, **plant.parameters},
    )


def _layouts(settings: TwinSettings, where: str) -> tuple[tuple[Layout, ...], ...]:
    ports = [*settings.plant.inputs, *settings.plant.outputs]
    found: list[tuple[Layout, ...]] = []
    taken: set[str] = set()
    for bus in settings.buses:
        database, origin = _database(settings, bus)
        there = {s.name for m in database.messages for s in m.signals}
        wanted = [
            p for p in ports if bus.signals.get(p.name, p.name) in there and p.name not in taken
        ]
        unknown = [s for s in bus.signals.values() if s not in there]
        if unknown:
            raise BusError(
                f"the DBC has no signal '{unknown[0]}'",
                where=f"{where}, {origin}",
                remedy="correct [twin.bus.signals]",
            )
        taken |= {p.name for p in wanted}
        found.append(tuple(layouts(database, wanted, signals=bus.signals, where=origin)))
    return tuple(found)


def _database(settings: TwinSettings, bus: TwinBus) -> tuple[Database, str]:
    plant = settings.plant
    word = bus.dbc or (BUNDLED if plant.model.startswith("Twinproof.Plants.") else PLANT)
    if word == PLANT:
        text = plant_dbc(plant.inputs, plant.outputs)
        return parse_dbc(text), "the DBC made from the plant's ports"
    path = bundled_dbc(plant.model) if word == BUNDLED else settings.file(word)
    return read_dbc(path), str(path)


def _noise(
    settings: TwinSettings,
    outputs: Sequence[str],
    buses: Sequence[Sequence[Layout]],
    where: str,
) -> Array:
    steps: dict[str, float] = {}
    for layout in (layout for bus in buses for layout in bus):
        for f in layout.fields:
            signal = layout.message.get_signal_by_name(f.signal)
            scale = 0.0 if signal.is_float else float(signal.conversion.scale)
            steps[f.variable] = abs(f.factor * scale)
    found: list[float] = []
    for name in outputs:
        sensor = settings.plant.sensors.get(name)
        if sensor is None or not (sensor.sd > 0 or sensor.resolution > 0):
            raise InputError(
                f"nothing is known of the noise of '{name}'",
                where=where,
                remedy=f'write [twin.plant.sensors.{name}] with sd = "…" or resolution = "…"',
            )
        # Rounding to steps is noise of a twelfth of the step's square (B. Widrow, I. Kollár).
        rounded = (sensor.resolution**2 + steps[name] ** 2) / 12
        found.append(math.sqrt(sensor.sd**2 + rounded))
    return np.array(found)


def _free(settings: TwinSettings, dae: Dae, where: str) -> tuple[str, ...]:
    fit, default = settings.plant.fit, fitted_by_default(dae)
    wanted = settings.estimator.free or (default if fit is None else fit.names)
    free = tuple(n for n in wanted if n in default or n in settings.estimator.free)
    if not free:
        raise InputError(
            "there is no parameter to follow", where=where, remedy="write estimator.free = […]"
        )
    return free


def with_free_covariance(free: Sequence[str], names: Sequence[str], covariance: Array) -> Array:
    """Return the covariance (k, k) of the free parameters; zero of those without one."""
    found = np.zeros((len(free), len(free)))
    have = [(i, list(names).index(n)) for i, n in enumerate(free) if n in names]
    for i, a in have:
        for j, b in have:
            found[i, j] = covariance[a, b]
    return found
