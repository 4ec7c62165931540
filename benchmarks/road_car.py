"""Road car, read from its CAN log: from a kinematic bicycle with data-sheet values."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.real_data.journey import Journey, Stretch

HALF = 45.14

JOURNEY = Journey(
    name="road_car",
    title="Road car: from a kinematic bicycle, out of the CAN log",
    model="RoadCarWithGear.mo:RoadCarWithGear",
    channel_map="road_car.toml",
    fitted=Stretch("motec-car", 0.0, HALF),
    unseen=Stretch("motec-car", HALF, 91.0),
    output="yaw_rate",
    expected=("SignLossInReverse", "Gain", "Understeer"),
    limit=0.08,
    source="S. Daniluk, *MotecLogGenerator*, sample CAN log and DBC. The speed comes from wheel "
    "pulses, which have no sign, and the car drives backwards for ten seconds. Wheelbase and "
    "steering ratio are a guess that the fit may not touch: what is wrong with them must be found.",
    free=(),
    max_effects=5,
)


def run() -> Iterator[Figure]:
    yield from JOURNEY.walk().figures(whole=True)
