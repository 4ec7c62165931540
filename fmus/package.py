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
from fmus.compiler import NATIVE, Target, compile_target, find_compiler, find_target
from fmus.dae import Dae
from fmus.description import model_identifier
from fmus.events import signs_as_relations
from fmus.explicit import explicit
from fmus.fmi2_description import fmi2_description
from fmus.fmi3_description import build_description, fmi3_description, terminals
from fmus.frontend import load, with_values
from fmus.icon import Icon, icon_of, png
from fmus.layout import layout, with_starts
from fmus.openmodelica import export_with_omc
from fmus.sources import ModelicaSource
from foundation.errors import InputError, UnknownNameError
from foundation.files import written_whole

_RUNTIME = Path(__file__).parent / "runtime"
_CORE = sorted(file.name for file in _RUNTIME.glob("*.[ch]") if not file.name.startswith("fmi"))
# What an importer compiles, and the standard's own headers (BSD licence), as FMPy carries them.
_LAYER = {"2": ("fmi2.c",), "3": ("fmi3.c",)}
_HEADERS = {
    "2": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
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
    fmi: str = "2",
    target: str = NATIVE,
    compiler: str = "own",
) -> ExportResult:
    """Write a model as an FMU, Co-Simulation and Model Exchange in one, with its sources.

    The same model gives the same file, byte for byte.

    Args:
        model: Modelica source, or the flat model that `load` made of it.
        path: The file to write; whole or not at all.
        parameters: Values that replace declared ones: of independent parameters, or of the start
            of states that have no start parameter.
        fmi: Version of the standard, "2" or "3".
        target: Platform of the binary.
        compiler: `own`, or `omc` for OpenModelica's, if that is on the path.

    Raises:
        ModelicaError: The source is wrong.
        UnsupportedModelError: The model has something that is not translated.
        UnknownNameError: A name in `parameters` is neither a parameter nor a state.
        CompilerError: There is no C compiler.
        InputError: The version, the target or the compiler is unknown, or do not go together.
        OSError: The file cannot be written.

    Example:
        >>> import tempfile
        >>> from fmus.sources import library_class
        >>> path = Path(tempfile.mkdtemp()) / "pendulum.fmu"
        >>> export(library_class("Twinproof.Plants.Pendulum"), path).fmi
        '2.0'
    """
    began = time.perf_counter()
    platform = find_target(target)
    _check_version(fmi)
    if compiler == "omc":
        _export_with_omc(model, path, parameters or {}, fmi, target)
        variables = len(fmpy.read_model_description(str(path)).modelVariables)
    elif compiler == "own":
        translation = _translate(model, parameters or {}, fmi)
        variables = translation.variables
        _write_zip(path, _compiled(translation, platform))
    else:
        raise InputError(
            f"there is no compiler '{compiler}'", where="--compiler", remedy="use own or omc"
        )
    return ExportResult(
        fmu=path,
        fmi=f"{fmi}.0",
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        variables=variables,
        seconds=time.perf_counter() - began,
    )


def _export_with_omc(
    model: ModelicaSource | Dae,
    path: Path,
    parameters: Mapping[str, float],
    fmi: str,
    target: str,
) -> None:
    if not isinstance(model, ModelicaSource):
        raise InputError("OpenModelica takes Modelica source only", where="--compiler")
    if parameters:
        raise InputError(
            "OpenModelica takes no parameter values here",
            where="--param",
            remedy="write them into the model, or use --compiler own",
        )
    if target != NATIVE:
        raise InputError(
            "OpenModelica compiles for this machine only",
            where="--target",
            remedy=f"use {NATIVE}, or --compiler own",
        )
    export_with_omc(model, path, fmi)


def _check_version(fmi: str) -> None:
    if fmi not in _LAYER:
        raise InputError(
            f"there is no FMI version '{fmi}' here",
            where="--fmi",
            remedy=f"use {' or '.join(_LAYER)}",
        )


def cached_fmu(
    model: ModelicaSource | Dae,
    *,
    parameters: Mapping[str, float] | None = None,
    fmi: str = "2",
) -> Path:
    """Return an FMU of a model in the user's cache, made only if it is not there yet.

    Args and errors as `export`.
    """
    translation = _translate(model, parameters or {}, fmi)
    compiler = find_compiler()
    key = content_key(translation.guid, *compiler.command, compiler.version)
    path = cache_folder("fmus") / f"{translation.identifier}-{key}.fmu"
    if not path.is_file():
        _write_zip(path, _compiled(translation, find_target(NATIVE)))
    return path


@dataclass(frozen=True)
class _Translation:
    """A model in the texts that make its FMU.

    Attributes:
        identifier: Name of the library.
        fmi: Version of the standard.
        guid: Identifies the FMU; in FMI 3 called instantiation token.
        sources: C files and what describes them, by name.
        files: All other files of the FMU, by name.
        variables: Their number.
        pictures: Files that are no text.
    """

    identifier: str
    fmi: str
    guid: str
    sources: Mapping[str, str]
    files: Mapping[str, str]
    variables: int
    pictures: Mapping[str, bytes]


def _translate(model: ModelicaSource | Dae, values: Mapping[str, float], fmi: str) -> _Translation:
    _check_version(fmi)
    dae = load(model) if isinstance(model, ModelicaSource) else model
    solved = explicit(signs_as_relations(_with_defaults(dae, values)), freeze_relations=True)
    icon: Icon | None = None
    if isinstance(model, ModelicaSource):
        icon = icon_of(model.written.text, model.written.class_name)
    variables = layout(solved)
    identifier = model_identifier(dae.name)
    headers = Path(fmpy.__file__).parent / "c-code"
    paths = [_RUNTIME / name for name in (*_CORE, *_LAYER[fmi])]
    paths += [headers / name for name in _HEADERS[fmi]]
    sources = {path.name: path.read_text(encoding="utf-8") for path in paths}
    sources["model.h"] = model_header(solved, variables)
    sources["buildDescription.xml"] = build_description(identifier, _LAYER[fmi])
    if fmi == "2":
        files = {"modelDescription.xml": fmi2_description(solved, variables, _LAYER[fmi])}
    else:
        files = {"modelDescription.xml": fmi3_description(solved, variables)}
        flanges = terminals(dae, variables, icon)
        if flanges is not None:
            files["terminalsAndIcons/terminalsAndIcons.xml"] = flanges
    guid = _guid(*files.values(), *sources.values())

    def marked(texts: Mapping[str, str]) -> dict[str, str]:
        return {name: text.replace(GUID_MARK, guid) for name, text in texts.items()}

    place = {"2": "model.png", "3": "terminalsAndIcons/icon.png"}[fmi]
    pictures = {place: png(icon, dae.name)} if icon is not None else {}
    count = len(variables.variables)
    return _Translation(identifier, fmi, guid, marked(sources), marked(files), count, pictures)


def _compiled(translation: _Translation, target: Target) -> dict[str, str | bytes]:
    """Return what goes into the FMU: name → content."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in translation.sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        binaries = compile_target(
            [Path(folder) / name for name in _LAYER[translation.fmi]],
            target,
            translation.identifier,
            translation.fmi,
        )
    return {
        **translation.files,
        **translation.pictures,
        **{f"binaries/{name}": binary for name, binary in sorted(binaries.items())},
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
