"""What all figures share: the picture as a value, legends, limits, axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from identification.problem import Problem, Vector
from twinproof.report.numbers import Scale


@dataclass(frozen=True)
class Picture:
    """An inline SVG with the words that stand for it."""

    svg: str
    description: str
    caption: str


def unit_of(problem: Problem, name: str) -> str:
    """Return the unit of a variable by the name that the user knows it by."""
    for candidate in (name, f"plant.{name}"):
        variable = problem.dae.variables.get(candidate)
        if variable is not None:
            return variable.unit
        alias = problem.dae.aliases.get(candidate)
        if alias is not None:
            return alias.declared.unit
    return ""


def limits(
    ax: Axes, values: Vector, *, inner: tuple[float, float] = (0.0, 1.0), room: float = 0.3
) -> None:
    """Leave room around the values; what runs far away is cut off, not squeezed in."""
    low, high = (float(q) for q in np.quantile(values[np.isfinite(values)], inner))
    margin = room * max(high - low, 1e-9 * max(abs(low), abs(high), 1e-300))
    ax.set_ylim(low - margin, high + margin)


def time_axis(ax: Axes, time: Vector) -> None:
    """Span the record, with few ticks upwards."""
    ax.set_xlim(float(time[0]), float(time[-1]))
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def in_scale(scale: Scale) -> FuncFormatter:
    """Return a formatter that shows SI values in a unit."""

    def text(value: float, _: int | None) -> str:
        return f"{value / scale.size:g}".replace("-", "−")

    return FuncFormatter(text)


def legend(drawn: Figure, *axes: Axes) -> None:
    """Put one legend of these axes' curves above the figure, each label once."""
    found: dict[str, Artist] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            found.setdefault(label, handle)
    drawn.legend(list(found.values()), list(found), loc="outside upper left", ncols=4)
