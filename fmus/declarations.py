"""Annotations of single declarations, read from source text.

The front end keeps no annotations, but it says where every declaration starts.
"""

from __future__ import annotations

import re


def declaration_annotation(text: str) -> str:
    """Return what stands in `annotation(__twinproof(…))` of the declaration at the start of `text`.

    Args:
        text: Source from the declared name on.

    Example:
        >>> declaration_annotation('k=2 "gain; (" annotation(__twinproof(known=true)); Real x;')
        'known=true'
        >>> declaration_annotation('b "slope" annotation(__twinproof(unit="signal/s")); Real x;')
        'unit="signal/s"'
    """
    # Of the same length, so that what is found there can be read in the text.
    code = _code(text)
    found = re.search(r"\b__twinproof\s*\(", code)
    if found is None:
        return ""
    depth, begin = 1, found.end()
    for index in range(begin, len(code)):
        depth += {"(": 1, ")": -1}.get(code[index], 0)
        if depth == 0:
            return text[begin:index].strip()
    return ""


def _code(text: str) -> str:
    """Return text up to the first semicolon, what is in strings and comments blanked."""
    kept: list[str] = []
    for token in re.finditer(r'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/|.', text, re.DOTALL):
        piece = token[0]
        if piece == ";":
            break
        kept.append(piece if len(piece) == 1 else " " * len(piece))
    return "".join(kept)
