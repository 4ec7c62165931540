"""What every estimator must do, run on every one of them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import truth_records as truth

from foundation.errors import (
    DivergenceError,
    ExcitationError,
    UnknownNameError,
    UnsupportedModelError,
)
from identification.estimate import Estimate
from identification.estimators import ESTIMATORS, Estimator, estimator

CHECKS = []
# Methods that are here to be compared with: noise biases them, and they do not know it.
BASELINES = {"differencing"}
HONEST = [method for method in ESTIMATORS if method not in BASELINES]


def check(function):
    """Register a check; all of them run for every estimator on every problem."""
    CHECKS.append(function)
    return function


@cache
def problem(name):
    """A record of 3 s with little noise, starting values wrong by a tenth."""
    if name == "Pendulum":
        clean = truth.pendulum_problem(3.0, 1e-3, outputs=("theta", "omega"), wrong=1.1)
        return truth.noisy(clean, [1e-5, 1e-4], 1)
    if name == "Positioner":
        voltage = truth.shuttle(3001, 1e-3)
        states = truth.held(truth.positioner_rates(), [0.01, 0.1], voltage, 1e-3)
        clean = truth.problem(
            truth.library(name), voltage, states, 1e-3, names=("q", "v"), wrong=1.1
        )
        return truth.noisy(clean, [1e-6, 1e-5], 2)
    volts, states = truth.balanced(3.0)
    names = ("theta_w", "theta_p", "omega_w", "omega_p")
    clean = truth.problem(truth.library(name), volts, states, 1e-3, names=names, wrong=1.1)
    return truth.noisy(clean, [1e-5, 1e-6, 1e-4, 1e-5], 3)


TRUE = {"Pendulum": truth.PENDULUM, "Positioner": truth.POSITIONER, "WheeledPendulum": truth.X}


@cache
def estimate(method, name):
    return estimator(method).estimate(problem(name))


@check
def names_and_units_are_the_models(method, name):
    found, given = estimate(method, name), problem(name)
    assert isinstance(found, Estimate)
    assert found.method == method
    assert set(found.parameters) == set(given.free)
    for parameter, value in found.parameters.items():
        assert value.unit == given.dae.variables[parameter].unit


@check
def numbers_are_finite_and_deviations_are_positive(method, name):
    found = estimate(method, name)
    for value in found.parameters.values():
        assert np.isfinite(value.value)
        assert value.sd > 0
        assert value.identifiable == np.isfinite(value.sd)
    k = len(found.parameters)
    assert found.covariance.shape == (k, k)
    assert found.condition_number >= 1
    for i, value in enumerate(found.parameters.values()):
        assert np.sqrt(found.covariance[i, i]) == pytest.approx(value.sd)
    assert np.allclose(found.covariance, found.covariance.T, equal_nan=True)


@check
def the_truth_is_found(method, name):
    for parameter, value in estimate(method, name).parameters.items():
        close = 0.25 if method in BASELINES else 0.01
        assert value.value == pytest.approx(TRUE[name][parameter], rel=close), parameter


@check
def all_parameters_are_seen_without_complaint(method, name):
    found = estimate(method, name)
    assert all(p.identifiable for p in found.parameters.values())
    assert not [w for w in found.warnings if "held" in w or "told apart" in w]


@check
def the_same_problem_has_the_same_answer(method, name):
    given = problem(name)
    before = given.outputs.copy(), given.inputs.copy(), dict(given.values)
    again = estimator(method).estimate(given)
    assert again.values == estimate(method, name).values
    np.testing.assert_array_equal(again.covariance, estimate(method, name).covariance)
    # Nor does an estimate change what it is made from.
    np.testing.assert_array_equal(given.outputs, before[0])
    np.testing.assert_array_equal(given.inputs, before[1])
    assert given.values == before[2]


@check
def the_order_of_channels_does_not_matter(method, name):
    given = problem(name)
    turned = replace(
        given,
        outputs=given.outputs[:, ::-1].copy(),
        output_names=given.output_names[::-1],
        noise_sd=given.noise_sd[::-1].copy(),
    )
    found = estimator(method).estimate(turned)
    # What an estimator draws at random goes to other channels.
    for parameter, value in estimate(method, name).parameters.items():
        assert found.values[parameter] == pytest.approx(value.value, rel=1e-3)


@check
def held_parameters_stay_where_they_are(method, name):
    first = problem(name).free[0]
    given = replace(problem(name), free=(first,)).with_values(TRUE[name])
    found = estimator(method).estimate(given)
    assert list(found.parameters) == [first]
    assert found.values[first] == pytest.approx(TRUE[name][first], rel=0.02)


@pytest.mark.parametrize("name", TRUE)
@pytest.mark.parametrize("method", ESTIMATORS)
def test_estimators_conform(method, name):
    ran = 0
    for function in CHECKS:
        function(method, name)
        ran += 1
    assert ran == 7


def test_every_estimator_is_checked():
    assert {cls().method for cls in ESTIMATORS.values()} == set(ESTIMATORS)
    assert len(ESTIMATORS) >= 4
    assert all(isinstance(estimator(word), Estimator) for word in ESTIMATORS)


def test_unknown_methods_are_refused():
    with pytest.raises(UnknownNameError, match="output-error"):
        estimator("output-eror")


def doubts(method, given):
    """True if an estimator says that a record cannot answer, by an error or in its answer."""
    try:
        found = estimator(method).estimate(given)
    except (ExcitationError, DivergenceError) as error:
        return bool(error.remedy)
    unseen = [name for name, p in found.parameters.items() if not p.identifiable]
    vague = [
        name for name, p in found.parameters.items() if not p.sd < abs(p.value) or p.value == 0
    ]
    for name in unseen:
        assert found.values[name] == given.values[name], "held at its start"
    return bool(unseen or vague) and (bool(found.warnings) or bool(vague))


@pytest.mark.parametrize("method", ESTIMATORS)
def test_a_machine_at_rest_answers_nothing(method):
    n = 2000
    given = truth.problem(
        truth.library("Pendulum"), np.zeros(n), np.zeros((n, 2)), 1e-3, names=("theta", "omega")
    )
    assert doubts(method, given)


@pytest.mark.parametrize("method", HONEST)
def test_a_machine_at_rest_with_noise_answers_nothing(method):
    n = 3000
    given = truth.problem(
        truth.library("Pendulum"), np.zeros(n), np.zeros((n, 2)), 1e-3, names=("theta", "omega")
    )
    assert doubts(method, truth.noisy(given, [1e-3, 1e-3], 4))


@pytest.mark.parametrize("method", HONEST)
def test_a_record_of_twenty_samples_is_doubted(method):
    given = truth.noisy(problem("WheeledPendulum").part(100, 120), np.full(4, 1e-3), 5)
    assert doubts(method, given)


@pytest.mark.parametrize("method", ESTIMATORS)
def test_a_parameter_that_the_record_does_not_show_is_held(method):
    """A carriage that is pushed but never moves shows no viscous friction."""
    source = truth.own(
        """model A
          parameter Real m(unit = "kg") = 2; parameter Real k(unit = "N/m") = 50;
          parameter Real idle(unit = "N.s/m") = 3;
          input Real f(unit = "N"); output Real x(unit = "m", start = 0, fixed = true);
          output Real v(unit = "m/s", start = 0, fixed = true);
        equation
          der(x) = v; m * der(v) = f - k * x - idle * v * (if x > 10 then 1.0 else 0.0);
        end A;"""
    )
    force = truth.swing(4000, 1e-3)
    states = truth.held(lambda _, x, f: [x[1], (f - 50 * x[0]) / 2], [0.1, 0.0], force, 1e-3)
    given = truth.problem(source, force, states, 1e-3, names=("x", "v"), wrong=1.1)
    found = estimator(method).estimate(given)
    idle = found.parameters["idle"]
    assert not idle.identifiable
    assert idle.value == given.values["idle"]
    assert idle.sd == np.inf
    assert any("idle" in w for w in found.warnings)
    assert found.values["m"] == pytest.approx(2, rel=1e-2)
    assert found.values["k"] == pytest.approx(50, rel=1e-2)


@pytest.mark.parametrize("method", sorted(set(ESTIMATORS) - {"auto", "output-error"}))
def test_models_with_jumps_are_refused_with_a_remedy(method):
    """By all but output error, which runs them as FMUs (see test_fmu_models)."""
    source = truth.own(
        "model A parameter Real c = 0.8; input Real u; output Real h(start = 1, fixed = true); "
        "output Real v(start = 0, fixed = true); equation der(h) = v; der(v) = u - 9.81; "
        "when h < 0 then reinit(v, -c * pre(v)); end when; end A;"
    )
    n = 1000
    given = truth.problem(source, np.zeros(n), np.ones((n, 2)), 1e-3, names=("h", "v"))
    with pytest.raises((UnsupportedModelError, ExcitationError)) as caught:
        estimator(method).estimate(given)
    assert caught.value.remedy
