"""Prediction: what a perfect model would show, which horizon, and how noisy the sensors are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import truth_records as truth
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.experiment import Experiment
from identification.prediction import WINDOW, choose_horizon, noise_estimate, predict

PITCH_SD = np.radians(0.5)


@cache
def balanced():
    volts, states = truth.balanced(6.0)
    names = ("theta_w", "theta_p", "omega_p")
    return truth.problem(
        truth.library("WheeledPendulum"), volts, states[:, [0, 1, 3]], 1e-3, names=names
    )


@cache
def experiments():
    swung = truth.pendulum_problem(6.0, 2e-3)
    return {"Pendulum": Experiment.of(swung), "WheeledPendulum": Experiment.of(balanced())}


NOISE = {"Pendulum": [5e-3], "WheeledPendulum": [3e-4, PITCH_SD, PITCH_SD]}


@pytest.mark.parametrize(
    ("plant", "horizon", "runs"),
    [("Pendulum", None, 300), ("Pendulum", 1.0, 120), ("WheeledPendulum", 1.0, 50)],
)
def test_the_floor_is_what_noise_alone_leaves(plant, horizon, runs):
    """Monte Carlo: the true model on the true motion with new noise each time."""
    experiment = experiments()[plant]
    problem = experiment.problem
    squares, floors = [], []
    for seed in range(runs):
        record = truth.noisy(problem, NOISE[plant], seed)
        prediction = experiment.on(record).predict(problem.values, horizon)
        squares.append(prediction.rmse**2)
        floors.append(prediction.floor)
    measured = np.sqrt(np.mean(squares, axis=0))
    floor = np.mean(floors, axis=0)
    np.testing.assert_allclose(floor, measured, rtol=0.1)
    assert np.all(floor >= NOISE[plant])


def test_a_free_simulation_scores_everything_and_windows_all_but_their_beginnings():
    experiment = experiments()["Pendulum"]
    values = experiment.problem.values
    free = experiment.predict(values, None)
    assert np.all(free.scored)
    windowed = experiment.predict(values, 1.0)
    for window in windowed.windows:
        part = windowed.scored[window.begin : window.end]
        assert not np.any(part[:50])
        assert np.all(part[50:])


def test_a_perfect_model_predicts_a_noise_free_record():
    experiment = experiments()["WheeledPendulum"]
    prediction = experiment.predict(experiment.problem.values, 1.0)
    assert np.all(prediction.nrmse < 1e-5)
    assert prediction.bounded
    assert prediction.window_errors().shape == (6, 3)


def test_nrmse_is_over_the_deviation_of_the_measurement():
    experiment = experiments()["WheeledPendulum"]
    values = {**experiment.problem.values, "X4": 1.0}
    prediction = experiment.predict(values, 1.0)
    error = experiment.problem.outputs - prediction.simulated
    rmse = np.sqrt(np.mean(error[prediction.scored] ** 2, axis=0))
    nrmse = rmse / np.std(experiment.problem.outputs, axis=0)
    np.testing.assert_allclose(prediction.nrmse, nrmse, rtol=1e-12)
    assert prediction.total_nrmse == pytest.approx(np.sqrt(np.mean(nrmse**2)))


def test_auto_horizon_is_free_for_a_stable_plant_and_windows_for_one_that_falls():
    for plant, expected in (("Pendulum", None), ("WheeledPendulum", WINDOW)):
        experiment = experiments()[plant]
        record = truth.noisy(experiment.problem, NOISE[plant], 3)
        assert choose_horizon(record, experiment.shooting, record.values) == expected


def test_a_short_record_is_always_simulated_freely():
    experiment = experiments()["WheeledPendulum"]
    record = truth.noisy(experiment.problem.part(0, 1200), NOISE["WheeledPendulum"], 3)
    assert choose_horizon(record, experiment.shooting, record.values) is None


def test_a_constant_channel_spoils_neither_horizon_nor_total():
    source = truth.own(
        "model A parameter Real T = 0.2; input Real u; output Real y(start = 0, fixed = true); "
        "output Real z; equation T * der(y) = u - y; z = 3 + 0 * y; end A;"
    )
    n, step = 2000, 2e-3
    inputs = np.sign(np.sin(5 * np.arange(n) * step))
    states = truth.held(lambda _, x, u: [(u - x[0]) / 0.2], [0.0], inputs, step)
    outputs = np.column_stack([states[:, 0], np.full(n, 3.0)])
    problem = truth.problem(source, inputs, outputs, step, names=("y", "z"))
    experiment = Experiment.of(problem)
    assert choose_horizon(problem, experiment.shooting, problem.values) is None
    wrong = experiment.predict({**problem.values, "T": 0.25}, None)
    assert np.isfinite(wrong.total_nrmse)
    assert wrong.total_nrmse == pytest.approx(wrong.nrmse[0], rel=1e-9)


def test_a_diverged_prediction_is_not_bounded():
    experiment = experiments()["WheeledPendulum"]
    values = {**experiment.problem.values, "X5": 4000.0}
    prediction = experiment.predict(values, None)
    assert not prediction.bounded


@settings(deadline=None, max_examples=25, derandomize=True)
@given(seed=st.integers(0, 10_000), exponent=st.floats(-6, 3))
def test_white_noise_is_estimated_within_five_percent(seed, exponent):
    sd = 10.0**exponent
    problem = balanced()
    noise = sd * np.random.default_rng(seed).standard_normal(problem.outputs.shape)
    estimate = noise_estimate(replace(problem, outputs=noise))
    np.testing.assert_allclose(estimate, sd, rtol=0.05)


def test_motion_is_not_taken_for_noise():
    """A motion of 0.1 to 23 rad carries noise of 1e-4: the estimate is that of the noise."""
    problem = balanced()
    assert np.all(noise_estimate(problem) < 1e-5 * np.std(problem.outputs, axis=0))
    noise = 1e-4 * np.random.default_rng(4).standard_normal(problem.outputs.shape)
    estimate = noise_estimate(replace(problem, outputs=problem.outputs + noise))
    np.testing.assert_allclose(estimate, 1e-4, rtol=0.1)


def test_what_is_known_of_a_sensor_is_believed():
    problem = replace(balanced(), noise_sd=np.array([0.1, np.nan, 0.3]))
    estimate = noise_estimate(problem)
    assert estimate[[0, 2]].tolist() == [0.1, 0.3]


def test_prediction_is_the_same_for_experiment_and_function():
    experiment = experiments()["Pendulum"]
    problem = experiment.problem
    one = experiment.predict(problem.values, 1.0)
    other = predict(problem, experiment.shooting, problem.values, 1.0)
    np.testing.assert_array_equal(one.simulated, other.simulated)


def test_a_machine_at_rest_is_predicted():
    n = 3000
    problem = truth.problem(
        truth.library("Pendulum"),
        np.zeros(n),
        np.zeros((n, 2)),
        1e-3,
        names=("theta", "omega"),
        sd=[np.nan, 1e-3],
    )
    experiment = Experiment.of(problem)
    for horizon in (None, 1.0):
        prediction = experiment.predict(problem.values, horizon)
        assert np.all(np.abs(prediction.rmse) < 1e-12)
        assert np.all(np.isfinite(prediction.floor))
    assert choose_horizon(problem, experiment.shooting, problem.values) is None
