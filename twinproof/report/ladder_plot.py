"""The ladder as a figure: errors falling from step to step."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from identification.problem import Vector
from twinproof.report.numbers import Scale, scale_for, significant
from twinproof.report.picture import Picture, legend
from twinproof.report.svg import WIDTH, Role, figure, inline

_LOG_FROM = 4.0
_WORD = re.compile(r"[A-Z]+[a-z0-9_]*|[a-z0-9_]+")
_LINE = 12
# A floor further than this below the least error would squeeze the errors into a corner.
_FLOOR_IN_SIGHT = 30.0


@dataclass(frozen=True)
class Rung:
    """One step of a ladder: label, error on the fitted and on the unseen record (None: none)."""

    label: str
    fitted: float
    unseen: float | None


@dataclass(frozen=True)
class LadderPanel:
    """One measure of error over the steps.

    Attributes:
        title: What is measured.
        unit: Of the errors; `%` for shares.
        rungs: One a step.
        floor: Error that sensor noise alone would leave; None if it is not known.
    """

    title: str
    unit: str
    rungs: tuple[Rung, ...]
    floor: float | None = None


def ladder(panels: Sequence[LadderPanel], name: str) -> Picture:
    """Draw how the errors fall from step to step."""
    columns = 2 if len(panels) == 4 else min(len(panels), 3)
    rows = -(-len(panels) // columns)
    width = WIDTH if columns > 1 else 0.62 * WIDTH
    with figure(2.35 * rows + 0.3, width) as drawn:
        axes = drawn.subplots(rows, columns, squeeze=False).ravel()
        for ax, panel in zip(axes, panels, strict=False):
            _ladder_panel(ax, panel)
        for ax in axes[len(panels) :]:
            ax.set_axis_off()
        legend(drawn, *axes[: len(panels)])
        svg = inline(drawn, name)
    sentences = [
        f"{panel.title}: "
        + ", ".join(
            f"step {k} fitted {significant(r.fitted)} {panel.unit}"
            + ("" if r.unseen is None else f", unseen {significant(r.unseen)} {panel.unit}")
            for k, r in enumerate(panel.rungs)
        )
        for panel in panels
    ]
    return Picture(svg, ". ".join(sentences), "")


def step_label(number: int, effect: str) -> str:
    """Return a step's label, the effect's name broken where its words join.

    Example:
        >>> step_label(2, "AsymmetricViscousFriction").splitlines()
        ['2', '+ Asymmetric', 'Viscous', 'Friction']
    """
    lines: list[str] = []
    for word in _WORD.findall(effect):
        if lines and len(lines[-1]) + len(word) <= _LINE:
            lines[-1] += word
        else:
            lines.append(word)
    return "\n".join([str(number), *(f"+ {x}" if k == 0 else x for k, x in enumerate(lines))])


def _ladder_panel(ax: Axes, panel: LadderPanel) -> None:
    steps = np.arange(len(panel.rungs))
    fitted = np.array([r.fitted for r in panel.rungs])
    unseen = np.array([np.nan if r.unseen is None else r.unseen for r in panel.rungs])
    finite = np.concatenate([fitted, unseen])
    finite = finite[np.isfinite(finite)]
    largest = float(np.max(finite, initial=0.0))
    scale = Scale(1.0, "%") if panel.unit == "%" else scale_for(panel.unit, largest)
    # Numbers stand on the side of the curve where there is room for them.
    above = fitted >= np.where(np.isfinite(unseen), unseen, -np.inf)
    for values, role, marker, dash, label, up in (
        (fitted, Role.FITTED, "o", "-", "fitted record", above),
        (unseen, Role.UNSEEN, "s", "--", "unseen record", ~above),
    ):
        if not np.any(np.isfinite(values)):
            continue
        ax.plot(
            steps, values / scale.size, dash, color=role.value, marker=marker, ms=5, label=label
        )
        for k, value in enumerate(values):
            if np.isfinite(value):
                ax.annotate(
                    significant(value / scale.size),
                    (float(steps[k]), float(value / scale.size)),
                    xytext=(0, 7 if up[k] else -7),
                    textcoords="offset points",
                    ha="center",
                    va="bottom" if up[k] else "top",
                    color=role.value,
                )
    _error_axis(ax, panel, finite, scale)
    ax.set_xticks(steps, [r.label for r in panel.rungs])
    ax.set_xlim(-0.5, len(steps) - 0.5)
    ax.grid(visible=False, axis="x")
    ax.set_title(panel.title)
    ax.set_ylabel(f"error [{scale.unit}]")


def _error_axis(ax: Axes, panel: LadderPanel, errors: Vector, scale: Scale) -> None:
    """Scale the axis (logarithmic where errors are far apart) and draw the noise floor."""
    floor = panel.floor if panel.floor is not None and np.isfinite(panel.floor) else None
    least, most = float(np.min(errors, initial=np.inf)), float(np.max(errors, initial=0.0))
    in_sight = floor is not None and least > 0 and floor > least / _FLOOR_IN_SIGHT
    if floor is not None and in_sight:
        least = min(least, floor)
        ax.axhline(
            floor / scale.size, color=Role.FLOOR.value, lw=1.0, ls=":", label="sensor noise alone"
        )
    if least > 0 and most / least > _LOG_FROM:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(FuncFormatter(_short))
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_ylim(least / scale.size / 2.2, most / scale.size * 2.2)
    else:
        ax.set_ylim(0.0, 1.25 * max(most, least if np.isfinite(least) else 0.0) / scale.size)


def _short(value: float, _: int | None) -> str:
    return significant(value, 1)
