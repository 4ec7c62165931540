"""Parameter values and their mappings (SSV and SSM, 1.0 and 2.0), and linear transformations."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] - it has no stubs

from foundation.errors import FmuError, UnsupportedModelError
from foundation.units import factor_and_offset

# Of both versions: 2.0 has kept the names of 1.0.
_NAMESPACES = {
    "ssd": "SystemStructureDescription",
    "ssc": "SystemStructureCommon",
    "ssv": "SystemStructureParameterValues",
    "ssm": "SystemStructureParameterMapping",
}
_NUMBERS = frozenset(
    (
        *("Real", "Float64", "Float32", "Integer", "Boolean"),
        *("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    )
)


def namespace(short: str) -> str:
    """Return the XML namespace that is usually called `ssd`, `ssc`, `ssv` or `ssm`."""
    return f"http://ssp-standard.org/SSP1/{_NAMESPACES[short]}"


def tag(short: str, name: str) -> str:
    """Return an element's full name, as lxml writes it."""
    return f"{{{namespace(short)}}}{name}"


@dataclass(frozen=True)
class Linear:
    """factor × value + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def after(self, first: Linear) -> Linear:
        """Return what this does to the result of another."""
        return Linear(self.factor * first.factor, self.factor * first.offset + self.offset)


@dataclass(frozen=True)
class Setting:
    """A value to set, in a unit or in whatever unit its target has, and what is done to it."""

    value: float
    unit: str = ""
    change: Linear = Linear()

    def changed(self, change: Linear) -> Setting:
        """Return the setting with a further transformation."""
        return Setting(self.value, self.unit, change.after(self.change))

    def value_in(self, unit: str, where: str) -> float:
        """Return the number in its target's unit: units first, then transformations.

        Raises:
            UnitError: The units do not fit.
        """
        value = self.value
        if self.unit and unit:
            factor, offset = factor_and_offset(self.unit, unit, where=where)
            value = factor * value + offset
        return self.change.factor * value + self.change.offset


def parsed(file: Path, where: Path) -> Any:
    """Return the root element of an XML file.

    Raises:
        FmuError: It is malformed, or of a version of the standard other than 1 and 2.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
    try:
        root = etree.parse(str(file), parser).getroot()
    except etree.XMLSyntaxError as error:
        raise FmuError(
            f"{file.name} is malformed: {error}", where=str(where), remedy="export it again"
        ) from error
    version = str(root.get("version", ""))
    if version.partition(".")[0] not in ("1", "2"):
        raise FmuError(
            f"{file.name} says that it is of version '{version}' of the standard",
            where=str(where),
            remedy="export it as SSP 1.0 or 2.0",
        )
    return root


def settings_of(element: Any, inside: Callable[[str], Path], where: Path) -> dict[str, Setting]:
    """Return what the parameter bindings of a system or component set, later ones last.

    Args:
        element: A system or component.
        inside: Returns a file of the archive.
        where: The archive, for messages.

    Raises:
        FmuError: Something is malformed or missing.
        UnsupportedModelError: Texts, arrays and other files than parameter sets.
    """
    found: dict[str, Setting] = {}
    path = f"{tag('ssd', 'ParameterBindings')}/{tag('ssd', 'ParameterBinding')}"
    for binding in element.findall(path):
        kind = str(binding.get("type") or "application/x-ssp-parameter-set")
        if kind != "application/x-ssp-parameter-set":
            raise unsupported(f"parameters of the type {kind}", where)
        source, prefix = _part(binding, "ParameterValues", inside, where), binding.get("prefix", "")
        values: dict[str, Setting] = {}
        for parameter in source.iter(tag("ssv", "Parameter")) if source is not None else ():
            name = prefix + str(parameter.get("name"))
            for typed in parameter:
                if etree.QName(typed).localname == "Annotations":
                    continue
                values[name] = _setting(name, typed, where)
        mapping = binding.find(tag("ssd", "ParameterMapping"))
        if mapping is not None:
            root = _part(binding, "ParameterMapping", inside, where, of=mapping)
            values = _mapped(values, root, where)
        for name, setting in values.items():
            found.pop(name, None)
            found[name] = setting
    return found


def _part(
    binding: Any, name: str, inside: Callable[[str], Path], where: Path, *, of: Any = None
) -> Any:
    """Return what stands inline or in a file."""
    holder = binding if of is None else of
    if holder.get("sourceBase", "SSD") != "SSD":
        raise unsupported("parameters inside a component's own archive", where)
    if holder.get("source") is not None:
        return parsed(inside(holder.get("source")), where)
    return binding.find(tag("ssd", name))


def _setting(name: str, typed: Any, where: Path) -> Setting:
    kind = etree.QName(typed).localname
    if kind not in _NUMBERS:
        raise unsupported(f"the {kind} parameter '{name}'", where)
    if len(str(typed.get("value")).split()) > 1 or typed.find(tag("ssc", "Dimension")) is not None:
        raise unsupported(f"the array parameter '{name}'", where)
    return Setting(number(typed.get("value"), where), str(typed.get("unit") or ""))


def _mapped(values: dict[str, Setting], mapping: Any, where: Path) -> dict[str, Setting]:
    """Return the values that a mapping names, under their new names; others are not set."""
    found: dict[str, Setting] = {}
    for entry in mapping.iter(tag("ssm", "MappingEntry")):
        setting = values.get(str(entry.get("source")))
        if setting is None:
            continue
        if entry.get("suppressUnitConversion", "false") in ("true", "1"):
            setting = Setting(setting.value)
        found[str(entry.get("target"))] = setting.changed(linear_of(entry, where))
    return found


def linear_of(element: Any, where: Path) -> Linear:
    """Return the transformation of a connection or mapping entry.

    Raises:
        UnsupportedModelError: It is not linear.
    """
    for transformation in element:
        kind = etree.QName(transformation).localname
        if kind == "LinearTransformation":
            return Linear(
                number(transformation.get("factor", "1"), where),
                number(transformation.get("offset", "0"), where),
            )
        if kind == "BooleanMappingTransformation":
            # Two values are on a line. One that is not named stays as it is.
            to = {0.0: 0.0, 1.0: 1.0}
            for entry in transformation.iter(tag("ssc", "MapEntry")):
                source, target = (number(entry.get(key), where) for key in ("source", "target"))
                to[source] = target
            return Linear(to[1.0] - to[0.0], to[0.0])
        if kind.endswith("Transformation"):
            raise unsupported(f"a {kind}", where)
    return Linear()


def number(text: str | None, where: Path) -> float:
    """Read a number or truth value.

    Raises:
        FmuError: It is none.
    """
    if text in ("true", "false"):
        return float(text == "true")
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FmuError(f"'{text}' is no number", where=str(where), remedy="export the system again")
    return value


def unsupported(what: str, where: Path) -> UnsupportedModelError:
    """Return the error for something that is not supported."""
    return UnsupportedModelError(
        f"the SSP has {what}, which is not supported",
        where=str(where),
        remedy="export it with scalar numbers, FMUs inside and plain connections",
    )
