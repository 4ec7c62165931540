"""The shape of a missing force as a figure, with the candidate laid over it."""

from __future__ import annotations

import itertools

import numpy as np

from identification.discovery.shape import MissingForce
from twinproof.report.numbers import quantity, scale_for
from twinproof.report.picture import Picture, legend, limits
from twinproof.report.svg import WIDTH, Role, figure, inline


def missing_force(found: MissingForce, effect: str, place_unit: str, name: str) -> Picture:
    """Draw a missing force, estimated without a law, with the candidate's own law over it.

    Args:
        found: The estimate and the candidate's characteristic.
        effect: The candidate in words.
        place_unit: Unit of the place; that of the abscissa of an effect in series with a signal.
        name: Unique in the page.
    """
    curve = found.curve
    unit = curve.variable.unit or place_unit
    across = scale_for(unit, float(np.max(np.abs(found.x))))
    law = np.interp(found.x, curve.x, curve.y)
    up = scale_for(found.unit, float(np.quantile(np.abs(np.concatenate([found.y, law])), 0.98)))
    what = "signal added" if curve.variable.name == "u" else "force"
    what = "torque" if found.unit == "N.m" else what
    window = quantity(found.window, "s", 2)
    with figure(3.3, 0.8 * WIDTH) as drawn:
        ax = drawn.subplots()
        x, y = found.x / across.size, found.y / up.size
        ax.plot(
            x,
            y,
            ".",
            color=Role.MEASURED.value,
            ms=3,
            alpha=0.35,
            label=f"one window of {window}",
            rasterized=False,
        )
        for k, part in enumerate(_unbroken(found)):
            centres, middle = found.centres[part] / across.size, found.law[part] / up.size
            spread = found.spread[part] / up.size
            ax.fill_between(
                centres, middle - spread, middle + spread, color=Role.LAST.value, alpha=0.25, lw=0
            )
            ax.plot(
                centres,
                middle,
                "o-",
                color=Role.LAST.value,
                ms=4,
                label="no law assumed: median and spread" if k == 0 else None,
            )
        ax.plot(
            curve.x / across.size, curve.y / up.size, "--", color=Role.FIRST.value, lw=1.8,
            label=effect,
        )  # fmt: skip
        ax.axhline(0.0, color=Role.MUTED.value, lw=0.6)
        limits(ax, np.concatenate([y, law / up.size]), inner=(0.01, 0.99), room=0.25)
        ax.set_xlabel(f"{curve.variable.words} [{across.unit}]")
        ax.set_ylabel(f"missing {what} [{up.unit}]")
        legend(drawn, ax)
        svg = inline(drawn, name)
    return Picture(
        svg,
        f"Missing {what} against {curve.variable.words}: {len(found.x)} windows of "
        f"{window}, their medians in bins, and {effect} over them",
        f"Each dot: the constant that explains one window of {window}, "
        "with the effect taken out and everything else kept. Positive opposes positive motion. "
        "The dashed curve is evaluated from the effect’s Modelica class."
        if what != "signal added"
        else f"Each dot: the constant that explains one window of "
        f"{window}, with the effect taken out and everything else kept. "
        "The dashed curve is evaluated from the effect’s Modelica class.",
    )


def _unbroken(found: MissingForce) -> list[slice]:
    """Return the runs of bins without a change of sign or a wide gap between them."""
    x = found.centres
    if len(x) == 0:
        return []
    step = np.diff(x)
    signed = found.curve.variable.name in ("w", "v", "u")
    gap = step > 4.0 * np.median(step) if len(step) else np.zeros(0, dtype=bool)
    crossing = x[1:] * x[:-1] < 0 if signed else np.zeros(len(step), dtype=bool)
    cuts = [0, *(int(k) + 1 for k in np.flatnonzero(gap | crossing)), len(x)]
    return [slice(a, b) for a, b in itertools.pairwise(cuts)]
