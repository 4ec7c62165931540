"""Silverbox: an analogue circuit that imitates a mass on a hardening spring."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.real_data.journey import Journey, Stretch

STEP = 1.6384e-3

JOURNEY = Journey(
    name="silverbox",
    title="Silverbox: a spring that stiffens",
    model="DuffingCircuit.mo:DuffingCircuit",
    channel_map="silverbox.toml",
    fitted=Stretch("silverbox", 40_650 * STEP, 40_650 * STEP + 20),
    unseen=Stretch("silverbox", 0.0, 39_999 * STEP),
    output="y",
    expected=("CubicSpring", "ConstantForce|Offset"),
    limit=0.019,
    source="T. Wigren, J. Schoukens, *Three free data sets for development and benchmarking in "
    "nonlinear system identification*, European Control Conference, 2013. Fitted are 20 s of the "
    "multisine; the arrow, noise that grows beyond what the fit has seen, only judges.",
)


def run() -> Iterator[Figure]:
    yield from JOURNEY.walk().figures()
