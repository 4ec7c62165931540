"""The report's controller in closed loop: swing-up, switching and incremental state feedback."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmus.plant import Plant
from fmus.running import model_fmu
from fmus.sources import ModelicaSource
from tests.identification import furuta_truth as truth

GAINS = (-6.0, -5.0, 137.0, 20.0, 0.16)
LARGEST = 127.0
CATCH, DROP = math.radians(10), math.radians(20)
SWING, ZONE = 85.0, (math.radians(3), math.radians(50))
DEAD = 45.0

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


class Controller:
    """(5.18) with (5.14), (5.15), and the swing-up of section 5.1 until the rod is near upright.

    Args:
        balancing: Whether the rod is up at the start.
    """

    def __init__(self, *, balancing: bool) -> None:
        self.balancing = balancing
        self._before: tuple[float, float] | None = None
        self._u = self._home = 0.0
        self._samples = 0

    def __call__(self, arm: float, tilt: float) -> float:
        """Return the command for what is read: arm and tilt from upright, rad."""
        arm_before, tilt_before = self._before or (arm, tilt)
        self._before = arm, tilt
        arm_rate = (arm - arm_before) / truth.STEP
        rate = wrapped(tilt - tilt_before) / truth.STEP
        self._samples += 1
        if self.balancing and abs(tilt) > DROP:
            self.balancing = False
        elif not self.balancing and abs(tilt) < CATCH:
            self.balancing, self._u, self._home = True, 0.0, arm
        if not self.balancing:
            return self._swing(wrapped(tilt - math.pi), rate)
        k = GAINS
        u = (1 - k[4]) * self._u - k[0] * (arm - self._home) - k[1] * arm_rate
        u -= k[2] * tilt + k[3] * rate
        self._u = max(-LARGEST, min(LARGEST, u))
        return self._u

    def _swing(self, hanging: float, rate: float) -> float:
        if self._samples <= 12:  # a kick, since a rod at rest is in no zone
            return SWING
        falls = hanging * rate < 0 and ZONE[0] < abs(hanging) < ZONE[1]
        return -math.copysign(SWING, rate) if falls else 0.0


def _loop(
    controller: Controller,
    read: Callable[[], tuple[float, float, float, float]],
    advance: Callable[[float], None],
    samples: int,
) -> Run:
    """Close a loop; `read` gives arm and tilt as counted, then as they are."""
    rows = []
    for k in range(samples):
        arm, tilt, true_arm, true_tilt = read()
        u = controller(arm, tilt)
        rows.append((k * truth.STEP, true_arm, true_tilt, u, float(controller.balancing)))
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
            tilt = wrapped(seen["rod_counts"] * 2 * math.pi / 1024 - math.pi)
            return arm, tilt, seen["alpha"], wrapped(seen["beta"] - math.pi)

        def advance(u: float) -> None:
            plant.set({"u": u})
            plant.step(truth.STEP)

        return _loop(Controller(balancing=False), read, advance, round(duration / truth.STEP))


def balance(case: Balance, tilt: float, duration: float = 20.0) -> Run:
    """Balance the plant with Karnopp's stiction from a tilt [rad]."""
    x = [0.0, math.pi + tilt, 0.0, 0.0]

    def read() -> tuple[float, float, float, float]:
        arm = round(x[0] / truth.ALPHA_STEP) * truth.ALPHA_STEP
        beta = round(x[1] / truth.BETA_STEP) * truth.BETA_STEP
        return arm, wrapped(beta - math.pi) + case.bias, x[0], wrapped(x[1] - math.pi)

    def advance(u: float) -> None:
        if case.compensated and abs(u) > 1:
            u += math.copysign(DEAD, u)
        if case.zone:
            passed = math.copysign(DEAD, u) if case.zone == "offset" else 0.0
            u = u - passed if abs(u) > DEAD else 0.0
        x[:] = truth.step(x, u, case.plant)

    return _loop(Controller(balancing=True), read, advance, round(duration / truth.STEP))
