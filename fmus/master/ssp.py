"""System Structure and Parameterization (SSP): systems of FMUs as one file.

Read are 1.0 and 2.0: nested systems, linear and Boolean transformations, parameter values and
mappings, inline or in files of the archive. Refused with a reason: signal dictionaries, arrays,
texts, Integer and enumeration transformations, systems inside components. Written is 1.0.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from fmus.archive import describe, extract
from fmus.guarded import ask
from fmus.master.ssd import Flat
from fmus.master.ssv import namespace, number, parsed, tag
from fmus.master.system import System
from fmus.plant import Value
from fmus.running import Simulation
from foundation.closing import Closing
from foundation.errors import FmuError, UnsupportedModelError
from foundation.files import written_whole


@dataclass(frozen=True, eq=False)
class OpenedSsp(Closing):
    """A system read from an SSP, whose FMUs stand in a folder that is removed at the end.

    Attributes:
        system: To be simulated.
        defaults: `start` and `stop` [s], as far as the file names them.
        folder: Of the extracted files.
    """

    system: System
    defaults: Mapping[str, float]
    folder: tempfile.TemporaryDirectory[str]

    def close(self) -> None:
        """Remove the folder."""
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
        tree = parsed(file, path)
        top = tree.find(tag("ssd", "System"))
        if top is None:
            raise FmuError(
                "the description has no system", where=str(path), remedy="export it again"
            )
        experiment = tree.find(tag("ssd", "DefaultExperiment"))
        defaults: dict[str, float] = {}
        for key, name in (("start", "startTime"), ("stop", "stopTime")):
            if experiment is not None and experiment.get(name) is not None:
                defaults[key] = number(experiment.get(name), path)
        flat = Flat(root, path)
        flat.add(top)
        return OpenedSsp(flat.system(str(path)), defaults, folder)
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


def _ssd_text(system: System, start: float | None, stop: float | None) -> str:
    spaces = " ".join(f'xmlns:{short}="{namespace(short)}"' for short in ("ssd", "ssc", "ssv"))
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<ssd:SystemStructureDescription {spaces} name={quoteattr(system.name)} version="1.0">',
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
            part, name = system.split(whole)
            element = f" {which}Element={quoteattr(part)}" if part else ""
            ends += f"{element} {which}Connector={quoteattr(name)}"
        if connection.factor is None and connection.offset is None:
            lines.append(f"<ssd:Connection{ends}/>")
        else:
            factor = 1.0 if connection.factor is None else connection.factor
            lines.append(
                f'<ssd:Connection{ends} suppressUnitConversion="true"><ssc:LinearTransformation'
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
