"""Torque-limited pendulum: from a pendulum without any loss."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.real_data.journey import Journey, Stretch

JOURNEY = Journey(
    name="dfki",
    title="Torque-limited pendulum: what the joint takes away",
    model="FrictionlessPendulum.mo:FrictionlessPendulum",
    channel_map=None,
    fitted=Stretch("dfki-ddp", 0.0, 6.0),
    also=(Stretch("dfki-sac", 0.0, 4.0),),
    unseen=Stretch("dfki-energy-shaping", 0.0, 3.6),
    output="theta",
    expected=("CoulombFriction|ViscousFriction", "ConstantTorque|Offset|AsymmetricCoulombFriction"),
    limit=0.012,
    source="F. Wiebe et al., *Torque-limited simple pendulum*, Journal of Open Source Software 7 "
    "(2022) 3884. Fitted at once are the swing-up found by differential dynamic programming (6 s) "
    "and the first 4 s under a soft actor-critic; unseen is the one by energy shaping, up to where "
    "it passes the upright. The torque is the motor driver's measurement.",
)


def run() -> Iterator[Figure]:
    yield from JOURNEY.walk().figures()
