"""Matplotlib figures as inline SVG whose colours are the page's: one picture for light and dark.

A figure is drawn in placeholder colours, one for each role. In the SVG these are replaced by CSS
custom properties, so that the page's style sheet alone decides what a role looks like, on a light
or a dark screen and on paper. The roles' colours there are those of Okabe and Ito, which stay apart
in every form of colour blindness; line styles and markers differ as well.

Reference:
    M. Okabe, K. Ito, *Color Universal Design* (2008).
"""

from __future__ import annotations

import io
import re
from collections.abc import Generator
from contextlib import contextmanager
from enum import Enum
from typing import Any, cast

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

WIDTH = 9.2
"""Width of a full figure [inch]; the page scales it to the column."""


class Role(Enum):
    """What a colour stands for: placeholder, and the style sheet's name for it."""

    INK = "#0a0b01"
    MUTED = "#0a0b02"
    GRID = "#0a0b03"
    MEASURED = "#0a0b04"
    FIRST = "#0a0b05"
    LAST = "#0a0b06"
    FITTED = "#0a0b07"
    UNSEEN = "#0a0b08"
    FLOOR = "#0a0b09"
    SURFACE = "#0a0b0a"

    @property
    def css(self) -> str:
        """The custom property that holds this role's colour."""
        return f"var(--{self.name.lower()})"


_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "twinproof",
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "normal",
    "axes.titlecolor": Role.INK.value,
    "axes.labelsize": 8.5,
    "axes.labelcolor": Role.INK.value,
    "axes.edgecolor": Role.MUTED.value,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": Role.GRID.value,
    "grid.linewidth": 0.5,
    "xtick.color": Role.MUTED.value,
    "ytick.color": Role.MUTED.value,
    "xtick.labelcolor": Role.INK.value,
    "ytick.labelcolor": Role.INK.value,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.size": 0,
    "ytick.minor.size": 0,
    "text.color": Role.INK.value,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "none",
    "lines.linewidth": 1.2,
    "path.simplify_threshold": 0.2,
}

_METADATA = re.compile(r"<metadata>.*?</metadata>\s*", re.DOTALL)
_PROLOG = re.compile(r"\A.*?(?=<svg)", re.DOTALL)
_NAMESPACE = re.compile(r' xmlns(?::xlink)?="[^"]*"')
_SIZE = re.compile(r'(<svg\b[^>]*?) width="[^"]*"( [^>]*?)?height="[^"]*"', re.DOTALL)
_DECIMALS = re.compile(r"(\d\.\d\d)\d+")
_TAG = re.compile(r"<[^>]*>")
_ID = re.compile(r' id="([^"]*)"')
_REFERENCE = re.compile(r'(url\(#|href="#)([^)"]+)')


@contextmanager
def figure(height: float, width: float = WIDTH) -> Generator[Figure]:
    """Give an empty figure in the report's style; draw it and call `inline` inside the context.

    Args:
        height: In inch.
        width: In inch.
    """
    with mpl.rc_context(cast("Any", _STYLE)):
        drawn = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(drawn)
        yield drawn


def inline(drawn: Figure, name: str) -> str:
    """Return a figure as an `<svg>` element for an HTML page.

    Args:
        drawn: The figure.
        name: Unique in the page: identifiers inside the SVG begin with it.
    """
    engine = drawn.get_layout_engine()
    if engine is not None:
        # Laid out once: saving would do it again, and draw everything twice.
        engine.execute(drawn)
        drawn.set_layout_engine("none")
    buffer = io.StringIO()
    drawn.savefig(buffer, format="svg", metadata={"Date": None})
    text = _PROLOG.sub("", buffer.getvalue(), count=1)
    text = _NAMESPACE.sub("", _METADATA.sub("", text)).replace("xlink:href", "href")
    text = _SIZE.sub(r'\1 aria-hidden="true" focusable="false"', text, count=1)
    # Coordinates need no more; what stands between tags are the figure's own numbers.
    text = _TAG.sub(lambda m: _DECIMALS.sub(r"\1", m[0]), text)
    for role in Role:
        text = text.replace(role.value, role.css)
    used = {m[2] for m in _REFERENCE.finditer(text)}
    text = _ID.sub(lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", text)
    return _REFERENCE.sub(rf"\g<1>{name}-\2", text).strip()
