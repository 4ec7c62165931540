"""Names in messages: what a wrong one may have meant, and lists that stay short."""

from __future__ import annotations

from collections.abc import Iterable

from foundation.errors import UnknownNameError


def suggestion(kind: str, name: str, known: Iterable[str]) -> str:
    """Return the remedy for a name that nothing has: the nearest names, or those there are.

    Example:
        >>> suggestion("column", "pitsch", ["time", "pitch"])
        'did you mean pitch?'
    """
    return UnknownNameError(kind, name, known).remedy


def listing(names: Iterable[str], most: int = 12) -> str:
    """Return the names with commas between; many are cut short.

    Example:
        >>> listing(["a", "b", "c"], most=2)
        'a, b, … (3 in all)'
    """
    shown = list(names)
    if len(shown) <= most:
        return ", ".join(shown)
    return f"{', '.join(shown[:most])}, … ({len(shown)} in all)"
