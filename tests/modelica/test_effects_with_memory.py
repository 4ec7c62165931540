"""Effects with states of their own, or that change with time, against SciPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, solve_ivp
from test_effects import KINDS, WITH_MEMORY, low_pass, of_kind, run, through

from fmus.explicit import explicit
from fmus.frontend import load as load_dae
from fmus.sources import ModelicaSource

Array = np.ndarray


@dataclass(frozen=True)
class Law:
    """States `s` of an effect at position, speed and time, and what the machine spends on it."""

    parameters: dict[str, float]
    rates: Callable[[dict[str, float], Any, Any, Any], list[Any]]
    effort: Callable[[dict[str, float], Any, Any, Any], Any]
    states: int = 1


def _bristles(p: dict[str, float], w: Any, s: Any) -> list[Any]:
    """Dahl's, and LuGre's with its level that falls with speed."""
    level = 1 + p.get("r_s", 0) * np.exp(-((w / p.get("w_s", 1)) ** 2))
    return [w * (1 - s[0] * np.sign(w) / level) / (p["phi_b"] + p["T_b"] * abs(w))]


def _bouc_wen(p: dict[str, float], w: Any, s: Any) -> list[Any]:
    loading = np.sign(w) == np.sign(s[0])
    return [w * (1 - s[0] ** 2 if loading else 1) / (p["phi_y"] + p["T_b"] * abs(w))]


def _spring(p: dict[str, float], w: Any, s: Any) -> Any:
    """Acceleration of the second inertia: unit mass on spring and damper."""
    own = 2 * np.pi * p["f_n"]
    return own * own * s[0] + 2 * p["zeta"] * own * (w - s[1])


LAWS = {
    "DahlFriction": Law(
        {"tau_c": 0.8, "phi_b": 0.06, "T_b": 1e-3},
        lambda p, w, s, t: _bristles(p, w, s),
        lambda p, w, s, t: p["tau_c"] * s[0],
    ),
    "LuGreFriction": Law(
        {"tau_c": 0.6, "w_s": 0.4, "r_s": 0.7, "phi_b": 0.02, "T_b": 2e-3},
        lambda p, w, s, t: _bristles(p, w, s),
        lambda p, w, s, t: p["tau_c"] * s[0],
    ),
    "BoucWenHysteresis": Law(
        {"tau_y": 0.8, "phi_y": 0.15, "T_b": 1e-3},
        lambda p, w, s, t: _bouc_wen(p, w, s),
        lambda p, w, s, t: p["tau_y"] * s[0],
    ),
    "FlexibleMode": Law(
        {"J_f": 0.2, "f_n": 3.0, "zeta": 0.1},
        lambda p, w, s, t: [w - s[1], _spring(p, w, s)],
        lambda p, w, s, t: p["J_f"] * _spring(p, w, s),
        2,
    ),
    "WarmUpFriction": Law(
        {"d_w": 0.9, "T_w": 6.0},
        lambda p, w, s, t: [],
        lambda p, w, s, t: p["d_w"] * w * np.exp(-t / p["T_w"]),
        0,
    ),
}
every_law = pytest.mark.parametrize("name", LAWS)
every_kind = pytest.mark.parametrize("kind", KINDS)


def test_there_is_a_law_for_every_effect_with_memory() -> None:
    assert set(LAWS) == WITH_MEMORY


def names(kind: str, law: Law, **more: float) -> dict[str, float]:
    parameters = {**law.parameters, **more}
    renamed = {"f_n": parameters.pop("f_n")} if "f_n" in parameters else {}
    return {f"e.{k}": v for k, v in {**of_kind(kind, parameters), **renamed}.items()}


@every_kind
@every_law
def test_absent_at_its_defaults(kind: str, name: str) -> None:
    _, effort = run(kind, name, 3.0)
    assert np.all(effort == 0.0)


@every_kind
@every_law
def test_body_moves_as_scipy_says(kind: str, name: str) -> None:
    law = LAWS[name]
    found, effort = run(kind, name, 3.0, names(kind, law))

    def motion(t: float, x: Array) -> list[Any]:
        spent = law.effort(law.parameters, x[1], x[2:], t)
        own = law.rates(law.parameters, x[1], x[2:], t)
        return [x[1], (2 * np.sin(3 * t) - spent) / 0.5, *own]

    start = [0.3, -1.0, *np.zeros(law.states)]
    time = found["time"]
    # Short steps, so that the corners of the laws are met closely.
    truth = solve_ivp(motion, (0, 3), start, "DOP853", time, rtol=1e-10, atol=1e-12, max_step=2e-3)
    np.testing.assert_allclose(found["q"], truth.y[0], atol=2e-6)
    np.testing.assert_allclose(found["w"], truth.y[1], atol=2e-6)
    expected = [
        law.effort(law.parameters, x[1], x[2:], t) for t, x in zip(time, truth.y.T, strict=True)
    ]
    np.testing.assert_allclose(effort, expected, atol=1e-4)
    assert np.ptp(np.sign(truth.y[1])) == 2, "the test has to visit both directions"


@every_kind
@every_law
def test_takes_energy_out_over_a_motion(kind: str, name: str) -> None:
    """Whatever it stores in between, an effect that began empty never gives more than it took."""
    found, effort = run(kind, name, 4.0, names(kind, LAWS[name]), 2001)
    taken = cumulative_simpson(effort * found["w"], x=found["time"], initial=0)
    # A second inertia begins at rest beside a moving body: only that one brings energy along.
    brought = 0.5 * 0.2 * 1.0 if name == "FlexibleMode" else 0.0
    assert np.min(taken) >= -1e-6 - brought
    assert taken[-1] > 0.05


@pytest.mark.parametrize("name", ["DahlFriction", "LuGreFriction"])
def test_bristles_slide_at_the_coulomb_level(name: str) -> None:
    """At steady speed z is the sign of the speed, far beyond the Stribeck speed."""
    fast_start = {**names("Rotational", LAWS[name], T_b=1e-3), "w_start": 6.0}
    found, effort = run("Rotational", name, 2.0, fast_start)
    fast = (np.abs(found["w"]) > 1.5) & (found["time"] > 0.3)
    level = LAWS[name].parameters["tau_c"]
    assert np.sum(fast) > 5
    np.testing.assert_allclose(effort[fast], level * np.sign(found["w"][fast]), rtol=0.02)


# Sensitivities at the absent default --------------------------------------------------------


@every_kind
@every_law
def test_its_slope_at_zero_is_finite_and_tells_something(kind: str, name: str) -> None:
    """The score test looks at the derivative by the main parameter where the effect is absent."""
    main = next(iter(LAWS[name].parameters))
    main = of_kind(kind, {main: 0.0}).popitem()[0]
    point, position, effort = (
        ("RotationalPoint", "phi", "tau")
        if kind == "Rotational"
        else ("TranslationalPoint", "s", "f")
    )
    text = (
        f"model T Twinproof.Interfaces.{point} p; Real w(start = 0, fixed = true);"
        f" Real q(start = 0, fixed = true); Twinproof.Effects.{kind}.{name} e; equation"
        f" connect(e.flange, p.flange); der(q) = w; p.{position} = q; der(w) = p.{effort}; end T;"
    )
    model = explicit(load_dae(ModelicaSource(text, "T", "t.mo", "T", ())))
    row = model.state_names.index("w")
    slope = ca.Function(
        "slope",
        [model.time, model.x, model.p],
        [ca.jacobian(model.derivatives[row], model.p)[model.parameter_names.index(f"e.{main}")]],
    )
    values = [model.dae.parameter_values[n] for n in model.parameter_names]
    rng = np.random.default_rng(1)
    found = [float(slope(1.0, rng.normal(size=len(model.state_names)), values)) for _ in range(5)]
    at_rest = float(slope(0.0, np.zeros(len(model.state_names)), values))
    assert np.all(np.isfinite([*found, at_rest]))
    assert min(np.abs(found)) > 1e-3


# Signals ------------------------------------------------------------------------------------


def play(u: Array, w: float, start: float) -> Array:
    """The play operator, sample by sample."""
    y = np.empty_like(u)
    last = start
    for k, value in enumerate(u):
        last = min(max(last, value - w), value + w)
        y[k] = last
    return y


def test_backlash_waits_until_the_gap_is_crossed() -> None:
    time, u, y = through("Backlash", w=0.4, T=1e-4)
    truth = play(u, 0.4, u[0])
    after = time > 0.5
    np.testing.assert_allclose(y[after], truth[after], atol=2e-3)
    resting = np.abs(np.diff(truth[after])) == 0
    assert np.sum(resting) > 20, "the test has to stay in the gap for a while"


def test_backlash_is_late_by_no_more_than_its_time() -> None:
    time, u, y = through("Backlash", w=0.4, T=2e-3)
    after = time > 0.5
    assert np.max(np.abs(y - play(u, 0.4, u[0]))[after]) < 6 * 2e-3 * 1.1


def test_backlash_below_its_smallest_is_right_to_first_order() -> None:
    time, u, y = through("Backlash", w=1e-4, w_min=1e-3)
    rate = 6 * np.cos(3 * time)
    moving = (np.abs(rate) > 1.5) & (time > 0.5)
    np.testing.assert_allclose((u - y)[moving], 1e-4 * np.sign(rate[moving]), atol=1e-12)


def test_rate_limit_limits_the_rate() -> None:
    time, u, y = through("RateLimit", inverse_rate=0.5, T=1e-3, x_start=0.3)
    rate = np.diff(y) / np.diff(time)
    after = time[1:] > 0.1
    assert np.max(np.abs(rate[after])) < 2.0 * 1.02
    assert np.max(np.abs(np.diff(u) / np.diff(time))) > 5.5


def test_rate_limit_follows_slow_signals() -> None:
    """Against SciPy's own limiter; the error is that of the follower's time constant."""
    time, _, y = through("RateLimit", u="0.5 * sin(3 * time)", inverse_rate=0.5, T=1e-3)
    # At 1.5 per second the follower is 6 T behind, of which 1.5 T are added again.
    assert np.max(np.abs(y - 0.5 * np.sin(3 * time))) < 4.6e-3

    def rate(t: float, x: Array) -> Array:
        return np.clip((2 * np.sin(3 * t) + 0.3 - x) / 1e-4, -2, 2)

    truth = solve_ivp(rate, (0, 4), [0.3], "RK45", time, rtol=1e-8, max_step=1e-3).y[0]
    _, _, limited = through("RateLimit", inverse_rate=0.5, T=1e-4, x_start=0.3)
    np.testing.assert_allclose(limited, truth, atol=5e-3)


def test_rate_limit_without_limit_is_no_lag() -> None:
    time, u, y = through("RateLimit", T=0.3)
    assert np.array_equal(u, y)
    assert np.max(np.abs(low_pass(time, 0.3) - u)) > 0.5
