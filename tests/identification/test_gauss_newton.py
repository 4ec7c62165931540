"""Windowed least squares: what it recovers, what it holds, and what its covariance is worth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import truth_records as truth
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import DivergenceError
from identification.estimators.output_error import OutputError
from identification.experiment import Experiment
from identification.gauss_newton import fit
from identification.linearisation import simulate

QUIET = {"deadline": None, "derandomize": True}


@cache
def plant_problem(name):
    """A noise-free record of 4 s with starting values wrong by a fifth."""
    if name == "Pendulum":
        return truth.pendulum_problem(4.0, wrong=1.2)
    if name == "Positioner":
        voltage = truth.shuttle(2001, 2e-3)
        states = truth.held(truth.positioner_rates(), [0.01, 0.1], voltage, 2e-3)
        return truth.problem(
            truth.library(name), voltage, states[:, 0], 2e-3, names=("q",), wrong=1.2
        )
    volts, states = truth.balanced(4.0)
    names = ("theta_w", "theta_p")
    return truth.problem(truth.library(name), volts, states[:, :2], 1e-3, names=names, wrong=1.2)


TRUE = {"Pendulum": truth.PENDULUM, "Positioner": truth.POSITIONER, "WheeledPendulum": truth.X}


@pytest.mark.parametrize("name", TRUE)
def test_noise_free_records_give_every_parameter_back(name):
    given_problem = plant_problem(name)
    assert set(given_problem.free) == set(TRUE[name])
    found = Experiment.of(given_problem).fit_stages()[-1]
    assert found.converged
    for parameter, value in TRUE[name].items():
        assert found.values[parameter] == pytest.approx(value, rel=1e-6)
    assert not found.held


def test_the_simulation_at_the_solution_is_the_record():
    given_problem = plant_problem("Pendulum")
    experiment = Experiment.of(given_problem)
    found = experiment.fit_stages()[-1]
    parts = simulate(given_problem, experiment.shooting, experiment.windows, found.x0, found.values)
    np.testing.assert_allclose(np.concatenate(parts), given_problem.outputs, atol=1e-8)


def test_bounds_hold_on_the_way_and_at_the_end():
    """The machine has d = -0.05 (it is driven); the model's range starts at 0."""
    torque = truth.swing(2001, 2e-3)
    states = truth.held(truth.pendulum_rates(d=-0.05), [0.4, -0.5], torque, 2e-3)
    given_problem = truth.problem(
        truth.library("Pendulum"), torque, states[:, 0], 2e-3, names=("theta",)
    )
    estimate = OutputError().estimate(given_problem)
    assert estimate.values["d"] == 0.0
    assert any("d is at the lower bound" in w for w in estimate.warnings)
    assert np.all(np.isfinite(list(estimate.values.values())))
    # The others take up what they can, and end where their cost is lowest with d held at 0.
    held = replace(given_problem, free=("J", "mgl")).with_values({"d": 0.0})
    other = OutputError().estimate(held)
    for name in ("J", "mgl"):
        assert estimate.values[name] == pytest.approx(other.values[name], rel=1e-4)


IDLE = truth.own(
    """model A
      parameter Real J = 0.2; parameter Real mgl = 3.0; parameter Real k = 7 "of no effect";
      input Real tau; output Real theta(start = 0, fixed = true);
      Real omega(start = 0, fixed = true); Real aside;
    equation
      der(theta) = omega; J * der(omega) = tau - mgl * sin(theta); aside = k * theta;
    end A;"""
)
TWINS = truth.own(
    """model A
      parameter Real J = 0.2; parameter Real m = 3.0; parameter Real l = 1.0;
      input Real tau; output Real theta(start = 0, fixed = true);
      Real omega(start = 0, fixed = true);
    equation
      der(theta) = omega; J * der(omega) = tau - m * l * sin(theta);
    end A;"""
)


def swung(source, *, sd=1e-3, seed=1):
    torque = truth.swing(1501, 2e-3)
    states = truth.held(truth.pendulum_rates(d=0.0), [0.4, -0.5], torque, 2e-3)
    given_problem = truth.problem(source, torque, states[:, 0], 2e-3, names=("theta",))
    return truth.noisy(given_problem, [sd], seed)


def test_a_parameter_without_effect_is_held():
    estimate = OutputError().estimate(swung(IDLE))
    k = estimate.parameters["k"]
    assert (k.value, k.sd, k.identifiable) == (7.0, np.inf, False)
    assert any(w.startswith("k has no effect") for w in estimate.warnings)
    for name, value in {"J": 0.185, "mgl": 3.61}.items():
        other = estimate.parameters[name]
        assert other.identifiable
        assert abs(other.value - value) < 4 * other.sd < 0.01 * value
    rows = [list(estimate.parameters).index(n) for n in ("k", "J")]
    assert np.isnan(estimate.covariance[rows[0], rows[1]])


def test_two_parameters_that_act_alike_are_both_named():
    """Only the product m·l shows: neither has a value, the product does."""
    estimate = OutputError().estimate(swung(TWINS))
    told = [w for w in estimate.warnings if "cannot be told apart" in w]
    assert len(told) == 1
    assert "m and l" in told[0]
    assert "-1.0" in told[0]
    values, sd = estimate.values, {n: p.sd for n, p in estimate.parameters.items()}
    assert values["m"] * values["l"] == pytest.approx(3.61, rel=3e-3)
    assert sd["m"] > 10 * values["m"]
    assert sd["l"] > 10 * values["l"]
    assert sd["J"] < 0.01 * values["J"]


def test_a_machine_at_rest_shows_nothing_and_says_so():
    """A constant channel has no deviation to be scaled by."""
    n = 2000
    given_problem = truth.problem(
        truth.library("Pendulum"), np.zeros(n), np.zeros(n), 1e-3, names=("theta",)
    )
    estimate = OutputError().estimate(given_problem)
    assert not any(p.identifiable for p in estimate.parameters.values())
    assert estimate.values == {name: given_problem.values[name] for name in given_problem.free}
    assert len(estimate.warnings) >= 3


def test_a_start_that_explodes_is_an_error_of_its_own_kind():
    source = truth.own(
        "model A parameter Real a = 900; input Real u; output Real y(start = 1, fixed = true); "
        "equation der(y) = a * y * y * y + u; end A;"
    )
    given_problem = truth.problem(source, np.zeros(500), np.ones(500), 1e-3, names=("y",))
    with pytest.raises(DivergenceError, match="--param"):
        OutputError().estimate(given_problem)


def both_channels():
    clean = truth.pendulum_problem(3.0, outputs=("theta", "omega"), wrong=1.1)
    return truth.noisy(clean, [2e-3, 2e-2], 5)


@cache
def reference_estimate():
    return OutputError().estimate(both_channels())


def test_the_order_of_channels_does_not_matter():
    given_problem = both_channels()
    turned = replace(
        given_problem,
        outputs=given_problem.outputs[:, ::-1],
        output_names=given_problem.output_names[::-1],
        noise_sd=given_problem.noise_sd[::-1],
    )
    found, expected = OutputError().estimate(turned), reference_estimate()
    for name, parameter in expected.parameters.items():
        assert found.parameters[name].value == pytest.approx(parameter.value, rel=1e-7)
        assert found.parameters[name].sd == pytest.approx(parameter.sd, rel=1e-3)


@settings(max_examples=8, **QUIET)
@given(exponent=st.floats(-6, 6))
def test_the_unit_of_a_channel_does_not_matter(exponent):
    """The rate in 10^k rad/s, in the model and in the record alike."""
    factor = 10.0**exponent
    source = truth.own(
        """model A
          parameter Real J = 0.185; parameter Real mgl = 3.61; parameter Real d = 0.006;
          parameter Real factor = 1 annotation(__twinproof(known = true));
          input Real tau; output Real theta(start = 0, fixed = true);
          Real w(start = 0, fixed = true); output Real omega;
        equation
          der(theta) = w; J * der(w) = tau - mgl * sin(theta) - d * w; omega = factor * w;
        end A;"""
    )
    base = both_channels()
    scaled = truth.problem(
        source,
        base.inputs,
        base.outputs * [1.0, factor],
        base.sample_time,
        names=("theta", "omega"),
        sd=base.noise_sd * [1.0, factor],
        wrong=1.1,
        values={"factor": factor},
    )
    found, expected = OutputError().estimate(scaled), reference_estimate()
    for name, parameter in expected.parameters.items():
        assert found.parameters[name].value == pytest.approx(parameter.value, rel=1e-5)
        assert found.parameters[name].sd == pytest.approx(parameter.sd, rel=1e-2)


@settings(max_examples=8, **QUIET)
@given(exponent=st.floats(-8, 8))
def test_the_unit_of_a_parameter_does_not_matter(exponent):
    factor = 10.0**exponent
    source = truth.own(
        f"""model A
          parameter Real J = {0.185 * factor!r}; parameter Real mgl = 3.61;
          parameter Real d = 0.006;
          input Real tau; output Real theta(start = 0, fixed = true);
          output Real omega(start = 0, fixed = true);
        equation
          der(theta) = omega; J * der(omega) = {factor!r} * (tau - mgl * sin(theta) - d * omega);
        end A;"""
    )
    base = both_channels()
    scaled = truth.problem(
        source,
        base.inputs,
        base.outputs,
        base.sample_time,
        names=base.output_names,
        sd=base.noise_sd,
        wrong=1.1,
    )
    found, expected = OutputError().estimate(scaled), reference_estimate()
    assert found.values["J"] / factor == pytest.approx(expected.values["J"], rel=1e-6)
    assert found.parameters["J"].sd / factor == pytest.approx(expected.parameters["J"].sd, rel=1e-3)
    assert found.values["mgl"] == pytest.approx(expected.values["mgl"], rel=1e-6)


@cache
def covered():
    clean = truth.pendulum_problem(4.0, 5e-3)
    return clean, Experiment.of(clean)


def estimates(disturb, runs):
    """(runs, k) errors and standard deviations of fits started at the truth."""
    clean, experiment = covered()
    errors, deviations = [], []
    for seed in range(runs):
        given_problem = disturb(clean, np.random.default_rng(seed))
        here = experiment.on(given_problem)
        found = fit(
            given_problem, here.shooting, here.windows, here.guess(here.windows), clean.values
        )
        errors.append([found.values[n] - truth.PENDULUM[n] for n in found.free])
        deviations.append(np.sqrt(np.diag(found.covariance)))
    return np.array(errors), np.array(deviations)


def with_white_noise(clean, rng):
    noise = 5e-3 * rng.standard_normal(clean.outputs.shape)
    return replace(clean, outputs=clean.outputs + noise, noise_sd=np.array([np.nan]))


def with_coloured_noise(clean, rng):
    """The same variance, correlated over 20 samples: what it says is worth far fewer samples."""
    noise = np.empty(len(clean.time))
    noise[0] = rng.standard_normal()
    keep = np.exp(-1 / 20)
    for k in range(1, len(noise)):
        noise[k] = keep * noise[k - 1] + np.sqrt(1 - keep**2) * rng.standard_normal()
    return replace(clean, outputs=clean.outputs + 5e-3 * noise[:, None])


@cache
def white_estimates():
    return estimates(with_white_noise, 80)


def test_standard_deviations_cover_white_noise():
    errors, deviations = white_estimates()
    inside = np.mean(np.abs(errors) <= 2 * deviations, axis=0)
    assert np.all((inside >= 0.85) & (inside <= 1.0)), inside
    # Neither too wide: the scatter of the estimates is what they say, within a third.
    ratio = np.sqrt(np.mean(deviations**2, axis=0)) / np.std(errors, axis=0)
    assert np.all((ratio > 0.8) & (ratio < 1.6)), ratio
    bias = np.abs(np.mean(errors, axis=0)) / np.std(errors, axis=0) * np.sqrt(len(errors))
    assert np.all(bias < 4), bias


def test_standard_deviations_widen_with_coloured_noise():
    errors, deviations = estimates(with_coloured_noise, 60)
    inside = np.mean(np.abs(errors) <= 2 * deviations, axis=0)
    assert np.all((inside >= 0.8) & (inside <= 1.0)), inside
    _, white = white_estimates()
    assert np.all(np.median(deviations, axis=0) > 1.5 * np.median(white, axis=0))


def test_the_log_likelihood_is_that_of_a_gaussian():
    from scipy import stats

    given_problem = both_channels()
    found = Experiment.of(given_problem).fit_stages()[-1]
    residuals = np.concatenate(found.at.residuals)
    expected = np.sum(stats.norm(0, found.sd).logpdf(residuals))
    constant = -0.5 * residuals.size * np.log(2 * np.pi)
    assert found.log_likelihood == pytest.approx(expected - constant, rel=1e-9)


def test_weights_are_the_noise_where_the_misfit_is_smaller():
    given_problem = both_channels()
    found = Experiment.of(given_problem).fit_stages()[-1]
    np.testing.assert_allclose(found.sd, [2e-3, 2e-2], rtol=0.05)
    assert np.all(found.sd >= given_problem.noise_sd * (1 - 1e-9))
