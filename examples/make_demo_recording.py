"""Make the recordings that `twinproof demo` starts from: a wheeled pendulum with a hidden effect.

The plant is the unstable wheel-driven pendulum of

    C.-C. Peng, N.-J. Cheng, M.-C. Tsai, "Application of an Output Filtering Method for an Unstable
    Wheel-Driven Pendulum System Parameter Identification", Electronics 12 (2023) 4569,

its equations (19) and (20) (with the sign of X5 in (20) corrected: gravity topples the body),
balanced by that paper's PID controller while the pitch follows a reference. What the plant does
beyond those equations is chosen by name from `EFFECTS`; the bundled recordings hide 25 N.m of
Coulomb friction at the wheel. The result is what a logger on the CAN bus would have seen.

This simulator is the truth that the product is tested against, so it imports nothing of the
product and repeats the physics on purpose.

Run it from the repository to write the two bundled logs anew:

    python examples/make_demo_recording.py twinproof/demo_data
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import cos, exp, isfinite, pi, radians, sin, tanh
from pathlib import Path

import can
import numpy as np
from cantools.database.can import Database as CanDatabase
from numpy.typing import NDArray

# Lumped parameters of the paper's Table 1, in volts: multiply by ALPHA for torques.
X1, X2, X3, X4, X5, X6, X7 = 0.0436, 0.0178, 0.1149, 0.8719, 4.6701, 0.7268, 0.7256
ALPHA = 165.418
"""Torque per motor voltage, N.m/V: 2 epsilon K_t / R_m of equation (12)."""

STEP = 1e-3
"""Time between two samples of controller and logger, s."""
SUBSTEPS = 4
"""Runge-Kutta steps within one sample."""

PROPORTIONAL, INTEGRAL, DERIVATIVE = -168.0, -800.0, -8.8
"""Gains on the pitch error, V/rad, V/(rad s), V s/rad; they are negative because a positive
voltage pushes the wheels forwards and so the body backwards."""
DERIVATIVE_BANDWIDTH = 100.0
"""Corner of the derivative's low-pass, rad/s."""

COUNT = 2 * pi / 60_000
"""One encoder count, rad."""
ANGLE_STEP = radians(0.01)
"""Resolution of pitch, rad, and of pitch rate, rad/s, on the bus."""
VOLT_STEP = 1e-3
"""Resolution of the motor voltage on the bus, V."""
PITCH_NOISE = radians(0.5)
"""Standard deviation of pitch, rad, and of pitch rate, rad/s."""

HIDDEN = {"coulomb_wheel": 25.0}
"""What the bundled recordings hide: Coulomb friction at the wheel, N.m."""

State = tuple[float, float, float, float]
"""Wheel angle and pitch, rad; wheel rate and pitch rate, rad/s."""
Torques = Callable[[State], tuple[float, float]]
"""Extra torques on wheel and body, N.m, each acting along its angle."""


# --- Hidden effects -----------------------------------------------------------------------------

SHARPNESS = 0.05
"""Speed at which the smooth sign of dry friction reaches 76 %, rad/s."""
STRIBECK_SPEED = 1.0
"""Speed at which the breakaway part of Stribeck friction has fallen to 37 %, rad/s."""


def _dry(speed: float) -> float:
    return tanh(speed / SHARPNESS)


TORQUE_EFFECTS: Mapping[str, Callable[[float], Torques]] = {
    "coulomb_wheel": lambda size: lambda x: (-size * _dry(x[2]), 0.0),
    "coulomb_body": lambda size: lambda x: (0.0, -size * _dry(x[3])),
    "stribeck_wheel": lambda size: (
        lambda x: (
            -size * _dry(x[2]) * (1.0 + exp(-((x[2] / STRIBECK_SPEED) ** 2))),
            0.0,
        )
    ),
    "viscous_wheel": lambda size: lambda x: (-size * x[2], 0.0),
    "viscous_body": lambda size: lambda x: (0.0, -size * x[3]),
    "quadratic_drag_wheel": lambda size: lambda x: (-size * x[2] * abs(x[2]), 0.0),
    "constant_torque_wheel": lambda size: lambda _: (size, 0.0),
    "constant_torque_body": lambda size: lambda _: (0.0, size),
    "cubic_spring_body": lambda size: lambda x: (0.0, -size * x[1] ** 3),
}
"""Law by name; its size is in N.m, N.m.s/rad, N.m.s2/rad2 or N.m/rad3."""

EFFECTS = (*TORQUE_EFFECTS, "input_dead_zone", "input_gain", "input_offset", "pitch_bias")
"""Every name that `simulate` knows; the last four are in V, 1 (0.1 is 10 % more), V, rad."""


def sum_of(torques: list[Torques]) -> Torques:
    """Return the law whose torques are the sums of those of `torques`."""
    if not torques:
        return lambda _: (0.0, 0.0)
    if len(torques) == 1:
        return torques[0]

    def total(x: State) -> tuple[float, float]:
        pairs = [torque(x) for torque in torques]
        return sum(wheel for wheel, _ in pairs), sum(body for _, body in pairs)

    return total


def _after_dead_zone(volts: float, half_width: float) -> float:
    if abs(volts) <= half_width:
        return 0.0
    return volts - half_width if volts > 0 else volts + half_width


# --- Plant --------------------------------------------------------------------------------------


def derivative(x: State, volts: float, torques: Torques) -> State:
    """Return the rates of the state: equations (19) and (20) solved for the accelerations.

    A torque tau beside the motor's enters its own equation as tau / ALPHA volts.
    """
    _, theta_p, omega_w, omega_p = x
    tau_w, tau_b = torques(x)
    s, c = sin(theta_p), cos(theta_p)
    motor = volts - X6 * omega_w + X7 * omega_p
    m11, m12, m22 = X1 + X2, X3 * c - X2, X4 + X2
    wheel = motor + X3 * omega_p * omega_p * s + tau_w / ALPHA
    body = -motor + X5 * s + tau_b / ALPHA
    det = m11 * m22 - m12 * m12
    return omega_w, omega_p, (m22 * wheel - m12 * body) / det, (m11 * body - m12 * wheel) / det


def advance(x: State, volts: float, torques: Torques, step: float) -> State:
    """Return the state after one classical Runge-Kutta step under a constant voltage."""
    a, b, c, d = x
    half = 0.5 * step
    p1, q1, r1, s1 = derivative(x, volts, torques)
    p2, q2, r2, s2 = derivative(
        (a + half * p1, b + half * q1, c + half * r1, d + half * s1), volts, torques
    )
    p3, q3, r3, s3 = derivative(
        (a + half * p2, b + half * q2, c + half * r2, d + half * s2), volts, torques
    )
    p4, q4, r4, s4 = derivative(
        (a + step * p3, b + step * q3, c + step * r3, d + step * s3), volts, torques
    )
    sixth = step / 6.0
    return (
        a + sixth * (p1 + 2.0 * (p2 + p3) + p4),
        b + sixth * (q1 + 2.0 * (q2 + q3) + q4),
        c + sixth * (r1 + 2.0 * (r2 + r3) + r4),
        d + sixth * (s1 + 2.0 * (s2 + s3) + s4),
    )


# --- References ---------------------------------------------------------------------------------


def aggressive(t: float) -> float:
    """Return the paper's aggressive pitch reference at time `t` in s, rad."""
    return radians(3 * sin(7 * t) + 6 * (cos(4 * t) - sin(t)) + 10 * cos(3 * t) * sin(5 * t) ** 2)


def held_out(t: float) -> float:
    """Return a reference of the same flavour but other frequencies and amplitudes, rad.

    It is ours, not the paper's: a model is scored on a movement that the fit has not seen.
    """
    return radians(
        4 * sin(5.5 * t) + 5 * (cos(3 * t) - sin(1.4 * t)) + 8 * cos(2.3 * t) * sin(4.2 * t) ** 2
    )


def simple(t: float) -> float:
    """Return the paper's simple pitch reference at time `t` in s, rad."""
    return radians(20 * sin(t))


# --- Closed loop --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """What the logger recorded, and what really happened.

    Attributes:
        time: Sample times, s, shape (n,).
        channels: `theta_w` and `theta_p` in rad, `omega_p` in rad/s as measured, and the voltage
            `V` applied from each sample to the next; shape (n,) each.
        counts: The same as the integers on the bus; all zero with ideal sensors.
        state: True wheel angle, pitch, wheel rate, pitch rate; rad, rad/s; shape (n, 4).
        reference: Wanted pitch, rad, shape (n,).
    """

    time: NDArray[np.float64]
    channels: dict[str, NDArray[np.float64]]
    counts: dict[str, NDArray[np.int64]]
    state: NDArray[np.float64]
    reference: NDArray[np.float64]


def simulate(
    effects: Mapping[str, float] | None = None,
    *,
    reference: Callable[[float], float] = aggressive,
    seed: int = 1,
    duration: float = 20.0,
    ideal_sensors: bool = False,
    disturbance: Callable[[float], float] | None = None,
) -> Run:
    """Balance the pendulum for a while and return the recording.

    It starts at rest, upright, as the paper does. Controller and logger see the same quantised,
    noisy measurements, and the motor gets exactly the quantised voltage that is logged.

    Args:
        effects: Size of each hidden effect by its name in `EFFECTS`; none by default.
        reference: Pitch wanted, rad, as a function of time, s.
        seed: Seed of the measurement noise.
        duration: Length, s.
        ideal_sensors: Without noise and quantisation, for controller and logger alike.
        disturbance: Voltage that reaches the motor and nobody logs, V, as a function of time, s.

    Raises:
        KeyError: An effect that is not in `EFFECTS`.
        RuntimeError: The pendulum fell over.

    Example:
        >>> run = simulate({"coulomb_wheel": 25.0}, duration=0.5)
        >>> run.time.size, sorted(run.channels)
        (501, ['V', 'omega_p', 'theta_p', 'theta_w'])
    """
    sizes = dict(effects or {})
    for name in sizes:
        if name not in EFFECTS:
            raise KeyError(f"unknown effect '{name}'; there are: {', '.join(EFFECTS)}")
    torques = sum_of([law(sizes[name]) for name, law in TORQUE_EFFECTS.items() if name in sizes])
    dead_zone = sizes.get("input_dead_zone", 0.0)
    gain, offset = 1.0 + sizes.get("input_gain", 0.0), sizes.get("input_offset", 0.0)
    bias = sizes.get("pitch_bias", 0.0)

    n = round(duration / STEP) + 1
    noise = np.random.default_rng(seed).standard_normal((n, 2)) * PITCH_NOISE
    wanted = [reference(k * STEP) for k in range(n)]
    states: list[State] = []
    seen: list[tuple[int, int, int, int]] = []
    exact: list[tuple[float, float, float, float]] = []

    x: State = (0.0, 0.0, 0.0, 0.0)
    integral = smooth_error = 0.0
    for k, (noise_p, noise_q) in enumerate(noise.tolist()):
        states.append(x)
        wheel, pitch, _, rate = x
        pitch += bias
        wheel_counts = pitch_counts = rate_counts = volt_counts = 0
        if not ideal_sensors:
            wheel_counts = round(wheel / COUNT)
            pitch_counts = round((pitch + noise_p) / ANGLE_STEP)
            rate_counts = round((rate + noise_q) / ANGLE_STEP)
            wheel, pitch = wheel_counts * COUNT, pitch_counts * ANGLE_STEP
            rate = rate_counts * ANGLE_STEP

        error = wanted[k] - pitch
        slope = DERIVATIVE_BANDWIDTH * (error - smooth_error)
        volts = PROPORTIONAL * error + INTEGRAL * integral + DERIVATIVE * slope
        integral += STEP * error
        smooth_error += STEP * slope
        if not ideal_sensors:
            volt_counts = round(volts / VOLT_STEP)
            volts = volt_counts * VOLT_STEP
        seen.append((wheel_counts, pitch_counts, rate_counts, volt_counts))
        exact.append((wheel, pitch, rate, volts))

        applied = gain * _after_dead_zone(volts, dead_zone) + offset
        if disturbance is not None:
            applied += disturbance(k * STEP)
        for _ in range(SUBSTEPS):
            x = advance(x, applied, torques, STEP / SUBSTEPS)
        if not isfinite(x[1]) or abs(x[1]) > pi / 2:
            raise RuntimeError(f"the pendulum fell over at {k * STEP:.3f} s with {sizes}")

    names = ("theta_w", "theta_p", "omega_p", "V")
    return Run(
        time=np.arange(n, dtype=np.float64) * STEP,
        channels=dict(zip(names, np.array(exact).T.copy(), strict=True)),
        counts=dict(zip(names, np.array(seen, dtype=np.int64).T.copy(), strict=True)),
        state=np.array(states),
        reference=np.array(wanted),
    )


def low_pass_noise(
    rms: float, rate: float, seed: int, duration: float = 20.0
) -> Callable[[float], float]:
    """Return first-order low-pass noise as a function of time: what a supply or a floor may do.

    Args:
        rms: Stationary standard deviation.
        rate: Corner of the low-pass, 1/s.
        seed: Of its own, apart from the sensors'.
        duration: Length, s.
    """
    n = round(duration / STEP) + 1
    white = np.random.default_rng(seed).standard_normal(n)
    decay = float(np.exp(-rate * STEP))
    values = np.empty(n)
    values[0] = rms * white[0]
    for k in range(1, n):
        values[k] = decay * values[k - 1] + rms * np.sqrt(1 - decay**2) * white[k]
    return lambda t: float(values[round(t / STEP)])


def fitted_run() -> Run:
    """Return the recording that the demo fits: `balancing.blf`."""
    return simulate(HIDDEN, reference=aggressive, seed=20231109)


def held_out_run() -> Run:
    """Return the recording that the demo is scored on: `held_out.blf`."""
    return simulate(HIDDEN, reference=held_out, seed=20231110)


# --- CAN log ------------------------------------------------------------------------------------

SIGNALS = {
    "WheelEncoder": {"WheelAngle": "theta_w"},
    "Attitude": {"Pitch": "theta_p", "PitchRate": "omega_p"},
    "MotorCommand": {"MotorVoltage": "V"},
}
"""Messages of the DBC, their signals, and the channel each signal carries."""


def frames(run: Run, dbc: Path) -> Iterator[can.Message]:
    """Yield the CAN frames of a recording, in time; each has a counter that rolls over at 256."""
    database = CanDatabase()
    database.add_dbc_file(dbc)
    layout = [(database.get_message_by_name(name), signals) for name, signals in SIGNALS.items()]
    for k in range(run.time.size):
        for message, signals in layout:
            raw = {signal: int(run.counts[channel][k]) for signal, channel in signals.items()}
            raw[f"{message.name}Counter"] = k % 256
            yield can.Message(
                # The writer cuts to whole ns: half of one more keeps exact milliseconds exact.
                timestamp=k * STEP + 0.5e-9,
                arbitration_id=message.frame_id,
                is_extended_id=False,
                data=message.encode(raw, scaling=False),
            )


def write_log(run: Run, dbc: Path, log: Path) -> None:
    """Write a recording as a BLF file whose time starts at 0."""
    with can.BLFWriter(log, compression_level=9) as writer:
        for frame in frames(run, dbc):
            writer.on_message_received(frame)


def main(folder: Path) -> None:
    """Write `balancing.blf` and `held_out.blf` to the folder that has `wheeled_pendulum.dbc`."""
    dbc = folder / "wheeled_pendulum.dbc"
    for name, run in (("balancing.blf", fitted_run()), ("held_out.blf", held_out_run())):
        write_log(run, dbc, folder / name)
        print(f"{folder / name}: {run.time.size} samples of {STEP * 1e3:g} ms")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "twinproof/demo_data"))
