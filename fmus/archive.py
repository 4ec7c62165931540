"""FMU files from anywhere: what they say about themselves, and their safe extraction."""

from __future__ import annotations

import contextlib
import hashlib
import stat
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias
from xml.parsers import expat

import fmpy
from fmpy.model_description import read_model_description

from foundation.errors import FmuError

ModelDescription: TypeAlias = Any
"""fmpy.model_description.ModelDescription; the package ships no type information."""

_LARGEST = 2 * 1024**3  # [bytes] extracted; an FMU with more is taken for a zip bomb
_LARGEST_XML = 256 * 1024**2  # [bytes]
_MOST_ENTRIES = 100_000
_ALWAYS_FINE = 16 * 1024**2  # [bytes] extracted, at whatever ratio
_HIGHEST_RATIO = 100  # of extracted to packed size; binaries and XML reach 3 to 30


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
    return description_of(read_description(fmu), _platforms(fmu), where=str(fmu))


def read_description(fmu: Path) -> ModelDescription:
    """Return FMPy's model description of an FMU file.

    Raises:
        FmuError: As `describe`.
    """
    check_archive(fmu)
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


def description_of(
    md: ModelDescription, platforms: tuple[str, ...] = (), *, where: str = ""
) -> FmuDescription:
    """Put FMPy's model description into our words.

    Raises:
        FmuError: It contradicts itself, such as a derivative of nothing.
    """
    try:
        return _in_our_words(md, platforms)
    except Exception as error:
        raise FmuError(
            f"modelDescription.xml contradicts itself: {_first_line(error)}",
            where=where,
            remedy="export the FMU again, or check it with `twinproof check`",
        ) from error


def _in_our_words(md: ModelDescription, platforms: tuple[str, ...]) -> FmuDescription:
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


def extract(fmu: Path, folder: Path, *, sha256: str | None = None) -> None:
    """Extract an FMU, if all it holds goes below `folder` and is of a sane size.

    Args:
        fmu: The file.
        folder: An empty folder.
        sha256: Of the file, if only that very file is to be used.

    Raises:
        FmuError: As `check_archive`; or the file is damaged.
    """
    check_archive(fmu, sha256=sha256)
    try:
        with zipfile.ZipFile(fmu) as archive:
            # The size that an entry declares bounds what zipfile writes for it.
            archive.extractall(folder)
    except Exception as error:  # zipfile and its codecs raise many kinds on damaged files
        raise FmuError(
            f"the FMU cannot be extracted: {_first_line(error)}",
            where=str(fmu),
            remedy="export it again, or download it again",
        ) from error


def check_archive(fmu: Path, *, sha256: str | None = None) -> None:
    """Look through an archive before anything of it is extracted or parsed.

    Refused are entries outside the folder, links, entries of the same name, encryption, sizes and
    ratios that only zip bombs have, and XML with a DTD (entities can expand without end, and read
    files).

    Raises:
        FmuError: It is refused, is no archive, or is not the file with the SHA-256 asked for.
    """
    if not fmu.is_file():
        raise FmuError("no such FMU", where=str(fmu), remedy="check the path")
    if sha256 is not None:
        with fmu.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        if found != sha256.lower():
            raise _refusal(fmu, f"the file's SHA-256 is {found}, not the one asked for")
    if not zipfile.is_zipfile(fmu):
        raise FmuError(
            "the file is not an FMU (not a zip file)",
            where=str(fmu),
            remedy="export it again, or download it again",
        )
    try:
        with zipfile.ZipFile(fmu) as archive:
            _check_entries(fmu, archive.infolist())
            for entry in archive.infolist():
                if entry.filename.lower().endswith((".xml", ".ssd", ".ssv", ".ssm")):
                    _check_xml(fmu, archive, entry)
    except FmuError:
        raise
    except Exception as error:
        raise FmuError(
            f"the archive is damaged: {_first_line(error)}",
            where=str(fmu),
            remedy="export it again, or download it again",
        ) from error


def _check_entries(fmu: Path, entries: Sequence[zipfile.ZipInfo]) -> None:
    if len(entries) > _MOST_ENTRIES:
        raise _refusal(fmu, f"the FMU has {len(entries)} entries")
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename
        path = PurePosixPath(name.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts or ":" in name or "\0" in name:
            raise _refusal(fmu, f"the entry '{name}' would be written outside the FMU's folder")
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise _refusal(fmu, f"the entry '{name}' is a link or a device")
        if str(path) in seen:
            raise _refusal(fmu, f"there are two entries '{name}'")
        seen.add(str(path))
        if entry.flag_bits & 1:
            raise _refusal(fmu, f"the entry '{name}' is encrypted")
        if path.suffix == ".xml" and entry.file_size > _LARGEST_XML:
            raise _refusal(fmu, f"'{name}' has {entry.file_size / 1024**2:.0f} MB")
    size = sum(entry.file_size for entry in entries)
    packed = sum(entry.compress_size for entry in entries)
    if size > _LARGEST:
        raise _refusal(fmu, f"the FMU would take {size / 1024**3:.1f} GB when extracted")
    if size > _ALWAYS_FINE and size > _HIGHEST_RATIO * packed:
        raise _refusal(
            fmu, f"the FMU would grow {size / max(packed, 1):.0f} times when it is extracted"
        )


def _check_xml(fmu: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    def refuse(*_: object) -> None:
        raise _refusal(fmu, f"'{entry.filename}' has a DTD")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    # Wrong XML is for the real parser to report, which stops where this one does.
    with contextlib.suppress(expat.ExpatError), archive.open(entry) as file:
        while block := file.read(1 << 20):
            parser.Parse(block, False)


def _refusal(fmu: Path, what: str) -> FmuError:
    return FmuError(
        what, where=str(fmu), remedy="do not use this file; get the FMU from where it was made"
    )


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
