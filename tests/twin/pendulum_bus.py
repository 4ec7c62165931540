"""A pendulum on a CAN bus, integrated here and not by the tool: frames of what its sensors say."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
from numpy.typing import NDArray

from hil.bus.codec import Packer, layouts
from hil.bus.dbc import Port, bundled_dbc, read_dbc
from hil.settings import parse_toml
from recordings.readers.can_frames import Frames
from twin.ingest import columns
from twin.settings import TwinSettings, settings_of

RATE = 100.0
TRUE = {"J": 0.185, "mgl": 3.61, "d": 0.05}
SD = {"theta": 0.01, "omega": 0.03}
DISTURBANCE, CORRELATION = 0.02, 0.3
START = 1_700_000_000.0

Change = Callable[[float], dict[str, float]]


def write_fit(folder: Path) -> None:
    """Write the true parameters as a fit."""
    fit = {"parameters": {n: {"value": v, "sd": 0.005 * v} for n, v in TRUE.items()}}
    (folder / "fit.json").write_text(json.dumps(fit))


def settings(folder: Path, estimator: str = "", bus: str = "", names: tuple[str, ...] = ("arm",)):
    """Return the settings of twins on this bus; the verified parameters are the true ones."""
    write_fit(folder)
    text = "".join(
        f"""
[[twin]]
name = "{name}"
rate = {RATE}
stale = "0.3 s"
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {{sd = {SD["theta"]}}}
omega = {{sd = {SD["omega"]}}}
{bus}
[twin.estimator]
disturbances = {{tau = {DISTURBANCE}}}
disturbance_time = {CORRELATION}
memory = 10.0
{estimator}
[twin.drift]
diagnose = 0.0
false_alarms_per_hour = 0.01
"""
        for name in names
    )
    return settings_of(parse_toml(text, folder / "service.toml"))


def twin(folder: Path, estimator: str = "") -> TwinSettings:
    """Return the settings of one twin."""
    return settings(folder, estimator).twins[0]


def diagnosing(folder: Path) -> TwinSettings:
    """Return the settings of a twin that diagnoses drifts on ten seconds."""
    one = twin(folder)
    return replace(one, drift=replace(one.drift, diagnose=10.0))


def torque(time: float) -> float:
    """Return what moves it [N.m]: enough for every parameter."""
    return 1.6 * math.sin(3.1 * time) + 1.2 * math.sin(5.3 * time + 1) + 0.8 * math.sin(1.3 * time)


def motion(
    seconds: float,
    seed: int,
    change: Change = lambda _: {},
    friction: Callable[[float], float] = lambda _: 0.0,
    command: Callable[[float], float] = torque,
) -> NDArray[np.float64]:
    """Integrate; return (n, 4): time, command, measured angle and speed."""
    rng, h, parts = np.random.default_rng(seed), 1 / RATE, 5
    decay = math.exp(-h / CORRELATION)
    push = DISTURBANCE * rng.standard_normal()
    x = np.array([0.1, 0.0])
    rows = np.empty((round(seconds * RATE), 4))
    for k in range(len(rows)):
        t = k * h
        p, tau_c = {**TRUE, **change(t)}, friction(t)
        u = command(t)
        seen = x + rng.standard_normal(2) * [SD["theta"], SD["omega"]]
        rows[k] = t, u, *seen

        def slope(y: NDArray[np.float64], p=p, tau_c=tau_c, drive=u + push):
            rub = tau_c * math.tanh(y[1] / 0.01)
            force = drive - p["mgl"] * math.sin(y[0]) - p["d"] * y[1] - rub
            return np.array([y[1], force / p["J"]])

        g = h / parts
        for _ in range(parts):
            k1 = slope(x)
            k2 = slope(x + g / 2 * k1)
            k3 = slope(x + g / 2 * k2)
            k4 = slope(x + g * k3)
            x = x + g / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        push = decay * push + DISTURBANCE * math.sqrt(1 - decay**2) * rng.standard_normal()
    return rows


def messages(rows: NDArray[np.float64], start: float = START) -> list[can.Message]:
    """Return what a motion sends, protected end to end: two messages a sample."""
    ports = [Port("tau", "N.m"), Port("theta", "rad"), Port("omega", "rad/s")]
    database = read_dbc(bundled_dbc("Twinproof.Plants.Pendulum"))
    packers = [Packer(layout) for layout in layouts(database, ports)]
    return [
        packer.pack({"tau": u, "theta": a, "omega": w}, time=start + t)
        for t, u, a, w in rows.tolist()
        for packer in packers
    ]


def frames(rows: NDArray[np.float64], start: float = START) -> Frames:
    """Return the frames of a motion, as columns."""
    return columns(messages(rows, start))


def part(whole: Frames, begin: int, end: int) -> Frames:
    """Return the frames `begin` to `end` (exclusive)."""
    return whole.ordered(np.arange(begin, min(end, len(whole))))
