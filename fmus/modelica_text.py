"""Just enough of Modelica's text to point at things in it; meaning is the front end's business."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

_HIDDEN = re.compile(r'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)
_CLASS_EDGE = re.compile(
    r"\b(?:(?P<end>end)\s+(?P<ended>\w+)\s*;"
    r"|(?:model|block|class|package|connector|record|function|operator|type)\s+(?P<name>\w+)"
    r"(?P<short>\s*(?:\([^)]*\)\s*)?=)?)"
)
_EXTENDS = re.compile(r"\bextends\s+(?P<base>\.?[A-Za-z_][\w.]*)\s*(?P<open>\()?")
_CONNECT = re.compile(r"\bconnect\s*\(\s*(?P<a>[\w.]+)\s*,\s*(?P<b>[\w.]+)\s*\)")
_MODIFIED = re.compile(
    r"\s*(?:(?:each|final)\s+)*(?P<name>[A-Za-z_]\w*(?:\.\w+)*)\s*(?P<open>[(=]|$)"
)


@dataclass(frozen=True)
class Modifier:
    """A modified name in an extends-clause: `X1` and `X1.min` in `extends Plant(X1(min = 2))`."""

    name: str
    offset: int


@dataclass(frozen=True)
class Extends:
    """An extends-clause."""

    inside: str
    base: str
    modifiers: tuple[Modifier, ...]


@dataclass(frozen=True)
class Connect:
    """A connect-equation between plain names (no subscripts)."""

    inside: str
    ends: tuple[str, str]
    offset: int


def without_comments_and_strings(text: str) -> str:
    """Blank comments and what strings hold; every offset and line stays.

    Example:
        >>> without_comments_and_strings('a "b;c" // d')
        'a "   "     '
    """

    def blank(match: re.Match[str]) -> str:
        hidden = match[0]
        if hidden.startswith('"'):
            return '"' + re.sub(r"[^\n]", " ", hidden[1:-1]) + '"'
        return re.sub(r"[^\n]", " ", hidden)

    return _HIDDEN.sub(blank, text)


def class_spans(text: str) -> list[tuple[str, int, int]]:
    """Return (dotted name, begin, end) of all classes with a body; `text` is blanked."""
    spans: list[tuple[str, int, int]] = []
    inside: list[tuple[str, int]] = []
    for edge in _CLASS_EDGE.finditer(text):
        if edge["end"]:
            if inside and inside[-1][0] == edge["ended"]:
                name = ".".join(part for part, _ in inside)
                spans.append((name, inside.pop()[1], edge.end()))
        elif not edge["short"]:
            inside.append((edge["name"], edge.start()))
    return spans


def enclosing_class(spans: list[tuple[str, int, int]], offset: int) -> str:
    """Return the innermost class around an offset, or nothing."""
    around = [span for span in spans if span[1] <= offset < span[2]]
    return min(around, key=lambda span: span[2] - span[1])[0] if around else ""


def extends_clauses(text: str) -> list[Extends]:
    """Return all extends-clauses of blanked text."""
    spans = class_spans(text)
    found: list[Extends] = []
    for match in _EXTENDS.finditer(text):
        modifiers: tuple[Modifier, ...] = ()
        if match["open"]:
            modifiers = tuple(_modifiers(text, match.end()))
        found.append(Extends(enclosing_class(spans, match.start()), match["base"], modifiers))
    return found


def connects(text: str) -> list[Connect]:
    """Return the connect-equations of blanked text."""
    spans = class_spans(text)
    return [
        Connect(enclosing_class(spans, m.start()), (m["a"], m["b"]), m.start())
        for m in _CONNECT.finditer(text)
    ]


def _modifiers(text: str, begin: int, prefix: str = "") -> Iterator[Modifier]:
    """Yield what a parenthesis that opened just before `begin` modifies; redeclarations apart."""
    for first, last in _arguments(text, begin):
        match = _MODIFIED.match(text[first:last])
        if match is None or match["name"] in ("redeclare", "replaceable"):
            continue
        name = f"{prefix}{match['name']}"
        yield Modifier(name, first + match.start("name"))
        if match["open"] == "(":
            yield from _modifiers(text, first + match.end(), f"{name}.")


def _arguments(text: str, begin: int) -> Iterator[tuple[int, int]]:
    depth, first = 1, begin
    for offset in range(begin, len(text)):
        letter = text[offset]
        depth += {"(": 1, "{": 1, "[": 1, ")": -1, "}": -1, "]": -1}.get(letter, 0)
        if depth == 0 or (depth == 1 and letter == ","):
            yield first, offset
            first = offset + 1
        if depth == 0:
            return


def parenthesis_depth(text: str, offset: int) -> int:
    """Return how many parentheses are open at an offset of blanked text."""
    before = text[:offset]
    return before.count("(") - before.count(")")


def find_declaration(text: str, component: str, inside: tuple[int, int]) -> re.Match[str] | None:
    """Return where a component is declared in blanked text: groups `type` and `name`."""
    pattern = re.compile(
        rf"(?P<type>\.?\b[A-Za-z_][\w.]*)\s+(?:\w+\s*(?:\([^;]*?\))?\s*,\s*)*"
        rf"(?P<name>\b{re.escape(component)}\b)\s*[(;,=\"\[]"
    )
    return pattern.search(text, *inside)
