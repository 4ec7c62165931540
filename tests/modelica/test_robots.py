"""The robots, the rotary pendulum and the car: Lagrange's equations by SymPy, printed matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from front_end import load, simulate
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import place_poles

from fmus.explicit import explicit
from fmus.frontend import load as load_dae
from fmus.sources import library_class

Array = np.ndarray
t = sp.Symbol("t")
GRAVITY = sp.Rational(981, 100)


class Mechanism:
    """Equations of motion of a Lagrangian, solved numerically for the accelerations.

    Args:
        coordinates: Functions of `t`.
        kinetic, potential: Energies in them [J].
        forces: Generalised force of each coordinate, in them, their rates and `inputs`.
        inputs: Symbols.
    """

    def __init__(
        self,
        coordinates: Sequence[Any],
        kinetic: Any,
        potential: Any,
        forces: Sequence[Any],
        inputs: Sequence[Any],
    ) -> None:
        rates = [q.diff(t) for q in coordinates]
        accelerations = sp.symbols(f"a:{len(coordinates)}")
        values = sp.symbols(f"x:{2 * len(coordinates)}")
        n = len(coordinates)
        plain = (
            dict(zip([r.diff(t) for r in rates], accelerations, strict=True))
            | dict(zip(rates, values[n:], strict=True))
            | dict(zip(coordinates, values[:n], strict=True))
        )

        def flat(expression: Any) -> Any:
            for old, new in plain.items():
                expression = expression.subs(old, new)
            return sp.expand(expression)

        energy = kinetic - potential
        equations = [
            flat(energy.diff(r).diff(t) - energy.diff(q) - force)
            for q, r, force in zip(coordinates, rates, forces, strict=True)
        ]
        inertia = sp.Matrix([[e.coeff(a) for a in accelerations] for e in equations])
        rest = [e.subs(dict.fromkeys(accelerations, 0)) for e in equations]
        self._inertia = sp.lambdify([values], inertia)
        self._rest = sp.lambdify([values, inputs], rest)
        self.size = n

    def __call__(self, x: Array, u: Sequence[float], extra: Any) -> list[float]:
        """d/dt of (coordinates, rates) with `extra` generalised forces."""
        right = np.array(extra) - np.array(self._rest(x, u))
        return [*x[self.size :], *np.linalg.solve(self._inertia(x), right)]


def lean(angle: Any, length: float, forward: Any, turn: Any = 0) -> Any:
    """Squared speed of a mass on a leaning body that drives and turns."""
    along = forward + (length * sp.sin(angle)).diff(t)
    up = (length * sp.cos(angle)).diff(t)
    return along**2 + up**2 + (length * sp.sin(angle) * turn) ** 2


@cache
def robot_2d() -> Mechanism:
    m, b, u = sp.Function("m")(t), sp.Function("b")(t), sp.Symbol("u")
    wheel, body = (m + b).diff(t), b.diff(t)
    # The rotors turn g_r times as fast as the wheels do against the body.
    rotor = 30 * m.diff(t) + body
    masses = 0.071 * (0.0249 * wheel) ** 2 + 0.5392 * lean(b, 0.1073, 0.0249 * wheel)
    inertias = 8.63e-6 * wheel**2 + 1.3e-7 * rotor**2 + 2.16e-3 * body**2
    potential = 0.5392 * GRAVITY * 0.1073 * sp.cos(b)
    forces = [6.28e-2 * u - 1e-4 * m.diff(t), 0]
    return Mechanism([m, b], (masses + inertias) / 2, potential, forces, [u])


@cache
def robot_3d() -> Mechanism:
    w, b, f = (sp.Function(n)(t) for n in "wbf")
    u1, u2 = sp.symbols("u1 u2")
    r, d, gear, K, R = 0.025, 0.06, 30, 0.02, 0.035
    wheels = [(w + side * d / r * f).diff(t) for side in (1, -1)]
    volts = [(u1 + u2) / 2, (u1 - u2) / 2]
    kinetic = 0.5 * lean(b, 0.1073, r * w.diff(t), f.diff(t))
    kinetic += 6.7e-3 * b.diff(t) ** 2 + 6e-4 * f.diff(t) ** 2
    for speed in wheels:
        kinetic += 0.07 * (r * speed) ** 2 + 8.75e-5 * speed**2
        kinetic += 1.3e-4 * (gear * (speed - b.diff(t))) ** 2
    # Torque of each motor on its wheel; in yaw the body's pitch rate drops out.
    torques = [
        gear * K * (v - K * gear * (s - b.diff(t))) / R - gear * 0.0022 * (s - b.diff(t))
        for v, s in zip(volts, wheels, strict=True)
    ]
    both = torques[0] + torques[1]
    forces = [both, -both, d / r * (torques[0] - torques[1])]
    return Mechanism([w, b, f], kinetic / 2, 0.5 * GRAVITY * 0.1073 * sp.cos(b), forces, [u1, u2])


@cache
def furuta() -> Mechanism:
    a, b, u = sp.Function("a")(t), sp.Function("b")(t), sp.Symbol("u")
    l0, l1, m = 0.1505, 0.145, 0.0276
    # Position of the rod's mass, the report's (2.2).
    place = [
        l0 * sp.cos(a) - l1 * sp.sin(a) * sp.sin(b),
        l0 * sp.sin(a) + l1 * sp.cos(a) * sp.sin(b),
        -l1 * sp.cos(b),
    ]
    squares: Any = sum(part.diff(t) ** 2 for part in place)
    speed2 = sp.simplify(squares)
    kinetic = m * speed2 + 0.0035 * a.diff(t) ** 2 + (0.79e-3 - m * l1**2) * b.diff(t) ** 2
    motor = 0.0706 / 0.9 * (0.0618 * u - 0.0707 * a.diff(t))
    friction = 0.0169 * a.diff(t) + 0.0351 * sp.tanh(15 * a.diff(t))
    return Mechanism(
        [a, b],
        kinetic / 2,
        -m * GRAVITY * l1 * sp.cos(b),
        [motor - friction, -1e-4 * b.diff(t)],
        [u],
    )


def compare(
    plant: str,
    mechanism: Mechanism,
    names: Sequence[str],
    points: Sequence[str],
    inputs: Mapping[str, str],
    starts: Mapping[str, float],
    stop: float,
) -> Array:
    """Simulate under `inputs` with 0.02 N m along and 0.003 N m s/rad against every point."""
    effects = "".join(
        f"Twinproof.Effects.Rotational.ConstantTorque c_{p}(tau_0 = 0.02);"
        f"Twinproof.Effects.Rotational.ViscousFriction v_{p}(d = 0.003);"
        for p in points
    )
    joints = "".join(
        f"connect(c_{p}.flange, {p}.flange); connect(v_{p}.flange, {p}.flange);" for p in points
    )
    head = ", ".join(f"{name}_start = {value}" for name, value in starts.items())
    set_inputs = "".join(f"p.{name} = {law};" for name, law in inputs.items())
    model = load(
        f"model P extends Twinproof.Plants.{plant}({head}); {effects} equation {joints} end P;"
        f"model Q P p; equation {set_inputs} end Q;"
    )
    found = simulate(model, stop)
    n = mechanism.size
    laws = [sp.lambdify(t, sp.sympify(law.replace("time", "t"))) for law in inputs.values()]

    def rate(time: float, x: Array) -> list[float]:
        return mechanism(x, [law(time) for law in laws], 0.02 - 0.003 * x[n:])

    x0 = [starts.get(name, 0.0) for name in names]
    time = found["time"]
    truth = solve_ivp(rate, (0, stop), x0, "DOP853", time, rtol=1e-11, atol=1e-13).y
    for name, expected in zip(names, truth, strict=True):
        np.testing.assert_allclose(found[f"p.{name}"], expected, rtol=1e-6, atol=1e-6)
    return truth


def test_robot_in_the_plane() -> None:
    truth = compare(
        "BalancingRobot2D",
        robot_2d(),
        ["theta_m", "theta_b", "omega_m", "omega_b"],
        ["motor", "body"],
        {"u": "0.8*sin(7*time)"},
        {"theta_b": 0.1, "omega_m": 3.0, "omega_b": -0.6},
        0.6,
    )
    assert np.max(np.abs(truth[1])) > 0.4, "far enough for the sine and the cosine to matter"


def test_robot_in_space() -> None:
    truth = compare(
        "BalancingRobot3D",
        robot_3d(),
        ["theta_w", "theta_b", "phi", "omega_w", "omega_b", "omega_phi"],
        ["wheel", "body", "yaw"],
        {"u1": "2*sin(5*time)", "u2": "1 + cos(3*time)"},
        {"theta_b": 0.2, "omega_phi": 4.0, "omega_w": 2.0},
        0.5,
    )
    assert np.max(np.abs(truth[1])) > 0.4
    assert np.max(np.abs(truth[5])) > 2, "fast enough for the centrifugal terms to matter"


def test_rotary_pendulum() -> None:
    truth = compare(
        "FurutaPendulum",
        furuta(),
        ["alpha", "beta", "omega_alpha", "omega_beta"],
        ["arm", "rod"],
        {"u": "60*sin(6*time)"},
        {"beta": 2.0, "omega_alpha": -1.0},
        2.0,
    )
    assert np.ptp(truth[1]) > np.pi / 2


# Linearised about the upright position, by the product's own front end ------------------------


def linear(
    plant: str,
    states: Sequence[str],
    signal: str,
    at: Mapping[str, float] | None = None,
    **values: float,
) -> tuple[Array, Array]:
    """Continuous A and B at rest."""
    dae = load_dae(library_class(f"Twinproof.Plants.{plant}"))
    model = explicit(dae)
    rows = [model.state_names.index(s) for s in states]
    column = model.input_names.index(signal)
    jacobians = ca.Function(
        "jacobians",
        [model.x, model.u, model.p],
        [ca.jacobian(model.derivatives, model.x), ca.jacobian(model.derivatives, model.u)],
    )
    x = [(at or {}).get(name, 0.0) for name in model.state_names]
    p = [{**dae.parameter_values, **values}[name] for name in model.parameter_names]
    A, B = (np.array(m) for m in jacobians(x, np.zeros(len(model.input_names)), p))
    return A[np.ix_(rows, rows)], B[rows, column]


def sampled(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """Zero-order hold."""
    n = len(A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, B
    held = expm(block * h)
    return held[:n, :n], held[:n, n]


def test_robot_in_the_plane_gives_the_printed_matrices() -> None:
    """(2.9) within 0.13 % of its largest elements, and the gain of the corrected reading."""
    states = ["theta_b", "theta_m", "omega_b", "omega_m"]
    A, B = sampled(*linear("BalancingRobot2D", states, "u"), 0.01)
    printed = [
        [1.0057, 0, 0.01, 0],
        [-0.0207, 1, -0.0001, 0.01],
        [1.1388, 0, 1.0057, 0.0007],
        [-4.1369, 0, -0.0207, 0.9954],
    ]
    np.testing.assert_allclose(A, printed, rtol=1.4e-3, atol=5.1e-5)
    np.testing.assert_allclose(B, [-0.0023, 0.0146, -0.4577, 2.9109], rtol=1.4e-3, atol=6e-5)
    placed: Any = place_poles(A, B[:, None], [0.8, 0.9, 0.9 + 0.05j, 0.9 - 0.05j])
    np.testing.assert_allclose(-placed.gain_matrix[0], [32.258, 1.763, 4.3125, 0.5216], rtol=3e-4)


def test_robot_in_space_gives_the_printed_matrices() -> None:
    """(3.31) to its four digits, with 3.5399 for the misprint 3.5299."""
    states = ["theta_w", "theta_b", "omega_w", "omega_b"]
    A, B = sampled(*linear("BalancingRobot3D", states, "u1"), 0.1)
    printed = [
        [1, 0.1719, 0.0226, 0.0830],
        [0, 1.1722, 0.0113, 0.0944],
        [0, 3.5363, 0.1388, 1.0332],
        [0, 3.5399, 0.1386, 1.0336],
    ]
    np.testing.assert_allclose(A, printed, atol=5.1e-5)
    np.testing.assert_allclose(B, [0.0641, -0.0094, 0.7131, -0.1148], atol=5.1e-5)
    A2, B2 = sampled(*linear("BalancingRobot3D", ["phi", "omega_phi"], "u2"), 0.1)
    np.testing.assert_allclose(A2, [[1, 0.0113], [0, 0.0001]], atol=5.1e-5)
    np.testing.assert_allclose(B2, [0.0306, 0.3450], atol=5.1e-5)


def test_floor_friction_slows_the_wheels_alone() -> None:
    states = ["omega_w", "omega_b"]
    without, _ = linear("BalancingRobot3D", states, "u1")
    with_it, _ = linear("BalancingRobot3D", states, "u1", d_w=0.1)
    rotors = 2 * 30**2 * 1.3e-4
    first = (2 * 0.07 + 0.5) * 0.025**2 + 2 * 8.75e-5 + rotors
    cross = 0.5 * 0.1073 * 0.025 - rotors
    second = 0.5 * 0.1073**2 + 6.7e-3 + rotors
    lost = np.array([[first, cross], [cross, second]]) @ (with_it - without)
    np.testing.assert_allclose(lost, [[-0.2, 0], [0, 0]], atol=1e-12)


ANGLES = ["alpha", "omega_alpha", "beta", "omega_beta"]


def incremental(A: Array, B: Array) -> tuple[Array, Array]:
    """The report's (5.10): the control's increments as input, sampled at 100 Hz."""
    Ad, Bd = sampled(A, B, 0.01)
    whole = np.eye(5)
    whole[:4, :4], whole[:4, 4] = Ad, Bd
    return whole, np.append(Bd, 1.0)


def test_rotary_pendulum_gives_the_printed_matrices() -> None:
    """(5.4) within 1 % (3 % where only two digits are printed), without Coulomb friction."""
    A, B = linear("FurutaPendulum", ANGLES, "u", {"beta": np.pi}, K_f=0.0)
    printed = [[0, 1, 0, 0], [0, -6.1, 8.1, -0.021], [0, 0, 0, 1], [0, -4.7, 55.5, -0.14]]
    np.testing.assert_allclose(A, printed, rtol=0.02, atol=1e-12)
    np.testing.assert_allclose(B, [0, 1.32, 0, 1.01], rtol=0.01, atol=1e-12)


@pytest.mark.parametrize(
    ("values", "gain", "poles"),
    [
        (
            {},
            [-6, -5, 137, 20, 0.15],
            [0.8730 + 0.3352j, 0.9375, 0.9867 + 0.0173j],
        ),
        (
            {"J_z0": 0.0059, "C0": 0.0140, "J_r1": 0.77e-3, "C1": 1.2e-4, "K_u": 0.0682},
            [-5.5, -4.5, 140, 18, 0.17],
            [0.9093 + 0.2583j, 0.9186, 0.9885 + 0.0162j],
        ),
    ],
    ids=["setup 1", "setup 2"],
)
def test_rotary_pendulum_has_the_printed_closed_loop_poles(
    values: dict[str, float], gain: list[float], poles: list[complex]
) -> None:
    """Of section 5.3.4, with the increment gain K5 that the corrections found."""
    A, B = incremental(*linear("FurutaPendulum", ANGLES, "u", {"beta": np.pi}, K_f=0.0, **values))
    found = np.linalg.eigvals(A - np.outer(B, gain))
    for pole in poles:
        assert np.min(np.abs(found - pole)) < 4e-3


def test_rotary_pendulum_open_loop_poles() -> None:
    A, _ = incremental(*linear("FurutaPendulum", ANGLES, "u", {"beta": np.pi}, K_f=0.0))
    found = np.sort(np.linalg.eigvals(A).real)
    np.testing.assert_allclose(found, [0.9183, 0.9520, 1, 1, 1.0746], atol=1.5e-3)


def test_car_follows_its_road_wheels() -> None:
    model = load("""model Q Twinproof.Plants.RoadCar p;
        equation p.v = 10 - 4 * time; p.delta = 3 * sin(time); end Q;""")
    found = simulate(model, 4.0)
    speed, wheel = 10 - 4 * found["time"], 3 * np.sin(found["time"])
    radius = 2.65 / np.tan(wheel[1:] / 13)
    np.testing.assert_allclose(found["p.yaw_rate"][1:], speed[1:] / radius, rtol=1e-12)
    assert speed[-1] < 0, "in reverse it turns the other way"
