"""Priors against the posterior of a plant that is linear in its parameters, in closed form."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import truth_records as truth

import twinproof
from foundation.errors import InputError, UnknownNameError
from identification.estimators.output_error import OutputError
from identification.experiment import Experiment, fit_stages
from identification.priors import Prior
from recordings import Channel, Recording

STEP, SAMPLES, SD = 0.01, 600, 0.02
TRUE = {"a": 0.8, "b": -0.3}
TANK = truth.own(
    """model A
      parameter Real a = 0.5; parameter Real b = 0.1;
      input Real u; input Real v; output Real y(start = 0, fixed = true);
    equation
      der(y) = a * u + b * v;
    end A;"""
)


def levels(b_seen=1.0):
    """Inputs (n, 2), and what a tank holds of each: inputs are held over a sample."""
    t = np.arange(SAMPLES) * STEP
    inputs = np.column_stack([np.sin(3 * t), b_seen * np.cos(5 * t)])
    held = np.vstack([np.zeros(2), np.cumsum(inputs[:-1] * STEP, axis=0)])
    return inputs, held


def record(seed, *, true=TRUE, b_seen=1.0, sd=SD):
    inputs, held = levels(b_seen)
    y = held @ [true["a"], true["b"]] + sd * np.random.default_rng(seed).standard_normal(SAMPLES)
    return truth.problem(TANK, inputs, y, STEP, names=("y",), sd=[sd])


def posterior(problems, priors, sds):
    """Mean and covariance of (a, b), every window's initial level free and flat."""
    information, score = np.zeros((2, 2)), np.zeros(2)
    for given, sd in zip(problems, sds, strict=True):
        held = np.vstack([np.zeros(2), np.cumsum(given.inputs[:-1] * STEP, axis=0)])
        for window in np.split(np.arange(SAMPLES), 6):
            # A free level takes the mean away.
            x = held[window] - np.mean(held[window], axis=0)
            information += x.T @ x / sd**2
            score += x.T @ given.outputs[window, 0] / sd**2
    for k, name in enumerate(TRUE):
        if name in priors:
            information[k, k] += 1 / priors[name].sd ** 2
            score[k] += priors[name].value / priors[name].sd ** 2
    covariance = np.linalg.inv(information)
    return covariance @ score, covariance


@pytest.mark.parametrize(
    "priors",
    [
        {},
        {"a": Prior(0.81, 0.01)},
        {"b": Prior(-0.28, 0.03)},
        {"a": Prior(0.78, 0.02), "b": Prior(-0.301, 1e-3)},
    ],
)
@pytest.mark.parametrize("records", [1, 2])
def test_the_fit_is_the_closed_form_posterior(priors, records):
    problems = [record(seed, sd=SD * seed) for seed in range(1, records + 1)]
    estimate = OutputError(priors=priors).estimate_together(problems)
    fit = estimate.details["fit"]
    mean, covariance = posterior(problems, priors, fit.sd)
    np.testing.assert_allclose(list(estimate.values.values()), mean, rtol=1e-5)
    # Never narrower than the posterior; wider only as residuals happen to correlate.
    sd = np.sqrt(np.diag(estimate.covariance))
    ratio = sd / np.sqrt(np.diag(covariance))
    assert np.all((ratio > 0.93) & (ratio < 1.6)), ratio


def test_a_narrow_prior_leaves_its_own_doubt():
    prior = Prior(-0.25, 1e-5)
    found = OutputError(priors={"b": prior}).estimate(record(3)).parameters["b"]
    assert found.value == pytest.approx(prior.value, abs=1e-6)
    assert found.sd == pytest.approx(prior.sd, rel=1e-3)


@cache
def compiled():
    return Experiment.of(record(0))


def test_the_posterior_covers_truths_drawn_from_the_prior():
    priors = {"a": Prior(0.8, 0.01), "b": Prior(-0.3, 0.02)}
    inside = []
    for seed in range(120):
        rng = np.random.default_rng([seed, 7])
        true = {name: rng.normal(p.value, p.sd) for name, p in priors.items()}
        here = compiled().on(record(seed, true=true))
        fit = fit_stages([here], priors=priors, stages=(1.0,))[-1]
        sd = np.sqrt(np.diag(fit.covariance))
        error = np.array([fit.values[n] - true[n] for n in fit.free])
        inside.append(np.abs(error) <= 2 * sd)
    share = np.mean(inside, axis=0)
    assert np.all((share >= 0.9) & (share <= 1.0)), share


def test_the_log_likelihood_leaves_priors_out():
    from scipy import stats

    estimate = OutputError(priors={"a": Prior(1.0, 0.01)}).estimate(record(1))
    fit = estimate.details["fit"]
    residuals = np.concatenate(fit.at.residuals)
    expected = np.sum(stats.norm(0, fit.sd).logpdf(residuals))
    constant = -0.5 * residuals.size * np.log(2 * np.pi)
    assert fit.log_likelihood == pytest.approx(expected - constant, rel=1e-9)


def test_a_prior_that_dominates_is_said():
    shown = OutputError(priors={"a": Prior(0.8, 0.5), "b": Prior(-0.2, 0.1)})
    assert shown.estimate(record(1)).warnings == ()
    estimate = shown.estimate(record(1, b_seen=1e-3))
    (warning,) = estimate.warnings
    assert warning.startswith("b is known from its prior, not from the record")
    assert estimate.parameters["b"].sd == pytest.approx(0.1, rel=0.1)


def test_residuals_with_memory_that_outvote_a_prior_are_said():
    """A drift of the level that no input explains: sure of itself as white noise, and wrong."""
    given = record(1)
    drift = np.cumsum(np.random.default_rng(5).standard_normal((SAMPLES, 1)), axis=0)
    wandering = replace(given, outputs=given.outputs + 0.02 * drift)
    estimate = OutputError(priors={"a": Prior(0.8, 0.02)}).estimate(wandering)
    assert estimate.parameters["a"].sd > 0.022
    assert any(w.startswith("a is less certain than its prior") for w in estimate.warnings)


def test_a_prior_that_the_record_contradicts_is_said():
    priors = {"a": Prior(0.7, 0.02), "b": Prior(0.0, 1e-3)}
    estimate = OutputError(priors=priors).estimate(record(1))
    mean, _ = posterior([record(1)], priors, estimate.details["fit"].sd)
    np.testing.assert_allclose(list(estimate.values.values()), mean, rtol=1e-4)
    said = [w for w in estimate.warnings if "contradict each other" in w]
    assert [w.split()[3] for w in said] == ["a", "b"]
    # What the record alone says of b, against the prior, by hand.
    value, alone = posterior([record(1)], {"a": priors["a"]}, estimate.details["fit"].sd)
    expected = abs(value[1] - 0.0) / np.hypot(np.sqrt(alone[1, 1]), 1e-3)
    told = float(said[1].split("(")[1].split()[0])
    assert told == pytest.approx(expected, abs=1)


def test_a_parameter_that_the_record_does_not_see_stays_at_its_prior():
    estimate = OutputError(priors={"b": Prior(-0.2, 0.1)}).estimate(record(1, b_seen=0.0))
    b = estimate.parameters["b"]
    assert (b.value, b.sd) == (pytest.approx(-0.2), pytest.approx(0.1))
    assert any(w.startswith("b is known from its prior") for w in estimate.warnings)
    assert np.all(np.isfinite(estimate.covariance))


@pytest.mark.parametrize("numbers", [(1.0, 0.0), (1.0, -1.0), (np.nan, 1.0), (1.0, np.inf)])
def test_priors_that_say_nothing_are_refused(numbers):
    with pytest.raises(InputError, match="says nothing"):
        Prior(*numbers)


def test_priors_of_what_is_not_fitted_or_out_of_range_are_refused():
    swung = truth.pendulum_problem(1.0)
    with pytest.raises(UnknownNameError, match=r"'j'.*J"):
        OutputError(priors={"j": Prior(1.0, 1.0)}).estimate(swung)
    with pytest.raises(InputError, match="outside its range"):
        OutputError(priors={"d": Prior(-0.1, 1.0)}).estimate(swung)


def test_from_python_a_prior_is_a_pair_and_needs_output_error():
    given = record(1)
    columns = {"u": given.inputs[:, 0], "v": given.inputs[:, 1], "y": given.outputs[:, 0]}
    data = Recording(given.time, {name: Channel(name, c) for name, c in columns.items()})
    model = twinproof.Model("A", TANK)
    found = twinproof.identify(model, data, priors={"b": (-0.25, 1e-5)})
    assert found.estimate.values["b"] == pytest.approx(-0.25, abs=1e-6)
    with pytest.raises(InputError, match="no priors"):
        twinproof.identify(model, data, priors={"b": (-0.25, 1.0)}, method="kalman")


def test_a_problems_own_priors_count_like_those_given():
    known = {"b": Prior(-0.28, 0.003)}
    given = record(3)
    told = fit_stages([Experiment.of(given)], priors=known)[-1]
    own = fit_stages([Experiment.of(replace(given, priors=known))])[-1]
    without = fit_stages([Experiment.of(given)])[-1]
    assert own.values == pytest.approx(told.values)
    np.testing.assert_allclose(own.covariance, told.covariance)
    assert abs(own.values["b"] + 0.28) < 0.5 * abs(without.values["b"] + 0.28)
