"""The benchmark's machines, as equations of motion in NumPy. Nothing here imports the product.

A machine's `rates` takes any number of lanes at once: state (nx, lanes), input (lanes,), parameters
and forces as scalars or (lanes,).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

Array = NDArray[np.float64]
Values = Mapping[str, Any]
Rates = Callable[[Array, Array, Values, Mapping[str, Any]], Array]
Controller = Callable[[float, Array], float]
"""(time [s], measured outputs) → command; keeps a memory of its own."""


@dataclass(frozen=True)
class Sensor:
    """A measured output: which state it shows, and how badly.

    Attributes:
        state: Index of the state.
        sd: Standard deviation of its noise at noise level 1.
        resolution: Step of the digits; 0 for none.
        unit: Of the output.
    """

    state: int
    sd: float
    resolution: float
    unit: str


@dataclass(frozen=True)
class Flange:
    """Where a force may act: the coordinate's index, its rate's, and what is usual there.

    Dry friction turns round below `reversal`, a speed.
    """

    position: int
    speed: int
    position_scale: float
    speed_scale: float
    force_scale: float
    reversal: float = 0.04


@dataclass(frozen=True)
class Plant:
    """A machine of the benchmark.

    Attributes:
        name: In the table.
        model: What the product is given, MODEL of its command line.
        parameters: True values of what the product fits.
        rates: Equations of motion.
        sensors: Output → sensor.
        command: Name and unit of the input.
        command_scale: Its usual size.
        flanges: Place → flange.
        excitations: Name → maker of a controller from a seed.
    """

    name: str
    model: str
    parameters: Mapping[str, float]
    states: int
    rates: Rates
    sensors: Mapping[str, Sensor]
    command: tuple[str, str]
    command_scale: float
    flanges: Mapping[str, Flange]
    excitations: Mapping[str, Callable[[int], Controller]]
    start: tuple[float, ...] = field(default=())


def multisine(seed: int, low: float, high: float, lines: int = 8) -> Callable[[float], float]:
    """Return a sum of sines of random phase, rms 1, between two frequencies [rad/s]."""
    rng = np.random.default_rng(seed)
    omega = np.geomspace(low, high, lines) * (1 + 0.05 * rng.uniform(-1, 1, lines))
    phase = rng.uniform(0, 2 * np.pi, lines)
    return lambda t: float(np.sqrt(2 / lines) * np.sum(np.sin(omega * t + phase)))


def sine(omega: float) -> Callable[[float], float]:
    """Return a sine of rms 1: as little excitation as there can be."""
    return lambda t: float(np.sqrt(2) * np.sin(omega * t))


# --- Wheel-driven pendulum -----------------------------------------------------------------------

_ALPHA = 165.418


def _wheeled(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    pitch, rolling, pitching = x[1], x[2], x[3]
    sine_, cosine = np.sin(pitch), np.cos(pitch)
    drive = u - p["X6"] * rolling + p["X7"] * pitching
    a = p["X1"] + p["X2"]
    b = p["X3"] * cosine - p["X2"]
    d = p["X4"] + p["X2"]
    on_wheel = drive + p["X3"] * pitching**2 * sine_ + force.get("wheel", 0.0) / _ALPHA
    on_body = -drive + p["X5"] * sine_ + force.get("body", 0.0) / _ALPHA
    det = a * d - b * b
    return np.array(
        [rolling, pitching, (d * on_wheel - b * on_body) / det, (a * on_body - b * on_wheel) / det]
    )


class _PitchPid:
    """The PID of the paper on the pitch, its derivative filtered."""

    def __init__(self, reference: Callable[[float], float], h: float = 2e-3) -> None:
        self.reference, self.h = reference, h
        self.integral = self.smooth = 0.0

    def __call__(self, t: float, y: Array) -> float:
        error = self.reference(t) - float(y[1])
        slope = 100.0 * (error - self.smooth)
        command = -168.0 * error - 800.0 * self.integral - 8.8 * slope
        self.integral += self.h * error
        self.smooth += self.h * slope
        return command


def _aggressive(seed: int) -> Controller:
    rng = np.random.default_rng(seed)
    s = 1 + 0.1 * rng.uniform(-1, 1, 4)

    def reference(t: float) -> float:
        return float(
            np.radians(
                3 * np.sin(7 * s[0] * t)
                + 6 * (np.cos(4 * s[1] * t) - np.sin(s[2] * t))
                + 10 * np.cos(3 * s[3] * t) * np.sin(5 * t) ** 2
            )
        )

    return _PitchPid(reference)


def _lively(seed: int) -> Controller:
    wave = multisine(seed, 1.0, 15.0)
    return _PitchPid(lambda t: float(np.radians(6 * wave(t))))


def _swaying(seed: int) -> Controller:
    omega = 1.0 + 0.2 * (seed % 5)
    return _PitchPid(lambda t: float(np.radians(12 * np.sin(omega * t))))


_DEGREE = np.pi / 180
WHEELED = Plant(
    "wheeled pendulum",
    "Twinproof.Plants.WheeledPendulum",
    {
        "X1": 0.0436,
        "X2": 0.0178,
        "X3": 0.1149,
        "X4": 0.8719,
        "X5": 4.6701,
        "X6": 0.7268,
        "X7": 0.7256,
    },
    4,
    _wheeled,
    {
        "theta_w": Sensor(0, 0.0, 2 * np.pi / 60000, "rad"),
        "theta_p": Sensor(1, 0.5 * _DEGREE, 0.0, "rad"),
        "omega_p": Sensor(3, 0.5 * _DEGREE, 0.0, "rad/s"),
    },
    ("V", "V"),
    8.0,
    {
        "wheel": Flange(0, 2, 3.0, 4.0, 200.0),
        "body": Flange(1, 3, 0.25, 1.0, 150.0),
    },
    {"rich": _aggressive, "lively": _lively, "poor": _swaying},
)


# --- Positioner ----------------------------------------------------------------------------------


def _positioner(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    push = 35.1507 * u - p["Fv"] * x[1] + force.get("carriage", 0.0)
    return np.array([x[1], push / p["M"] + 0.0 * x[1]])


def _cascade(path: Callable[[float], float]) -> Controller:
    """Position and speed in cascade, as on the measured machine; the speed from differences."""
    memory = {"q": 0.0, "v": 0.0}

    def control(t: float, y: Array) -> float:
        q = float(y[0])
        memory["v"] += 0.3 * ((q - memory["q"]) / 2e-3 - memory["v"])
        memory["q"] = q
        wanted = 160.0 * (path(t) - q)
        return float(np.clip(243.45 * (wanted - memory["v"]) / 10.0, -10, 10))

    return control


def _strokes(seed: int) -> Controller:
    """Strokes of growing speed, with rests."""
    rng = np.random.default_rng(seed)
    reach = 0.1 * (1 + 0.2 * rng.uniform(-1, 1, 8))

    def path(t: float) -> float:
        k = min(int(t / 1.25), 7)
        share = np.clip((t - 1.25 * k) / (1.1 - 0.1 * k), 0, 1)
        smooth = share * share * (3 - 2 * share)
        return float(reach[k] * (smooth if k % 2 == 0 else 1 - smooth)) + 0.0

    return _cascade(path)


def _shaking(seed: int) -> Controller:
    wave = multisine(seed, 1.5, 15.0)
    return _cascade(lambda t: 0.008 * wave(t))


def _to_and_fro(seed: int) -> Controller:
    wave = sine(3.0 + 0.3 * (seed % 5))
    return _cascade(lambda t: 0.06 * wave(t))


POSITIONER = Plant(
    "positioner",
    "Twinproof.Plants.Positioner",
    {"M": 95.1089, "Fv": 203.5034},
    2,
    _positioner,
    {"q": Sensor(0, 5e-6, 1e-6, "m")},
    ("vir", "V"),
    4.0,
    {"carriage": Flange(0, 1, 0.08, 0.15, 60.0, 8e-4)},
    {"rich": _strokes, "lively": _shaking, "poor": _to_and_fro},
)


# --- Pendulum ------------------------------------------------------------------------------------


def _pendulum(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    torque = u - p["mgl"] * np.sin(x[0]) - p["d"] * x[1] + force.get("joint", 0.0)
    return np.array([x[1], torque / p["J"]])


def _held(wave: Callable[[float], float], size: float, stiffness: float) -> Controller:
    """A force, with a weak pull back to where it began so that nothing walks away."""
    return lambda t, y: float(np.clip(size * wave(t) - stiffness * y[0], -4 * size, 4 * size))


PENDULUM = Plant(
    "pendulum",
    "Twinproof.Plants.Pendulum",
    {"J": 0.185, "mgl": 3.61, "d": 0.006},
    2,
    _pendulum,
    {"theta": Sensor(0, 2e-3, 0.0, "rad"), "omega": Sensor(1, 0.02, 0.0, "rad/s")},
    ("tau", "N.m"),
    1.0,
    {"joint": Flange(0, 1, 0.8, 2.5, 1.0)},
    {
        "rich": lambda seed: _held(multisine(seed, 0.8, 12.0), 0.9, 0.0),
        "lively": lambda seed: _held(multisine(seed, 2.0, 6.0, 5), 0.6, 0.0),
        "poor": lambda seed: _held(sine(2.0 + 0.2 * (seed % 5)), 0.6, 0.0),
    },
)


# --- Balancing robot -----------------------------------------------------------------------------

_ROBOT = {"J_b": 2.16e-3, "J_w": 8.63e-6, "J_m": 1.3e-7, "l": 0.1073, "c": 1e-4}
_WHEELS, _BODY, _RADIUS, _GEAR, _AMPERE, _G = 0.071, 0.5392, 0.0249, 30.0, 6.28e-2, 9.81


def _robot(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    tilt, tilting, spinning = x[0], x[2], x[3]
    sine_, cosine = np.sin(tilt), np.cos(tilt)
    rolling = (_WHEELS + _BODY) * _RADIUS**2 + p["J_w"]
    lever = _BODY * p["l"] * _RADIUS
    a = rolling + _GEAR**2 * p["J_m"]
    b = rolling + _GEAR * p["J_m"] + lever * cosine
    d = rolling + p["J_m"] + p["J_b"] + _BODY * p["l"] ** 2 + 2 * lever * cosine
    centrifugal = lever * sine_ * tilting**2
    on_motor = _AMPERE * u - p["c"] * spinning + centrifugal + force.get("motor", 0.0)
    on_body = centrifugal + _BODY * _G * p["l"] * sine_ + force.get("body", 0.0)
    det = a * d - b * b
    return np.array(
        [
            tilting,
            spinning,
            (a * on_body - b * on_motor) / det,
            (d * on_motor - b * on_body) / det,
        ]
    )


def _robot_gain() -> Array:
    """LQ gain about the upright, from differences of the equations."""
    e = 1e-6
    columns = [
        (_robot(e * v, np.zeros(1), _ROBOT, {}) - _robot(-e * v, np.zeros(1), _ROBOT, {})) / (2 * e)
        for v in np.eye(4)[:, :, None]
    ]
    a = np.hstack(columns)
    zero = np.zeros((4, 1))
    b = (_robot(zero, np.full(1, e), _ROBOT, {}) - _robot(zero, np.full(1, -e), _ROBOT, {})) / (
        2 * e
    )
    weight = np.diag([4.0, 0.02, 0.1, 2e-4])
    riccati = solve_continuous_are(a, b, weight, np.eye(1))
    return np.asarray((b.T @ riccati)[0])


def _balanced(wave: Callable[[float], float], size: float) -> Controller:
    gain = _robot_gain()
    memory = {"angle": 0.0, "speed": 0.0}

    def control(t: float, y: Array) -> float:
        memory["speed"] += 0.2 * ((float(y[1]) - memory["angle"]) / 2e-3 - memory["speed"])
        memory["angle"] = float(y[1])
        state = np.array([y[0], y[1] - size * wave(t), y[2], memory["speed"]])
        return float(np.clip(-gain @ state, -3, 3))

    return control


ROBOT = Plant(
    "balancing robot",
    "Twinproof.Plants.BalancingRobot2D",
    _ROBOT,
    4,
    _robot,
    {
        "theta_b": Sensor(0, 3e-3, 0.0, "rad"),
        "theta_m": Sensor(1, 0.0, 2 * np.pi / 720, "rad"),
        "omega_b": Sensor(2, 0.01, 0.0, "rad/s"),
    },
    ("u", "A"),
    0.4,
    {
        "body": Flange(0, 2, 0.15, 0.8, 0.08),
        "motor": Flange(1, 3, 3.0, 8.0, 0.03),
    },
    {
        "rich": lambda seed: _balanced(multisine(seed, 0.8, 12.0), 3.0),
        "lively": lambda seed: _balanced(multisine(seed, 2.0, 8.0, 5), 2.5),
        "poor": lambda seed: _balanced(sine(2.0 + 0.2 * (seed % 5)), 2.5),
    },
)


# --- Rotary pendulum -----------------------------------------------------------------------------

_MOTOR = 0.0706 / 0.9
_ROD_MASS, _ARM, _ROD = 0.0276, 0.1505, 0.145


def _furuta(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    swing, turning, swinging = x[1], x[2], x[3]
    sine_, cosine = np.sin(swing), np.cos(swing)
    coupling = _ROD_MASS * _ARM * _ROD
    square = _ROD_MASS * _ROD**2
    a = p["J_z0"] + _ROD_MASS * _ARM**2 + square * sine_**2
    b = coupling * cosine
    d = p["J_r1"] + 0.0 * swing
    on_arm = (
        _MOTOR * 0.0618 * u
        - (p["C0"] + _MOTOR * 0.0707) * turning
        - p["K_f"] * np.tanh(15 * turning)
        - 2 * square * sine_ * cosine * turning * swinging
        + coupling * sine_ * swinging**2
        + force.get("arm", 0.0)
    )
    on_rod = (
        square * sine_ * cosine * turning**2
        - p["C1"] * swinging
        - _ROD_MASS * 9.81 * _ROD * sine_
        + force.get("rod", 0.0)
    )
    det = a * d - b * b
    return np.array(
        [turning, swinging, (d * on_arm - b * on_rod) / det, (a * on_rod - b * on_arm) / det]
    )


FURUTA = Plant(
    "rotary pendulum",
    "Twinproof.Plants.FurutaPendulum",
    {"J_z0": 0.0035, "J_r1": 0.79e-3, "C0": 0.0169, "C1": 1e-4, "K_f": 0.0351},
    4,
    _furuta,
    {
        "alpha": Sensor(0, 0.0, 2 * np.pi / 4000, "rad"),
        "beta": Sensor(1, 2e-3, 0.0, "rad"),
    },
    ("u", "1"),
    20.0,
    {
        "arm": Flange(0, 2, 2.0, 6.0, 0.15),
        "rod": Flange(1, 3, 0.6, 4.0, 0.02),
    },
    {
        "rich": lambda seed: _held(multisine(seed, 1.0, 15.0), 22.0, 8.0),
        "lively": lambda seed: _held(multisine(seed, 3.0, 9.0, 5), 18.0, 8.0),
        "poor": lambda seed: _held(sine(4.0 + 0.3 * (seed % 5)), 18.0, 8.0),
    },
)


# --- Two machines of users' own (models/) --------------------------------------------------------


def _oscillator(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    push = u - p["k"] * x[0] - p["d"] * x[1] + force.get("mass", 0.0)
    return np.array([x[1], push / p["m"]])


OSCILLATOR = Plant(
    "oscillator",
    "Oscillator",
    {"m": 2.0, "k": 180.0, "d": 1.5},
    2,
    _oscillator,
    {"s": Sensor(0, 2e-4, 0.0, "m")},
    ("F", "N"),
    8.0,
    {"mass": Flange(0, 1, 0.06, 0.5, 8.0, 8e-4)},
    {
        "rich": lambda seed: _held(multisine(seed, 2.0, 25.0, 10), 7.0, 0.0),
        "lively": lambda seed: _held(multisine(seed, 5.0, 14.0, 6), 5.0, 0.0),
        "poor": lambda seed: _held(sine(8.0 + 0.3 * (seed % 5)), 4.0, 0.0),
    },
)


def _drive(x: Array, u: Array, p: Values, force: Mapping[str, Any]) -> Array:
    shaft = p["k"] * (x[0] - x[1]) + p["d"] * (x[2] - x[3])
    return np.array(
        [
            x[2],
            x[3],
            (u - shaft - p["d1"] * x[2] + force.get("motor", 0.0)) / p["J1"],
            (shaft - p["d2"] * x[3] + force.get("load", 0.0)) / p["J2"],
        ]
    )


DRIVE = Plant(
    "two-mass drive",
    "TwoMassDrive",
    {"J1": 0.02, "J2": 0.06, "k": 15.0, "d": 0.02, "d1": 0.05, "d2": 0.05},
    4,
    _drive,
    {
        "phi_1": Sensor(0, 0.0, 2 * np.pi / 20000, "rad"),
        "phi_2": Sensor(1, 1e-3, 0.0, "rad"),
    },
    ("tau", "N.m"),
    1.0,
    {
        "motor": Flange(0, 2, 3.0, 6.0, 0.8),
        "load": Flange(1, 3, 3.0, 6.0, 0.8),
    },
    {
        "rich": lambda seed: _held(multisine(seed, 0.8, 30.0, 10), 1.0, 0.2),
        "lively": lambda seed: _held(multisine(seed, 2.0, 12.0, 6), 1.0, 0.2),
        "poor": lambda seed: _held(sine(4.0 + 0.3 * (seed % 5)), 0.8, 0.2),
    },
)

PLANTS = {p.name: p for p in (WHEELED, POSITIONER, PENDULUM, ROBOT, FURUTA, OSCILLATOR, DRIVE)}
