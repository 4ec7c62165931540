"""A class's `Icon` annotation as a picture, for tools that show FMUs as blocks.

Only what the class itself draws: lines, polygons, rectangles, ellipses and texts. Bitmaps and the
icons of base classes are left out. Graphics as in the Modelica Language Specification 3.6, 18.6.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fmus.modelica_text import class_spans, enclosing_class, without_comments_and_strings

_TOKEN = re.compile(
    r'\s*(?:(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?)|(?P<text>"(?:[^"\\]|\\.)*")'
    r"|(?P<name>[A-Za-z_][\w.]*)|(?P<mark>\S))"
)
_PIXELS = 128
_EXTENT = ((-100.0, -100.0), (100.0, 100.0))


@dataclass(frozen=True)
class Shape:
    """One graphic: its class and arguments (numbers, names, texts and nested tuples)."""

    kind: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class Icon:
    """Graphics, and the corners of the area that they are drawn in."""

    extent: tuple[tuple[float, float], tuple[float, float]] = _EXTENT
    shapes: Sequence[Shape] = field(default_factory=tuple[Shape, ...])


def icon_of(text: str, class_name: str) -> Icon | None:
    """Return the icon that a class of a text draws; None if it draws none, or none we can read.

    Example:
        >>> icon = icon_of(
        ...     "model A annotation (Icon(graphics={Line(points={{0,0},{9,9}})})); end A;", "A"
        ... )
        >>> icon.shapes[0].kind, icon.shapes[0].arguments["points"]
        ('Line', ((0.0, 0.0), (9.0, 9.0)))
    """
    blanked = without_comments_and_strings(text)
    spans = class_spans(blanked)
    for found in re.finditer(r"\bIcon\s*\(", blanked):
        if enclosing_class(spans, found.start()) == class_name:
            try:
                return _icon(_value(_Tokens(text[found.start() :])))
            except (ValueError, KeyError, TypeError, IndexError, StopIteration):
                return None  # decoration: nothing is lost that a simulation needs
    return None


def _icon(call: Any) -> Icon | None:
    shapes = tuple(s for s in call.arguments.get("graphics", ()) if isinstance(s, Shape))
    system = call.arguments.get("coordinateSystem")
    corners = system.arguments.get("extent", _EXTENT) if system is not None else _EXTENT
    (x0, y0), (x1, y1) = corners
    return Icon(((float(x0), float(y0)), (float(x1), float(y1))), shapes) if shapes else None


class _Tokens:
    def __init__(self, text: str) -> None:
        self._matches: Iterator[re.Match[str]] = _TOKEN.finditer(text)
        self.now = next(self._matches)

    def take(self, mark: str = "") -> re.Match[str]:
        taken = self.now
        if mark and taken["mark"] != mark:
            raise ValueError(mark)
        self.now = next(self._matches)
        return taken

    def at(self, mark: str) -> bool:
        return self.now["mark"] == mark


def _value(tokens: _Tokens) -> Any:
    if tokens.at("-"):
        tokens.take()
        return -_value(tokens)
    if tokens.at("{"):
        tokens.take()
        items: list[Any] = []
        while not tokens.at("}"):
            items.append(_value(tokens))
            if not tokens.at("}"):
                tokens.take(",")
        tokens.take("}")
        return tuple(items)
    token = tokens.take()
    if token["number"]:
        return float(token["number"])
    if token["text"]:
        return token["text"][1:-1]
    if not token["name"]:
        raise ValueError(token[0])
    return _call(token["name"], tokens) if tokens.at("(") else token["name"]


def _call(kind: str, tokens: _Tokens) -> Shape:
    """Read `(a = 1, b(c = 2))` behind a name."""
    tokens.take("(")
    arguments: dict[str, Any] = {}
    while True:
        name = tokens.take()["name"]
        if tokens.at("("):
            arguments[name] = _call(name, tokens)
        else:
            tokens.take("=")
            arguments[name] = _value(tokens)
        if tokens.at(")"):
            break
        tokens.take(",")
    tokens.take(")")
    return Shape(kind, arguments)


def png(icon: Icon, name: str) -> bytes:
    """Return a picture of 128 × 128 pixels; `%name` in texts is replaced by a name."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - takes half a second
    from matplotlib.figure import Figure  # noqa: PLC0415 - as slow

    figure = Figure(figsize=(1, 1), dpi=_PIXELS, frameon=False)
    FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0, 0, 1, 1))
    (x0, y0), (x1, y1) = icon.extent
    axes.set(xlim=(min(x0, x1), max(x0, x1)), ylim=(min(y0, y1), max(y0, y1)), aspect="equal")
    axes.axis("off")
    for shape in icon.shapes:
        draw = _DRAW.get(shape.kind)
        if draw is not None and shape.arguments.get("visible") != "false":
            draw(axes, shape.arguments, name)
    written = io.BytesIO()
    # Without a date or version the same icon gives the same bytes.
    figure.savefig(written, format="png", metadata={"Software": None})
    return written.getvalue()


def _outline(arguments: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Corners of an extent, or points, moved and turned."""
    points: Sequence[tuple[float, float]] = arguments.get("points", ())
    if "extent" in arguments:
        (x0, y0), (x1, y1) = arguments["extent"]
        points = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    x, y = arguments.get("origin", (0.0, 0.0))
    angle = math.radians(arguments.get("rotation", 0.0))
    c, s = math.cos(angle), math.sin(angle)
    return [(x + c * a - s * b, y + s * a + c * b) for a, b in points]


def _colour(arguments: Mapping[str, Any], key: str) -> tuple[float, ...]:
    return tuple(part / 255 for part in arguments.get(key, (0.0, 0.0, 0.0)))


def _style(arguments: Mapping[str, Any]) -> dict[str, Any]:
    filled = str(arguments.get("fillPattern", "None")).rpartition(".")[2] != "None"
    lined = str(arguments.get("pattern", "Solid")).rpartition(".")[2] != "None"
    return {
        "facecolor": _colour(arguments, "fillColor") if filled else "none",
        "edgecolor": _colour(arguments, "lineColor") if lined else "none",
        "linewidth": 2 * arguments.get("lineThickness", 0.25),
    }


def _draw_polygon(axes: Any, arguments: Mapping[str, Any], _: str) -> None:
    x, y = zip(*_outline(arguments), strict=True)
    axes.fill(x, y, **_style(arguments))


def _draw_ellipse(axes: Any, arguments: Mapping[str, Any], _: str) -> None:
    (x0, y0), (x1, y1) = arguments["extent"]
    middle, rx, ry = ((x0 + x1) / 2, (y0 + y1) / 2), (x1 - x0) / 2, (y1 - y0) / 2
    round_about = [
        (middle[0] + rx * math.cos(a), middle[1] + ry * math.sin(a))
        for a in (2 * math.pi * k / 72 for k in range(72))
    ]
    bent = {k: v for k, v in arguments.items() if k != "extent"}
    _draw_polygon(axes, {**bent, "points": round_about}, "")


def _draw_line(axes: Any, arguments: Mapping[str, Any], _: str) -> None:
    x, y = zip(*_outline(arguments), strict=True)
    width = 2 * arguments.get("thickness", 0.25)
    axes.plot(x, y, color=_colour(arguments, "color"), linewidth=width)


def _draw_text(axes: Any, arguments: Mapping[str, Any], name: str) -> None:
    corners = _outline(arguments)
    x, y = (sum(part) / len(corners) for part in zip(*corners, strict=True))
    text = str(arguments.get("textString", arguments.get("string", ""))).replace("%name", name)
    colour = _colour(arguments, "textColor" if "textColor" in arguments else "lineColor")
    axes.text(x, y, text, color=colour, ha="center", va="center", fontsize=7)


_DRAW: Mapping[str, Callable[[Any, Mapping[str, Any], str], None]] = {
    "Rectangle": _draw_polygon,
    "Polygon": _draw_polygon,
    "Ellipse": _draw_ellipse,
    "Line": _draw_line,
    "Text": _draw_text,
}
