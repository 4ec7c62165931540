"""System Structure and Parameterization (SSP 1.0): systems of FMUs as one file.

Read: one system with components and connections, linear transformations, parameter values (inline
or in `.ssv` files of the archive), start and stop time. Refused with a reason: nested systems,
signal dictionaries, parameter mappings, other transformations.
"""

from __future__ import annotations

import math
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any
from urllib.parse import unquote
from xml.sax.saxutils import quoteattr

from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] - it has no stubs

from fmus.archive import describe, extract
from fmus.guarded import ask
from fmus.master.system import Component, Connection, System
from fmus.plant import Value
from fmus.running import Simulation
from foundation.errors import FmuError, UnsupportedModelError
from foundation.files import written_whole

_SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
_NUMBERS = ("Real", "Integer", "Boolean", "Float64", "Int32")


@dataclass(frozen=True, eq=False)
class OpenedSsp:
    """A system read from an SSP, whose FMUs stand in a folder that is removed at the end.

    Attributes:
        system: To be simulated.
        defaults: `start` and `stop` [s], as far as the file names them.
        folder: Of the extracted files.
    """

    system: System
    defaults: Mapping[str, float]
    folder: tempfile.TemporaryDirectory[str]

    def __enter__(self) -> OpenedSsp:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.folder.cleanup()


def read_ssp(path: Path) -> OpenedSsp:
    """Read a system. Use the result in a `with` statement.

    Raises:
        FmuError: The archive is refused, or its description is malformed.
        UnsupportedModelError: It has something that is not supported.
    """
    folder = tempfile.TemporaryDirectory(prefix="twinproof-")
    try:
        root = Path(folder.name)
        extract(path, root)
        file = root / "SystemStructure.ssd"
        if not file.is_file():
            raise FmuError(
                "the archive has no SystemStructure.ssd", where=str(path), remedy="export it again"
            )
        tree = _parsed(file, path)
        top = tree.find(f"{{{_SSD}}}System")
        if top is None:
            raise FmuError(
                "the description has no system", where=str(path), remedy="export it again"
            )
        experiment = tree.find(f"{{{_SSD}}}DefaultExperiment")
        defaults: dict[str, float] = {}
        for key, name in (("start", "startTime"), ("stop", "stopTime")):
            if experiment is not None and experiment.get(name) is not None:
                defaults[key] = _number(experiment.get(name), path)
        return OpenedSsp(_system(top, root, path), defaults, folder)
    except BaseException:
        folder.cleanup()
        raise


def simulate_ssp(path: Path, **settings: Any) -> Simulation:
    """Run a system in the child process for foreign FMUs; settings as `System.simulate`.

    Raises:
        TwinproofError: As `read_ssp` and `System.simulate`.
    """
    answer = ask("system", path, settings=settings)
    return Simulation(answer["time"], answer["columns"])


def write_ssp(
    system: System, path: Path, *, start: float | None = None, stop: float | None = None
) -> None:
    """Write a system as an SSP, with its FMUs inside; whole or not at all.

    Raises:
        FmuError: An FMU cannot be read.
        UnsupportedModelError: A parameter has a unit of its own.
        OSError: The file cannot be written.
    """
    text = _ssd_text(system, start, stop)
    with written_whole(path) as beside, zipfile.ZipFile(beside, "w") as archive:
        archive.writestr("SystemStructure.ssd", text, zipfile.ZIP_DEFLATED)
        for name, part in system.components.items():
            archive.write(part.fmu, f"resources/{name}.fmu")


def _parsed(file: Path, path: Path) -> Any:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
    try:
        return etree.parse(str(file), parser).getroot()
    except etree.XMLSyntaxError as error:
        raise FmuError(
            f"{file.name} is malformed: {error}", where=str(path), remedy="export it again"
        ) from error


def _system(top: Any, root: Path, path: Path) -> System:
    for tag in ("SignalDictionaries",):
        if top.find(f"{{{_SSD}}}{tag}") is not None:
            raise _unsupported(f"{tag} in the system", path)
    components: dict[str, Component] = {}
    for element in top.findall(f"{{{_SSD}}}Elements/*"):
        kind = etree.QName(element).localname
        if kind != "Component":
            raise _unsupported(f"a {kind} inside the system", path)
        name = str(element.get("name"))
        fmu = _inside(root, str(element.get("source", "")), path)
        components[name] = Component(fmu, _values(element, root, path))
    parameters = _values(top, root, path)
    for name, value in parameters.items():
        part, _, variable = name.partition(".")
        if part not in components:
            raise _unsupported(f"the parameter '{name}' of the system itself", path)
        known = components[part]
        components[part] = Component(known.fmu, {**known.parameters, variable: value})
    connectors = top.findall(f"{{{_SSD}}}Connectors/{{{_SSD}}}Connector")
    return System(
        components,
        [_connection(e, path) for e in top.findall(f"{{{_SSD}}}Connections/{{{_SSD}}}Connection")],
        inputs=[str(c.get("name")) for c in connectors if c.get("kind") == "input"],
        outputs=[str(c.get("name")) for c in connectors if c.get("kind") == "output"],
        name=str(path),
    )


def _inside(root: Path, source: str, path: Path) -> Path:
    name = unquote(source)
    parts = PurePosixPath(name).parts
    file = (root / name).resolve()
    if ":" in name or ".." in parts or not file.is_relative_to(root.resolve()):
        raise _unsupported(f"the component '{source}' outside the archive", path)
    if not file.is_file():
        raise FmuError(
            f"the archive has no '{source}'", where=str(path), remedy="export the system again"
        )
    return file


def _connection(element: Any, path: Path) -> Connection:
    def end(which: str) -> str:
        part, name = element.get(f"{which}Element"), element.get(f"{which}Connector")
        return f"{part}.{name}" if part else str(name)

    factor = offset = None
    for transformation in element:
        kind = etree.QName(transformation).localname
        if kind == "LinearTransformation":
            factor = _number(transformation.get("factor", "1"), path)
            offset = _number(transformation.get("offset", "0"), path)
        elif kind.endswith("Transformation"):
            raise _unsupported(f"a {kind}", path)
    return Connection(end("start"), end("end"), factor, offset)


def _values(element: Any, root: Path, path: Path) -> dict[str, Value]:
    values: dict[str, Value] = {}
    for binding in element.findall(f"{{{_SSD}}}ParameterBindings/{{{_SSD}}}ParameterBinding"):
        if binding.find(f"{{{_SSD}}}ParameterMapping") is not None:
            raise _unsupported("a parameter mapping", path)
        source, prefix = binding.get("source"), binding.get("prefix", "")
        tree = binding if source is None else _parsed(_inside(root, source, path), path)
        for parameter in tree.iter(f"{{{_SSV}}}Parameter"):
            for typed in parameter:
                kind = etree.QName(typed).localname
                if kind not in _NUMBERS:
                    raise _unsupported(f"the {kind} parameter '{parameter.get('name')}'", path)
                number = _number(typed.get("value"), path)
                unit = typed.get("unit")
                values[prefix + str(parameter.get("name"))] = (number, unit) if unit else number
    return values


def _number(text: str | None, path: Path) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    try:
        number = float(text or "")
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise FmuError(f"'{text}' is no number", where=str(path), remedy="export the system again")
    return number


def _unsupported(what: str, path: Path) -> UnsupportedModelError:
    return UnsupportedModelError(
        f"the SSP has {what}, which is not supported",
        where=str(path),
        remedy="export it flat, with plain values",
    )


def _ssd_text(system: System, start: float | None, stop: float | None) -> str:
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<ssd:SystemStructureDescription xmlns:ssd="{_SSD}" xmlns:ssc="{_SSC}"'
        f' xmlns:ssv="{_SSV}" name={quoteattr(system.name)} version="1.0">',
        f"<ssd:System name={quoteattr(system.name)}>",
        "<ssd:Connectors>",
        *_connectors(
            [(n, "input") for n in system.inputs] + [(n, "output") for n in system.outputs]
        ),
        "</ssd:Connectors>",
        "<ssd:Elements>",
    ]
    for name, part in system.components.items():
        known = describe(part.fmu)
        lines += [
            f'<ssd:Component name={quoteattr(name)} type="application/x-fmu-sharedlibrary"'
            f" source={quoteattr(f'resources/{name}.fmu')}>",
            "<ssd:Connectors>",
            *_connectors(
                [(v.name, "input") for v in known.inputs]
                + [(v.name, "output") for v in known.outputs]
            ),
            "</ssd:Connectors>",
            *_binding(name, part.parameters),
            "</ssd:Component>",
        ]
    lines += ["</ssd:Elements>", "<ssd:Connections>"]
    for connection in system.connections:
        ends = ""
        for which, whole in (("start", connection.source), ("end", connection.target)):
            part, dot, name = whole.partition(".")
            element = (
                f" {which}Element={quoteattr(part)}" if dot and part in system.components else ""
            )
            ends += f"{element} {which}Connector={quoteattr(name if element else whole)}"
        if connection.factor is None and connection.offset is None:
            lines.append(f"<ssd:Connection{ends}/>")
        else:
            factor = 1.0 if connection.factor is None else connection.factor
            lines.append(
                f"<ssd:Connection{ends}><ssc:LinearTransformation"
                f' factor="{factor!r}" offset="{connection.offset or 0.0!r}"/></ssd:Connection>'
            )
    lines += ["</ssd:Connections>", "</ssd:System>"]
    if start is not None or stop is not None:
        times = "".join(
            f' {name}="{float(value)!r}"'
            for name, value in (("startTime", start), ("stopTime", stop))
            if value is not None
        )
        lines.append(f"<ssd:DefaultExperiment{times}/>")
    return "\n".join([*lines, "</ssd:SystemStructureDescription>", ""])


def _connectors(ends: Iterable[tuple[str, str]]) -> list[str]:
    return [
        f'<ssd:Connector name={quoteattr(name)} kind="{kind}"><ssc:Real/></ssd:Connector>'
        for name, kind in ends
    ]


def _binding(component: str, parameters: Mapping[str, Value]) -> list[str]:
    if not parameters:
        return []
    lines = [
        "<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>",
        f'<ssv:ParameterSet version="1.0" name={quoteattr(component)}><ssv:Parameters>',
    ]
    for name, value in parameters.items():
        if isinstance(value, tuple):
            raise UnsupportedModelError(
                f"the parameter '{component}.{name}' has a unit of its own",
                remedy="give it in the FMU's unit",
            )
        lines.append(
            f"<ssv:Parameter name={quoteattr(name)}>"
            f'<ssv:Real value="{float(value)!r}"/></ssv:Parameter>'
        )
    return [
        *lines,
        "</ssv:Parameters></ssv:ParameterSet>",
        "</ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>",
    ]
