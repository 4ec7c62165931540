"""The plants against mechanics: Lagrange's equations by SymPy, motions by SciPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from front_end import load, load_class, simulate
from scipy.integrate import cumulative_simpson, solve_ivp

from foundation.units import factor_and_offset

X = {
    "X1": 0.0436,
    "X2": 0.0178,
    "X3": 0.1149,
    "X4": 0.8719,
    "X5": 4.6701,
    "X6": 0.7268,
    "X7": 0.7256,
}
ALPHA = 165.418
EFFECT = "Twinproof.Effects.Rotational"


def euler_lagrange() -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """Inertia matrix, remaining forces and energy of the wheeled pendulum, all over alpha.

    From the kinetic and potential energy of the paper's (1), so independent of its (19), (20).
    """
    t = sp.Symbol("t")
    w, p = (sp.Function(n)(t) for n in ("w", "p"))
    X1, X2, X3, X4, X5 = sp.symbols("X1:6")
    dw, dp = w.diff(t), p.diff(t)
    kinetic = X1 * dw**2 / 2 + X3 * sp.cos(p) * dw * dp + X4 * dp**2 / 2 + X2 * (dw - dp) ** 2 / 2
    potential = X5 * sp.cos(p)
    lagrangian = kinetic - potential
    forces = [sp.expand(lagrangian.diff(q.diff(t)).diff(t) - lagrangian.diff(q)) for q in (w, p)]
    accelerations = [w.diff(t, 2), p.diff(t, 2)]
    values = sp.symbols("theta_w theta_p omega_w omega_p")

    def plain(expression: Any) -> Any:
        rates = expression.subs({dw: values[2], dp: values[3]})
        return rates.subs({w: values[0], p: values[1]})

    inertia = sp.Matrix([[plain(f.coeff(a)) for a in accelerations] for f in forces])
    rest = [plain(f.subs(dict.fromkeys(accelerations, 0))) for f in forces]
    arguments = (values, (X1, X2, X3, X4, X5))
    return (
        sp.lambdify(arguments, inertia),
        sp.lambdify(arguments, rest),
        sp.lambdify(arguments, plain(kinetic + potential)),
    )


INERTIA, REST, ENERGY = euler_lagrange()
FIRST_FIVE = [X[f"X{i}"] for i in range(1, 6)]


def accelerate(x: Any, V: float, wheel: float, body: float) -> list[float]:
    """d/dt of (theta_w, theta_p, omega_w, omega_p); torques `wheel` and `body` in N m."""
    motor = V - X["X6"] * x[2] + X["X7"] * x[3]
    force = np.array([motor + wheel / ALPHA, -motor + body / ALPHA]) - REST(x, FIRST_FIVE)
    return [x[2], x[3], *np.linalg.solve(INERTIA(x, FIRST_FIVE), force)]


def reference(rate: Callable[..., Any], start: list[float], time: np.ndarray) -> np.ndarray:
    span = (time[0], time[-1])
    return solve_ivp(rate, span, start, "DOP853", time, rtol=1e-11, atol=1e-13).y


STATES = ["theta_w", "theta_p", "omega_w", "omega_p"]


def test_wheeled_pendulum_with_torques_at_both_points() -> None:
    model = load(f"""
        model P extends Twinproof.Plants.WheeledPendulum(theta_p_start = 0.05, omega_w_start = 0.2);
          {EFFECT}.CoulombFriction onWheel(tau_c = 3); {EFFECT}.ConstantTorque onBody(tau_0 = -5);
        equation connect(onWheel.flange, wheel.flange); connect(onBody.flange, body.flange); end P;
        model Q P p; equation p.V = 0.5 * sin(4 * time) - 0.3; end Q;""")
    found = simulate(model, 1.5)

    def rate(t: float, x: np.ndarray) -> list[float]:
        return accelerate(x, 0.5 * np.sin(4 * t) - 0.3, -3 * np.tanh(x[2] / 0.05), -5)

    truth = reference(rate, [0, 0.05, 0.2, 0], found["time"])
    for name, expected in zip(STATES, truth, strict=True):
        np.testing.assert_allclose(found[f"p.{name}"], expected, atol=1e-6)
    assert np.max(np.abs(truth[1])) > 0.3, "far enough for the sine and the cosine to matter"


@pytest.mark.parametrize("point", ["wheel", "body"])
def test_friction_takes_its_work_from_the_energy_of_the_pendulum(point: str) -> None:
    """No voltage, no back-EMF: what the mechanism loses is d w², at either point."""
    model = load(f"""
        model P extends Twinproof.Plants.WheeledPendulum(X6 = 0, X7 = 0, theta_p_start = 0.1);
          {EFFECT}.ViscousFriction friction(d = 8);
        equation connect(friction.flange, {point}.flange); end P;
        model Q P p; equation p.V = 0; end Q;""")
    found = simulate(model, 4.0, 4001)
    state = np.array([found[f"p.{name}"] for name in STATES])
    energy = np.array([ENERGY(x, FIRST_FIVE) for x in state.T])
    rate = found["p.omega_w" if point == "wheel" else "p.omega_p"]
    lost = cumulative_simpson(8 / ALPHA * rate**2, x=found["time"], initial=0)
    np.testing.assert_allclose(energy, energy[0] - lost, atol=1e-6)
    assert lost[-1] > 0.01


def test_wheeled_pendulum_falls_at_the_known_rate() -> None:
    """Unstable eigenvalue +2.08 1/s of the paper's plant, open loop."""
    model = load("""model Q Twinproof.Plants.WheeledPendulum p(theta_p_start = 1e-6);
        equation p.V = 0; end Q;""")
    found = simulate(model, 4.0, 401)
    pitch = found["p.theta_p"]
    rate = np.log(pitch[400] / pitch[300])
    assert rate == pytest.approx(2.08, abs=0.005)


def test_positioner() -> None:
    """The benchmark's equation, with its published friction and offset (the example)."""
    model = load("""model Q Twinproof.Examples.PositionerWithFriction p(q_start = 0.1);
        equation p.vir = 3 * sin(5 * time); end Q;""")
    found = simulate(model, 3.0)

    def rate(t: float, x: np.ndarray) -> list[float]:
        dry = 20.3935 * np.tanh(x[1] / 1e-3)
        force = 35.1507 * 3 * np.sin(5 * t) - 203.5034 * x[1] - dry + 3.1648
        return [x[1], force / 95.1089]

    truth = reference(rate, [0.1, 0], found["time"])
    np.testing.assert_allclose(found["p.q"], truth[0], atol=1e-8)
    np.testing.assert_allclose(found["p.v"], truth[1], atol=1e-6)


def test_pendulum() -> None:
    model = load(f"""
        model P extends Twinproof.Plants.Pendulum(theta_start = 2.5, omega_start = 0.4, d = 0.02);
          {EFFECT}.CoulombFriction friction(tau_c = 0.164);
        equation connect(friction.flange, joint.flange); end P;
        model Q P p; equation p.tau = 0.7 * cos(2 * time); end Q;""")
    found = simulate(model, 3.0)

    def rate(t: float, x: np.ndarray) -> list[float]:
        friction = 0.02 * x[1] + 0.164 * np.tanh(x[1] / 0.05)
        return [x[1], (0.7 * np.cos(2 * t) - 3.61 * np.sin(x[0]) - friction) / 0.185]

    truth = reference(rate, [2.5, 0.4], found["time"])
    np.testing.assert_allclose(found["p.theta"], truth[0], atol=1e-6)
    np.testing.assert_allclose(found["p.omega"], truth[1], atol=1e-5)


def test_pendulum_hangs_still_at_zero() -> None:
    """Small swings have the period of a hanging pendulum, 2 pi sqrt(J / mgl)."""
    model = load("""model Q Twinproof.Plants.Pendulum p(theta_start = 1e-4, d = 0);
        equation p.tau = 0; end Q;""")
    period = 2 * np.pi * np.sqrt(0.185 / 3.61)
    found = simulate(model, period, 5)
    np.testing.assert_allclose(found["p.theta"] / 1e-4, [1, 0, -1, 0, 1], atol=1e-5)


def test_dead_zone_example_holds_back_small_voltages() -> None:
    for volts, moves in ((0.19, False), (0.21, True)):
        model = load(f"""model Q Twinproof.Examples.WheeledPendulumWithDeadZone p;
            equation p.V = {volts}; end Q;""")
        found = simulate(model, 0.5)
        assert (np.max(np.abs(found["p.theta_w"])) > 0) == moves


@pytest.mark.parametrize(
    ("plant", "inputs", "outputs"),
    [
        (
            "WheeledPendulum",
            {"V": "V"},
            dict(zip(STATES, ["rad", "rad", "rad/s", "rad/s"], strict=True)),
        ),
        ("Positioner", {"vir": "V"}, {"q": "m", "v": "m/s"}),
        ("Pendulum", {"tau": "N.m"}, {"theta": "rad", "omega": "rad/s"}),
    ],
)
def test_inputs_and_outputs_keep_their_units(
    plant: str, inputs: dict[str, str], outputs: dict[str, str]
) -> None:
    """Also where an output is a state and inputs are connectors."""
    model = load_class(f"Twinproof.Plants.{plant}")
    attributes = {v["name"]: v["attributes"] for v in model.to_dict("dae")["storage"]["variables"]}
    found = {
        kind: {n: a["unit"] for n, a in attributes.items() if a["causality"] == kind}
        for kind in ("input", "output")
    }
    assert found == {"input": inputs, "output": outputs}


# What each parameter is multiplied by in the equation of motion, and the unit of that equation.
TERMS = {
    "WheeledPendulum": (
        "V",
        {"X1": "rad/s2", "X2": "rad/s2", "X3": "rad/s2", "X4": "rad/s2", "X5": "1"}
        | {"X6": "rad/s", "X7": "rad/s"},
    ),
    "Positioner": ("N", {"M": "m/s2", "Fv": "m/s", "gtau": "V"}),
    "Pendulum": ("N.m", {"J": "rad/s2", "mgl": "1", "d": "rad/s"}),
}


@pytest.mark.parametrize("plant", TERMS)
def test_every_term_has_the_unit_of_its_equation(plant: str) -> None:
    parameters = load_class(f"Twinproof.Plants.{plant}").parameters
    effort, terms = TERMS[plant]
    for name, factor in terms.items():
        unit = parameters[name].unit
        product = unit if factor == "1" else f"{unit}.{factor}"
        assert factor_and_offset(product, effort) == pytest.approx((1.0, 0.0)), name
