"""Noise in the regressors: what least squares makes of it, and estimators that allow for it."""

import numpy as np
import pytest
import truth_records as truth
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import make_demo_recording as rig
from foundation.errors import ExcitationError
from identification.estimators import estimator
from identification.estimators.bias_compensated import BiasCompensated
from identification.estimators.delayed_instruments import DelayedInstruments
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.estimators.simulated_instruments import SimulatedInstruments
from identification.estimators.total_least_squares import TotalLeastSquares
from identification.output_filter import OutputFilter

SD = [2 * np.pi / 60_000 / np.sqrt(12), np.radians(0.5), np.radians(0.5)]


@pytest.fixture(scope="module")
def open_loop():
    """Twelve seeds of a pendulum that nobody controls, its angle alone recorded, noisily."""
    clean = truth.pendulum_problem(20.0, 2e-3, wrong=1.2)
    return [truth.noisy(clean, [0.02], seed) for seed in range(12)]


def estimates(method, problems):
    found = [method.estimate(p) for p in problems]
    values = np.array([[e.values[n] for n in truth.PENDULUM] for e in found])
    sd = np.array([[e.parameters[n].sd for n in truth.PENDULUM] for e in found])
    return values / list(truth.PENDULUM.values()) - 1, sd / list(truth.PENDULUM.values()), found


TAU = (0.06, 0.06)


def test_least_squares_is_biased_and_the_others_are_not(open_loop):
    inertia = {}
    for method in (FilteredLeastSquares, BiasCompensated, TotalLeastSquares, DelayedInstruments):
        error, sd, _ = estimates(method(tau=TAU), open_loop)
        inertia[method] = float(np.mean(error[:, 0]))
        if method is not FilteredLeastSquares:
            off = np.abs(np.mean(error, axis=0)) / (np.std(error, axis=0) / np.sqrt(len(error)))
            assert np.all(off[:2] < 4), method
            assert np.mean(np.abs(error[:, :2]) < 2 * sd[:, :2]) > 0.8, method
    assert abs(inertia[FilteredLeastSquares]) > 0.02
    for method in (BiasCompensated, TotalLeastSquares, DelayedInstruments):
        assert abs(inertia[method]) < 0.2 * abs(inertia[FilteredLeastSquares])


def test_total_least_squares_finds_the_noise_it_was_not_told(open_loop):
    """The sensor is four times as noisy as stated."""
    told = [truth.replace(p, noise_sd=p.noise_sd / 4) for p in open_loop[:6]]
    error, _, found = estimates(TotalLeastSquares(tau=TAU), told)
    assert np.median([e.details["noise_scale"] for e in found]) == pytest.approx(16, rel=0.15)
    assert abs(np.mean(error[:, 0])) < 0.01
    wrong, _, _ = estimates(BiasCompensated(tau=TAU), told)
    assert abs(np.mean(wrong[:, 0])) > 0.01


@pytest.mark.parametrize("method", [DelayedInstruments(), SimulatedInstruments(iterations=2)])
def test_instruments_serve_in_closed_loop(method):
    """The wheeled pendulum under the paper's controller, which works on the noisy pitch."""
    run = rig.simulate({}, seed=3, duration=12.0)
    names = ("theta_w", "theta_p", "omega_p")
    outputs = np.column_stack([run.channels[n] for n in names])
    given = truth.problem(
        truth.library("WheeledPendulum"),
        run.channels["V"],
        outputs,
        1e-3,
        names=names,
        sd=SD,
        wrong=1.3,
    )
    found = method.estimate(given)
    for name, value in truth.X.items():
        p = found.parameters[name]
        assert abs(p.value - value) < 3 * p.sd, name
    for name in ("X4", "X5", "X6", "X7"):
        assert found.values[name] == pytest.approx(truth.X[name], rel=0.02), name


def test_more_noise_than_motion_is_refused():
    clean = truth.pendulum_problem(4.0, 2e-3)
    drowned = truth.noisy(clean, [3.0], 1)
    told = truth.replace(drowned, noise_sd=np.array([4.0]))
    with pytest.raises(ExcitationError, match="noise") as caught:
        estimator("bias-compensated").estimate(told)
    assert "output-error" in caught.value.remedy


@settings(max_examples=30, deadline=None)
@given(st.floats(0.02, 2.0), st.floats(0.02, 2.0), st.integers(0, 2), st.integers(0, 2**32 - 1))
def test_backwards_is_the_mirror_image(tau1, tau2, order, seed):
    """Run from the end, the filter answers to a mirrored motion with the mirrored answer."""
    values = np.cumsum(np.random.default_rng(seed).standard_normal(200))
    low = OutputFilter(tau1, tau2, 0.01)
    ends = np.append(values[1:], values[-1])
    forwards = low.apply(values[::-1].copy(), order=order)[::-1]
    backwards = low.apply_backwards(values, ends, order=order)
    # d/dt changes its sign in the mirror.
    np.testing.assert_allclose(backwards, forwards * (-1) ** order, atol=1e-9 / tau1 / tau2)


def test_backwards_a_held_signal_is_held_over_the_same_intervals():
    """An input that is one from sample 5 to sample 6 only; known answer of one section pair."""
    low = OutputFilter(0.5, 0.5, 0.1)
    held = np.zeros(20)
    held[5] = 1.0
    answer = low.apply_backwards(held, held, order=0)
    assert np.all(answer[6:] == 0)
    t = (0.6 - 0.1 * np.arange(6)) / 0.5
    step = 1 - (1 + t) * np.exp(-t)
    later = np.where(t > 0.2, t - 0.2, 0.0)
    expected = step - (1 - (1 + later) * np.exp(-later))
    np.testing.assert_allclose(answer[:6], expected, atol=1e-12)
