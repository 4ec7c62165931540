"""Rotary pendulum: inertia and friction of the arm from one pulse, with 45 counts of stiction."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.figures import Figure
from recordings import Channel, Recording, Sensor
from tests.identification import furuta_truth as truth
from twinproof import Estimate, Model, identify

FREE = ("J_z0", "C0", "K_f")
START = {"J_z0": 0.0025, "C0": 0.012, "K_f": 0.025}
BACK_EMF = 0.0706 * 0.0707 / 0.9
"""Viscous friction that the motor adds to C0, N.m.s/rad."""
PULSES = (
    (0.5, 1.5, 50.0),
    (0.5, 1.5, -50.0),
    (0.5, 2.0, 50.0),
    (0.5, 2.0, -50.0),
    (0.5, 1.5, 60.0),
)
SEEDS = 10


def recording(record: truth.Record) -> Recording:
    """Return what the board stores: command and counted angles at 100 Hz."""
    alpha, beta = record.angles.T
    return Recording(
        record.time,
        {
            "u": Channel("u", record.u, "1"),
            "alpha": Channel("alpha", alpha, "rad", Sensor(resolution=truth.ALPHA_STEP)),
            "beta": Channel("beta", beta, "rad", Sensor(resolution=truth.BETA_STEP)),
        },
    )


def known(setup: truth.Setup) -> dict[str, float]:
    """Return the parameters that are known before the arm is identified."""
    return {"J_r1": setup.Jr, "C1": setup.C1, "K_u": setup.motor * 0.9 / 0.0706}


def fit(setup: truth.Setup, record: truth.Record, method: str = "auto") -> Estimate:
    """Identify the arm."""
    model = Model.of("Twinproof.Plants.FurutaPendulum")
    start = {**known(setup), **START}
    return identify(
        model, recording(record), method=method, free=FREE, parameters=start, horizon="1"
    ).estimate


def arm(estimate: Estimate) -> np.ndarray:
    """Return J, d = C0 + K_t K_b / R_a and K_f."""
    values = estimate.values
    return np.array([values["J_z0"], values["C0"] + BACK_EMF, values["K_f"]])


def true_arm(setup: truth.Setup) -> np.ndarray:
    """Return the true J, d and K_f."""
    return np.array([setup.J, setup.d, setup.Kf])


def errors(
    setup: truth.Setup,
    pulses: Sequence[tuple[float, float, float]] = PULSES,
    seeds: Sequence[int] = range(SEEDS),
    method: str = "auto",
) -> np.ndarray:
    """Return relative errors of J, d and K_f from one pulse each, shape (pulses * seeds, 3)."""
    rows = [
        arm(fit(setup, truth.record(setup, truth.pulses(10.0, pulse), seed), method))
        for pulse in pulses
        for seed in seeds
    ]
    return np.array(rows) / true_arm(setup) - 1


def run() -> Iterator[Figure]:
    for name, setup in (
        ("45 counts of stiction", truth.SETUP_1.sticky()),
        ("no stiction", truth.SETUP_1),
    ):
        began = time.perf_counter()
        found = 100 * np.abs(errors(setup, seeds=range(100, 100 + SEEDS)))
        seconds = (time.perf_counter() - began) / len(found)
        for quantity, column in zip(("J", "d", "K_f"), found.T, strict=True):
            yield Figure(f"{name}: {quantity}, median error", float(np.median(column)), 10, "%")
            yield Figure(f"{name}: {quantity}, largest error", float(column.max()), 10, "%")
        yield Figure(f"{name}: one record, simulated and fitted", seconds, None, "s")
