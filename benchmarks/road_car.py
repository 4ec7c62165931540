"""Road car, read from its CAN log: from a kinematic bicycle with data-sheet values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import twinproof
from benchmarks.figures import Figure
from benchmarks.real_data.journey import Journey, Stretch

HALF = 45.14
_STANDS = 0.02  # [m/s], about a step of the speed signal


def direction_of_travel(recording: twinproof.Recording) -> twinproof.Recording:
    """Return the record with `reverse` held as long as the car rolls.

    The driver takes the reverse gear out 0.4 s before the car stands. What he has in says where
    the car goes only while it stands; what rolls cannot turn round.
    """
    standing = recording["v"].values < _STANDS
    standing[0] = True
    last = np.maximum.accumulate(np.where(standing, np.arange(len(standing)), 0))
    return recording.replace_values({"reverse": recording["reverse"].values[last]})


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
    "pulses, which have no sign, and the car drives backwards for ten seconds; the reverse gear, "
    "which is out 0.4 s before the car stands, is held until it does. Wheelbase and steering ratio "
    "are a guess that the fit may not touch: what is wrong with them must be found.",
    free=(),
    max_effects=5,
    prepare=direction_of_travel,
)


def run() -> Iterator[Figure]:
    yield from JOURNEY.walk().figures(whole=True)
