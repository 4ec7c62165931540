"""Every plant and effect as an FMU, against right-hand sides written here, to 1e-6."""

from itertools import pairwise

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from numpy import abs, array, cos, exp, sign, sin, tanh
from reference_runs import integrate, source, staircase

from fmus.package import cached_fmu
from fmus.running import Fmu
from fmus.sources import library_class
from modelica import LIBRARY

T = np.linspace(0.0, 2.0, 101)
LEVELS = np.sin(3 * T) + 0.5 * np.cos(17 * T)
KINDS = ["CoSimulation", "ModelExchange"]

J, MGL, D = 0.1, 0.9, 0.03
PENDULUM = {"J": J, "mgl": MGL, "d": D, "theta_start": 0.7, "omega_start": -1.1}
PENDULUM_STARTS = [0.7, -1.1]
M, FV, GTAU = 95.1089, 203.5034, 35.1507

# Torque on the joint, as a function of angle and speed; parameters that are not at rest.
ROTATIONAL = {
    "AsymmetricCoulombFriction": ({"tau_a": 0.2}, lambda q, w: -0.2 * tanh(w / 0.05) ** 2),
    "AsymmetricViscousFriction": ({"d_a": 0.02}, lambda q, w: -0.02 * abs(w)),
    "ConstantTorque": ({"tau_0": 0.3}, lambda q, w: 0.3),
    "CoulombFriction": ({"tau_c": 0.25}, lambda q, w: -0.25 * tanh(w / 0.05)),
    "CubicSpring": ({"k3": 0.8}, lambda q, w: -0.8 * q**3),
    "LinearSpring": ({"k": 0.7}, lambda q, w: -0.7 * q),
    "QuadraticDrag": ({"c": 0.05}, lambda q, w: -0.05 * w**2 * sign(w)),
    "StribeckFriction": (
        {"tau_s": 0.2, "w_s": 0.4},
        lambda q, w: -0.2 * exp(-((w / 0.4) ** 2)) * tanh(w / 0.05),
    ),
    "ViscousFriction": ({"d": 0.06}, lambda q, w: -0.06 * w),
}
TRANSLATIONAL = {
    "AsymmetricCoulombFriction": ({"f_a": 20.0}, lambda q, v: -20 * tanh(v / 1e-3) ** 2),
    "AsymmetricViscousFriction": ({"d_a": 90.0}, lambda q, v: -90 * abs(v)),
    "ConstantForce": ({"f_0": 11.0}, lambda q, v: 11.0),
    "CoulombFriction": ({"f_c": 20.0}, lambda q, v: -20 * tanh(v / 1e-3)),
    "CubicSpring": ({"k3": 1e5}, lambda q, v: -1e5 * q**3),
    "LinearSpring": ({"k": 900.0}, lambda q, v: -900 * q),
    "QuadraticDrag": ({"c": 120.0}, lambda q, v: -120 * v * abs(v)),
    "StribeckFriction": (
        {"f_s": 9.0, "v_s": 0.02},
        lambda q, v: -9 * exp(-((v / 0.02) ** 2)) * tanh(v / 1e-3),
    ),
    "ViscousFriction": ({"d": 80.0}, lambda q, v: -80 * v),
}
SIGNAL = {
    "AsymmetricGain": ({"k": 0.2}, lambda u: u + 0.2 * abs(u)),
    "DeadZone": ({"w": 0.4}, lambda u: sign(u) * max(abs(u) - 0.4, 0.0)),
    "Gain": ({"k": -0.3}, lambda u: 0.7 * u),
    "Offset": ({"b": 0.15}, lambda u: u + 0.15),
    "Saturation": ({"inverse_limit": 1.25}, lambda u: min(max(u, -0.8), 0.8)),
}


LAWS = {
    "Rotational": {*ROTATIONAL},
    "Translational": {*TRANSLATIONAL},
    "Signal": {*SIGNAL, "Delay", "FirstOrderLag"},
}
"""Effects whose values are compared here; of the others only that they begin as nothing."""


def effects(kind):
    return {file.stem for file in (LIBRARY / "Effects" / kind).glob("*.mo")} - {"package"}


OTHERS = [(kind, name) for kind in LAWS for name in sorted(effects(kind) - LAWS[kind])]


def test_the_laws_are_those_of_effects_in_the_library():
    for kind, names in LAWS.items():
        assert names <= effects(kind)


def assert_agree(fmu, kind, inputs, outputs, expected, **settings):
    with Fmu(fmu) as opened:
        run = opened.simulate(kind=kind, inputs=(T, inputs), outputs=outputs, **settings)
    for column, name in enumerate(outputs):
        assert run[name] == pytest.approx(expected[:, column], abs=1e-6), name


def modifiers(values):
    return ", ".join(f"{name} = {value!r}" for name, value in values.items())


def wheeled_pendulum(_, x, volts):
    x1, x2, x3, x4, x5, x6, x7 = 0.0436, 0.0178, 0.1149, 0.8719, 4.6701, 0.7268, 0.7256
    _, pitch, ww, wp = x
    coupling = x3 * cos(pitch) - x2
    mass = array([[x1 + x2, coupling], [-coupling, -(x4 + x2)]])
    motor = volts - x6 * ww + x7 * wp
    force = array([motor + x3 * wp**2 * sin(pitch), motor - x5 * sin(pitch)])
    return [ww, wp, *np.linalg.solve(mass, force)]


def pendulum(torque):
    return lambda t, x, u: [x[1], (u - MGL * sin(x[0]) - D * x[1] + torque(x[0], x[1])) / J]


def positioner(force):
    return lambda t, x, u: [x[1], (GTAU * u - FV * x[1] + force(x[0], x[1])) / M]


PLANTS = {
    "Pendulum": (PENDULUM, pendulum(lambda q, w: 0.0), "tau", ["theta", "omega"]),
    "Positioner": ({"v_start": 0.1}, positioner(lambda q, v: 0.0), "vir", ["q", "v"]),
    "WheeledPendulum": (
        {"theta_p_start": 0.05, "omega_w_start": 1.0},
        wheeled_pendulum,
        "V",
        ["theta_w", "theta_p", "omega_w", "omega_p"],
    ),
}
STARTS = {"Pendulum": PENDULUM_STARTS, "Positioner": [0, 0.1], "WheeledPendulum": [0, 0.05, 1, 0]}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", PLANTS)
def test_plant(name, kind, fmi):
    fmu = cached_fmu(library_class(f"Twinproof.Plants.{name}"), fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    parameters, rhs, signal, outputs = PLANTS[name]
    # The wheeled pendulum falls over within half a second: compare while it does.
    until = T <= 0.5 if name == "WheeledPendulum" else T <= 2.0
    expected = integrate(rhs, STARTS[name], T, staircase(T, LEVELS), T[until])
    with Fmu(fmu) as opened:
        run = opened.simulate(
            kind=kind, inputs=(T[until], {signal: LEVELS[until]}), parameters=parameters
        )
    for column, output in enumerate(outputs):
        assert run[output] == pytest.approx(expected[:, column], abs=1e-6), output


@pytest.mark.parametrize("name", ROTATIONAL)
def test_rotational_effect(name):
    values, torque = ROTATIONAL[name]
    fmu = cached_fmu(
        source(
            f"model T extends Twinproof.Plants.Pendulum({modifiers(PENDULUM)});"
            f" Twinproof.Effects.Rotational.{name} effect({modifiers(values)});"
            " equation connect(effect.flange, joint.flange); end T;"
        )
    )
    assert validate_fmu(str(fmu)) == []
    expected = integrate(pendulum(torque), PENDULUM_STARTS, T, staircase(T, LEVELS), T)
    for kind in KINDS:
        assert_agree(fmu, kind, {"tau": LEVELS}, ["theta", "omega"], expected)


@pytest.mark.parametrize("name", TRANSLATIONAL)
def test_translational_effect(name):
    values, force = TRANSLATIONAL[name]
    fmu = cached_fmu(
        source(
            "model T extends Twinproof.Plants.Positioner(v_start = 0.1);"
            f" Twinproof.Effects.Translational.{name} effect({modifiers(values)});"
            " equation connect(effect.flange, carriage.flange); end T;"
        )
    )
    assert validate_fmu(str(fmu)) == []
    expected = integrate(positioner(force), [0.0, 0.1], T, staircase(T, LEVELS), T)
    for kind in KINDS:
        assert_agree(fmu, kind, {"vir": LEVELS}, ["q", "v"], expected)


def in_series(name, values, fmi):
    return cached_fmu(
        source(
            "model T Twinproof.Interfaces.RealInput u; Twinproof.Interfaces.RealOutput theta;"
            " Twinproof.Interfaces.RealOutput omega;"
            f" Twinproof.Plants.Pendulum plant({modifiers(PENDULUM)});"
            f" Twinproof.Effects.Signal.{name} effect({modifiers(values)});"
            " equation connect(u, effect.u); connect(effect.y, plant.tau);"
            " connect(plant.theta, theta); connect(plant.omega, omega); end T;"
        ),
        fmi=fmi,
    )


@pytest.mark.parametrize("name", SIGNAL)
def test_signal_effect(name, fmi):
    values, law = SIGNAL[name]
    fmu = in_series(name, values, fmi)
    assert validate_fmu(str(fmu)) == []
    shaped = array([law(u) for u in LEVELS])
    free = pendulum(lambda q, w: 0.0)
    expected = integrate(free, PENDULUM_STARTS, T, staircase(T, shaped), T)
    for kind in KINDS:
        assert_agree(fmu, kind, {"u": LEVELS}, ["theta", "omega"], expected)


@pytest.mark.parametrize(("kind", "name"), OTHERS)
def test_any_other_effect_is_absent_with_its_defaults(kind, name):
    """Which is what lets all candidates be attached to a model at once."""
    rhs, starts, outputs = pendulum(lambda q, w: 0.0), PENDULUM_STARTS, ["theta", "omega"]
    plant, point, signal = f"Pendulum({modifiers(PENDULUM)})", "joint", "tau"
    if kind == "Translational":
        rhs, starts, outputs = positioner(lambda q, v: 0.0), [0.0, 0.1], ["q", "v"]
        plant, point, signal = "Positioner(v_start = 0.1)", "carriage", "vir"
    if kind == "Signal":
        fmu, signal = in_series(name, {}, "2"), "u"
    else:
        fmu = cached_fmu(
            source(
                f"model T extends Twinproof.Plants.{plant};"
                f" Twinproof.Effects.{kind}.{name} effect;"
                f" equation connect(effect.flange, {point}.flange); end T;"
            )
        )
    assert validate_fmu(str(fmu)) == []
    expected = integrate(rhs, starts, T, staircase(T, LEVELS), T)
    for run_kind in KINDS:
        assert_agree(fmu, run_kind, {signal: LEVELS}, outputs, expected)


def test_first_order_lag(fmi):
    fmu = in_series("FirstOrderLag", {"T": 0.08}, fmi)
    assert validate_fmu(str(fmu)) == []

    def rhs(t, x, u):
        return [*pendulum(lambda q, w: 0.0)(t, x[:2], x[2]), (u - x[2]) / 0.08]

    expected = integrate(rhs, [*PENDULUM_STARTS, 0.0], T, staircase(T, LEVELS), T)
    for kind in KINDS:
        assert_agree(fmu, kind, {"u": LEVELS}, ["theta", "omega"], expected[:, :2])


# Whole and half samples, much longer than a sample, shorter, none: the delayed stairs lie anywhere.
@pytest.mark.parametrize("delay", [0.0, 0.005, 0.02, 0.05, 0.31])
def test_delay(delay, fmi):
    fmu = in_series("Delay", {"T": delay}, fmi)
    assert validate_fmu(str(fmu)) == []
    delayed = staircase(np.concatenate([[-1.0], T[1:] + delay]), LEVELS)
    free = pendulum(lambda q, w: 0.0)
    breaks = np.union1d(T, (T + delay)[T + delay < 2.0])
    expected = integrate(free, PENDULUM_STARTS, breaks, delayed, T)
    for kind in KINDS:
        assert_agree(fmu, kind, {"u": LEVELS}, ["theta", "omega"], expected)


def test_linear_inputs_are_followed_exactly():
    """A double integrator under a piecewise linear force has a closed form: cubics."""
    fmu = cached_fmu(library_class("Twinproof.Plants.Positioner"))
    with Fmu(fmu) as opened:
        run = opened.simulate(
            inputs=(T, {"vir": LEVELS}), hold="linear", parameters={"Fv": 0.0, "gtau": M}
        )
    h, q, v = T[1] - T[0], [0.0], [0.0]
    for a, b in pairwise(LEVELS):
        q.append(q[-1] + h * v[-1] + h**2 * (2 * a + b) / 6)
        v.append(v[-1] + h * (a + b) / 2)
    assert run["q"] == pytest.approx(array(q), abs=1e-12)
    assert run["v"] == pytest.approx(array(v), abs=1e-12)
