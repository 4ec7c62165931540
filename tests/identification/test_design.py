"""Bounds against analytic ones, and suggestions against what they promise."""

import numpy as np
import pytest
import truth_records as truth

from foundation.errors import ExcitationError, InputError, UnknownNameError
from identification.design import (
    Limits,
    bound_of_plan,
    bound_of_record,
    plan,
    suggest,
)
from identification.estimators import OutputError

RAMP = truth.own(
    'model A parameter Real K(unit = "1/s") = 2; parameter Real idle = 1; input Real u; '
    "output Real x(start = 0, fixed = true); equation "
    "der(x) = K * u + (if x > 1e6 then idle else 0.0); end A;"
)


def ramp_plan(n=200, h=0.01, sd=0.05, seed=1):
    dae = truth.load(RAMP)
    u = np.random.default_rng(seed).standard_normal((n, 1))
    return plan(dae, np.arange(n) * h, u, noise_sd={"x": sd}), u[:, 0]


def test_a_gain_behind_an_integrator_has_the_textbooks_bound():
    """x = x0 + K ∫u: straight-line regression with unknown intercept."""
    problem, u = ramp_plan()
    bound = bound_of_plan(problem)
    s = np.concatenate([[0.0], np.cumsum(u[:-1])]) * 0.01
    expected = 0.05 / np.sqrt(np.sum((s - s.mean()) ** 2))
    assert bound.sd["K"] == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(problem.outputs[:, 0], 2 * s, atol=1e-12)


def test_what_cannot_be_seen_is_named():
    problem, _ = ramp_plan()
    bound = bound_of_plan(problem)
    assert bound.unseen == ("idle",)
    assert bound.sd["idle"] == np.inf
    assert any("idle" in line and "--free" in line for line in bound.advice)


def test_two_that_are_one_have_an_advice():
    source = truth.own(
        "model A parameter Real a = 2; parameter Real b = 3; input Real u; output Real x(start = "
        "0, fixed = true); equation der(x) = (a + b) * u + 1e-7 * a * x; end A;"
    )
    n = 500
    u = truth.swing(n, 0.01)[:, None]
    bound = bound_of_plan(plan(truth.load(source), np.arange(n) * 0.01, u, noise_sd={"x": 1e-3}))
    assert bound.condition_number > 1e4
    assert set(bound.weakest) == {"a", "b"}
    assert bound.correlated[0][:2] == ("a", "b")
    assert any("a and b" in line for line in bound.advice)


def test_a_first_order_lags_bound_is_that_of_its_sensitivities():
    """Sensitivities of T x' = K u - x by SciPy, initial state unknown."""
    from scipy.signal import dlsim

    dae = truth.load(
        truth.own(
            "model A parameter Real K = 2; parameter Real T = 0.5; input Real u; "
            "output Real x(start = 0, fixed = true); equation T * der(x) = K * u - x; end A;"
        )
    )
    n, h, sd = 800, 0.005, 0.01
    u = np.sign(np.sin(3 * np.arange(n) * h))

    def response(K, T, x0):
        a = np.exp(-h / T)
        out = dlsim((np.array([[a]]), [[K * (1 - a)]], [[1.0]], [[0.0]], h), u, x0=[x0])
        return out[1][:, 0]

    step = 1e-6
    columns = np.column_stack(
        [
            (response(2 + step, 0.5, 0) - response(2 - step, 0.5, 0)) / (2 * step),
            (response(2, 0.5 + step, 0) - response(2, 0.5 - step, 0)) / (2 * step),
            (response(2, 0.5, step) - response(2, 0.5, -step)) / (2 * step),
        ]
    )
    expected = sd * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))[:2]
    bound = bound_of_plan(plan(dae, np.arange(n) * h, u[:, None], noise_sd={"x": sd}))
    assert [bound.sd["K"], bound.sd["T"]] == pytest.approx(expected.tolist(), rel=1e-5)
    assert bound.spread == pytest.approx(np.sqrt(np.mean((expected / [2, 0.5]) ** 2)), rel=1e-5)


def test_output_error_reaches_the_bound():
    problem = truth.pendulum_problem(1.0, 2e-3, outputs=("theta", "omega"), sd=[2e-3, 2e-2])
    bound = bound_of_record(problem, None)
    errors = []
    for seed in range(24):
        found = OutputError().estimate(truth.noisy(problem, [2e-3, 2e-2], seed))
        errors.append([found.values[n] - v for n, v in truth.PENDULUM.items()])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    ratio = rms / [bound.sd[n] for n in truth.PENDULUM]
    assert np.all((ratio > 0.6) & (ratio < 1.5)), ratio


def test_unknown_sensors_are_assumed_and_said():
    dae = truth.load(truth.library("Pendulum"))
    time = np.arange(2000) * 1e-3
    bound = bound_of_plan(plan(dae, time, truth.swing(2000, 1e-3)[:, None], outputs=["theta"]))
    assert any("sensor of theta" in note for note in bound.notes)


def test_a_suggestion_keeps_the_limits_and_beats_the_families():
    dae = truth.load(truth.library("Pendulum"))
    limits = Limits((1.5,), (0.2, 4.0), 6.0, 2e-3, {"theta": (-0.8, 0.8)})
    found = suggest(dae, limits, noise_sd={"omega": 1e-2}, outputs=["omega"], tries=40)
    assert np.max(np.abs(found.problem.inputs)) <= 1.5 + 1e-12
    assert found.bound.score <= min(found.tried.values()) + 1e-9
    assert set(found.tried) == {"flat", "low", "high", "chirp", "steps"}
    # An angle that is not measured keeps its limits too; integrated here by SciPy.
    torque = found.problem.inputs[:, 0]
    states = truth.held(truth.pendulum_rates(), [0.0, 0.0], torque, 2e-3)
    assert np.max(np.abs(states[:, 0])) <= 0.8 * (1 + 1e-6)
    np.testing.assert_allclose(found.problem.outputs[:, 0], states[:, 1], atol=1e-6)
    again = suggest(dae, limits, noise_sd={"omega": 1e-2}, outputs=["omega"], tries=40)
    np.testing.assert_array_equal(again.problem.inputs, found.problem.inputs)


def test_a_suggestion_beats_a_sine_by_far():
    dae = truth.load(truth.library("Pendulum"))
    noise = {"theta": 1e-3}
    limits = Limits((1.0,), (0.1, 3.0), 8.0, 2e-3)
    sine = np.sin(2 * np.pi * 0.2 * limits.time)[:, None]
    before = bound_of_plan(plan(dae, limits.time, sine, noise_sd=noise, outputs=["theta"]))
    after = suggest(dae, limits, noise_sd=noise, outputs=["theta"], criterion="A", tries=30).bound
    assert after.spread < 0.3 * before.spread


def test_an_unstable_plant_is_told_to_use_its_loop():
    dae = truth.load(truth.library("WheeledPendulum"))
    time = np.arange(20_000) * 1e-3
    with pytest.raises(ExcitationError, match=r"runs away|leaves its limits") as caught:
        suggest(dae, Limits((5.0,), (0.1, 5.0), 20.0, 1e-3, {"theta_p": (-0.5, 0.5)}), tries=1)
    assert "controller" in caught.value.remedy
    volts, states = truth.balanced(4.0)
    names = ("theta_w", "theta_p", "omega_w", "omega_p")
    record = truth.problem(
        truth.library("WheeledPendulum"), volts, states, 1e-3, names=names, sd=[1e-4] * 4
    )
    bound = bound_of_record(record)
    assert not bound.unseen
    assert all(bound.sd[n] < 0.1 * v for n, v in truth.X.items())
    assert len(time) == 20_000


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"band": (3.0, 1.0)}, "band"),
        ({"band": (1.0, 600.0)}, "band"),
        ({"duration": 0.01}, "experiment"),
        ({"amplitude": (-1.0,)}, "amplitude"),
    ],
)
def test_impossible_limits_are_refused(change, word):
    good = {"amplitude": (1.0,), "band": (0.1, 5.0), "duration": 5.0, "step": 1e-3}
    with pytest.raises(InputError, match=word) as caught:
        Limits(**{**good, **change})
    assert caught.value.remedy


def test_unknown_names_are_refused():
    dae = truth.load(truth.library("Pendulum"))
    limits = Limits((1.0,), (0.1, 5.0), 2.0)
    with pytest.raises(UnknownNameError, match="theto"):
        suggest(dae, limits, outputs=["theto"])
    with pytest.raises(UnknownNameError, match="tetha"):
        suggest(dae, Limits((1.0,), (0.1, 5.0), 2.0, 1e-3, {"tetha": (0, 1)}))
    with pytest.raises(InputError, match="amplitudes"):
        suggest(dae, Limits((1.0, 2.0), (0.1, 5.0), 2.0))
