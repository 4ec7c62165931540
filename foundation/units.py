"""Units as Modelica and DBC files write them, converted with pint.

Modelica writes `kg.m2/s2` and `N.m.s/rad` (dots multiply, an exponent follows its symbol); DBC
files write whatever their authors typed. Both are turned into pint's grammar in one place.
"""

from __future__ import annotations

import re
from functools import cache

import pint

from foundation.errors import UnitError

_ALIASES = {
    "": "",
    "1": "",
    "-": "",
    "%": "percent",
    "°": "degree",
    "deg/s": "degree/s",
    "°/s": "degree/s",
    "Ohm": "ohm",
    "degC": "degC",
    "l": "liter",
}
_FACTOR = re.compile(r"([A-Za-zµ°%_]+)(-?\d+)?")


@cache
def _registry() -> pint.UnitRegistry[float]:
    registry: pint.UnitRegistry[float] = pint.UnitRegistry(cache_folder=None)
    registry.define("count = 1 * dimensionless")
    return registry


def _pint_text(unit: str) -> str:
    text = unit.strip()
    if text in _ALIASES:
        return _ALIASES[text]
    if "**" in text or "^" in text:
        return text
    text = text.replace("(", " ( ").replace(")", " ) ").replace(".", "*")
    return _FACTOR.sub(
        lambda m: f"{_ALIASES.get(m[1], m[1])}" + (f"**{m[2]}" if m[2] else ""), text
    )


def factor_and_offset(source: str, target: str, *, where: str = "") -> tuple[float, float]:
    """Return `(a, b)` such that `value_in_target = a * value_in_source + b`.

    Args:
        source: Unit of the numbers there are, for example `deg/s`.
        target: Unit wanted, for example `rad/s`.
        where: Named in the error.

    Raises:
        UnitError: A unit is unknown, or the two measure different things.

    Example:
        >>> round(factor_and_offset("deg", "rad")[0], 6)
        0.017453
        >>> factor_and_offset("kg.m2", "kg.m2")
        (1.0, 0.0)
    """
    if source.strip() == target.strip():
        return 1.0, 0.0
    registry = _registry()
    try:
        zero = registry.Quantity(0.0, _pint_text(source)).to(_pint_text(target)).magnitude
        one = registry.Quantity(1.0, _pint_text(source)).to(_pint_text(target)).magnitude
    except pint.DimensionalityError as error:
        raise UnitError(
            f"'{source}' cannot be converted to '{target}'",
            where=where,
            remedy="correct `unit` in the channel map",
        ) from error
    except (
        pint.UndefinedUnitError,
        pint.PintError,
        ValueError,
        TypeError,
        AttributeError,
        SyntaxError,
    ) as error:
        raise UnitError(
            f"unit '{source}' or '{target}' is not known",
            where=where,
            remedy="write it in SI symbols, such as rad/s, N.m or kg.m2",
        ) from error
    return float(one - zero), float(zero)
