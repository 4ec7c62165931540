"""The plant of a scenario or a study: model, parameters, sensors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus.archive import FmuDescription, describe
from fmus.running import model_fmu
from foundation.errors import FormatError, InputError, UnknownNameError
from hil.bus.dbc import Port
from hil.sensors import SensorSettings
from hil.settings import Table, build, number


@dataclass(frozen=True, eq=False)
class PlantSettings:
    """A plant.

    Attributes:
        model: MODEL as the user wrote it; relative files start from the settings' file.
        fmu: The FMU of it.
        described: What the FMU says about itself.
        parameters: Values set before the start.
        fit: Of `identify`, if named.
        sensors: By output.
        roots: Folders of further Modelica libraries.
    """

    model: str
    fmu: Path
    described: FmuDescription
    parameters: Mapping[str, float]
    fit: Fit | None = None
    sensors: Mapping[str, SensorSettings] = field(default_factory=dict[str, SensorSettings])

    @property
    def inputs(self) -> list[Port]:
        """Its inputs."""
        return [Port(v.name, v.unit, v.description) for v in self.described.inputs]

    @property
    def outputs(self) -> list[Port]:
        """Its outputs."""
        return [Port(v.name, v.unit, v.description) for v in self.described.outputs]

    def value(self, parameter: str) -> float:
        """Return a parameter's value at the start, in its unit; NaN: neither we nor the FMU say."""
        declared = {v.name: v.start for v in self.described.parameters}
        value = self.parameters.get(parameter, declared.get(parameter))
        return np.nan if value is None else value

    def unit(self, name: str) -> str:
        """Return the unit of a column: of an input or output, also with a prefix."""
        bare = name.rpartition(".")[2]
        return next((p.unit for p in (*self.inputs, *self.outputs) if p.name == bare), "")


@dataclass(frozen=True, eq=False)
class Fit:
    """What `identify --json` wrote.

    Attributes:
        values: Parameter → value.
        names: Parameters that the covariance is of.
        covariance: (k, k).
    """

    values: Mapping[str, float]
    names: tuple[str, ...]
    covariance: npt.NDArray[np.float64]

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Return parameters as the data leave them open: a draw from their normal distribution.

        Example:
            >>> fit = Fit({"m": 1.0}, ("m",), np.array([[0.0]]))
            >>> fit.draw(np.random.default_rng(1))
            {'m': 1.0}
        """
        if not self.names:
            return dict(self.values)
        mean = np.array([self.values[name] for name in self.names])
        scale = np.sqrt(np.diag(self.covariance))
        scale[scale == 0] = 1.0
        # In units of the standard deviations: parameters differ by many powers of ten.
        correlation = self.covariance / np.outer(scale, scale)
        eigenvalues, vectors = np.linalg.eigh(correlation)
        root = vectors * np.sqrt(np.clip(eigenvalues, 0.0, None))
        drawn = mean + scale * (root @ rng.standard_normal(len(mean)))
        return {**self.values, **dict(zip(self.names, drawn.tolist(), strict=True))}


def read_fit(path: Path, where: str) -> Fit:
    """Read what `identify --json` wrote.

    Raises:
        InputError: There is no such file.
        FormatError: It is something else.
    """
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
        parameters = {n: (float(p["value"]), p) for n, p in document["parameters"].items()}
    except OSError as error:
        raise InputError(
            f"the fit {path} cannot be read: {error.strerror}", where=where, remedy="correct it"
        ) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FormatError(
            f"{path} is not what `twinproof identify --json` writes",
            where=where,
            remedy="write it with `twinproof identify MODEL DATA --json FILE`",
        ) from error
    # A parameter that the data do not see has no standard deviation: it stays where it is.
    names = tuple(n for n, (_, p) in parameters.items() if p.get("sd") is not None)
    listed = document.get("covariance")
    if isinstance(listed, Mapping):
        all_names: list[str] = list(listed["names"])
        places = [all_names.index(n) for n in names]
        matrix = np.array(listed["matrix"], float)[np.ix_(places, places)]
    else:
        matrix = np.diag([float(parameters[n][1]["sd"]) ** 2 for n in names])
    seen = [k for k in range(len(names)) if np.all(np.isfinite(matrix[k, k]))]
    names = tuple(names[k] for k in seen)
    matrix = matrix[np.ix_(seen, seen)].reshape(len(seen), len(seen))
    return Fit({n: v for n, (v, _) in parameters.items()}, names, matrix)


def plant_of(table: Table, roots: tuple[Path, ...] = ()) -> PlantSettings:
    """Return the plant that a table describes.

    Keys: `model`, `parameters`, `parameters_from` (a file of `identify --json`), `sensors`.

    Raises:
        TwinproofError: As for every MODEL.
        UnknownNameError: A key, parameter or output that there is not.
        InputError, UnitError: A value that does not fit.
    """
    table.only(["model", "parameters", "parameters_from", "sensors"])
    word = table.values.get("model")
    if not isinstance(word, str):
        raise InputError(
            "no model", where=table.where("model"), remedy='write model = "Twinproof.Plants.…"'
        )
    model = from_here(word, table)
    fmu = model_fmu(model, roots)
    described = describe(fmu)
    fit: Fit | None = None
    parameters: dict[str, float] = {}
    if "parameters_from" in table.values:
        where = table.where("parameters_from")
        fit = read_fit(table.file(str(table.values["parameters_from"])), where)
        parameters |= fit.values
        _known(fit.values, described, where)
    own = table.sub("parameters")
    units = {v.name: v.unit for v in described.parameters}
    _known(own.values, described, own.where())
    parameters |= {
        name: number(value, units.get(name, ""), own.where(name))
        for name, value in own.values.items()
    }
    outputs = {v.name: v.unit for v in described.outputs}
    sensors: dict[str, SensorSettings] = {}
    for name in table.sub("sensors").values:
        inner = table.sub("sensors").sub(name)
        if name not in outputs:
            raise UnknownNameError("output", name, outputs, where=inner.where())
        sensors[name] = build(SensorSettings, inner, own=outputs[name])
    return PlantSettings(model, fmu, described, parameters, fit, sensors)


def _known(names: Mapping[str, float], described: FmuDescription, where: str) -> None:
    for name in names:
        if name not in described.names:
            known = [v.name for v in described.parameters]
            raise UnknownNameError("parameter", name, known, where=where)


def from_here(word: str, table: Table) -> str:
    """Return a MODEL whose file stands beside the settings, as seen from where we are."""
    file, colon, name = word.partition(":")
    if file.endswith((".mo", ".fmu")) and table.file(file).exists():
        return f"{table.file(file)}{colon}{name}"
    return word
