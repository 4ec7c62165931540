"""State, time and input events, against closed forms, as Co-Simulation and Model Exchange."""

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from numpy import exp, pi, sin
from reference_runs import source
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fmus.package import cached_fmu
from fmus.running import simulate
from foundation.errors import FmuError

KINDS = ["CoSimulation", "ModelExchange"]
kinds = pytest.mark.parametrize("kind", KINDS)

BALL = """model T parameter Real e = 0.8; parameter Real g = 9.81;
  Real h(start = 1, fixed = true, unit = "m"); Real v(start = 0, fixed = true, unit = "m/s");
  discrete Real bounces(start = 0, fixed = true); output Real height = h;
equation der(h) = v; der(v) = -g;
  when h < 0 then reinit(v, -e * pre(v)); bounces = pre(bounces) + 1; end when; end T;"""


def ball(t, e=0.8, g=9.81):
    """Height and number of bounces of a ball that falls from 1 m."""
    begin, speed, flight, bounces = 0.0, 0.0, np.sqrt(2 / g), 0
    height = 1.0
    while t > begin + flight:
        begin += flight
        speed = e * (g * flight if bounces == 0 else speed)
        flight, height, bounces = 2 * speed / g, 0.0, bounces + 1
    s = t - begin
    return height + (speed * s if bounces else 0.0) - g * s**2 / 2, bounces


@kinds
def test_bouncing_ball(kind, fmi):
    fmu = cached_fmu(source(BALL), fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    run = simulate(fmu, stop=2.5, step=0.01, kind=kind, outputs=["h", "bounces", "height"])
    expected = np.array([ball(t) for t in run.time])
    assert run["h"] == pytest.approx(expected[:, 0], abs=1e-6)
    assert run["height"] == pytest.approx(expected[:, 0], abs=1e-6)
    assert run["bounces"].tolist() == expected[:, 1].tolist()
    assert run["bounces"][-1] >= 3


@kinds
def test_event_exactly_at_a_communication_point(kind, fmi):
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); discrete Real n(start = 0, fixed = true);"
            " equation der(x) = 1; when x >= 0.5 then n = pre(n) + 1; end when; end T;"
        ),
        fmi=fmi,
    )
    run = simulate(fmu, stop=1.0, step=0.25, kind=kind, outputs=["n"])
    assert run["n"][[0, 1, 3, 4]].tolist() == [0, 0, 1, 1]


@kinds
def test_relations_switch_where_they_should(kind, fmi):
    """A sawtooth force by `if`: the speed is a triangle, the position made of parabolas."""
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); Real v(start = 0, fixed = true);"
            " equation der(x) = v; der(v) = if sin(2*3.141592653589793*time) > 0 then 1 else -1;"
            " end T;"
        ),
        fmi=fmi,
    )
    assert validate_fmu(str(fmu)) == []
    run = simulate(fmu, stop=3.0, step=0.05, kind=kind, outputs=["x", "v"])
    phase = np.mod(run.time, 1.0)
    speed = np.minimum(phase, 1 - phase)
    within = np.where(phase <= 0.5, phase**2 / 2, 0.25 - (1 - phase) ** 2 / 2)
    assert run["v"] == pytest.approx(speed, abs=1e-6)
    assert run["x"] == pytest.approx(np.floor(run.time + 1e-9) * 0.25 + within, abs=1e-6)


@kinds
def test_time_event_follows_its_parameter(kind, fmi):
    fmu = cached_fmu(
        source(
            "model T parameter Real t0 = 0.3; Real x(start = 0, fixed = true);"
            " equation der(x) = if time > t0 then 1 else 0; end T;"
        ),
        fmi=fmi,
    )
    for t0 in (0.3, 0.77):
        run = simulate(fmu, stop=1.0, step=0.1, kind=kind, outputs=["x"], parameters={"t0": t0})
        assert run["x"] == pytest.approx(np.maximum(run.time - t0, 0.0), abs=1e-9)


@kinds
def test_elsewhen_and_events_that_set_off_events(kind, fmi):
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); discrete Real a(start = 0, fixed = true);"
            " discrete Real b(start = 0, fixed = true);"
            " equation der(x) = 1;"
            " when x > 0.35 then a = 1; elsewhen x > 0.65 then a = 5; end when;"
            " when a > 0.5 then b = pre(b) + a; end when; end T;"
        ),
        fmi=fmi,
    )
    run = simulate(fmu, stop=1.0, step=0.1, kind=kind, outputs=["a", "b"])
    assert run["a"].tolist() == [0, 0, 0, 0, 1, 1, 1, 5, 5, 5, 5]
    assert run["b"].tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1]


@kinds
def test_when_with_several_conditions(kind, fmi):
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); discrete Real n(start = 0, fixed = true);"
            " equation der(x) = 1; when {x > 0.25, x > 0.55 and x < 2} then n = pre(n) + 1;"
            " end when; end T;"
        ),
        fmi=fmi,
    )
    run = simulate(fmu, stop=1.0, step=0.1, kind=kind, outputs=["n"])
    assert run["n"].tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 2]


def test_sticking_on_a_sign_function():
    """Dry friction with sign(v) above the driving force: the mass stops and stays."""
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); Real v(start = 1, fixed = true);"
            " equation der(x) = v; der(v) = 0.5 - 2 * sign(v); end T;"
        )
    )
    run = simulate(fmu, stop=2.0, step=0.01, outputs=["x", "v"])
    stops = 1 / 1.5
    t = np.minimum(run.time, stops)
    assert run["v"] == pytest.approx(1 - 1.5 * t, abs=1e-5)
    assert run["x"] == pytest.approx(t - 0.75 * t**2, abs=1e-5)


def test_chattering_relation_slides_instead_of_hanging():
    fmu = cached_fmu(
        source(
            "model T Real v(start = 1, fixed = true);"
            " equation der(v) = 0.5 - (if v > 0 then 2 else -2); end T;"
        )
    )
    run = simulate(fmu, stop=2.0, step=0.1, outputs=["v"])
    assert run["v"] == pytest.approx(np.maximum(1 - 1.5 * run.time, 0.0), abs=1e-5)


def test_events_that_never_settle_are_reported():
    endless = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); discrete Real a(start = 0, fixed = true);"
            " discrete Real b(start = 0, fixed = true);"
            " equation der(x) = 1; when {x > 0.5, a > b} then b = pre(a) + 1; end when;"
            " when b > a then a = pre(b) + 1; end when; end T;"
        )
    )
    with pytest.raises(FmuError, match="do not settle"):
        simulate(endless, stop=1.0, step=0.1, outputs=["x"])


@kinds
def test_delayed_smooth_signal(kind, fmi):
    """der(x) = cos(t), y(t) = x(t - 0.3): a sine, late."""
    fmu = cached_fmu(
        source(
            "model T parameter Real T0 = 0.3; Real x(start = 0, fixed = true); output Real y;"
            " equation der(x) = cos(time); y = delay(x, T0, 1.0); end T;"
        ),
        fmi=fmi,
    )
    assert validate_fmu(str(fmu)) == []
    for step in (0.01, 0.5):
        if kind == "ModelExchange" and step == 0.5:
            continue  # an importer that reports its steps so rarely leaves nothing to interpolate
        run = simulate(fmu, stop=5.0, step=step, kind=kind)
        expected = np.where(run.time > 0.3, sin(run.time - 0.3), 0.0)
        assert run["y"] == pytest.approx(expected, abs=1e-6)


@kinds
def test_delay_in_a_loop(kind, fmi):
    """x' = -x(t - 1), x = 1 before the start: polynomials piece by piece (method of steps)."""
    fmu = cached_fmu(
        source("model T Real x(start = 1, fixed = true); equation der(x) = -delay(x, 1.0); end T;"),
        fmi=fmi,
    )
    run = simulate(fmu, stop=3.0, step=0.02, kind=kind, outputs=["x"])
    t = run.time
    expected = 1 - t
    expected = expected + np.where(t > 1, (t - 1) ** 2 / 2, 0)
    expected = expected - np.where(t > 2, (t - 2) ** 3 / 6, 0)
    assert run["x"] == pytest.approx(expected, abs=1e-6)


def test_delay_much_longer_than_what_is_remembered_densely():
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); output Real y;"
            " equation der(x) = cos(time); y = delay(x, 8.0); end T;"
        )
    )
    run = simulate(fmu, stop=10.0, step=0.001)  # 8000 steps are more than there is room for
    assert run["y"] == pytest.approx(np.where(run.time > 8, sin(run.time - 8), 0.0), abs=1e-6)


def test_delay_shorter_than_the_steps():
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); output Real y;"
            " equation der(x) = cos(time); y = delay(x, 1e-5); end T;"
        )
    )
    run = simulate(fmu, stop=1.0, step=0.1)
    assert run["y"][1:] == pytest.approx(sin(run.time[1:] - 1e-5), abs=1e-9)


@kinds
def test_initial_equations(kind, fmi):
    """Steady state at the start: der(x) = 0 gives x = u/k, a nonlinear one is solved too."""
    fmu = cached_fmu(
        source(
            "model T parameter Real k = 4; parameter Real u = 2; Real x; Real y(start = 1);"
            " Real z(start = 0.3, fixed = true); Real w;"
            " initial equation der(x) = 0; y^3 = 8;"
            " equation der(x) = u - k * x; der(y) = -y; w = 2 * z; der(z) = -z; end T;"
        ),
        fmi=fmi,
    )
    assert validate_fmu(str(fmu)) == []
    run = simulate(
        fmu, stop=1.0, step=0.1, kind=kind, outputs=["x", "y", "w"], parameters={"u": 3.0}
    )
    assert run["x"] == pytest.approx(np.full(11, 0.75), abs=1e-9)
    assert run["y"] == pytest.approx(2 * exp(-run.time), abs=1e-6)
    assert run["w"] == pytest.approx(0.6 * exp(-run.time), abs=1e-6)


@kinds
def test_fixed_start_of_a_variable_that_is_no_state(kind, fmi):
    fmu = cached_fmu(
        source(
            "model T Real x; Real y(start = 6, fixed = true);"
            " equation der(x) = -x; y = 2 * x + 1; end T;"
        ),
        fmi=fmi,
    )
    run = simulate(fmu, stop=1.0, step=0.1, kind=kind, outputs=["x"])
    assert run["x"] == pytest.approx(2.5 * exp(-run.time), abs=1e-6)


def test_period_of_a_large_swing_is_right():
    """An energy check over 100 s that step control cannot pass by luck."""
    fmu = cached_fmu(
        source(
            "model T Real q(start = 3, fixed = true); Real w(start = 0, fixed = true);"
            " output Real E = w^2 / 2 - cos(q);"
            " equation der(q) = w; der(w) = -sin(q); end T;"
        )
    )
    run = simulate(fmu, stop=100.0, step=0.5)
    assert run["E"] == pytest.approx(np.full(run.time.size, -np.cos(3.0)), abs=2e-6)
    assert pi > 3


@kinds
def test_stick_and_slip_under_a_slow_force(kind, fmi):
    """A block with dry friction under A·sin(t): a stick-slip automaton in closed form."""
    fmu = cached_fmu(
        source(
            "model T parameter Real A = 2; parameter Real c = 1.2;"
            " Real x(start = 0, fixed = true); Real v(start = 0, fixed = true);"
            " output Real friction;"
            " equation der(x) = v; friction = c * sign(v); der(v) = A * sin(time) - friction;"
            " end T;"
        ),
        fmi=fmi,
    )
    run = simulate(fmu, stop=6.0, step=0.05, kind=kind, outputs=["v", "friction"])
    amplitude, c = 2.0, 1.2
    leaves = np.arcsin(c / amplitude)  # the force reaches the friction

    def speed(t, sign_of_force, begin):
        return sign_of_force * (amplitude * abs(np.cos(begin) - np.cos(t)) - c * (t - begin))

    stops = brentq(lambda t: speed(t, 1, leaves), leaves + 0.5, 4.0)
    assert amplitude * abs(np.sin(stops)) < c, "it sticks before it goes back"
    again = pi + leaves
    stops_again = brentq(lambda t: speed(t, -1, again), again + 0.5, again + 3.3)
    for t, v, friction in zip(run.time, run["v"], run["friction"], strict=True):
        if leaves < t < stops:
            assert v == pytest.approx(speed(t, 1, leaves), abs=1e-6)
            assert friction == c
        elif again < t < stops_again:
            assert v == pytest.approx(speed(t, -1, again), abs=1e-6)
            assert friction == -c
        else:
            assert v == pytest.approx(0.0, abs=1e-6)
            assert friction == pytest.approx(amplitude * np.sin(t), abs=1e-4), t


def test_two_bodies_stick_at_once():
    """Coupled masses, both with dry friction, against a steep smooth law and a stiff solver."""
    fmu = cached_fmu(
        source(
            "model T Real a(start = 0.5, fixed = true); Real v(start = 0, fixed = true);"
            " Real b(start = 0, fixed = true); Real w(start = 0, fixed = true);"
            " equation der(a) = v; der(b) = w; der(v) = -8 * (a - b) - 0.9 * sign(v);"
            " der(w) = 8 * (a - b) - 3 * b - 0.5 * sign(w); end T;"
        )
    )
    run = simulate(fmu, stop=6.0, step=0.1, outputs=["a", "b", "v", "w"])
    width = 1e-5

    def rhs(_, x):
        a, v, b, w = x
        return [
            v,
            -8 * (a - b) - 0.9 * np.tanh(v / width),
            w,
            8 * (a - b) - 3 * b - 0.5 * np.tanh(w / width),
        ]

    smooth = solve_ivp(
        rhs, (0, 6), [0.5, 0, 0, 0], method="Radau", t_eval=run.time, rtol=1e-8, atol=1e-10
    )
    assert run["a"] == pytest.approx(smooth.y[0], abs=2e-4)
    assert run["b"] == pytest.approx(smooth.y[2], abs=2e-4)
    assert run["v"][-1] == pytest.approx(0.0, abs=1e-8)
    assert run["w"][-1] == pytest.approx(0.0, abs=1e-8)
