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

_STILL = 1e-9
_TINY = 1e-200


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
    finite = values[np.isfinite(values)]
    low, high = (float(q) for q in np.quantile(finite, inner)) if len(finite) else (0.0, 0.0)
    # A signal that stands still is drawn in the middle.
    margin = room * (high - low) if high - low > _STILL * max(abs(low), abs(high)) else _around(low)
    ax.set_ylim(low - margin, high + margin)


def _around(value: float) -> float:
    return 0.1 * abs(value) if abs(value) > _TINY else 1.0


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
