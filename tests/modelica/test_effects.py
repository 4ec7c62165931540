"""Every effect against its textbook law, written here a second time and integrated by SciPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import rumoca
from front_end import EXPLICIT, TIGHT, load, names_in, simulate
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


def _tanh(p: dict[str, float], w: Any) -> Any:
    return np.tanh(w / p["w_0"])


# Keys of both kinds of motion; w_0, w_s stand for v_0, v_s where something slides.
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
}

KINDS = ["Rotational", "Translational"]
SLIDING = {"tau": "f", "w": "v"}


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
        f"{SLIDING.get(head, head)}{bar}{tail}": value
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
    config: rumoca.SimConfig = TIGHT,
) -> tuple[dict[str, Array], Array]:
    """Trajectories, and what the machine spends on the effect."""
    found = simulate(body_with(kind, name), stop, points, params, config)
    return found, found["e.flange.tau" if kind == "Rotational" else "e.flange.f"]


def effect_parameters(kind: str, law: Law) -> dict[str, float]:
    return {f"e.{key}": value for key, value in of_kind(kind, law.parameters).items()}


every_law = pytest.mark.parametrize("name", LAWS)
every_kind = pytest.mark.parametrize("kind", KINDS)


@every_kind
def test_there_is_a_law_for_every_effect(kind: str) -> None:
    constant = "ConstantTorque" if kind == "Rotational" else "ConstantForce"
    laws = {constant if name == "Constant" else name for name in LAWS}
    assert set(names_in(f"Effects/{kind}")) == laws


@every_kind
@every_law
def test_absent_at_its_defaults(kind: str, name: str) -> None:
    _, effort = run(kind, name, 3.0)
    assert np.all(effort == 0.0)


@every_kind
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


@every_kind
@every_law
@settings(max_examples=15, deadline=None, derandomize=True)
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
    found, effort = run(kind, name, 0.02, names, 3, EXPLICIT)
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


def through(name: str, **params: float) -> tuple[Array, Array, Array]:
    """Time, `u = 2 sin 3t + 0.3` and `y` of a block; the fast state keeps the steps short."""
    model = load(
        f"model Q Twinproof.Effects.Signal.{name} e; Real x(start = 0, fixed = true); "
        "equation der(x) = cos(200 * time); e.u = 2 * sin(3 * time) + 0.3; end Q;"
    )
    found = simulate(model, 4.0, 401, {f"e.{key}": value for key, value in params.items()})
    return found["time"], found["e.u"], found["e.y"]


STATIC: dict[str, tuple[dict[str, float], Callable[[Array], Array]]] = {
    "DeadZone": ({"w": 0.4}, lambda u: np.sign(u) * np.clip(np.abs(u) - 0.4, 0, None)),
    "Gain": ({"k": -0.1}, lambda u: 0.9 * u),
    "AsymmetricGain": ({"k": 0.2}, lambda u: np.where(u > 0, 1.2 * u, 0.8 * u)),
    "Offset": ({"b": -0.7}, lambda u: u - 0.7),
    "Saturation": ({"inverse_limit": 0.8}, lambda u: np.clip(u, -1.25, 1.25)),
}


def test_every_signal_effect_is_tested() -> None:
    assert set(names_in("Effects/Signal")) == set(STATIC) | {"Delay", "FirstOrderLag"}


@pytest.mark.parametrize("name", [*STATIC, "Delay", "FirstOrderLag"])
def test_signal_passes_untouched_at_defaults(name: str) -> None:
    _, u, y = through(name, **({"T_min": 0.005} if name == "Delay" else {}))
    assert np.array_equal(u, y)


@pytest.mark.parametrize("name", STATIC)
def test_static_law(name: str) -> None:
    parameters, law = STATIC[name]
    _, u, y = through(name, **parameters)
    np.testing.assert_allclose(y, law(u), atol=1e-14)
    assert np.max(np.abs(y - u)) > 0.05


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
