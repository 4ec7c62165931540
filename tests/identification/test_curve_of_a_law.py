"""A law of nearly the library's shape: named, and a curve takes up what its shape leaves over."""

from functools import cache

import numpy as np
import pytest
import truth_records as truth

from fmus.frontend import load
from fmus.places import places
from identification.discovery.climb import climb
from identification.discovery.diagnosis import Outcome
from identification.discovery.effects import find_effects
from identification.discovery.extension import Addition, extend
from identification.discovery.ladder import improve
from identification.experiment import Experiment
from twinproof.report import wording

STEP = 2e-3
J, MGL, D = 0.185, 3.61, 0.006
PENDULUM = truth.library("Pendulum")


def rates(_, x, torque):
    # Drag with a power of 1.7, where the library's is 2.
    drag = 0.03 * x[1] * abs(x[1]) ** 0.7
    return [x[1], (torque - MGL * np.sin(x[0]) - D * x[1] - drag) / J]


def record(seed, phase):
    n = 5001
    time = np.arange(n) * STEP
    torque = 0.9 * np.sin(4.1 * time + phase) + 0.5 * np.sin(7.3 * time) + 0.2 * np.sin(17 * time)
    states = truth.held(rates, [0.4, -0.5], torque, STEP)
    clean = truth.problem(PENDULUM, torque, states, STEP, names=("theta", "omega"))
    return truth.noisy(clean, [1e-4, 1e-3], seed)


@cache
def improved():
    return improve(PENDULUM, record(1, 0.0), record(2, 1.0), max_effects=3, horizon=1.0)


def test_the_law_is_named_and_the_curve_comes_after_it():
    found = improved()
    assert [a.label for a in found.added] == ["QuadraticDrag@joint", "EmpiricalOverSpeed@joint"]
    assert found.steps[-1].verdict.accepted
    # A curve says what acts, not why.
    assert found.outcome is Outcome.UNKNOWN_SHAPE
    assert found.steps[-1].diagnosis.ranking == ()


def test_unseen_errors_fall_towards_the_noise_with_the_curve():
    named, curve = (step.holdout.prediction for step in improved().steps[-2:])
    assert np.all(named.rmse > 3 * named.floor)
    # The unseen record is a little faster at its fastest than the curve has been drawn.
    assert np.all(curve.rmse < 1.6 * curve.floor)


def test_the_inertia_is_found_through_the_curve():
    named, curve = improved().steps[-2:]
    for name, true in (("J", J), ("mgl", MGL)):
        assert abs(curve.fit.values[name] - true) < abs(named.fit.values[name] - true)
        assert curve.fit.values[name] == pytest.approx(true, rel=5e-4)


def test_what_the_curve_can_stand_for_is_said_to_be_unsure():
    """A curve over speed has viscous friction in it."""
    fit = improved().steps[-1].fit
    sd = np.sqrt(fit.covariance[fit.free.index("d"), fit.free.index("d")])
    assert D / 3 < sd < 3 * D
    assert abs(fit.values["d"] - D) < 3 * sd


def test_the_report_says_that_the_curve_explains_nothing():
    found = improved()
    assert wording.improvement_headline(found) == "QuadraticDrag at joint is missing from Pendulum"
    assert "EmpiricalOverSpeed at joint: a curve drawn from these data" in wording.remaining(found)


def test_the_written_model_has_every_value_that_was_scored():
    """The range of the curve too, which is known and not fitted."""
    step = improved().steps[-1]
    written = load(step.model.source).parameter_values
    scored = step.fit.values
    assert scored["empiricalOverSpeed_joint.highest"] > 3
    starts = set(load(step.model.source).start_parameters)
    for name in set(scored) - starts:
        assert written[name] == pytest.approx(scored[name], rel=1e-6, abs=1e-12), name


def test_a_curve_is_one_of_the_effects_that_may_be_added():
    given = record(1, 0.0)
    experiment, fit = Experiment.of(given).followed(given.values)
    rungs = climb(extend(PENDULUM, []), experiment, fit, max_effects=1)
    assert [a.label for a in rungs[-1].model.additions] == ["QuadraticDrag@joint"]


def test_a_curve_stands_before_the_limit_of_its_signal():
    """Behind it nothing is left of what the limit cuts off."""
    at = next(place for place in places(PENDULUM) if place.kind == "input")
    signal = {e.name: e for e in find_effects() if e.kind == "signal"}
    additions = [Addition(signal[name], at) for name in ("Saturation", "EmpiricalOverSignal")]
    text = extend(PENDULUM, additions).source.text
    assert "empiricalOverSignal_tau.u = tau;" in text
    assert "saturation_tau.u = empiricalOverSignal_tau.y;" in text
