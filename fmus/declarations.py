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
    """
    declaration = _until_semicolon(text)
    found = re.search(r"\b__twinproof\s*\(", declaration)
    if found is None:
        return ""
    depth, begin = 1, found.end()
    for index in range(begin, len(declaration)):
        depth += {"(": 1, ")": -1}.get(declaration[index], 0)
        if depth == 0:
            return declaration[begin:index].strip()
    return ""


def _until_semicolon(text: str) -> str:
    """Return text up to the first semicolon outside strings, comments blanked."""
    kept: list[str] = []
    for token in re.finditer(r'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/|.', text, re.DOTALL):
        piece = token[0]
        if piece == ";":
            break
        if piece.startswith(("//", "/*")):
            kept.append(" ")
        elif piece.startswith('"'):
            kept.append('""')
        else:
            kept.append(piece)
    return "".join(kept)
