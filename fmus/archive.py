"""FMU files from anywhere: what they say about themselves, and their safe extraction."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

import fmpy
from fmpy.model_description import read_model_description

from foundation.errors import FmuError

ModelDescription: TypeAlias = Any
"""fmpy.model_description.ModelDescription; the package ships no type information."""

_LARGEST = 2 * 1024**3  # [bytes] extracted; an FMU with more is taken for a zip bomb


@dataclass(frozen=True)
class FmuVariableInfo:
    """A variable of an FMU as a user sees it; numbers in `unit`, None where nothing is said."""

    name: str
    unit: str
    description: str
    start: float | None
    minimum: float | None
    maximum: float | None
    nominal: float | None


@dataclass(frozen=True)
class FmuDescription:
    """What an FMU says about itself.

    Attributes:
        name: Of the model.
        fmi: `1.0`, `2.0` or `3.0`.
        kinds: `CoSimulation`, `ModelExchange`, as it offers them.
        platforms: That it has binaries for.
        inputs, outputs: Its numeric signals.
        parameters: That can be set.
        states: Names of the continuous states, as far as they are listed.
        others: Names of all other variables, which can be read.
        directional_derivatives: It computes partial derivatives.
        saves_state: Its state can be saved and restored.
    """

    name: str
    fmi: str
    kinds: tuple[str, ...]
    platforms: tuple[str, ...]
    inputs: tuple[FmuVariableInfo, ...]
    outputs: tuple[FmuVariableInfo, ...]
    parameters: tuple[FmuVariableInfo, ...]
    states: tuple[str, ...]
    others: tuple[str, ...]
    directional_derivatives: bool
    saves_state: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all variables that can be read."""
        groups = (*self.inputs, *self.outputs, *self.parameters)
        return (*(v.name for v in groups), *self.others)


def describe(fmu: Path) -> FmuDescription:
    """Read what an FMU says about itself, without running any of it.

    Raises:
        FmuError: The file is not there, is not a zip file, or its description is malformed.
    """
    return description_of(read_description(fmu), _platforms(fmu))


def read_description(fmu: Path) -> ModelDescription:
    """Return FMPy's model description of an FMU file.

    Raises:
        FmuError: As `describe`.
    """
    if not fmu.is_file():
        raise FmuError("no such FMU", where=str(fmu), remedy="check the path")
    if not zipfile.is_zipfile(fmu):
        raise FmuError(
            "the file is not an FMU (not a zip file)",
            where=str(fmu),
            remedy="export it again, or download it again",
        )
    try:
        return read_model_description(str(fmu), validate=False)
    except Exception as error:  # FMPy and its XML parser raise many kinds
        raise FmuError(
            f"modelDescription.xml cannot be read: {_first_line(error)}",
            where=str(fmu),
            remedy="export the FMU again, or check it with `twinproof check`",
        ) from error


def _platforms(fmu: Path) -> tuple[str, ...]:
    return tuple(p for p in fmpy.supported_platforms(str(fmu)) if p != "c-code")


def description_of(md: ModelDescription, platforms: tuple[str, ...] = ()) -> FmuDescription:
    """Put FMPy's model description into our words."""
    variables: list[Any] = list(md.modelVariables)
    numeric = [v for v in variables if v.type not in ("String", "Binary", "Clock")]

    def with_causality(*causalities: str) -> tuple[FmuVariableInfo, ...]:
        return tuple(_info(v) for v in numeric if v.causality in causalities)

    shown = {"input", "output", "parameter", "structuralParameter"}
    kinds = {"CoSimulation": md.coSimulation, "ModelExchange": md.modelExchange}
    abilities = [kind for kind in kinds.values() if kind is not None]
    return FmuDescription(
        name=str(md.modelName),
        fmi=str(md.fmiVersion),
        kinds=tuple(name for name, kind in kinds.items() if kind is not None),
        platforms=platforms,
        inputs=with_causality("input"),
        outputs=with_causality("output"),
        parameters=with_causality("parameter", "structuralParameter"),
        states=tuple(str(v.derivative.name) for v in variables if v.derivative is not None),
        others=tuple(str(v.name) for v in numeric if v.causality not in shown),
        directional_derivatives=any(
            bool(getattr(kind, name, False))
            for kind in abilities
            for name in ("providesDirectionalDerivative", "providesDirectionalDerivatives")
        ),
        saves_state=any(
            bool(getattr(kind, name, False))
            for kind in abilities
            for name in ("canGetAndSetFMUstate", "canGetAndSetFMUState")
        ),
    )


def _info(variable: Any) -> FmuVariableInfo:
    unit = variable.unit or getattr(variable.declaredType, "unit", None) or ""
    return FmuVariableInfo(
        name=str(variable.name),
        unit=str(unit),
        description=str(variable.description or ""),
        start=_number(variable.start),
        minimum=_number(variable.min),
        maximum=_number(variable.max),
        nominal=_number(variable.nominal),
    )


def _number(text: Any) -> float | None:
    if text is None or text == "":
        return None
    if text in ("true", "false"):
        return float(text == "true")
    try:
        return float(str(text).split()[0])
    except ValueError:
        return None


def extract(fmu: Path, folder: Path) -> None:
    """Extract an FMU, if all it holds goes below `folder` and is of a sane size.

    Raises:
        FmuError: An entry would land elsewhere, the whole is too large, or the file is damaged.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            for entry in archive.infolist():
                path = PurePosixPath(entry.filename.replace("\\", "/"))
                if path.is_absolute() or ".." in path.parts or ":" in entry.filename:
                    raise FmuError(
                        f"the entry '{entry.filename}' would be written outside the FMU's folder",
                        where=str(fmu),
                        remedy="do not use this file; get the FMU from where it was made",
                    )
            size = sum(entry.file_size for entry in archive.infolist())
            if size > _LARGEST:
                raise FmuError(
                    f"the FMU would take {size / 1024**3:.1f} GB when extracted",
                    where=str(fmu),
                    remedy="do not use this file; get the FMU from where it was made",
                )
            archive.extractall(folder)
    except (zipfile.BadZipFile, OSError, NotImplementedError) as error:
        raise FmuError(
            f"the FMU cannot be extracted: {_first_line(error)}",
            where=str(fmu),
            remedy="export it again, or download it again",
        ) from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
