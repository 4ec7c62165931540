"""Modelica to a packed FMU: the whole way, in one call."""

from __future__ import annotations

import hashlib
import tempfile
import time
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import fmpy

from fmus.cache import cache_folder, content_key
from fmus.codegen import GUID_MARK, model_header
from fmus.compiler import compile_library, find_compiler, find_target
from fmus.dae import Dae
from fmus.description import fmi2_description, model_identifier
from fmus.events import signs_as_relations
from fmus.explicit import explicit
from fmus.frontend import load, with_values
from fmus.layout import layout, with_starts
from fmus.sources import ModelicaSource
from foundation.errors import UnknownNameError
from foundation.files import written_whole

_RUNTIME = Path(__file__).parent / "runtime"
_CORE = (
    "core.h",
    "core.c",
    "linear.c",
    "sliding.c",
    "history.c",
    "events.c",
    "solver.c",
    "dormand_prince.c",
    "rosenbrock.c",
    "location.c",
    "derivatives.c",
    "access.c",
)
_FMI2 = ("fmi2.c",)
# The standard's own header files (BSD licence), as FMPy carries them.
_FMI2_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
# A zip entry has a date; one for all makes equal models equal files.
_DATE = (2000, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class ExportResult:
    """A written FMU.

    Attributes:
        fmu: Where it is.
        fmi: Version of the standard.
        sha256: Of the file.
        variables: Number of its variables.
        seconds: Time it took [s].
    """

    fmu: Path
    fmi: str
    sha256: str
    variables: int
    seconds: float


def export(
    model: ModelicaSource | Dae,
    path: Path,
    *,
    parameters: Mapping[str, float] | None = None,
    target: str = "linux64",
) -> ExportResult:
    """Write a model as an FMU for FMI 2.0, Co-Simulation and Model Exchange, with its sources.

    The same model gives the same file, byte for byte.

    Args:
        model: Modelica source, or the flat model that `load` made of it.
        path: The file to write; whole or not at all.
        parameters: Values that replace declared ones: of independent parameters, or of the start
            of states that have no start parameter.
        target: Platform of the binary.

    Raises:
        ModelicaError: The source is wrong.
        UnsupportedModelError: The model has something that is not translated.
        UnknownNameError: A name in `parameters` is neither a parameter nor a state.
        CompilerError: There is no C compiler.
        InputError: The target is unknown.
        OSError: The file cannot be written.

    Example:
        >>> import tempfile
        >>> from fmus.sources import library_class
        >>> path = Path(tempfile.mkdtemp()) / "pendulum.fmu"
        >>> export(library_class("Twinproof.Plants.Pendulum"), path).fmi
        '2.0'
    """
    began = time.perf_counter()
    find_target(target)
    translation = _translate(model, parameters or {})
    entries = _compiled(translation, target)
    _write_zip(path, entries)
    return ExportResult(
        fmu=path,
        fmi="2.0",
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        variables=translation.variables,
        seconds=time.perf_counter() - began,
    )


def cached_fmu(
    model: ModelicaSource | Dae, *, parameters: Mapping[str, float] | None = None
) -> Path:
    """Return an FMU of a model in the user's cache, made only if it is not there yet.

    Args and errors as `export`.
    """
    translation = _translate(model, parameters or {})
    compiler = find_compiler()
    key = content_key(translation.guid, *compiler.command, compiler.version)
    path = cache_folder("fmus") / f"{translation.identifier}-{key}.fmu"
    if not path.is_file():
        _write_zip(path, _compiled(translation, "linux64"))
    return path


@dataclass(frozen=True)
class _Translation:
    """A model in the texts that make its FMU."""

    identifier: str
    guid: str
    description: str
    sources: Mapping[str, str]
    variables: int


def _translate(model: ModelicaSource | Dae, values: Mapping[str, float]) -> _Translation:
    dae = load(model) if isinstance(model, ModelicaSource) else model
    solved = explicit(signs_as_relations(_with_defaults(dae, values)), freeze_relations=True)
    variables = layout(solved)
    sources = {name: (_RUNTIME / name).read_text(encoding="utf-8") for name in (*_CORE, *_FMI2)}
    headers = Path(fmpy.__file__).parent / "c-code"
    sources |= {name: (headers / name).read_text(encoding="utf-8") for name in _FMI2_HEADERS}
    header = model_header(solved, variables)
    description = fmi2_description(solved, variables, _FMI2)
    guid = _guid(description, header, *sources.values())
    return _Translation(
        identifier=model_identifier(dae.name),
        guid=guid,
        description=description.replace(GUID_MARK, guid),
        sources=sources | {"model.h": header.replace(GUID_MARK, guid)},
        variables=len(variables.variables),
    )


def _compiled(translation: _Translation, target: str) -> dict[str, str | bytes]:
    """Return what goes into the FMU: name → content."""
    platform = find_target(target)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in translation.sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        library = Path(folder) / f"{translation.identifier}{platform.suffix}"
        compile_library([Path(folder) / name for name in _FMI2], library, target=target)
        binary = library.read_bytes()
    return {
        "modelDescription.xml": f'<?xml version="1.0" encoding="UTF-8"?>\n'
        f"{translation.description}\n",
        f"binaries/{platform.name}/{library.name}": binary,
        **{f"sources/{name}": text for name, text in sorted(translation.sources.items())},
    }


def _with_defaults(dae: Dae, values: Mapping[str, float]) -> Dae:
    parameters = {name: value for name, value in values.items() if name in _parameter_names(dae)}
    starts = {name: value for name, value in values.items() if name not in parameters}
    states = {v.name for v in dae.states}
    for name in starts:
        if name not in states:
            raise UnknownNameError(
                "parameter", name, [*_parameter_names(dae), *states], where=dae.name
            )
    return with_starts(with_values(dae, parameters), starts)


def _parameter_names(dae: Dae) -> list[str]:
    return [v.name for v in dae.parameters if v.name not in dae.dependent_parameters]


def _guid(*texts: str) -> str:
    digest = hashlib.sha256("\0".join(texts).encode()).digest()
    return f"{{{uuid.UUID(bytes=digest[:16])}}}"


def _write_zip(path: Path, entries: Mapping[str, str | bytes]) -> None:
    with (
        written_whole(path) as beside,
        zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, content in entries.items():
            info = zipfile.ZipInfo(name, _DATE)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
