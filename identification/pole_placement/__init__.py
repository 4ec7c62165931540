"""Data-driven pole placement: a linear model and a gain from sampled states and inputs."""

from __future__ import annotations

from identification.pole_placement.base import Method, RowMethod, Solution
from identification.pole_placement.gains import gain, read_poles
from identification.pole_placement.online import (
    ONLINE,
    OnlineModel,
    OnlineUpdate,
    PublishedUpdate,
    WindowedUpdate,
)
from identification.pole_placement.placement import METHODS, Placement, method_of, place
from identification.pole_placement.region import Reach, region
from identification.pole_placement.samples import Samples, samples_of

__all__ = [
    "METHODS",
    "ONLINE",
    "Method",
    "OnlineModel",
    "OnlineUpdate",
    "Placement",
    "PublishedUpdate",
    "Reach",
    "RowMethod",
    "Samples",
    "Solution",
    "WindowedUpdate",
    "gain",
    "method_of",
    "place",
    "read_poles",
    "region",
    "samples_of",
]
