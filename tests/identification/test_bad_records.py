"""Records that cannot answer: a verdict with its remedy, never a number without a warning."""

import numpy as np
import pytest
import truth_records as truth

import twinproof
from foundation.errors import (
    ExcitationError,
    RecordingError,
    TwinproofError,
)
from identification.doubts import about_record, check_motion, with_doubts
from identification.estimators import estimator

NOISE = [1e-3, 5e-3]
METHODS = ("auto", "output-filter", "instrumental", "output-error", "kalman")


@pytest.fixture(scope="module")
def good():
    clean = truth.pendulum_problem(4.0, 2e-3, outputs=("theta", "omega"), wrong=1.2)
    return truth.noisy(clean, NOISE, 1)


def warnings_of(method, problem):
    """All that a user is told: the error in one line, or the warnings."""
    try:
        check_motion(problem)
        return with_doubts(problem, estimator(method).estimate(problem)).warnings
    except TwinproofError as error:
        return (str(error) if error.remedy else "an error without a remedy",)


def said(method, problem, *words):
    text = " | ".join(warnings_of(method, problem))
    for word in words:
        assert word in text, (method, text)


def test_a_good_record_is_answered_without_a_word(good):
    assert warnings_of("auto", good) == ()
    assert warnings_of("output-filter", good) == ()


@pytest.mark.parametrize("method", ["output-filter", "output-error"])
def test_too_little_excitation(method):
    """A torque whose motion is thousands of times smaller than the sensors' noise."""
    n = 3000
    torque = 1e-6 * truth.swing(n, 2e-3)
    states = truth.held(truth.pendulum_rates(), [0.0, 0.0], torque, 2e-3)
    clean = truth.problem(
        truth.library("Pendulum"), torque, states, 2e-3, names=("theta", "omega"), wrong=1.2
    )
    problem = truth.noisy(clean, NOISE, 1)
    heard = " | ".join(warnings_of(method, problem))
    assert "no motion above its sensor's noise" in heard or "finite numbers" in heard
    assert "excite" in heard or "check" in heard


@pytest.mark.parametrize("method", ["auto", "output-filter", "instrumental"])
def test_collinear_and_inert_parameters(method):
    source = truth.own(
        """model A parameter Real J = 0.2; parameter Real k = 3.5; parameter Real k2 = 1;
        parameter Real idle = 2; input Real u; output Real theta(start = 0, fixed = true);
        output Real omega(start = 0, fixed = true); equation der(theta) = omega;
        J * der(omega) + (k + k2) * theta + (if theta > 50 then idle else 0) = u; end A;"""
    )
    torque = truth.swing(3000, 2e-3)
    states = truth.held(lambda _, x, u: [x[1], (u - 4.5 * x[0]) / 0.2], [0.1, 0], torque, 2e-3)
    clean = truth.problem(source, torque, states, 2e-3, names=("theta", "omega"), wrong=1.2)
    problem = truth.noisy(clean, NOISE, 1)
    said(method, problem, "idle", "held at", "apart", "k2")
    found = estimator(method).estimate(problem)
    assert found.values["J"] == pytest.approx(0.2, rel=0.01)
    assert not found.parameters["idle"].identifiable


@pytest.mark.parametrize("method", METHODS)
def test_the_wrong_sign_of_an_input(method, good):
    turned = truth.replace(good, inputs=-good.inputs)
    words = ("sign",) if method == "kalman" else ("sign of tau", "factor = -1")
    said(method, turned, *words)


@pytest.mark.parametrize("method", ["auto", "output-filter"])
def test_a_channel_quantised_to_a_constant(method, good):
    flat = truth.replace(good, outputs=good.outputs * [1.0, 0.0])
    said(method, flat, "omega is constant", "leave the channel out")


@pytest.mark.parametrize("method", METHODS)
def test_all_channels_constant_is_an_error(method, good):
    dead = truth.replace(good, outputs=np.zeros_like(good.outputs))
    said(method, dead, "constant over the whole record")


def test_steps_as_large_as_the_motion_are_named(good):
    coarse = truth.replace(good, outputs=np.round(good.outputs / [1.5, 1e-3]) * [1.5, 1e-3])
    assert len(np.unique(coarse.outputs[:, 0])) > 1
    assert "theta takes only" in " | ".join(about_record(coarse))


@pytest.mark.parametrize("method", ["auto", "output-filter", "output-error"])
def test_an_unstable_plant_that_runs_open_loop(method):
    source = truth.own(
        "model A parameter Real J = 0.2; parameter Real mgl = 3.5; input Real tau; "
        "output Real theta(start = 0, fixed = true); output Real omega(start = 0, fixed = true); "
        "equation der(theta) = omega; J * der(omega) - mgl * theta = tau; end A;"
    )
    torque = 0.02 * truth.swing(1500, 2e-3)
    states = truth.held(lambda _, x, u: [x[1], (u + 3.5 * x[0]) / 0.2], [0.0, 0], torque, 2e-3)
    clean = truth.problem(source, torque, states, 2e-3, names=("theta", "omega"), wrong=1.2)
    said(method, truth.noisy(clean, NOISE, 1), "grows without end", "closed loop")


def test_an_absurd_start_is_left_or_refused(good):
    lost = good.with_values({"J": 1e-9, "mgl": 1e6, "d": -1e3})
    found = with_doubts(lost, estimator("auto").estimate(lost))
    assert found.values["J"] == pytest.approx(0.185, rel=1e-3)
    said("output-error", lost, "starting values")


def recording(good, keep):
    t = good.time[keep]
    columns = {"tau": good.inputs[:, 0], "theta": good.outputs[:, 0], "omega": good.outputs[:, 1]}
    units = {"tau": "N.m", "theta": "rad", "omega": "rad/s"}
    channels = {
        name: twinproof.Channel(name, values[keep], units[name]) for name, values in columns.items()
    }
    return twinproof.Recording(t, channels, "run.csv", ())


def test_gaps_are_refused_and_irregular_sampling_is_told(good):
    model = twinproof.Model.of("Twinproof.Plants.Pendulum")
    keep = np.ones(len(good.time), bool)
    keep[1000:1200] = False  # 0.4 s
    with pytest.raises(RecordingError, match=r"gap of 0\.4") as caught:
        twinproof.identify(model, recording(good, keep), method="output-filter")
    assert "parts" in caught.value.remedy
    random = np.random.default_rng(1)
    keep = random.random(len(good.time)) > 0.2
    keep[::3] = True
    found = twinproof.identify(model, recording(good, keep), method="output-filter")
    assert any("uneven steps" in note for note in found.problem.notes)
    assert found.estimate.values["mgl"] == pytest.approx(3.61, rel=0.05)


def test_the_front_door_refuses_a_dead_record(good):
    model = twinproof.Model.of("Twinproof.Plants.Pendulum")
    dead = truth.replace(good, outputs=np.ones_like(good.outputs))
    with pytest.raises(ExcitationError, match="constant over the whole record"):
        twinproof.identify(model, recording(dead, np.ones(len(good.time), bool)))
