"""A page of Markdown with its pictures beside it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from foundation.files import write_text, written_whole

POINTS = 700
"""Points a drawn curve keeps: more would make a picture large and show nothing new."""


@dataclass(frozen=True)
class Page:
    """Text, tables and pictures, collected in order.

    Attributes:
        folder: Where `name.md` goes; its pictures go to the folder `name` beside it.
        name: Of the page.
        parts: Blocks of text.
    """

    folder: Path
    name: str
    parts: list[str] = field(default_factory=list)

    def text(self, *blocks: str) -> None:
        """Add paragraphs or headings."""
        self.parts.extend(blocks)

    def table(self, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Add a table."""
        lines = ["|" + "---|" * len(heads)]
        for row in (heads, *rows):
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |")
        lines[:2] = lines[1::-1]
        self.parts.append("\n".join(lines))

    def picture(
        self,
        name: str,
        title: str,
        rows: int,
        columns: int,
        draw: Callable[[list[Axes]], None],
        *,
        height: float = 2.1,
    ) -> None:
        """Draw a grid of axes and add it with its caption.

        Args:
            name: Of the file.
            title: The caption.
            rows, columns: Of the grid.
            draw: Is given the axes, row by row.
            height: Of one row, in inches.
        """
        # Written the same way each time, so that an unchanged picture is an unchanged file.
        style = {"svg.hashsalt": name, "svg.fonttype": "none", "font.size": 8}
        with mpl.rc_context(style):
            figure = Figure(figsize=(3.6 * columns, height * rows), layout="constrained")
            draw(np.atleast_1d(figure.subplots(rows, columns)).ravel().tolist())
            with written_whole(self.folder / self.name / f"{name}.svg") as beside:
                figure.savefig(beside, format="svg", metadata={"Date": None})
                beside.write_text(shortened(beside.read_text()))
        self.parts.append(f"![{title}]({self.name}/{name}.svg)\n\n{title}")

    def write(self) -> Path:
        """Write the Markdown and return its path."""
        target = self.folder / f"{self.name}.md"
        write_text(target, "\n\n".join(self.parts) + "\n")
        return target


def shortened(svg: str) -> str:
    """Return a picture without what makes Matplotlib's large: digits, and fonts for each word."""
    svg = re.sub(r"'DejaVu Sans'[^;\"]*sans-serif", "sans-serif", svg)
    return re.sub(r"(?<=[ \"ML])(-?\d+\.\d)\d+(?=[ \"\n])", r"\1", svg)


def curve(axis: Axes, time: np.ndarray, values: np.ndarray, **style: object) -> None:
    """Draw a curve with as many points as can be seen; each stretch keeps its least and most."""
    every = max(2 * len(time) // POINTS, 1)
    if every > 1:
        whole = len(time) // every * every
        parts = values[:whole].reshape(-1, every)
        first = np.arange(0, whole, every)
        chosen = np.unique(np.concatenate([first + parts.argmin(1), first + parts.argmax(1)]))
        time, values = time[chosen], values[chosen]
    axis.plot(time, values, **{"lw": 0.8, **style})
