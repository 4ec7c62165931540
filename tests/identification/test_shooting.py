"""Windowed simulation against DOP853, and its derivatives against differences of simulations."""

import numpy as np
import pytest
import truth_records as truth
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from fmus.frontend import load
from fmus.sources import ModelicaSource
from foundation.errors import UnsupportedModelError
from identification.discovery.extension import extend, parse_addition
from identification.shooting import Shooting

N, STEP = 1500, 1e-3


def shooting_of(source, outputs, sensitive=()):
    return Shooting(load(source), outputs, sensitive)


def declared(shooting, **changes):
    dae = shooting.dae
    values = {name: dae.parameter_values[name] for name in shooting.parameter_names}
    for name, value in changes.items():
        assert name in values
        values[name] = value
    return values


def run(shooting, x0, inputs, values, step=STEP, *, sensitivities=False):
    p = shooting.parameter_vector(values)
    columns = shooting.inputs_with_delays(np.asarray(inputs).reshape(len(inputs), -1), step, p)
    return shooting.run(np.array(x0, float), columns, p, step, sensitivities=sensitivities)


PLANTS = {
    "Pendulum": (
        ("theta", "omega"),
        truth.pendulum_rates(),
        truth.swing(N, STEP),
        [0.4, -0.5],
    ),
    "Positioner": (("q", "v"), truth.positioner_rates(), truth.shuttle(N, STEP), [0.01, 0.1]),
    "WheeledPendulum": (
        ("theta_w", "theta_p", "omega_w", "omega_p"),
        truth.wheeled_rates(),
        2 * np.sin(40 * np.arange(400) * STEP),
        [0.1, 0.05, 0.5, -0.2],
    ),
}


@pytest.mark.parametrize("name", PLANTS)
def test_outputs_are_those_of_dop853(name):
    outputs, rates, inputs, start = PLANTS[name]
    response = run(s := shooting_of(truth.library(name), outputs), start, inputs, declared(s))
    states = truth.held(rates, start, inputs, STEP, rtol=1e-12, atol=1e-14)
    assert response.finite == len(inputs)
    assert np.ptp(states, axis=0).min() > 0.01
    np.testing.assert_allclose(response.outputs, states, rtol=0, atol=2e-9)


@pytest.mark.parametrize("step", [0.25e-3, 1e-3, 1.4e-3, 5e-3, 20e-3])
def test_long_sample_intervals_are_divided(step):
    """The voltage is held for 20 ms; the error stays that of 1 ms steps however coarse the log."""
    s = shooting_of(truth.library("Positioner"), ("q", "v"))
    inputs = truth.shuttle(100, step)
    states = truth.held(truth.positioner_rates(), [0, 0], inputs, step)
    response = run(s, [0, 0], inputs, declared(s), step)
    np.testing.assert_allclose(response.outputs, states, rtol=0, atol=1e-10)


def test_steps_are_never_longer_than_a_millisecond():
    """Friction as steep as 800/s per unit: steps of 1.4 ms would be unstable near standstill."""
    s = shooting_of(
        truth.own(
            "model A parameter Real k = 2000; input Real u; output Real y(start = 1, fixed = true);"
            " equation der(y) = u - k * y; end A;"
        ),
        ("y",),
    )
    response = run(s, [1.0], np.zeros(400), declared(s), 1.4e-3)
    assert abs(response.outputs[-1, 0]) < 1e-6


def test_dry_friction_agrees_with_dop853():
    rates = truth.pendulum_rates(coulomb=0.3)
    source = truth.library("Pendulum")
    model = extend(source, [parse_addition("CoulombFriction@joint,tau_c=0.3", source)])
    s = shooting_of(model.source, ("theta", "omega"))
    inputs = truth.swing(N, STEP)
    states = truth.held(rates, [0.4, -0.5], inputs, STEP)
    response = run(s, [0.4, -0.5], inputs, declared(s))
    np.testing.assert_allclose(response.outputs, states, rtol=0, atol=1e-6)


def differences(shooting, x0, inputs, values, step, sizes):
    """Central differences of the simulation: (n, ny, nx + ns)."""
    x0 = np.array(x0, float)
    columns = []
    for i in range(len(x0)):
        move = np.zeros(len(x0))
        move[i] = 1e-6
        ends = [run(shooting, x0 + sign * move, inputs, values, step) for sign in (1, -1)]
        columns.append((ends[0].outputs - ends[1].outputs) / 2e-6)
    for name in shooting.sensitive:
        size = sizes.get(name, 1e-6 * max(1.0, abs(values[name])))
        ends = [
            run(shooting, x0, inputs, {**values, name: values[name] + sign * size}, step)
            for sign in (1, -1)
        ]
        columns.append((ends[0].outputs - ends[1].outputs) / (2 * size))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("name", PLANTS)
def test_sensitivities_are_those_of_central_differences(name):
    outputs, _, inputs, start = PLANTS[name]
    source = truth.library(name)
    # Where no torque acts on a point, its scale (alpha) has no effect.
    values = load(source).parameter_values
    free = tuple(n for n in values if not n.endswith("_start") and n != "alpha")
    s = shooting_of(source, outputs, free)
    found = run(s, start, inputs, declared(s), sensitivities=True)
    expected = differences(s, start, inputs, declared(s), STEP, {})
    scale = np.max(np.abs(expected), axis=(0, 1))
    assert np.all(scale > 0), "a parameter without effect tests nothing"
    np.testing.assert_allclose(found.sensitivities / scale, expected / scale, rtol=0, atol=1e-6)


def test_sensitivities_are_those_of_dop853_differences():
    """Both the simulation and its derivative, against differences of somebody else's solver."""
    inputs, start = truth.swing(800, 2e-3), [0.4, -0.5]
    s = shooting_of(truth.library("Pendulum"), ("theta",), ("J", "mgl", "d"))
    found = run(s, start, inputs, declared(s), 2e-3, sensitivities=True)
    for k, (name, value) in enumerate(truth.PENDULUM.items()):
        size = 1e-4 * value
        ends = [
            truth.held(truth.pendulum_rates(**{name: value + sign * size}), start, inputs, 2e-3)
            for sign in (1, -1)
        ]
        expected = (ends[0] - ends[1])[:, 0] / (2 * size)
        error = np.abs(found.sensitivities[:, 0, 2 + k] - expected)
        assert error.max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("addition", "parameter", "value", "size"),
    [
        # Absent, at its default: what the score test relies on.
        ("CoulombFriction@joint", "coulombFriction_joint.tau_c", 0.0, 1e-7),
        ("QuadraticDrag@joint", "quadraticDrag_joint.c", 0.0, 1e-7),
        ("Offset@theta", "offset_theta.b", 0.0, 1e-6),
        ("Gain@tau", "gain_tau.k", 0.0, 1e-6),
        ("Delay@tau", "delay_tau.T", 0.0, 1e-6),
        ("FirstOrderLag@tau", "firstOrderLag_tau.T", 0.0, 1e-6),
        ("Delay@theta", "delay_theta.T", 0.0, 1e-6),
        # Present.
        ("Delay@theta", "delay_theta.T", 0.0137, 1e-6),
        ("Delay@tau", "delay_tau.T", 0.0137, 1e-6),
        ("FirstOrderLag@tau", "firstOrderLag_tau.T", 0.02, 1e-6),
        ("StribeckFriction@joint,tau_s=0.2", "stribeckFriction_joint.w_s", 0.6, 1e-6),
        ("DeadZone@tau", "deadZone_tau.w", 0.3, 1e-7),
    ],
)
def test_sensitivities_to_effects(addition, parameter, value, size):
    source = truth.library("Pendulum")
    model = extend(source, [parse_addition(addition, source)])
    dae = model.dae
    name = parameter if parameter in dae.parameter_values else f"plant.{parameter}"
    s = Shooting(dae, ("theta", "omega"), (name,))
    start = np.zeros(s.nx)
    start[s.state_names.index(next(n for n in s.state_names if n.endswith("theta")))] = 0.4
    inputs = truth.swing(1000, STEP)
    values = declared(s, **{name: value})
    found = run(s, start, inputs, values, sensitivities=True)
    expected = differences(s, start, inputs, values, STEP, {name: size})
    scale = np.max(np.abs(expected[:, :, -1]))
    assert scale > 1e-3
    # A kink that a difference straddles, and a slope between samples, cost a few digits.
    np.testing.assert_allclose(
        found.sensitivities[:, :, -1] / scale, expected[:, :, -1] / scale, rtol=0, atol=5e-3
    )


@pytest.mark.parametrize("delay", [0.0042, 0.010, 0.0333])
def test_a_delayed_input_agrees_with_dop853(delay):
    """The held staircase itself is delayed, so the plant sees its edges between samples."""
    source = truth.library("Pendulum")
    model = extend(source, [parse_addition(f"Delay@tau,T={delay}", source)])
    step = 2e-3
    s = Shooting(model.dae, ("theta", "omega"), ())
    inputs = truth.swing(1500, step)
    fine = 20  # every edge falls on a multiple of 0.1 ms
    times = np.arange(len(inputs) * fine) * step / fine
    late = np.clip(np.floor((times - delay) / step + 1e-9).astype(int), 0, None)
    states = truth.held(truth.pendulum_rates(), [0.4, -0.5], inputs[late], step / fine)[::fine]
    response = run(s, [0.4, -0.5], inputs, declared(s), step)
    # What half a sample of delay more or less would do:
    other = np.clip(np.floor((times - delay - step / 2) / step + 1e-9).astype(int), 0, None)
    half = truth.held(truth.pendulum_rates(), [0.4, -0.5], inputs[other], step / fine)[::fine]
    resolution = np.abs(half - states).max(axis=0)
    error = np.abs(response.outputs - states).max(axis=0)
    assert np.all(error < 0.05 * resolution), error / resolution


@pytest.mark.parametrize("delay", [0.0042, 0.010, 0.0333])
def test_a_delayed_output_agrees_with_dop853(delay):
    """Beside another fault of the sensor, which acts on the signal that is delayed."""
    source = truth.library("Pendulum")
    texts = [f"Delay@theta,T={delay}", "Gain@theta,k=0.1", "Delay@omega,T=0.02", "Offset@omega,b=1"]
    model = extend(source, [parse_addition(text, source) for text in texts])
    step = 2e-3
    free = ("J", "gain_theta.k", "delay_theta.T", "delay_omega.T")
    s = Shooting(model.dae, ("theta", "omega"), free)
    inputs = truth.swing(1500, step)
    fine = 20  # every delay is a multiple of 0.1 ms
    held = np.repeat(inputs, fine)
    states = truth.held(truth.pendulum_rates(), [0.4, -0.5], held, step / fine)
    response = run(s, [0.4, -0.5], inputs, declared(s), step)
    for k, (late, scale, offset) in enumerate([(delay, 1.1, 0.0), (0.02, 1.0, 1.0)]):
        shift = round(late / step * fine)
        expected = scale * np.concatenate([np.full(shift, np.nan), states[: -shift or None, k]])
        expected = expected[::fine] + offset
        error = np.abs(response.outputs[:, k] - expected)
        without = np.abs(scale * states[::fine, k] + offset - expected)
        assert np.nanmax(error) < 0.01 * np.nanmax(without)
        # What was before is guessed from the beginning.
        assert np.abs(response.outputs[0, k] - scale * (states[0, k]) - offset) < 0.1
    found = run(s, [0.4, -0.5], inputs, declared(s), step, sensitivities=True)
    values = declared(s)
    expected = differences(s, [0.4, -0.5], inputs, values, step, dict.fromkeys(free, 1e-6))
    scale = np.max(np.abs(expected), axis=(0, 1))
    error = np.max(np.abs(found.sensitivities[:, :, -4:] - expected[:, :, -4:]), axis=(0, 1))
    assert np.all(error < 5e-3 * scale[-4:])


def test_a_delay_that_the_plant_feels_is_refused():
    source = ModelicaSource(
        "model Echo parameter Real T = 0.1; output Real x(start = 1, fixed = true); equation "
        "der(x) = -delay(x, T, 1.0); end Echo;",
        *("Echo", "echo.mo", "Echo"),
    )
    with pytest.raises(UnsupportedModelError, match="acts on it"):
        Shooting(load(source), ("x",), ())


@pytest.mark.parametrize("delay", [0.0, 0.013])
def test_a_measured_input_runs_in_straight_lines(delay):
    """Unlike a command, also through a delay: a coarse record of a smooth torque is not a stair."""
    step = 10e-3
    inputs = truth.swing(150, step)
    model = extend(
        truth.library("Pendulum"), [parse_addition("Delay@tau", truth.library("Pendulum"))]
    )
    s = Shooting(model.dae, ("theta", "omega"), (), measured_inputs=["tau"])
    values = declared(s, **{"delay_tau.T": delay})
    found = run(s, [0.4, -0.5], inputs, values, step).outputs
    time = step * np.arange(len(inputs))
    J, mgl, d = (values[f"{name}"] for name in ("J", "mgl", "d"))

    def rates(t, x):
        tau = np.interp(t - delay, time, inputs)
        return [x[1], (tau - mgl * np.sin(x[0]) - d * x[1]) / J]

    solved = solve_ivp(
        rates, (0, time[-1]), [0.4, -0.5], "DOP853", time, rtol=1e-10, atol=1e-12, max_step=step / 2
    )
    stairs = run(Shooting(model.dae, ("theta", "omega"), ()), [0.4, -0.5], inputs, values, step)
    error = np.abs(found - solved.y.T).max(axis=0)
    # A delayed line is again a line between samples, which cuts its corners.
    assert np.all(error < (1e-6 if delay == 0 else 2e-3))
    assert np.all(error < 0.15 * np.abs(stairs.outputs - solved.y.T).max(axis=0))


def test_a_sensors_filter_begins_where_its_signal_leads_it():
    """Its start is not free: in the middle of a motion it is that of the filter that saw it all."""
    source = truth.library("Pendulum")
    lag, begin = 0.02, 700
    model = extend(source, [parse_addition(f"FirstOrderLag@theta,T={lag}", source)])
    inputs = truth.swing(N, STEP)
    states = truth.held(truth.pendulum_rates(), [0.4, -0.5], inputs, STEP)
    share = -np.expm1(-STEP / lag)
    # First-order hold of the angle: what reaches the filter between samples.
    middle = (states[1:, 0] + states[:-1, 0]) / 2
    filtered = np.concatenate(
        [[0.4], lfilter([share], [1, share - 1], middle, zi=[0.4 * (1 - share)])[0]]
    )
    free = ("J", "mgl", "firstOrderLag_theta.T")
    s = Shooting(model.dae, ("theta",), free, following=["firstOrderLag_theta.x"])
    x0 = np.zeros(3)
    for name, value in (("theta", states[begin, 0]), ("omega", states[begin, 1])):
        where = [k for k, n in enumerate(s.state_names) if n.rpartition(".")[2] == name]
        x0[where] = value
    values = declared(s)
    response = run(s, x0, inputs[begin:], values, sensitivities=True)
    ideal = truth.held(truth.pendulum_rates(), states[begin], inputs[begin:], STEP)[:, 0]
    error = np.abs(response.outputs[:, 0] - filtered[begin:])
    # The signal is bent: T²·d²u/dt² is left of it, and forgotten after a few T.
    bend = np.abs(np.gradient(np.gradient(states[:, 0], STEP), STEP)[begin])
    assert abs(ideal[0] - filtered[begin]) > 1.5 * lag**2 * bend
    assert error[0] == pytest.approx(lag**2 * bend, rel=0.3)
    assert error[200:].max() < 1e-4 * np.ptp(ideal)
    assert not response.sensitivities[:, :, s.state_names.index("firstOrderLag_theta.x")].any()
    for k, name in enumerate(free):
        step = 1e-5 * values[name]
        high, low = (
            run(s, x0, inputs[begin:], {**values, name: values[name] + sign * step}).outputs
            for sign in (1, -1)
        )
        found = response.sensitivities[:, :, s.nx + k]
        difference = (high - low) / (2 * step)
        np.testing.assert_allclose(found, difference, atol=1e-5 * np.abs(difference).max())


def test_a_window_that_diverges_says_where():
    """x' = x² from 1 escapes at t = 1."""
    s = shooting_of(
        truth.own(
            "model A input Real u; output Real y(start = 1, fixed = true); "
            "equation der(y) = y * y + u; end A;"
        ),
        ("y",),
    )
    response = run(s, [1.0], np.zeros(2000), {}, sensitivities=True)
    assert 990 < response.finite < 1010
    assert np.all(np.isfinite(response.outputs[: response.finite]))
    assert np.all(np.isnan(response.outputs[response.finite :]))


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        (
            "model A input Real u; output Real y(start = 1, fixed = true); "
            "equation der(y) = u; when y < 0 then reinit(y, 1); end when; end A;",
            "smooth",
        ),
        (
            "model A input Real u; output Real y(start = 1, fixed = true); "
            "equation der(y) = u - delay(y, 0.1); end A;",
            "at an input",
        ),
        (
            "model A input Real u; output Real y(start = 1, fixed = true); "
            "equation der(y) = delay(u, 0.1 + 0.01 * abs(u), 1.0) - y; end A;",
            "parameter",
        ),
        (
            "model A parameter Real k = 2; input Real u; output Real y(start = 1, fixed = true); "
            "equation der(y) = delay(k * u, 0.1) - y; end A;",
            "after the delay",
        ),
    ],
)
def test_models_without_sensitivities_are_refused(text, remedy):
    dae = load(truth.own(text))
    free = tuple(n for n in ("k",) if n in dae.parameter_values)
    with pytest.raises(UnsupportedModelError) as caught:
        Shooting(dae, ("y",), free)
    assert remedy in caught.value.remedy


def test_a_delayed_signal_of_known_parameters_is_no_obstacle():
    dae = load(
        truth.own(
            "model A parameter Real k = 2; input Real u; output Real y(start = 0, fixed = true); "
            "equation der(y) = delay(k * u, 0.1) - y; end A;"
        )
    )
    s = Shooting(dae, ("y",), ())
    response = run(s, [0.0], np.ones(4000), declared(s))
    np.testing.assert_allclose(response.outputs[-1, 0], 2 * (1 - np.exp(-4)), atol=1e-3)


def test_a_model_without_states_is_simulated():
    s = shooting_of(
        truth.own(
            "model A parameter Real k = 2; input Real u; output Real y; equation y = k * u; end A;"
        ),
        ("y",),
        ("k",),
    )
    response = run(s, [], np.arange(5.0), declared(s), sensitivities=True)
    np.testing.assert_array_equal(response.outputs[:, 0], 2 * np.arange(5.0))
    np.testing.assert_array_equal(response.sensitivities[:, 0, 0], np.arange(5.0))


def test_sensitivities_scale_with_units():
    """The same pendulum in degrees: outputs and derivatives are 180/π times as large."""
    text = """model A
      parameter Real J = 0.185; parameter Real mgl = 3.61;
      input Real tau; output Real theta(start = 0, fixed = true);
      Real omega(start = 0, fixed = true);
    equation
      der(theta) = omega;
      J * der(omega) = {a} * tau - {a} * mgl * sin(theta / {a});
    end A;"""
    inputs = truth.swing(500, STEP)
    found = []
    for factor in (1.0, 180 / np.pi):
        s = shooting_of(truth.own(text.format(a=repr(float(factor)))), ("theta",), ("J", "mgl"))
        found.append(run(s, [0.3 * factor, 0.0], inputs, declared(s), sensitivities=True))
    ratio = 180 / np.pi
    np.testing.assert_allclose(found[1].outputs, ratio * found[0].outputs, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        found[1].sensitivities[:, :, 2:], ratio * found[0].sensitivities[:, :, 2:], atol=1e-9
    )
