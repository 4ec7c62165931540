"""Every effect against its textbook law, written here a second time and integrated by SciPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import rumoca
from front_end import EXPLICIT, load, names_in, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

Array = np.ndarray


@dataclass(frozen=True)
class Law:
    """What the machine spends on an effect at position `q` and speed `w` (torque or force)."""

    parameters: dict[str, float]
    effort: Callable[[dict[str, float], Any, Any], Any]
    dissipates: bool = True
    kinds: tuple[str, ...] = ("Rotational", "Translational")


def _tanh(p: dict[str, float], w: Any) -> Any:
    return np.tanh(w / p["w_0"])


KINDS = ["Rotational", "Translational"]
TURNING = ("Rotational",)
SLIDING = ("Translational",)

# Keys of both kinds of motion; w_0, phi_e stand for v_0, s_e where something slides.
LAWS = {
    "ViscousFriction": Law({"d": 0.4}, lambda p, q, w: p["d"] * w),
    "CoulombFriction": Law({"tau_c": 0.7, "w_0": 0.03}, lambda p, q, w: p["tau_c"] * _tanh(p, w)),
    "StribeckFriction": Law(
        {"tau_s": 0.5, "w_s": 0.3, "w_0": 0.03},
        lambda p, q, w: p["tau_s"] * np.exp(-((w / p["w_s"]) ** 2)) * _tanh(p, w),
    ),
    "AsymmetricViscousFriction": Law(
        {"d_a": 0.3}, lambda p, q, w: p["d_a"] * np.maximum(w, -w), dissipates=False
    ),
    "AsymmetricCoulombFriction": Law(
        {"tau_a": 0.3, "w_0": 0.03},
        lambda p, q, w: p["tau_a"] * _tanh(p, w) * _tanh(p, w),
        dissipates=False,
    ),
    "QuadraticDrag": Law({"c": 0.2}, lambda p, q, w: p["c"] * w**2 * np.sign(w)),
    "LinearSpring": Law({"k": 1.5}, lambda p, q, w: p["k"] * q, dissipates=False),
    "CubicSpring": Law({"k3": 0.8}, lambda p, q, w: p["k3"] * q * q * q, dissipates=False),
    "Constant": Law({"tau_0": 0.2}, lambda p, q, w: -p["tau_0"] + 0.0 * w, dissipates=False),
    "HystereticDamping": Law(
        {"k_h": 0.9, "w_0": 0.03}, lambda p, q, w: p["k_h"] * np.maximum(q, -q) * _tanh(p, w)
    ),
    "LoadDependentFriction": Law(
        {"tau_l": 0.8, "w_0": 0.03},
        lambda p, q, w: p["tau_l"] * np.sqrt(1 - np.cos(q) ** 2) * _tanh(p, w),
        kinds=TURNING,
    ),
    "RollingResistance": Law(
        {"tau_r": 0.6, "w_r": 0.8, "w_0": 0.04},
        lambda p, q, w: p["tau_r"] * (w / p["w_r"]) / np.cbrt(np.hypot(w, p["w_0"]) / p["w_r"]),
    ),
    "EndStop": Law(
        {"k_e": 6.0, "phi_e": 0.2},
        lambda p, q, w: p["k_e"] * np.sign(q) * np.fmax(np.abs(q) - p["phi_e"], 0),
        dissipates=False,
    ),
    "Imbalance": Law(
        {"tau_s": 0.5, "tau_k": -0.3},
        lambda p, q, w: np.imag((p["tau_s"] + 1j * p["tau_k"]) * np.exp(1j * q)),
        dissipates=False,
        kinds=TURNING,
    ),
    "Cogging": Law(
        {"tau_s": 0.5, "tau_k": 0.3, "n": 7},
        lambda p, q, w: np.imag((p["tau_s"] + 1j * p["tau_k"]) * np.exp(7j * q)),
        dissipates=False,
        kinds=TURNING,
    ),
    "ForceRipple": Law(
        {"f_s": 0.5, "f_k": 0.3, "p": 0.25},
        lambda p, q, w: np.imag((p["f_s"] + 1j * p["f_k"]) * np.exp(8j * np.pi * q)),
        dissipates=False,
        kinds=SLIDING,
    ),
}

# Effects with states of their own, or that change with time: test_effects_with_memory.py.
WITH_MEMORY = {
    "DahlFriction",
    "LuGreFriction",
    "BoucWenHysteresis",
    "FlexibleMode",
    "WarmUpFriction",
}
SLIDING_NAMES = {"tau": "f", "w": "v", "phi": "s", "J": "m"}


def body(kind: str) -> str:
    """Inertia 0.5 under a torque or force of 2 sin 3t, with a point of that kind."""
    position, effort = ("phi", "tau") if kind == "Rotational" else ("s", "f")
    return f"""
        model Body
          parameter Real q_start = 0.3; parameter Real w_start = -1;
          Real q(start = q_start, fixed = true); Real w(start = w_start, fixed = true);
          Twinproof.Interfaces.{kind}Point point;
        equation
          der(q) = w; point.{position} = q;
          0.5 * der(w) = 2 * sin(3 * time) + point.{effort};
        end Body;"""


def of_kind(kind: str, parameters: dict[str, float]) -> dict[str, float]:
    """The library's names: `tau_c`, `w_0` where something turns, `f_c`, `v_0` where it slides."""
    if kind == "Rotational":
        return dict(parameters)
    renamed = (name.partition("_") for name in parameters)
    return {
        f"{SLIDING_NAMES.get(head, head)}{bar}{tail}": value
        for (head, bar, tail), value in zip(renamed, parameters.values(), strict=True)
    }


@cache
def body_with(kind: str, name: str) -> Any:
    if name == "Constant":
        name = "ConstantTorque" if kind == "Rotational" else "ConstantForce"
    return load(
        f"{body(kind)} model Q extends Body; Twinproof.Effects.{kind}.{name} e; "
        "equation connect(e.flange, point.flange); end Q;"
    )


def run(
    kind: str,
    name: str,
    stop: float,
    params: Mapping[str, float] | None = None,
    points: int = 201,
    config: rumoca.SimConfig = EXPLICIT,
) -> tuple[dict[str, Array], Array]:
    """Trajectories, and what the machine spends on the effect."""
    found = simulate(body_with(kind, name), stop, points, params, config)
    return found, found["e.flange.tau" if kind == "Rotational" else "e.flange.f"]


def effect_parameters(kind: str, law: Law) -> dict[str, float]:
    return {f"e.{key}": value for key, value in of_kind(kind, law.parameters).items()}


every_law = pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for name, law in LAWS.items() for kind in law.kinds]
)
every_kind = pytest.mark.parametrize("kind", KINDS)


@every_kind
def test_there_is_a_law_for_every_effect(kind: str) -> None:
    constant = "ConstantTorque" if kind == "Rotational" else "ConstantForce"
    here = {name for name, law in LAWS.items() if kind in law.kinds}
    laws = {constant if name == "Constant" else name for name in here}
    # Curves drawn from data have no law of their own.
    named = {name for name in names_in(f"Effects/{kind}") if not name.startswith("Empirical")}
    assert named == laws | WITH_MEMORY


@every_law
def test_absent_at_its_defaults(kind: str, name: str) -> None:
    _, effort = run(kind, name, 3.0)
    assert np.all(effort == 0.0)


@every_law
def test_body_moves_as_scipy_says(kind: str, name: str) -> None:
    law = LAWS[name]
    found, _ = run(kind, name, 4.0, effect_parameters(kind, law))

    def motion(t: float, x: Array) -> list[Any]:
        effort = law.effort(law.parameters, x[0], x[1])
        return [x[1], (2 * np.sin(3 * t) - effort) / 0.5]

    truth = solve_ivp(motion, (0, 4), [0.3, -1.0], "DOP853", found["time"], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found["q"], truth.y[0], atol=1e-6)
    np.testing.assert_allclose(found["w"], truth.y[1], atol=1e-6)
    assert np.ptp(np.sign(truth.y[1])) == 2, "the test has to visit both directions"


@every_law
@settings(max_examples=8, deadline=None, derandomize=True)
@given(scale=st.floats(0.01, 10.0), q=st.floats(-3.0, 3.0), w=st.floats(-5.0, 5.0))
def test_law_holds_and_passive_effects_dissipate(
    kind: str, name: str, scale: float, q: float, w: float
) -> None:
    """Pointwise on a short motion from any state, at any positive main parameter."""
    law = LAWS[name]
    main = next(iter(law.parameters))
    parameters = law.parameters | {main: scale * law.parameters[main]}
    names = {f"e.{key}": value for key, value in of_kind(kind, parameters).items()}
    names |= {"q_start": q, "w_start": w}
    found, effort = run(kind, name, 0.02, names, 3)
    expected = law.effort(parameters, found["q"], found["w"])
    np.testing.assert_allclose(effort, expected, rtol=1e-9, atol=1e-12)
    assert found["q"][0] == q
    if law.dissipates:
        assert np.all(effort * found["w"] >= 0)


@pytest.mark.parametrize("word", ["Viscous", "Coulomb"])
@every_kind
def test_asymmetric_friction_opposes_positive_motion_and_helps_negative(
    kind: str, word: str
) -> None:
    name = f"Asymmetric{word}Friction"
    found, effort = run(kind, name, 4.0, effect_parameters(kind, LAWS[name]))
    moving = np.abs(found["w"]) > 0.1
    assert np.all(effort[moving] > 0)


@every_kind
def test_constant_pushes_along_the_coordinate(kind: str) -> None:
    pushed, _ = run(kind, "Constant", 1.0, effect_parameters(kind, LAWS["Constant"]))
    free, _ = run(kind, "Constant", 1.0)
    # 0.2 on 0.5 for one second: q gains a t² / 2.
    assert pushed["q"][-1] - free["q"][-1] == pytest.approx(0.2, abs=1e-8)


def test_effects_on_one_flange_add_up() -> None:
    model = load(
        f"{body('Rotational')} model Q extends Body;"
        "Twinproof.Effects.Rotational.ViscousFriction a(d = 0.1);"
        "Twinproof.Effects.Rotational.ViscousFriction b(d = 0.3);"
        "equation connect(a.flange, point.flange); connect(b.flange, point.flange); end Q;"
    )
    both = simulate(model, 2.0)
    one, _ = run("Rotational", "ViscousFriction", 2.0, {"e.d": 0.4})
    np.testing.assert_allclose(both["q"], one["q"], atol=1e-8)


def test_mixes_with_flanges_of_the_standard_library() -> None:
    """Inertia as the Modelica Standard Library writes it, slowed by a friction of ours."""
    model = load("""
        package Modelica
          package SI
            type Angle = Real(final quantity = "Angle", final unit = "rad", displayUnit = "deg");
            type Torque = Real(final quantity = "Torque", final unit = "N.m");
          end SI;
          connector Flange SI.Angle phi; flow SI.Torque tau; end Flange;
          model Inertia
            Flange flange_a; Flange flange_b; parameter Real J = 1;
            SI.Angle phi(start = 0, fixed = true); Real w(start = 2, fixed = true); Real a;
          equation
            phi = flange_a.phi; phi = flange_b.phi; w = der(phi); a = der(w);
            J * a = flange_a.tau + flange_b.tau;
          end Inertia;
        end Modelica;
        model Q
          Modelica.Inertia inertia(J = 0.5);
          Twinproof.Effects.Rotational.ViscousFriction friction(d = 0.25);
        equation connect(inertia.flange_b, friction.flange); end Q;""")
    found = simulate(model, 2.0)
    np.testing.assert_allclose(found["inertia.w"], 2 * np.exp(-0.5 * found["time"]), atol=1e-8)


# Effects on signals -------------------------------------------------------------------------


SWING = "2 * sin(3 * time) + 0.3"
TURNS = "4 * sin(3 * time)"


def through(name: str, *, u: str = SWING, **params: float) -> tuple[Array, Array, Array]:
    """Time, `u` and `y` of a block; the fast state keeps the steps short."""
    model = load(
        f"model Q Twinproof.Effects.Signal.{name} e; Real x(start = 0, fixed = true); "
        f"equation der(x) = cos(200 * time); e.u = {u}; end Q;"
    )
    found = simulate(model, 4.0, 401, {f"e.{key}": value for key, value in params.items()})
    return found["time"], found["e.u"], found["e.y"]


STATIC: dict[str, tuple[dict[str, float], Callable[[Array, Array], Array]]] = {
    "DeadZone": ({"w": 0.4}, lambda t, u: np.sign(u) * np.clip(np.abs(u) - 0.4, 0, None)),
    "AffineAmplifier": ({"b": 0.3, "u_0": 1e-4}, lambda t, u: u + 0.3 * np.sign(u)),
    "Gain": ({"k": -0.1}, lambda t, u: 0.9 * u),
    "AsymmetricGain": ({"k": 0.2}, lambda t, u: np.where(u > 0, 1.2 * u, 0.8 * u)),
    "GainDrift": ({"k_t": 0.1}, lambda t, u: u + t * u / 10),
    "Offset": ({"b": -0.7}, lambda t, u: u - 0.7),
    "Drift": ({"b_t": 0.2}, lambda t, u: u + t / 5),
    "Saturation": ({"inverse_limit": 0.8}, lambda t, u: np.clip(u, -1.25, 1.25)),
    "Quantisation": ({"q": 0.25}, lambda t, u: 0.25 * np.floor(4 * u + 0.5)),
    "SignLoss": ({"k": 1.0}, lambda t, u: np.abs(u)),
    "Wrap": ({"k": 1.0}, lambda t, u: np.mod(u + np.pi, 2 * np.pi) - np.pi),
    "Eccentricity": ({"e_s": 0.05, "e_k": -0.1}, lambda t, u: u + np.sin(u) / 20 - np.cos(u) / 10),
    "Understeer": ({"K_us": 0.09}, lambda t, u: u * 100 / (100 + 9 * u * u)),
}
MEMORY = ["Delay", "FirstOrderLag", "Backlash", "RateLimit"]


def test_every_signal_effect_is_tested() -> None:
    named = {name for name in names_in("Effects/Signal") if not name.startswith("Empirical")}
    assert named == {*STATIC, *MEMORY}


@pytest.mark.parametrize("name", [*STATIC, *MEMORY])
def test_signal_passes_untouched_at_defaults(name: str) -> None:
    _, u, y = through(name, T_min=0.005) if name == "Delay" else through(name)
    assert np.array_equal(u, y)


@pytest.mark.parametrize("name", STATIC)
def test_static_law(name: str) -> None:
    parameters, law = STATIC[name]
    # The angle that wraps has to leave its range.
    time, u, y = through(name, u=TURNS if name == "Wrap" else SWING, **parameters)
    np.testing.assert_allclose(y, law(time, u), atol=1e-14)
    assert np.max(np.abs(y - u)) > 0.05


@pytest.mark.parametrize("name", ["SignLoss", "Wrap"])
def test_what_is_lost_is_lost_entirely(name: str) -> None:
    """No gain in between that could pass for another effect, and a slope to be found by."""
    _, _, lost = through(name, u=TURNS, k=1.0)
    _, before, half = through(name, u=TURNS, k=0.3)
    _, _, little = through(name, u=TURNS, k=0.0005)
    np.testing.assert_array_equal(half, lost)
    np.testing.assert_allclose(little - before, 0.0005 * (lost - before), atol=1e-15)


def low_pass(time: Array, T: float) -> Array:
    def rate(t: float, x: Array) -> Array:
        return (2 * np.sin(3 * t) + 0.3 - x) / T

    span = (time[0], time[-1])
    return solve_ivp(rate, span, [0.0], "DOP853", time, rtol=1e-10, atol=1e-12).y[0]


@pytest.mark.parametrize("T", [0.02, 0.3])
def test_first_order_lag(T: float) -> None:
    time, _, y = through("FirstOrderLag", T=T)
    np.testing.assert_allclose(y, low_pass(time, T), atol=1e-7)


def test_first_order_lag_below_its_shortest_is_right_to_first_order() -> None:
    """y = u - T u' + O(T T_min), so that a small T can be scored and fitted from 0."""
    T, T_min = 1e-3, 4e-3
    time, u, y = through("FirstOrderLag", T=T, T_min=T_min)
    settled = time > 0.1
    np.testing.assert_allclose(
        (u - y)[settled], (T * 6 * np.cos(3 * time))[settled], atol=1.1 * T * T_min * 18
    )


def test_delay() -> None:
    """The front end interpolates its memory coarsely: 2e-3 here, against 0.6 without a delay."""
    time, u, y = through("Delay", T=0.1)
    expected = np.where(time > 0.1, 2 * np.sin(3 * (time - 0.1)) + 0.3, 0.3)
    assert np.max(np.abs(u - expected)) > 0.5
    np.testing.assert_allclose(y, expected, atol=3e-3)


def test_delay_below_its_shortest_is_right_to_first_order() -> None:
    time, u, y = through("Delay", T=2e-3, T_min=2e-2)
    settled = time > 0.1
    np.testing.assert_allclose((u - y)[settled], 2e-3 * 6 * np.cos(3 * time[settled]), atol=1e-3)
