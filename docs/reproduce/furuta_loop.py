"""The report's controller in closed loop: swing-up, switching and incremental state feedback."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmus.plant import Plant
from fmus.running import model_fmu
from fmus.sources import ModelicaSource
from hil.controllers.base import Controller
from hil.controllers.incremental import Incremental
from hil.controllers.swing_up import SwingUp
from tests.identification import furuta_truth as truth

GAINS = (-6.0, -5.0, 137.0, 20.0, 0.16)
DEAD = 45.0
WIRING: Mapping[str, Any] = {
    "measured": ("alpha", "beta"),
    "commanded": ("u",),
    "period": truth.STEP,
    "limit": 127.0,
    "gains": GAINS,
}

RIG = ModelicaSource(
    """model Rig "The rotary pendulum as the computer sees it"
  extends Twinproof.Plants.FurutaPendulum;
  Twinproof.Interfaces.RealOutput arm_counts(unit = "1");
  Twinproof.Interfaces.RealOutput rod_counts(unit = "1");
  Twinproof.Effects.Rotational.StribeckFriction rest(tau_s = 0.183, w_s = 0.1);
  Twinproof.Sensors.Encoder encoder;
  Twinproof.Sensors.Potentiometer potentiometer;
equation
  connect(rest.flange, arm.flange);
  encoder.phi = alpha;
  potentiometer.phi = beta;
  arm_counts = encoder.counts;
  rod_counts = potentiometer.counts;
end Rig;""",
    "Rig",
    "Rig.mo",
    "Rig.mo:Rig",
)


@dataclass(frozen=True)
class Run:
    """A closed loop: time, arm, tilt from upright, command, all (n,), and which controller ran."""

    time: np.ndarray
    arm: np.ndarray
    tilt: np.ndarray
    u: np.ndarray
    balancing: np.ndarray


@dataclass(frozen=True)
class Balance:
    """A plant to be balanced: dead zone of its amplifier, compensation, error of upright [rad]."""

    plant: truth.Setup
    zone: str = ""
    compensated: bool = False
    bias: float = 0.0


def wrapped(angle: float) -> float:
    """Return an angle between -π and π."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def _loop(
    controller: Controller,
    reference: Sequence[float],
    read: Callable[[], tuple[float, float, float, float]],
    advance: Callable[[float], None],
    samples: int,
) -> Run:
    """Close a loop; `read` gives arm and rod as counted, then as they are."""
    rows = []
    for k in range(samples):
        arm, rod, true_arm, true_rod = read()
        time = k * truth.STEP
        u = controller.step(time, (arm, rod), reference)[0]
        tilt = wrapped(true_rod - math.pi)
        rows.append((time, true_arm, tilt, u, float(controller.mode != "swing")))
        advance(u)
    time, arm, tilt, u, balancing = np.array(rows).T
    return Run(time, arm, tilt, u, balancing > 0)


def swing_up(duration: float = 15.0) -> Run:
    """Swing up, catch and balance the Modelica plant, from what its sensors count."""
    outputs = ("arm_counts", "rod_counts", "alpha", "beta")
    start = {"beta_start": math.radians(0.5)}
    with Plant(model_fmu(RIG), parameters=start, outputs=outputs) as plant:

        def read() -> tuple[float, float, float, float]:
            seen = plant.read()
            arm = seen["arm_counts"] * 2 * math.pi / 6541
            rod = seen["rod_counts"] * 2 * math.pi / 1024
            return arm, rod, seen["alpha"], seen["beta"]

        def advance(u: float) -> None:
            plant.set({"u": u})
            plant.step(truth.STEP)

        samples = round(duration / truth.STEP)
        return _loop(SwingUp(**WIRING), (0.0, math.pi), read, advance, samples)


def balance(case: Balance, tilt: float, duration: float = 20.0) -> Run:
    """Balance the plant with Karnopp's stiction from a tilt [rad]."""
    x = [0.0, math.pi + tilt, 0.0, 0.0]

    def read() -> tuple[float, float, float, float]:
        arm = round(x[0] / truth.ALPHA_STEP) * truth.ALPHA_STEP
        beta = round(x[1] / truth.BETA_STEP) * truth.BETA_STEP
        return arm, beta + case.bias, x[0], x[1]

    def advance(u: float) -> None:
        if case.compensated and abs(u) > 1:
            u += math.copysign(DEAD, u)
        if case.zone:
            passed = math.copysign(DEAD, u) if case.zone == "offset" else 0.0
            u = u - passed if abs(u) > DEAD else 0.0
        x[:] = truth.step(x, u, case.plant)

    controller = Incremental(**WIRING, wrap=("beta",))
    return _loop(controller, (0.0, math.pi), read, advance, round(duration / truth.STEP))
