"""The truth simulator hides an effect by name; the diagnosis has to name it, or say `complete`."""

from functools import cache

import numpy as np
import pytest
import truth_records as truth

from examples import make_demo_recording as simulator
from fmus.frontend import load
from identification.discovery.diagnosis import Outcome, diagnose
from identification.discovery.extension import extend
from identification.estimators.start import best_start
from identification.experiment import Experiment
from identification.problem import match
from recordings import Channel, Recording, Sensor

SOURCE = truth.library("WheeledPendulum")
UNITS = {"theta_w": "rad", "theta_p": "rad", "omega_p": "rad/s", "V": "V"}
SENSORS = {
    "theta_w": Sensor(resolution=simulator.COUNT),
    "theta_p": Sensor(sd=simulator.PITCH_NOISE),
    "omega_p": Sensor(sd=simulator.PITCH_NOISE),
    "V": Sensor(),
}


def recording(effects, seed=1, duration=8.0):
    run = simulator.simulate(effects, seed=seed, duration=duration)
    channels = {
        name: Channel(name, values, UNITS[name], SENSORS[name])
        for name, values in run.channels.items()
    }
    return Recording(run.time, channels, "truth")


@cache
def diagnosed(name="", size=0.0, seed=1, duration=8.0):
    problem = match(load(SOURCE), recording({name: size} if name else {}, seed, duration))
    experiment = Experiment.of(problem)
    fit = experiment.fit_stages(best_start(experiment).values)[-1]
    return diagnose(extend(SOURCE, []), experiment, fit), fit


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_hidden_is_complete(seed):
    found, fit = diagnosed(seed=seed)
    assert found.outcome is Outcome.COMPLETE
    assert found.chosen is None
    assert found.ties == ()
    assert found.ranking
    for name, value in truth.X.items():
        k = fit.free.index(name)
        assert abs(fit.values[name] - value) < 5 * np.sqrt(fit.covariance[k, k])


HIDDEN = [
    ("coulomb_wheel", 3.0, "CoulombFriction@wheel"),
    ("coulomb_body", 5.0, "CoulombFriction@body"),
    ("quadratic_drag_wheel", 0.5, "QuadraticDrag@wheel"),
    ("constant_torque_wheel", 10.0, "ConstantTorque@wheel"),
    ("input_dead_zone", 0.3, "DeadZone@V"),
    ("input_offset", 0.1, "Offset@V"),
    ("pitch_bias", np.radians(0.3), "Offset@theta_p"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size", "label"), HIDDEN)
def test_a_hidden_effect_is_named_first_and_sized(name, size, label):
    found, _ = diagnosed(name, size)
    at_a_sensor = label.endswith("@theta_p")
    assert found.outcome is (Outcome.SENSOR if at_a_sensor else Outcome.EFFECT)
    assert found.chosen is not None
    assert found.chosen.addition.label == label
    first = found.ranking[0]
    assert first.label == label
    assert first.refitted
    assert found.checks[label].accepted
    ((value, sd, unit),) = first.parameters.values()
    assert value == pytest.approx(size, rel=0.05)
    assert abs(value - size) < 5 * sd
    assert unit in ("N.m", "N.m.s2/rad2", "V", "rad")


@pytest.mark.slow
def test_a_gain_at_the_input_is_the_plants_own():
    """All lumped parameters are in volts: they absorb it, and nothing is missing."""
    found, fit = diagnosed("input_gain", 0.1)
    assert found.outcome is Outcome.COMPLETE
    for name, value in truth.X.items():
        assert fit.values[name] == pytest.approx(value / 1.1, rel=0.02)


def test_the_ranking_lists_every_candidate_once():
    found, _ = diagnosed("coulomb_wheel", 3.0)
    labels = [row.label for row in found.ranking]
    assert len(labels) == len(set(labels))
    assert len(labels) + len(found.skipped) > 35
    refitted = [row.refitted for row in found.ranking]
    assert refitted == sorted(refitted, reverse=True), "refits come first"
    assert all(0 <= row.explains <= 1 for row in found.ranking if row.refitted and row.evidence > 0)


def test_declared_values_that_run_away_are_no_place_to_look():
    """Where a fit is far from them, candidates are scored there too, if anything can be."""
    clean = truth.pendulum_problem(coulomb=0.1, outputs=("theta", "omega"), values={"d": -1e5})
    given = truth.noisy(clean, [1e-3, 1e-2], 1)
    experiment, fit = Experiment.of(given).followed({**given.values, "d": 0.006})
    assert np.all(fit.at.rms > 3 * given.noise_sd)
    found = diagnose(extend(truth.library("Pendulum"), []), experiment, fit)
    assert found.chosen is not None
    assert found.chosen.addition.label == "CoulombFriction@joint"
