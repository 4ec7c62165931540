"""Sensors that are wrong, told from dynamics that are missing: against SciPy's simulations."""

import numpy as np
import pytest
import truth_records as truth
from scipy.signal import lfilter

from identification.discovery.diagnosis import Outcome, diagnose
from identification.discovery.extension import extend
from identification.experiment import Experiment

PENDULUM = truth.library("Pendulum")
STEP, SD = 5e-3, np.array([1e-3, 1e-2])


def record(fault=None, *, coulomb=0.0, seed=1):
    """A driven pendulum whose angle passes a fault before its noise is added."""
    t = np.arange(2000) * STEP
    torque = 1.2 * (np.sin(1.1 * t) + np.sin(2.3 * t + 1) + np.sin(4.7 * t + 2))
    states = truth.held(truth.pendulum_rates(coulomb=coulomb), [0.3, 0.0], torque, STEP)
    if fault is not None:
        states[:, 0] = fault(states[:, 0])
    noisy = states + SD * np.random.default_rng(seed).standard_normal(states.shape)
    return truth.problem(PENDULUM, torque[:, None], noisy, STEP, names=("theta", "omega"), sd=SD)


def late(angle, lag=0.03):
    share = -np.expm1(-STEP / lag)
    start = [(1 - share) * angle[0]]
    return lfilter([share], [1, share - 1], angle, zi=start)[0]


def shifted(angle, delay=0.04):
    """Later by whole samples; before the record, the angle ran on as it begins."""
    count = round(delay / STEP)
    slope = angle[1] - angle[0]
    return np.concatenate([angle[0] - slope * np.arange(count, 0, -1), angle[:-count]])


def diagnosed(problem):
    experiment = Experiment.of(problem)
    return diagnose(extend(PENDULUM, []), experiment, experiment.fit_stages()[-1])


@pytest.mark.parametrize(
    ("fault", "label"),
    [
        (lambda angle: angle + 0.05, "Offset@theta"),
        (lambda angle: 1.05 * angle, "Gain@theta"),
        (late, "FirstOrderLag@theta"),
        (shifted, "Delay@theta"),
    ],
    ids=["bias", "scale", "lag", "delay"],
)
def test_a_wrong_sensor_is_called_one(fault, label):
    found = diagnosed(record(fault))
    assert found.outcome is Outcome.SENSOR
    labels = {found.chosen.addition.label, *(name for tie in found.ties for name in tie)}
    assert label in labels
    assert all(name.endswith("@theta") for name in labels)


def test_how_late_a_sensor_is():
    chosen = diagnosed(record(shifted)).chosen
    assert chosen.addition.label == "Delay@theta"
    index = chosen.fit.free.index(chosen.model.parameter_of(chosen.addition, "T"))
    sd = np.sqrt(chosen.fit.covariance[index, index])
    assert abs(chosen.addition.values["T"] - 0.04) < 5 * sd < 2e-3


def test_missing_friction_is_no_sensors_fault():
    found = diagnosed(record(coulomb=0.05))
    assert found.outcome is Outcome.EFFECT
    assert found.chosen.addition.label == "CoulombFriction@joint"


def test_a_sensors_fault_that_explains_a_part_is_not_all():
    """With friction missing too, more than a tenth of the error above the noise stays."""
    found = diagnosed(record(lambda angle: angle + 0.05, coulomb=0.1))
    assert found.outcome is not Outcome.SENSOR
    assert found.chosen is not None


def test_nothing_is_wrong_with_right_sensors():
    found = diagnosed(record(seed=2))
    assert found.outcome is Outcome.COMPLETE
