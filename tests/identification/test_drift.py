"""Moved parameters against missing effects: records by SciPy, on a pendulum that was verified."""

import numpy as np
import pytest
import truth_records as truth

from foundation.errors import InputError, UnknownNameError
from identification.discovery.drift import Change, missing_or_drifted
from identification.priors import Prior

PENDULUM = truth.library("Pendulum")
KNOWN = {"J": Prior(0.185, 5e-4), "mgl": Prior(3.61, 5e-3), "d": Prior(0.006, 5e-4)}
STEP, SD = 5e-3, 1e-3


def record(seed=1, **changed):
    t = np.arange(1600) * STEP
    torque = 0.8 * (np.sin(1.1 * t) + np.sin(2.3 * t + 1) + np.sin(4.7 * t + 2))
    states = truth.held(truth.pendulum_rates(**changed), [0.3, 0.0], torque, STEP)
    theta = states[:, :1] + SD * np.random.default_rng(seed).standard_normal((len(t), 1))
    return truth.problem(PENDULUM, torque[:, None], theta, STEP, names=("theta",), sd=[SD])


@pytest.mark.parametrize(
    ("name", "value", "twin"),
    [("mgl", 3.8, "Imbalance@joint"), ("J", 0.2, ""), ("d", 0.03, "ViscousFriction@joint")],
    ids=["mgl", "J", "d"],
)
def test_a_moved_parameter_is_no_missing_effect(name, value, twin):
    """Where an effect is the parameter's own law once more, both are said."""
    found = missing_or_drifted(PENDULUM, record(**{name: value}), KNOWN)
    best = found.moved[0]
    assert found.change is (Change.EITHER if twin else Change.DRIFTED)
    if twin:
        assert found.effect == twin
    assert list(best.values) == [name]
    before, now, sd = best.values[name]
    assert before == KNOWN[name].value
    assert now == pytest.approx(value, abs=4 * sd)
    assert best.deviations > 3


def test_a_missing_effect_is_no_moved_parameter():
    found = missing_or_drifted(PENDULUM, record(coulomb=0.05), KNOWN)
    assert found.change is Change.MISSING
    assert found.effect == "CoulombFriction@joint"
    assert found.effect_merit > found.moved[0].merit


def test_nothing_has_happened():
    found = missing_or_drifted(PENDULUM, record(seed=3), KNOWN)
    assert found.change is Change.NOTHING
    assert found.effect == ""


def test_what_was_never_known_so_well_has_not_moved():
    vague = {**KNOWN, "mgl": Prior(3.7, 0.1)}
    found = missing_or_drifted(PENDULUM, record(seed=4), vague)
    assert found.change is Change.NOTHING
    assert found.moved[0].evidence > 10


def test_mistakes():
    with pytest.raises(InputError, match="no verified value"):
        missing_or_drifted(PENDULUM, record(), {})
    with pytest.raises(UnknownNameError, match="mgl"):
        missing_or_drifted(PENDULUM, record(), {"mgk": Prior(1.0, 1.0)})
