"""Where a model fails: planted errors are found in time and in the state space."""

from functools import cache

import numpy as np
import pytest
import truth_records as truth

from identification.comparison import compare, observed_variables, whiteness
from identification.experiment import Experiment

STEP = 2e-3


@cache
def planted():
    """A pendulum that meets a soft stop of 2 N.m/rad beyond 0.9 rad, which the model lacks."""

    def rates(_, x, torque):
        stop = 2.0 * (x[0] - 0.9) if x[0] > 0.9 else 0.0
        return [x[1], (torque - 3.61 * np.sin(x[0]) - 0.006 * x[1] - stop) / 0.185]

    n = round(12 / STEP) + 1
    t = np.arange(n) * STEP
    # Large swings at first and last, small ones from 4 s to 8 s, where the stop is not met.
    size = np.where((t > 3) & (t < 8), 0.15, 1.0)
    torque = size * truth.swing(n, STEP) - 0.3 * np.sign(np.sin(4 * t)) * (size < 1)
    states = truth.held(rates, [0.3, 0.0], torque, STEP)
    noise = np.random.default_rng(2).standard_normal(n) * 1e-3
    problem = truth.problem(
        truth.library("Pendulum"), torque, states[:, 0] + noise, STEP, names=("theta",), sd=[1e-3]
    )
    experiment = Experiment.of(problem)
    prediction = experiment.predict(problem.values, 1.0)
    return problem, experiment, compare(problem, experiment.shooting, prediction), states


def test_the_worst_spans_are_where_the_error_was_planted():
    problem, _, comparison, states = planted()
    assert comparison.channels["theta"].rmse > 10e-3
    for failure in comparison.worst:
        span = (problem.time >= failure.begin) & (problem.time <= failure.end)
        before = (problem.time >= failure.begin - 1.0) & (problem.time <= failure.end)
        assert failure.channel == "theta"
        assert failure.rmse > comparison.channels["theta"].rmse
        # An error made at the stop stays until the next window begins.
        assert states[before, 0].max() > 0.9, (failure.begin, failure.end)
        assert span.sum() > 10


def test_the_region_of_a_failure_contains_its_samples():
    problem, experiment, comparison, _ = planted()
    variables = observed_variables(problem, experiment.shooting)
    for failure in comparison.worst:
        assert 1 <= len(failure.where) <= 2
        span = (problem.time >= failure.begin) & (problem.time <= failure.end)
        for name, (low, high) in failure.where.items():
            inside = np.mean((variables[name][span] >= low) & (variables[name][span] <= high))
            assert inside > 0.85
            assert low < high


def test_an_error_in_one_channel_and_one_second_is_found_there():
    """3° on the pitch between 2 s and 2.5 s: a sensor that stuck."""
    volts, states = truth.balanced(6.0)
    outputs = states[:, :2].copy()
    outputs[2000:2500, 1] += np.radians(3)
    problem = truth.problem(
        truth.library("WheeledPendulum"), volts, outputs, 1e-3, names=("theta_w", "theta_p")
    )
    experiment = Experiment.of(problem)
    prediction = experiment.predict(problem.values, 1.0, sd=np.array([1e-4, 1e-4]))
    comparison = compare(problem, experiment.shooting, prediction)
    first = comparison.worst[0]
    assert first.channel == "theta_p"
    assert 2.0 <= first.begin < first.end <= 3.0


def test_rates_that_are_not_measured_are_differentiated():
    problem, experiment, _, states = planted()
    variables = observed_variables(problem, experiment.shooting)
    assert set(variables) == {"tau", "theta", "omega"}
    inner = slice(50, -50)
    np.testing.assert_allclose(variables["omega"][inner], states[inner, 1], atol=0.1)


def test_bias_and_rmse_are_those_of_numpy():
    problem, _, comparison, _ = planted()
    prediction = comparison.prediction
    error = (problem.outputs - prediction.simulated)[prediction.scored, 0]
    channel = comparison.channels["theta"]
    assert channel.bias == pytest.approx(np.mean(error))
    assert channel.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    assert comparison.nrmse == pytest.approx(channel.rmse / np.std(problem.outputs))


def test_whiteness_is_uniform_for_white_noise():
    p = [whiteness(np.random.default_rng(seed).standard_normal(600)) for seed in range(200)]
    counts, _ = np.histogram(p, bins=5, range=(0, 1))
    assert np.all(np.abs(counts - 40) < 4 * np.sqrt(40 * 0.8))


def test_whiteness_is_that_of_the_textbook():
    """Ljung and Box, Biometrika 65 (1978) 297, written out by hand."""
    from scipy import stats

    x = np.random.default_rng(7).standard_normal(300).cumsum() * 0.02
    x += np.random.default_rng(8).standard_normal(300)
    centred = x - x.mean()
    q = 0.0
    for k in range(1, 21):
        q += (np.sum(centred[k:] * centred[:-k]) / np.sum(centred**2)) ** 2 / (300 - k)
    assert whiteness(x) == pytest.approx(stats.chi2.sf(300 * 302 * q, 20), rel=1e-9)


@pytest.mark.parametrize("kind", ["autoregressive", "sine", "drift"])
def test_whiteness_refuses_memory(kind):
    t = np.arange(1000)
    white = np.random.default_rng(1).standard_normal(1000)
    signals = {
        "autoregressive": np.convolve(white, 0.5 ** np.arange(20))[:1000],
        "sine": white + np.sin(t / 10),
        "drift": white + t / 500,
    }
    assert whiteness(signals[kind]) < 1e-3


def test_whiteness_of_nothing_is_unknown():
    assert np.isnan(whiteness(np.zeros(100)))
    assert np.isnan(whiteness(np.ones(3)))
