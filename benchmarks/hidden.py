"""Wheeled pendulum with one hidden effect, or with none: what is named first."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

import twinproof
from benchmarks.figures import Figure
from examples import make_demo_recording as truth

DEGREE = np.pi / 180
CASES: Mapping[str, tuple[str, float]] = {
    "CoulombFriction@wheel": ("coulomb_wheel", 3.0),
    "CoulombFriction@body": ("coulomb_body", 5.0),
    "QuadraticDrag@wheel": ("quadratic_drag_wheel", 0.5),
    "ViscousFriction@body": ("viscous_body", 5.0),
    "ConstantTorque@wheel": ("constant_torque_wheel", 10.0),
    "ConstantTorque@body": ("constant_torque_body", 10.0),
    "CubicSpring@body": ("cubic_spring_body", 3000.0),
    "DeadZone@V": ("input_dead_zone", 0.3),
    "Offset@V": ("input_offset", 0.1),
    "Offset@theta_p": ("pitch_bias", 0.3 * DEGREE),
}
_NULLS = 10


def recording(effects: Mapping[str, float], seed: int) -> twinproof.Recording:
    """Simulate the truth as the demo's sensors would record it."""
    return _recorded(truth.simulate(effects, seed=seed), f"truth {dict(effects)} seed {seed}")


def lagging_pitch(lag: float, seed: int) -> twinproof.Recording:
    """Simulate the truth, whose pitch passes a low-pass filter of `lag` seconds when recorded."""
    run = truth.simulate({}, seed=seed, ideal_sensors=True)
    step = float(run.time[1] - run.time[0])
    share = -np.expm1(-step / lag)
    pitch = run.channels["theta_p"]
    late = lfilter([share], [1, share - 1], pitch, zi=[(1 - share) * pitch[0]])[0]
    noise = np.random.default_rng(seed).normal(0.0, 0.5 * DEGREE, (2, len(pitch)))
    tick = 2 * np.pi / 60000
    measured = {
        **run.channels,
        "theta_w": np.round(run.channels["theta_w"] / tick) * tick,
        "theta_p": late + noise[0],
        "omega_p": run.channels["omega_p"] + noise[1],
    }
    return _recorded(replace(run, channels=measured), f"pitch late by {lag} s, seed {seed}")


def _recorded(run: truth.Run, origin: str) -> twinproof.Recording:
    sensors = {
        "theta_w": ("rad", twinproof.Sensor(None, 2 * np.pi / 60000, 0.0)),
        "theta_p": ("rad", twinproof.Sensor(0.5 * DEGREE, None, 0.0)),
        "omega_p": ("rad/s", twinproof.Sensor(0.5 * DEGREE, None, 0.0)),
        "V": ("V", twinproof.Sensor(None, None, 0.0)),
    }
    channels = {
        name: twinproof.Channel(name, run.channels[name], unit, sensor)
        for name, (unit, sensor) in sensors.items()
    }
    return twinproof.Recording(run.time, channels, origin, ())


def run() -> Iterator[Figure]:
    model = twinproof.Model.of("Twinproof.Plants.WheeledPendulum")
    seconds: list[float] = []
    named = 0
    for seed, (label, (effect, size)) in enumerate(CASES.items()):
        began = time.perf_counter()
        found = twinproof.diagnose(model, recording({effect: size}, seed)).diagnosis
        seconds.append(time.perf_counter() - began)
        right = found.chosen is not None and found.chosen.addition.label == label
        named += right
        yield Figure(f"hidden {label} named first", float(right), None)
    yield Figure("hidden effects named first", named / len(CASES), 0.95, "", True)
    found = twinproof.diagnose(model, lagging_pitch(0.02, 50)).diagnosis
    right = found.chosen is not None and found.chosen.addition.label == "FirstOrderLag@theta_p"
    yield Figure("hidden FirstOrderLag@theta_p, 20 ms, named first", float(right), 1, "", True)
    complete = 0
    for seed in range(100, 100 + _NULLS):
        found = twinproof.diagnose(model, recording({}, seed)).diagnosis
        complete += found.outcome is twinproof.Outcome.COMPLETE and found.chosen is None
    yield Figure(f"nothing hidden, {_NULLS} seeds: complete", complete / _NULLS, 1.0, "", True)
    yield Figure("diagnose 20 s at 1 kHz, median", float(np.median(seconds)), None, "s")
