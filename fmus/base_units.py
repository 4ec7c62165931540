"""Modelica units in powers of SI base units, as FMI's unit definitions want them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from math import pi

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class BaseUnit:
    """`value in base units = factor · value + offset`.

    Attributes:
        exponents: Base unit → power, without zeros.
        factor, offset: The conversion.
    """

    exponents: dict[str, int] = field(default_factory=dict[str, int])
    factor: float = 1.0
    offset: float = 0.0


def _power(**exponents: int) -> BaseUnit:
    return BaseUnit(exponents)


_SYMBOLS: dict[str, BaseUnit] = {
    **{symbol: _power(**{symbol: 1}) for symbol in BASE_UNITS},
    "1": BaseUnit(),
    "Hz": _power(s=-1),
    "N": _power(kg=1, m=1, s=-2),
    "Pa": _power(kg=1, m=-1, s=-2),
    "J": _power(kg=1, m=2, s=-2),
    "W": _power(kg=1, m=2, s=-3),
    "C": _power(A=1, s=1),
    "V": _power(kg=1, m=2, s=-3, A=-1),
    "Ohm": _power(kg=1, m=2, s=-3, A=-2),
    "F": _power(kg=-1, m=-2, s=4, A=2),
    "H": _power(kg=1, m=2, s=-2, A=-2),
    "Wb": _power(kg=1, m=2, s=-2, A=-1),
    "T": _power(kg=1, s=-2, A=-1),
    "deg": BaseUnit({"rad": 1}, pi / 180),
    "g": BaseUnit({"kg": 1}, 1e-3),
    "min": BaseUnit({"s": 1}, 60.0),
    "h": BaseUnit({"s": 1}, 3600.0),
    "rpm": BaseUnit({"rad": 1, "s": -1}, pi / 30),
}
_PREFIXES = {"k": 1e3, "M": 1e6, "G": 1e9, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d+)?\Z")


def base_unit(unit: str) -> BaseUnit | None:
    """Return a unit in base units, or None if it holds a symbol that is not known here.

    Example:
        >>> base_unit("N.m/V").exponents == {"A": 1, "s": 1}
        True
        >>> base_unit("mm/s2")
        BaseUnit(exponents={'m': 1, 's': -2}, factor=0.001, offset=0.0)
        >>> base_unit("degC")
        BaseUnit(exponents={'K': 1}, factor=1.0, offset=273.15)
    """
    if unit == "degC":
        return BaseUnit({"K": 1}, 1.0, 273.15)
    exponents: Counter[str] = Counter()
    factor = 1.0
    numerator, _, denominator = unit.partition("/")
    for part, sign in ((numerator, 1), (denominator.strip("()"), -1)):
        for text in filter(None, part.split(".")):
            found = _FACTOR.match(text)
            symbol = _symbol(found[1]) if found else None
            if found is None or symbol is None:
                return None
            power = sign * int(found[2] or 1)
            factor *= symbol.factor**power
            for name, exponent in symbol.exponents.items():
                exponents[name] += power * exponent
    return BaseUnit({name: exponents[name] for name in BASE_UNITS if exponents[name]}, factor)


def _symbol(text: str) -> BaseUnit | None:
    if text in _SYMBOLS:
        return _SYMBOLS[text]
    scale, rest = _PREFIXES.get(text[0]), _SYMBOLS.get(text[1:])
    if scale is None or rest is None:
        return None
    return BaseUnit(rest.exponents, scale * rest.factor)
