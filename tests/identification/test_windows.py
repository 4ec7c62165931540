"""Where windows begin and end, and the state that each begins in."""

from dataclasses import replace

import numpy as np
import pytest
import truth_records as truth
from hypothesis import given
from hypothesis import strategies as st

from identification.experiment import Experiment
from identification.shooting import Shooting
from identification.windows import Window, cut, guess_states, settle, settling_samples


@given(
    n=st.integers(2, 5000),
    sample_time=st.floats(1e-5, 10),
    horizon=st.none() | st.floats(1e-4, 100),
)
def test_windows_hold_every_sample_once(n, sample_time, horizon):
    windows = cut(n, sample_time, horizon)
    assert [k for w in windows for k in range(w.begin, w.end)] == list(range(n))
    assert all(len(w) >= 2 for w in windows)


@given(n=st.integers(50, 5000), length=st.integers(4, 500))
def test_windows_are_as_long_as_asked(n, length):
    windows = cut(n, 0.5, 0.5 * length)
    if n < length:
        assert len(windows) == 1
        return
    assert all(len(w) == length for w in windows[:-1])
    assert length / 2 <= len(windows[-1]) < 1.5 * length


@given(begin=st.integers(0, 100), length=st.integers(2, 5000))
def test_settling_leaves_something_to_score(begin, length):
    samples = settling_samples(Window(begin, begin + length))
    assert 1 <= samples <= length // 2
    if length >= 160:
        assert samples == round(0.1 * length)


def test_states_are_guessed_from_a_known_motion():
    """Positions measured; the rates are slopes of what is measured."""
    step = 1e-3
    t = np.arange(3000) * step
    motion = np.column_stack([0.3 * np.sin(2 * t) + t, 0.1 * np.cos(3 * t)])
    rates = np.column_stack([0.6 * np.cos(2 * t) + 1, -0.3 * np.sin(3 * t)])
    problem = truth.problem(
        truth.library("WheeledPendulum"), 0 * t, motion, step, names=("theta_w", "theta_p")
    )
    shooting = Shooting(problem.dae, problem.output_names, ())
    windows = cut(len(t), step, 0.5)
    guessed = guess_states(problem, shooting, windows)
    at = [w.begin for w in windows]
    columns = [shooting.state_names.index(n) for n in ("theta_w", "theta_p")]
    np.testing.assert_allclose(guessed[:, columns], motion[at], atol=1e-5)
    columns = [shooting.state_names.index(n) for n in ("omega_w", "omega_p")]
    np.testing.assert_allclose(guessed[:, columns], rates[at], atol=2e-3)


def test_a_measured_rate_is_preferred_to_a_slope():
    problem = truth.pendulum_problem(outputs=("theta", "omega"))
    wrong = replace(problem, outputs=problem.outputs + np.array([0.0, 5.0]))
    shooting = Shooting(problem.dae, problem.output_names, ())
    windows = cut(len(problem.time), problem.sample_time, 1.0)
    measured = wrong.outputs[[w.begin for w in windows], 1]
    guessed = guess_states(wrong, shooting, windows)
    np.testing.assert_allclose(guessed[:, 1], measured, atol=0.05)


def test_an_output_with_a_gain_is_seen_through_it():
    source = truth.own(
        "model A input Real u; Real x(start = 0, fixed = true); output Real y; "
        "equation der(x) = u; y = -4 * x; end A;"
    )
    problem = truth.problem(source, np.zeros(100), np.full(100, 2.0), 0.01, names=("y",))
    shooting = Shooting(problem.dae, ("y",), ())
    assert guess_states(problem, shooting, cut(100, 0.01, None))[0, 0] == pytest.approx(-0.5)


def test_an_unseen_state_starts_where_the_user_said():
    source = truth.own(
        "model A parameter Real z_start = 3; input Real u; output Real y(start = 0, fixed = true); "
        "Real z(start = z_start, fixed = true); equation der(y) = z - y; der(z) = u - z; end A;"
    )
    problem = truth.problem(
        source, np.zeros(100), np.zeros(100), 0.01, names=("y",), values={"z_start": 7.0}
    )
    shooting = Shooting(problem.dae, ("y",), ())
    guessed = guess_states(problem, shooting, cut(100, 0.01, None))
    assert guessed[0].tolist() == [pytest.approx(0.0), 7.0]


@pytest.mark.parametrize("seed", range(5))
def test_settling_finds_the_state_of_a_noise_free_window(seed):
    """Also from a guess that is far off, and for the state that is not measured."""
    volts, states = truth.balanced(1.5)
    problem = truth.problem(
        truth.library("WheeledPendulum"),
        volts,
        states[:, :2],
        1e-3,
        names=("theta_w", "theta_p"),
    )
    shooting = Shooting(problem.dae, problem.output_names, ())
    p = shooting.parameter_vector(problem.values)
    begin = 300
    wrong = states[begin] + np.random.default_rng(seed).normal(size=4) * [0.5, 0.2, 2, 1]
    found = settle(
        problem, shooting, Window(begin, 1300), 100, wrong, problem.inputs, p, np.full(2, 1e-4)
    )
    np.testing.assert_allclose(found, states[begin], atol=1e-6)


def test_settling_leaves_an_unseen_state_at_its_guess():
    source = truth.own(
        "model A input Real u; output Real y(start = 0, fixed = true); "
        "Real z(start = 0, fixed = true); equation der(y) = u - y; der(z) = u - z; end A;"
    )
    t = np.arange(200) * 0.01
    problem = truth.problem(source, 0 * t, 2 * np.exp(-t), 0.01, names=("y",))
    shooting = Shooting(problem.dae, ("y",), ())
    order = [shooting.state_names.index(n) for n in ("y", "z")]
    guess = np.zeros(2)
    guess[order] = [0.5, 9.0]
    found = settle(
        problem, shooting, Window(0, 200), 50, guess, problem.inputs, np.zeros(0), np.ones(1)
    )
    np.testing.assert_allclose(found[order], [2.0, 9.0], atol=1e-6)


def test_a_slow_plant_has_windows_that_say_something():
    """A sample every 2 s: a window of one second would hold nothing."""
    source = truth.own(
        "model A parameter Real T = 90; parameter Real k = 2; input Real u; "
        "output Real y(start = 0, fixed = true); equation T * der(y) = k * u - y; end A;"
    )
    n, step = 600, 2.0
    inputs = np.sign(np.sin(np.arange(n) * step / 100))
    states = truth.held(lambda _, x, u: [(2 * u - x[0]) / 90], [0.0], inputs, step)
    problem = truth.problem(source, inputs, states, step, names=("y",), wrong=1.5)
    experiment = Experiment.of(problem)
    assert all(len(w) >= 20 for w in experiment.windows)
    fit = experiment.fit_stages()[-1]
    assert fit.values["T"] == pytest.approx(90, rel=1e-6)
    assert fit.values["k"] == pytest.approx(2, rel=1e-6)
