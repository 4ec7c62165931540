"""The integrator of Co-Simulation: stiff models, relations that switch back, nothing allocated."""

import numpy as np
import pytest
from numpy import cos, sin
from reference_runs import source
from scipy.integrate import solve_ivp

from fmus.package import cached_fmu
from fmus.running import simulate

# Names of the states, their starts, Modelica equations, the same as a function, stop and step [s].
STIFF = {
    "fast follower, ratio 1e6": (
        ["x", "y"], [2.0, 0.0],
        "der(x) = -1e6*(x - cos(time)); der(y) = x - y;",
        lambda t, s: [-1e6 * (s[0] - cos(t)), s[0] - s[1]],
        10.0, 0.1,
    ),
    "Van der Pol, mu = 1000": (
        ["x", "y"], [2.0, 0.0],
        "der(x) = y; der(y) = 1000*(1 - x^2)*y - x;",
        lambda t, s: [s[1], 1000 * (1 - s[0] ** 2) * s[1] - s[0]],
        500.0, 5.0,
    ),
    "Robertson": (
        ["a", "b", "c"], [1.0, 0.0, 0.0],
        "der(a) = -0.04*a + 1e4*b*c; der(b) = 0.04*a - 1e4*b*c - 3e7*b^2; der(c) = 3e7*b^2;",
        lambda t, s: [
            -0.04 * s[0] + 1e4 * s[1] * s[2],
            0.04 * s[0] - 1e4 * s[1] * s[2] - 3e7 * s[1] ** 2,
            3e7 * s[1] ** 2,
        ],
        1000.0, 10.0,
    ),
}  # fmt: skip


def stiff_model(name):
    states, starts, equations, *_ = STIFF[name]
    declared = "".join(
        f" Real {s}(start = {x}, fixed = true);" for s, x in zip(states, starts, strict=True)
    )
    return cached_fmu(source(f"model T{declared} equation {equations} end T;"))


@pytest.mark.parametrize("name", STIFF)
def test_stiff_model(name):
    """An explicit method would need from a million to a hundred million evaluations here."""
    states, starts, _, rhs, stop, step = STIFF[name]
    run = simulate(stiff_model(name), stop=stop, step=step, outputs=states)
    reference = solve_ivp(
        rhs, (0, stop), starts, method="Radau", rtol=1e-11, atol=1e-13, t_eval=run.time
    )
    for row, state in enumerate(states):
        assert run[state] == pytest.approx(reference.y[row], rel=1e-6, abs=1e-7), state


def test_error_of_the_stiff_method_follows_the_tolerance():
    states, _, _, _, stop, step = STIFF["Robertson"]
    fmu = stiff_model("Robertson")
    reference = simulate(fmu, stop=stop, step=step, outputs=states, tolerance=1e-12)
    errors = [
        np.max(np.abs(simulate(fmu, stop=stop, step=step, outputs=["a"], tolerance=t)["a"]
                      - reference["a"]))
        for t in (1e-4, 1e-6, 1e-8)
    ]  # fmt: skip
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert errors[2] < 1e-8


def test_stiff_model_with_events_and_delays():
    """Fast first-order lag of a bouncing signal: the switched equation has a closed form."""
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); Real y(start = 0, fixed = true);"
            " output Real late = delay(y, 0.25);"
            " equation der(x) = 1e6*((if sin(2*3.141592653589793*time) > 0 then 1 else -1) - x);"
            " der(y) = x; end T;"
        )
    )
    run = simulate(fmu, stop=3.0, step=0.05, outputs=["y", "late"])

    def triangle(t):
        phase = np.mod(t, 1.0)
        return np.minimum(phase, 1 - phase)

    assert run["y"] == pytest.approx(triangle(run.time), abs=3e-6)
    late = np.where(run.time > 0.25, triangle(run.time - 0.25), 0.0)
    assert run["late"] == pytest.approx(late, abs=1e-5)


def test_method_returns_to_the_explicit_one():
    """A model that is stiff in its first second only, then oscillates for long."""
    fmu = cached_fmu(
        source(
            "model T Real z(start = 1, fixed = true); Real q(start = 1, fixed = true);"
            " Real w(start = 0, fixed = true);"
            " equation der(z) = (if time < 1 then -1e6 else -1)*(z - cos(time));"
            " der(q) = w; der(w) = -q; end T;"
        )
    )
    run = simulate(fmu, stop=50.0, step=0.5, outputs=["q", "z"])
    assert run["q"] == pytest.approx(cos(run.time), abs=1e-6)
    reference = solve_ivp(
        lambda t, z: -(z - cos(t)), (1, 50), [cos(1.0) + 1e-6 * sin(1.0)], rtol=1e-11, atol=1e-13,
        t_eval=run.time[2:],
    )  # fmt: skip
    assert run["z"][2:] == pytest.approx(reference.y[0], abs=1e-6)


# Relations that switch forth and back within a step


def test_short_pulse_within_a_long_step():
    """x integrates a pulse of 0.2 ms that lies anywhere in a step of a second."""
    fmu = cached_fmu(
        source(
            "model T parameter Real c = 0.5; Real x(start = 0, fixed = true);"
            " equation der(x) = if (1e4*(time - c))^2 < 1 then 1 else 0; end T;"
        )
    )
    for centre in (0.0503, 0.25, 0.4871, 0.77777, 0.99):
        run = simulate(fmu, stop=1.0, step=1.0, outputs=["x"], parameters={"c": centre})
        assert run["x"][-1] == pytest.approx(2e-4, rel=1e-6)


def test_grazing_trajectory():
    """A throw whose apex is above the line by 1e-8 for a moment."""
    fmu = cached_fmu(
        source(
            "model T parameter Real level = 0.49999999; Real h(start = 0, fixed = true);"
            " Real v(start = 1, fixed = true); discrete Real up(start = 0, fixed = true);"
            " discrete Real down(start = 0, fixed = true);"
            " equation der(h) = v; der(v) = -1;"
            " when h > level then up = time; end when; when h < level then down = time; end when;"
            " end T;"
        )
    )
    half = np.sqrt(2e-8)
    run = simulate(fmu, stop=2.0, step=2.0, outputs=["up", "down"])
    assert run["up"][-1] == pytest.approx(1 - half, abs=1e-5)
    assert run["down"][-1] == pytest.approx(1 + half, abs=1e-5)
    missed = simulate(fmu, stop=2.0, step=2.0, outputs=["up"], parameters={"level": 0.50001})
    assert missed["up"][-1] == 0.0


def test_indicator_much_faster_than_the_states():
    """Nothing in the states tells the integrator that sin(100 t) changes its sign."""
    fmu = cached_fmu(
        source(
            "model T Real x(start = 0, fixed = true); discrete Real n(start = 0, fixed = true);"
            " equation der(x) = 1; when sin(100 * time) > 0 then n = pre(n) + 1; end when; end T;"
        )
    )
    run = simulate(fmu, stop=10.0, step=10.0, outputs=["n"])
    assert run["n"][-1] == np.floor(10 * 100 / (2 * np.pi)) + 1
