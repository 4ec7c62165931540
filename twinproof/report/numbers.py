"""Numbers and units as an engineer writes them: digits that mean something, SI prefixes, `N·m`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_EXPONENT = re.compile(r"(?<=[A-Za-z)])(-?\d+)")
_E_NOTATION = re.compile(r"\b(\d+(?:\.\d+)?)e([-+]?\d+)\b")
_PREFIXES = ((1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""), (1e3, "k"))
_LEADING = re.compile(r"(rad|Hz|[msNVAW])(?=$|[./])")
# Nobody speaks of kilometres of a carriage, or of kiloradians.
_NEVER_KILO = {"m", "s", "rad"}
_MOST_DIGITS = 9


@dataclass(frozen=True)
class Scale:
    """A unit to show numbers in: `shown = SI / size`."""

    size: float
    unit: str


def typeset(unit: str) -> str:
    """Return a Modelica unit as it is printed.

    Example:
        >>> typeset("N.m.s/rad"), typeset("kg.m2"), typeset("")
        ('N·m·s/rad', 'kg·m²', '1')
    """
    if not unit:
        return "1"
    return _EXPONENT.sub(lambda m: m[1].translate(_SUPERSCRIPTS), unit.replace(".", "·"))


def scale_for(unit: str, magnitude: float) -> Scale:
    """Return the unit in which a quantity of a given size (in `unit`) is best shown.

    Example:
        >>> scale_for("m", 0.088), scale_for("rad/s", 12.0)
        (Scale(size=0.001, unit='mm'), Scale(size=1.0, unit='rad/s'))
    """
    leading = _LEADING.match(unit)
    if leading is None or not math.isfinite(magnitude) or magnitude <= 0.0:
        return Scale(1.0, typeset(unit))
    size, prefix = _PREFIXES[0]
    for candidate, name in _PREFIXES:
        if name == "k" and leading[1] in _NEVER_KILO:
            continue
        if magnitude >= candidate:
            size, prefix = candidate, name
    return Scale(size, prefix + typeset(unit))


def significant(value: float, digits: int = 3) -> str:
    """Return a number with a given number of significant digits.

    Example:
        >>> significant(0.0123456), significant(-95.108, 4), significant(3.2e-9, 2)
        ('0.0123', '−95.11', '3.2·10⁻⁹')
    """
    if not math.isfinite(value):
        return "–" if math.isnan(value) else ("∞" if value > 0 else "−∞")
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -4 < exponent < 6:
        return f"{_plain(value / 10.0**exponent, digits - 1)}·10{_raised(exponent)}"
    return _plain(value, digits - 1 - exponent)


def uncertain(value: float, sd: float) -> str:
    """Return `value ± sd`: the deviation with two digits, the value to the same place.

    Example:
        >>> uncertain(21.1747, 0.3142), uncertain(95123.4, 210.0), uncertain(1.5e-7, 2e-9)
        ('21.17 ± 0.31', '95120 ± 210', '(1.500 ± 0.020)·10⁻⁷')

    A simulated record without noise is known to more digits than anyone reads:
        >>> uncertain(4.3, 3.7e-14)
        '4.30000000 ± 3.7·10⁻¹⁴'
    """
    if not math.isfinite(sd) or sd <= 0.0:
        return significant(value, 4)
    largest = max(abs(value), sd)
    exponent = math.floor(math.log10(largest))
    if exponent + _places(sd) >= _MOST_DIGITS:
        return f"{significant(value, _MOST_DIGITS)} ± {significant(sd, 2)}"
    if not -4 < exponent < 6:
        power = 10.0**exponent
        places = _places(sd / power)
        return (
            f"({_plain(value / power, places)} ± {_plain(sd / power, places)})"
            f"·10{_raised(exponent)}"
        )
    places = _places(sd)
    return f"{_plain(value, places)} ± {_plain(sd, places)}"


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit, in the prefix that suits it.

    Example:
        >>> quantity(0.0881, "m"), quantity(2.5, "")
        ('88.1 mm', '2.50')
    """
    if math.isnan(value):
        return "–"
    scale = scale_for(unit, abs(value))
    number = significant(value / scale.size, digits)
    return f"{number} {scale.unit}" if unit else number


def typeset_powers(text: str) -> str:
    """Return a sentence with its numbers' exponents raised.

    Example:
        >>> typeset_powers("may be chance (p = 2e-10)")
        'may be chance (p = 2·10⁻¹⁰)'
        >>> typeset_powers("is no chance (p < 1e-15)")
        'is no chance (p < 10⁻¹⁵)'
    """

    def power(found: re.Match[str]) -> str:
        factor = "" if found[1] == "1" else f"{found[1]}·"
        return f"{factor}10{_raised(int(found[2]))}"

    return _E_NOTATION.sub(power, text)


def with_unit(number: str, unit: str) -> str:
    """Return a number's text followed by its unit, if it has one.

    Example:
        >>> with_unit("3.2", "N.m"), with_unit("0.05", "1")
        ('3.2 N·m', '0.05')
    """
    return f"{number} {typeset(unit)}" if unit not in ("", "1") else number


def percent(share: float) -> str:
    """Return a share in per cent.

    Example:
        >>> percent(0.04113), percent(1.188)
        ('4.11 %', '119 %')
    """
    return "–" if math.isnan(share) else f"{significant(100.0 * share)} %"


def chance(probability: float) -> str:
    """Return a probability: `p = 0.03`, or a bound where more digits mean nothing.

    Example:
        >>> chance(0.0312), chance(1e-20)
        ('p = 0.031', 'p < 10⁻¹⁵')
    """
    if math.isnan(probability):
        return "p unknown"
    return "p < 10⁻¹⁵" if probability < 1e-15 else f"p = {significant(probability, 2)}"


def _places(sd: float) -> int:
    """Return the decimal place of a deviation's second digit (negative: before the point)."""
    return 1 - math.floor(math.log10(float(f"{sd:.1e}")))


def _plain(value: float, places: int) -> str:
    rounded = round(value, places)
    return f"{rounded:.{max(places, 0)}f}".replace("-", "−")


def _raised(exponent: int) -> str:
    return str(exponent).translate(_SUPERSCRIPTS)
