"""What a refit is worth, and whether a term predicts what it has not seen."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import truth_records as truth
from scipy import signal, stats

from identification.discovery.crossvalidation import crossvalidate, crossvalidate_candidate
from identification.discovery.evidence import (
    chance_of_nothing,
    independent_samples,
    refit,
    refit_all,
)
from identification.discovery.extension import extend
from identification.discovery.scan import scan
from identification.experiment import Experiment
from identification.prediction import noise_estimate

PENDULUM = truth.library("Pendulum")
PLAIN = extend(PENDULUM, [])


def autoregressive(rho, n, windows, seed=0):
    """Windows of one stationary AR(1) process."""
    white = np.random.default_rng(seed).standard_normal(n * windows + 1000)
    process = signal.lfilter([1.0], [1.0, -rho], white)[1000:]
    return [part[:, None] for part in np.split(process, windows)]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.97])
@pytest.mark.parametrize("windows", [1, 40])
def test_independent_samples_of_autoregressive_noise(rho, windows):
    """n (1 - ρ)/(1 + ρ), the textbook's effective size of an AR(1) sample."""
    found = independent_samples(autoregressive(rho, 80_000 // windows, windows))
    expected = 80_000 * (1 - rho) / (1 + rho)
    np.testing.assert_allclose(found, expected, rtol=0.15)


def test_independent_samples_are_counted_for_each_channel():
    parts = [
        np.hstack(pair)
        for pair in zip(
            autoregressive(0.0, 20_000, 2, 1), autoregressive(0.9, 20_000, 2, 2), strict=True
        )
    ]
    found = independent_samples(parts)
    np.testing.assert_allclose(found, [40_000, 40_000 / 19], rtol=0.15)


def test_what_stands_still_is_one_sample():
    assert independent_samples([np.ones((500, 1))])[0] < 5


@cache
def fitted(coulomb, seed=1, duration=10.0, sd=2e-3):
    clean = truth.pendulum_problem(duration, 2e-3, coulomb=coulomb)
    experiment = Experiment.of(truth.noisy(clean, [sd], seed))
    return experiment, experiment.fit_stages()[-1]


@cache
def candidates_of(coulomb):
    experiment, base = fitted(coulomb)
    return {s.addition.label: s for s in scan(PLAIN, experiment, base).scored}


def tried(label, coulomb):
    experiment, base = fitted(coulomb)
    return refit(PLAIN, experiment, base, candidates_of(coulomb)[label])


def test_a_refit_finds_the_hidden_size():
    found = tried("CoulombFriction@joint", 0.05)
    assert found.addition.values["tau_c"] == pytest.approx(0.05, rel=0.02)
    assert found.evidence > 100
    assert 0 < found.explains <= 1
    assert found.merit < found.evidence
    assert found.at_bound == ()


def test_refits_are_ranked_by_merit():
    experiment, base = fitted(0.05)
    shortlist = sorted(candidates_of(0.05).values(), key=lambda s: -s.gain)[:4]
    found, failed = refit_all(PLAIN, experiment, base, shortlist)
    assert found[0].addition.label == "CoulombFriction@joint"
    merits = [r.merit for r in found]
    assert merits == sorted(merits, reverse=True)
    assert {r.addition.label for r in found} | set(failed) == {s.addition.label for s in shortlist}


def test_evidence_is_the_gain_in_log_likelihood():
    """For residuals without memory: half the fall of the sum of squares over the variance."""
    found = tried("CoulombFriction@joint", 0.05)
    _, base = fitted(0.05)
    before = np.concatenate(base.at.residuals)[:, 0]
    after = np.concatenate(found.fit.at.residuals)[:, 0]
    expected = len(before) * np.log(np.std(before) / np.std(after))
    assert found.evidence == pytest.approx(expected, rel=0.15)
    share = 1 - np.mean(after**2) / np.mean(before**2)
    assert found.explains == pytest.approx(share, rel=1e-2)


def judged(label, coulomb, **options):
    experiment, base = fitted(coulomb)
    found = tried(label, coulomb)
    noise = noise_estimate(experiment.problem)
    return crossvalidate(experiment, base, found.experiment, found.fit, noise, **options)


def test_a_true_effect_is_accepted():
    verdict = judged("CoulombFriction@joint", 0.05)
    assert verdict.accepted
    assert verdict.chance < 1e-3
    assert 0.9 < verdict.removed <= 1.0
    np.testing.assert_allclose(verdict.after, 2e-3, rtol=0.05)
    assert np.all(verdict.before > verdict.after)


@pytest.mark.parametrize("label", ["CubicSpring@joint", "Offset@tau", "DeadZone@tau"])
def test_a_useless_effect_is_rejected(label):
    verdict = judged(label, 0.0)
    assert not verdict.accepted
    assert verdict.reason


def test_trying_more_candidates_asks_for_more():
    one, many = (
        judged("CoulombFriction@joint", 0.05),
        judged("CoulombFriction@joint", 0.05, tried=8),
    )
    assert many.chance == pytest.approx(8 * one.chance)


def test_a_small_friction_shows_over_whole_windows():
    """Over 0.25 s it hides in the initial states; what is left over is white, so 1 s are asked."""
    found = tried("CoulombFriction@joint", 0.004)
    label, options = "CoulombFriction@joint", {"independent": found.independent, "tried": 50}
    patient = judged(label, 0.004, patient=True, **options)
    assert patient.accepted
    assert patient.chance < 1e-6
    assert not judged(label, 0.004, **options).accepted


def test_beside_something_slow_only_short_windows_are_asked():
    """A tenth of the samples independent: over ten windows the same gain may be a disturbance's."""
    found = tried("CoulombFriction@joint", 0.004)
    few = 0.1 * found.independent
    assert not judged("CoulombFriction@joint", 0.004, patient=True, independent=few).accepted


def test_the_chance_of_nothing_is_that_of_a_normal_deviate():
    found = tried("CoulombFriction@joint", 0.0)
    k = found.fit.free.index(found.model.parameter_of(found.addition, "tau_c"))
    deviate = found.addition.values["tau_c"] / np.sqrt(found.fit.covariance[k, k])
    assert chance_of_nothing(found) == pytest.approx(2 * stats.norm.sf(abs(deviate)))
    assert chance_of_nothing(tried("CoulombFriction@joint", 0.05)) < 1e-12


def test_the_chance_of_several_parameters_has_no_units():
    found = tried("Cogging@joint", 0.0)
    k = found.fit.free.index(found.model.parameter_of(found.addition, "tau_s"))
    units = np.ones(len(found.fit.free))
    units[k] = 1e6
    name = found.fit.free[k]
    fit = replace(
        found.fit,
        values={**found.fit.values, name: 1e6 * found.fit.values[name]},
        covariance=found.fit.covariance * np.outer(units, units),
    )
    chance = chance_of_nothing(found)
    assert 1e-3 < chance < 1
    assert chance_of_nothing(replace(found, fit=fit)) == pytest.approx(chance, rel=1e-6)


def test_what_is_not_told_from_nothing_is_not_let_in():
    """Windows that prefer it do not help it beside slow rests: its size may be anything."""
    experiment, base = fitted(0.05)
    slow = tried("CoulombFriction@joint", 0.05)
    slow = replace(slow, independent=0.1 * slow.independent)
    assert crossvalidate_candidate(experiment, base, slow, tried=8).accepted
    unsure = replace(slow.fit, covariance=1e6 * slow.fit.covariance)
    verdict = crossvalidate_candidate(experiment, base, replace(slow, fit=unsure), tried=8)
    assert not verdict.accepted
    assert "not told from nothing" in verdict.reason


def test_what_leaves_no_doubt_may_be_of_uncertain_size():
    experiment, base = fitted(0.05)
    found = tried("CoulombFriction@joint", 0.05)
    unsure = replace(found.fit, covariance=1e6 * found.fit.covariance)
    verdict = crossvalidate_candidate(experiment, base, replace(found, fit=unsure), tried=8)
    assert verdict.accepted
    assert verdict.chance < 1e-8


def test_a_short_record_cannot_be_judged():
    experiment, base = fitted(0.05, duration=1.2)
    found = refit(PLAIN, experiment, base, candidates_of(0.05)["CoulombFriction@joint"])
    verdict = crossvalidate(experiment, base, found.experiment, found.fit, np.array([2e-3]))
    assert not verdict.accepted
    assert "2.5 s" in verdict.reason


def test_a_noise_free_record_is_judged():
    """Nothing is left over: logarithms and ratios of nothing must not appear."""
    clean = truth.pendulum_problem(6.0, 2e-3, coulomb=0.05)
    experiment = Experiment.of(clean)
    base = experiment.fit_stages()[-1]
    found = refit(PLAIN, experiment, base, candidates_of(0.05)["CoulombFriction@joint"])
    assert found.addition.values["tau_c"] == pytest.approx(0.05, rel=1e-3)
    noise = noise_estimate(clean)
    for independent in (None, found.independent):
        verdict = crossvalidate(
            experiment, base, found.experiment, found.fit, noise, independent=independent
        )
        assert verdict.accepted
    again = found.experiment
    verdict = crossvalidate(
        again, found.fit, again, found.fit, noise, independent=found.independent
    )
    assert not verdict.accepted


@pytest.mark.parametrize("deviations", [5.0, 1.0])
def test_a_shape_that_is_told_is_held_where_it_was_found_and_paid_for(deviations):
    """Height and width of a Stribeck curve go together: the height is asked for at that width."""
    found = tried("StribeckFriction@joint", 0.05)
    names = [found.model.parameter_of(found.addition, p) for p in ("tau_s", "w_s")]
    height, width = (found.fit.values[name] for name in names)
    index = [found.fit.free.index(name) for name in names]
    # Correlated by 0.9, the height is 4 deviations at its width, and 1.7 at any.
    sd = np.array([height / 4 / np.sqrt(1 - 0.9**2), width / deviations])
    covariance = found.fit.covariance.copy()
    covariance[np.ix_(index, index)] = np.outer(sd, sd) * [[1, 0.9], [0.9, 1]]
    chance = chance_of_nothing(replace(found, fit=replace(found.fit, covariance=covariance)))
    is_told = deviations > 3
    expected = 9 * 2 * stats.norm.sf(4.0) if is_told else 2 * stats.norm.sf(height / sd[0])
    assert chance == pytest.approx(expected, rel=1e-6)
