"""The description of a system (SSD 1.0 and 2.0), nested systems and parameters included, made flat.

Everything that connects or sets values gets one name within the whole: `inner.plant.x` is the
variable x of the component `plant` in the system `inner`, `inner.u` that system's own connector.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] - it has no stubs

from fmus.archive import FmuDescription, FmuVariableInfo, describe
from fmus.master.ssv import Linear, Setting, linear_of, settings_of, tag, unsupported
from fmus.master.system import Component, Connection, System
from fmus.plant import Value
from foundation.errors import FmuError
from foundation.units import factor_and_offset

_FMU = "application/x-fmu-sharedlibrary"
_SIGNALS = ("input", "output")


@dataclass(frozen=True)
class _Edge:
    source: str
    target: str
    change: Linear
    converts: bool


@dataclass
class Flat:
    """A system under construction.

    Attributes:
        folder: Of the extracted archive.
        where: The archive, for messages.
        ports: Connectors of systems: their kind and unit.
        components: Component → FMU.
        edges: Connections.
        settings: Variable or connector → value; what was set last stands last.
        top: Connectors of the outermost system.
    """

    folder: Path
    where: Path
    ports: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])
    components: dict[str, Path] = field(default_factory=dict[str, Path])
    edges: list[_Edge] = field(default_factory=list[_Edge])
    settings: dict[str, Setting] = field(default_factory=dict[str, Setting])
    top: list[str] = field(default_factory=list[str])

    def add(self, system: Any, prefix: str = "") -> None:
        """Take in a system element and all below it.

        Raises:
            FmuError: Something is malformed or missing.
            UnsupportedModelError: Something is not supported.
        """
        if system.find(tag("ssd", "SignalDictionaries")) is not None:
            raise unsupported("signal dictionaries", self.where)
        for connector in system.findall(f"{tag('ssd', 'Connectors')}/{tag('ssd', 'Connector')}"):
            kind, unit = str(connector.get("kind")), ""
            for typed in connector:
                if typed.find(tag("ssc", "Dimension")) is not None:
                    raise unsupported(f"the array connector '{connector.get('name')}'", self.where)
                unit = str(typed.get("unit") or unit)
            self.ports[f"{prefix}{connector.get('name')}"] = (kind, unit)
            if not prefix:
                self.top.append(str(connector.get("name")))
        for element in system.findall(f"{tag('ssd', 'Elements')}/*"):
            kind, name = etree.QName(element).localname, f"{prefix}{element.get('name')}"
            if kind == "System":
                self.add(element, f"{name}.")
            elif kind == "Component":
                self._add_component(element, name)
            else:
                raise unsupported(f"a {kind} inside the system", self.where)
        for connection in system.findall(f"{tag('ssd', 'Connections')}/{tag('ssd', 'Connection')}"):
            self.edges.append(self._edge(connection, prefix))
        # A system's own values go before those of its parts: they are set later.
        self._set(system, prefix)

    def _add_component(self, element: Any, name: str) -> None:
        kind = str(element.get("type") or _FMU)
        if kind != _FMU:
            raise unsupported(f"the component '{name}' of the type {kind}", self.where)
        if element.get("source") is None:
            raise unsupported(f"the component '{name}' without a source", self.where)
        self.components[name] = self.inside(str(element.get("source")))
        self._set(element, f"{name}.")

    def _set(self, element: Any, prefix: str) -> None:
        for name, setting in settings_of(element, self.inside, self.where).items():
            self.settings.pop(prefix + name, None)
            self.settings[prefix + name] = setting

    def inside(self, source: str) -> Path:
        """Return a file of the archive.

        Raises:
            UnsupportedModelError: It would be outside.
            FmuError: It is not there.
        """
        name = unquote(source)
        file = (self.folder / name).resolve()
        is_outside = not file.is_relative_to(self.folder.resolve())
        if ":" in name or ".." in PurePosixPath(name).parts or is_outside:
            raise unsupported(f"the file '{source}' outside the archive", self.where)
        if not file.is_file():
            raise FmuError(
                f"the archive has no '{source}'",
                where=str(self.where),
                remedy="export the system again",
            )
        return file

    def _edge(self, connection: Any, prefix: str) -> _Edge:
        ends: list[str] = []
        for which in ("start", "end"):
            part, name = connection.get(f"{which}Element"), connection.get(f"{which}Connector")
            if connection.get(f"{which}Indices") is not None:
                raise unsupported(f"a connection of elements of the array '{name}'", self.where)
            ends.append(f"{prefix}{part}.{name}" if part else f"{prefix}{name}")
        suppresses = connection.get("suppressUnitConversion", "false") in ("true", "1")
        return _Edge(ends[0], ends[1], linear_of(connection, self.where), not suppresses)

    # From the parts to the whole

    def system(self, name: str) -> System:
        """Return the whole as one flat system."""
        values: dict[str, dict[str, Value]] = {part: {} for part in self.components}
        for target, setting in self.settings.items():
            self._assign(target, setting, values)
        inputs, outputs = ([n for n in self.top if self.ports[n][0] == k] for k in _SIGNALS)
        return System(
            {part: Component(fmu, values[part]) for part, fmu in self.components.items()},
            self._connections(inputs, outputs),
            inputs=inputs,
            outputs=outputs,
            name=name,
        )

    def _assign(
        self, target: str, setting: Setting, values: Mapping[str, dict[str, Value]]
    ) -> None:
        """Set a variable of a component, or whatever a connector leads to."""
        if target in self.ports:
            for edge in self.edges:
                if edge.source == target:
                    self._assign(edge.target, setting.changed(edge.change), values)
        part, variable = self._split(target)
        info = self._variables(part).get(variable) if part else None
        # The standard: what names nothing is left out, for parameter sets are shared.
        if info is not None:
            number = setting.value_in(info.unit, f"{self.where}: {target}")
            values[part].pop(variable, None)
            values[part][variable] = number

    def _connections(self, inputs: list[str], outputs: list[str]) -> list[Connection]:
        into = {edge.target: edge for edge in self.edges}
        if len(into) < len(self.edges):
            names = [edge.target for edge in self.edges]
            twice = next(name for name in names if names.count(name) > 1)
            raise FmuError(
                f"'{twice}' has two sources",
                where=str(self.where),
                remedy="remove one of the connections",
            )
        found: list[Connection] = []
        for edge in self.edges:
            part, variable = self._split(edge.target)
            is_parameter = part and variable in {v.name for v in self._known[part].parameters}
            if (edge.target in self.ports and edge.target not in outputs) or is_parameter:
                continue
            source, change, converts, seen = edge.source, edge.change, edge.converts, {edge.target}
            while source in self.ports and source not in inputs and source not in seen:
                seen.add(source)
                if source not in into:
                    break  # a connector that leads nowhere
                before = into[source]
                source, change = before.source, change.after(before.change)
                converts = converts and before.converts
            else:
                units = (self._unit(source), self._unit(edge.target))
                if converts and all(units):
                    where = f"{source} → {edge.target}"
                    change = change.after(Linear(*factor_and_offset(*units, where=where)))
                # Without a number, the system converts from unit to unit.
                is_plain = converts and change == Linear()
                found.append(
                    Connection(source, edge.target)
                    if is_plain
                    else Connection(source, edge.target, change.factor, change.offset)
                )
        return found

    def _unit(self, name: str) -> str:
        if name in self.ports:
            return self.ports[name][1]
        part, variable = self._split(name)
        info = self._variables(part).get(variable) if part else None
        return info.unit if info is not None else ""

    def _split(self, name: str) -> tuple[str, str]:
        """Return component and variable; their names may have dots."""
        parts = [part for part in self.components if name.startswith(f"{part}.")]
        part = max(parts, key=len, default="")
        return part, name.removeprefix(f"{part}.")

    @cached_property
    def _known(self) -> Mapping[str, FmuDescription]:
        return {part: describe(fmu) for part, fmu in self.components.items()}

    def _variables(self, part: str) -> Mapping[str, FmuVariableInfo]:
        known = self._known[part]
        nothing = dict[str, FmuVariableInfo]()
        for name in known.others:
            nothing[name] = FmuVariableInfo(name, "", "", None, None, None, None)
        return nothing | {v.name: v for v in (*known.inputs, *known.outputs, *known.parameters)}
