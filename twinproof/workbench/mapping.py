"""Which column is which variable: what there is, what is likely, and the file that says so."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from difflib import SequenceMatcher
from itertools import pairwise
from pathlib import Path
from typing import Any

import tomli_w

from foundation.errors import InputError, UnitError
from foundation.files import write_text
from foundation.units import factor_and_offset
from recordings import parse_map

_UNITS = (
    *("rad", "deg", "rev", "m", "mm", "um", "km", "rad/s", "deg/s", "rpm", "m/s", "mm/s", "km/h"),
    *("rad/s2", "deg/s2", "m/s2", "N.m", "mN.m", "N", "kN", "V", "mV", "kV", "A", "mA", "W", "kW"),
    *("s", "ms", "us", "Pa", "kPa", "bar", "K", "degC", "1", "%"),
)
_LIKELY = 0.72
_WORD = re.compile(r"[A-Za-z][a-z0-9]*|\d+")
NUMBERS = ("factor", "offset", "sd", "resolution", "delay")
"""The keys of a channel that are numbers."""


def units_for(unit: str) -> list[str]:
    """Return the units that a column of a model's unit is likely to be in, the model's own first.

    Example:
        >>> units_for("rad/s")
        ['rad/s', 'deg/s', 'rpm']
    """
    return [unit, *(u for u in _UNITS if u != unit and unit and converts(u, unit))]


def converts(source: str, target: str) -> bool:
    """Return whether numbers in one unit can be turned into another."""
    try:
        factor_and_offset(source, target)
    except UnitError:
        return False
    return True


def likeness(variable: str, description: str, column: str) -> float:
    """Return how like a column's name is to a variable's, or to words of its description: 0 to 1.

    Example:
        >>> likeness("theta_p", "pitch angle", "Pitch") > 0.9
        True
    """
    plain = _plain(column)
    words = _WORD.findall(description.replace("_", " "))
    pairs = [" ".join(pair) for pair in pairwise(words)]
    # A long word of the description is a good name; a short one matches anything.
    names = [variable, *pairs, *(w for w in words if len(w) > 3)]
    return max((SequenceMatcher(None, _plain(name), plain).ratio() for name in names), default=0.0)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def suggest(
    variables: Mapping[str, tuple[str, str]], columns: Mapping[str, str | None]
) -> dict[str, str]:
    """Return the likeliest column of each variable, no column twice.

    Args:
        variables: Name → (unit, description).
        columns: Name → unit, as the file says it; None where it does not.
    """
    pairs = sorted(
        (
            (likeness(name, description, column), name, column)
            for name, (unit, description) in variables.items()
            for column, there in columns.items()
            if there is None or not unit or converts(there, unit)
        ),
        reverse=True,
    )
    found: dict[str, str] = {}
    for score, name, column in pairs:
        if score >= _LIKELY and name not in found and column not in found.values():
            found[name] = column
    return found


def read_tables(path: Path) -> dict[str, Any]:
    """Return a channel map's tables as they are written; empty where there is no file.

    Raises:
        FormatError: It is not TOML.
        ChannelError: It says what no channel map can say.
    """
    if not path.is_file():
        return {}
    text = path.read_text(encoding="utf-8")
    parse_map(text, origin=path.name)
    return tomllib.loads(text)


def change_tables(path: Path, variable: str, said: Mapping[str, str]) -> None:
    """Say something else of one channel, or of `time`; an empty text says nothing any more.

    Args:
        path: The channel map; what it says of others stays.
        variable: A variable of the model, or `time`.
        said: Key → text, as typed.

    Raises:
        InputError: A number is none; the file stays as it was.
        ChannelError: The map would be wrong; the file stays as it was.
    """
    tables = read_tables(path)
    channels: dict[str, Any] = tables.setdefault("channels", {})
    if variable == "time":
        table: dict[str, Any] = tables.setdefault("time", {})
    else:
        table = channels.setdefault(variable, {})
    for key, text in said.items():
        if not text.strip():
            table.pop(key, None)
        elif key in NUMBERS or key == "step":
            table[key] = _number(key, text)
        else:
            table[key] = text.strip()
    kept: dict[str, Any] = {name: t for name, t in channels.items() if t}
    text = tomli_w.dumps(
        {
            k: v
            for k, v in {**tables, "channels": kept}.items()
            if v or k not in ("time", "channels")
        }
    )
    parse_map(text, origin=path.name)
    if text or path.exists():
        write_text(path, text)


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"'{text}' is no number", where=key, remedy="write it like 0.0087 or 8.7e-3"
        ) from None
