"""Settings from TOML: each table becomes a dataclass; what does not fit is said with file and line.

A number may be written with its unit as text, `"10 deg"`, where the field says in which unit it is
kept. Keys that no field has, and keys that a field needs, are errors.
"""

from __future__ import annotations

import dataclasses
import re
import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from foundation.errors import FormatError, InputError, UnitError, UnknownNameError
from foundation.units import factor_and_offset

T = TypeVar("T")
_WITH_UNIT = re.compile(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([^\d\s].*)?")


@dataclass(frozen=True)
class Table:
    """A table of a TOML file.

    Attributes:
        values: Its keys and values.
        name: As in the file, `plant` or `faults.2`; empty for the file's top.
        path: The file, which relative paths in it start from.
        text: Of the whole file, to find lines in.
    """

    values: Mapping[str, Any]
    name: str = ""
    path: Path = Path("settings.toml")
    text: str = field(default="", repr=False)

    def where(self, key: str = "") -> str:
        """Return file, line and name of a key, or of the table."""
        name = ".".join(part for part in (self.name, key) if part)
        line = self._line(key)
        return f"{self.path}{'' if line is None else f':{line}'}{f', {name}' if name else ''}"

    def _line(self, key: str) -> int | None:
        """Find a key's line; of inline tables and of what is not there, the table's."""
        group, _, number = self.name.rpartition(".")
        header, count = self.name, 0
        if number.isdigit():
            header, count = group, int(number) - 1
        found: int | None = None if header else 0
        seen = -1
        for k, line in enumerate(self.text.splitlines(), 1):
            opened = re.match(r"\s*\[\[?\s*([^\]]+?)\s*\]", line)
            if opened:
                if found:
                    break
                if opened[1].replace('"', "") == header:
                    seen += 1
                    found = k if seen == count else found
                elif found == 0:
                    break
            elif found is not None and key and re.match(rf'\s*"?{re.escape(key)}"?\s*[=.]', line):
                return k
        return found or None

    def sub(self, key: str) -> Table:
        """Return an inner table; an empty one if it is not there.

        Raises:
            InputError: The key holds something else.
        """
        value = self.values.get(key, {})
        if not isinstance(value, Mapping):
            raise InputError(
                f"'{key}' is no table", where=self.where(key), remedy=f"write it as [{key}]"
            )
        return Table(value, f"{self.name}.{key}".lstrip("."), self.path, self.text)

    def subs(self, key: str) -> list[Table]:
        """Return the tables of an array of tables.

        Raises:
            InputError: The key holds something else.
        """
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, Mapping) for v in value):
            raise InputError(
                f"'{key}' is no list of tables", where=self.where(key), remedy=f"write [[{key}]]"
            )
        return [
            Table(v, f"{self.name}.{key}.{k}".lstrip("."), self.path, self.text)
            for k, v in enumerate(value, 1)
        ]

    def without(self, *keys: str) -> Table:
        """Return the table without some keys."""
        return dataclasses.replace(
            self, values={k: v for k, v in self.values.items() if k not in keys}
        )

    def with_value(self, key: str, value: Any) -> Table:
        """Return the table with another value of a key."""
        return dataclasses.replace(self, values={**self.values, key: value})

    def only(self, known: Sequence[str]) -> None:
        """Refuse keys that are not known.

        Raises:
            UnknownNameError: There is one.
        """
        for key in self.values:
            if key not in known:
                raise UnknownNameError("key", key, known, where=self.where(key))

    def word(self, key: str, choices: Mapping[str, T] | Sequence[str]) -> str:
        """Return a key that chooses among words.

        Raises:
            InputError, UnknownNameError: It is missing, or no such word.
        """
        if key not in self.values:
            raise InputError(
                f"no '{key}'", where=self.where(), remedy=f"write one of {', '.join(choices)}"
            )
        word = str(self.values[key])
        if word not in choices:
            raise UnknownNameError(key, word, choices, where=self.where(key))
        return word

    def file(self, value: str) -> Path:
        """Return a path that is written in the file."""
        return self.path.parent / value


def read_toml(path: Path) -> Table:
    """Read a TOML file.

    Raises:
        InputError: There is no such file.
        FormatError: It is not TOML; says at which line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(
            f"the file is not text: {error.reason} at byte {error.start}",
            where=str(path),
            remedy="save it as UTF-8",
        ) from error
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror}",
            where=str(path),
            remedy="correct its name",
        ) from error
    return parse_toml(text, path)


def parse_toml(text: str, path: Path = Path("settings.toml")) -> Table:
    """Read TOML text; errors as `read_toml`."""
    try:
        return Table(tomllib.loads(text), "", path, text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"line (\d+)", str(error))
        raise FormatError(
            f"not TOML: {error}",
            where=f"{path}:{found[1]}" if found else str(path),
            remedy="mend the line",
        ) from error


OWN = "own"
"""In place of a unit: that of the variable which the table is about."""


def unit(of: str, default: Any = dataclasses.MISSING) -> Any:
    """Return a dataclass field that is kept in a unit, or `OWN`, and may be written in others."""
    return field(default=default, metadata={"unit": of})


def build(kind: type[T], table: Table, *, own: str = "", **given: Any) -> T:
    """Make a dataclass of a table.

    Args:
        kind: A dataclass whose fields are numbers, texts, flags, or tuples and mappings of these.
        table: Its keys are the fields' names.
        own: Unit of fields whose unit is `OWN`.
        given: Fields that do not come from the table.

    Raises:
        UnknownNameError: A key that is no field.
        InputError: A key that is missing, or a value of the wrong kind.
        UnitError: A unit that does not fit.

    Example:
        >>> @dataclass
        ... class Zone:
        ...     low: float = unit("rad")
        ...     name: str = "a"
        >>> round(build(Zone, parse_toml('low = "180 deg"')).low, 6)
        3.141593
    """
    fields = {f.name: f for f in dataclasses.fields(kind) if f.init and f.name not in given}  # pyright: ignore[reportArgumentType] - it is a dataclass
    table.only(list(fields))
    hints = typing.get_type_hints(kind)
    values: dict[str, Any] = dict(given)
    for name, f in fields.items():
        if name in table.values:
            wanted = f.metadata.get("unit", "")
            wanted = own if wanted == OWN else wanted
            values[name] = _converted(table.values[name], hints[name], wanted, table.where(name))
        elif f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING:
            raise InputError(f"no '{name}'", where=table.where(), remedy=f"add `{name} = …`")
    try:
        return kind(**values)
    except InputError as error:
        # What a value means is checked where it is kept; where it was written is known here.
        if type(error) is not InputError or str(table.path) in error.where:
            raise
        raise InputError(error.what, where=table.where(), remedy=error.remedy) from error


def number(value: Any, unit_: str, where: str) -> float:
    """Return a number that may be written with its unit.

    Raises:
        InputError: It is no number.
        UnitError: Its unit does not fit.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"{value!r} is no number", where=where, remedy="write for example 0.5")
    if not isinstance(value, str):
        return float(value)
    found = _WITH_UNIT.fullmatch(value)
    if found is None:
        raise InputError(
            f"'{value}' is no number",
            where=where,
            remedy='write a number, or a number and its unit as text: "10 deg"',
        )
    if not found[2]:
        return float(found[1])
    if not unit_:
        raise UnitError(f"'{value}' has a unit, but here is none", where=where, remedy="drop it")
    factor, offset = factor_and_offset(found[2].strip(), unit_, where=where)
    return factor * float(found[1]) + offset


def _converted(value: Any, hint: Any, unit_: str, where: str) -> Any:  # noqa: PLR0911 - one return a kind
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _converted(value, next(a for a in inner if a is not type(None)), unit_, where)
    if origin is typing.Literal:
        if value not in inner:
            raise UnknownNameError("word", str(value), [str(a) for a in inner], where=where)
        return value
    if hint is float:
        return number(value, unit_, where)
    if hint is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if hint in (bool, str) and isinstance(value, hint):
        return value
    if hint is Path and isinstance(value, str):
        return Path(value)
    if origin is tuple and isinstance(value, list | tuple):
        if len(inner) == 2 and inner[1] is Ellipsis:
            return tuple(_converted(v, inner[0], unit_, where) for v in value)
        if len(value) == len(inner):
            pairs = zip(value, inner, strict=True)
            return tuple(_converted(v, kind, unit_, where) for v, kind in pairs)
    if (origin is Mapping or str(origin).endswith("Mapping'>")) and isinstance(value, Mapping):
        return {str(k): _converted(v, inner[1], unit_, where) for k, v in value.items()}
    if hint is Any:
        return value
    name = str(getattr(hint, "__name__", hint)).replace("typing.", "")
    raise InputError(f"{value!r} is no {name}", where=where, remedy="see the documentation")
