"""What is said of a drift: a parameter that moved, or an effect that appeared."""

import numpy as np
import pytest
from pendulum_bus import DISTURBANCE, RATE, SD, TRUE, motion

from twin.diagnosis import diagnose
from twin.excerpt import Excerpt

SENSORS = np.array(list(SD.values()))
VERIFIED = {n: 0.005 * v for n, v in TRUE.items()}


def since(rows, disturbance=None):
    """Return the excerpt of a motion, with the parameters as verified."""
    stated = None if disturbance is None else np.array([disturbance])
    plant = "Twinproof.Plants.Pendulum"
    columns = ("theta", "omega")
    values = {**TRUE, "theta_start": 0.0, "omega_start": 0.0}
    return Excerpt(
        *(plant, (), 1 / RATE, rows[:, 1:2], rows[:, 2:], columns, SENSORS, tuple(TRUE), values),
        disturbance_sd=stated,
    )


def test_a_parameter_that_moved_is_no_effect_also_where_samples_are_missing():
    rows = motion(10, 4, change=lambda _: {"J": 0.25})
    rows[1::2, 3] = np.nan  # a sensor at half the rate
    found = diagnose(since(rows), VERIFIED)
    assert (found.verdict, found.name) == ("parameter", "J")
    assert found.parameters["J"] == pytest.approx(0.25, rel=0.05)


def test_innovations_that_are_as_they_should_be_say_which_parameter_moved_and_where_all_are_now():
    rows = motion(10, 4, change=lambda _: {"J": 0.25})
    found = diagnose(since(rows, DISTURBANCE), VERIFIED)
    assert (found.verdict, found.name) == ("parameter", "J")
    assert found.parameters["J"] == pytest.approx(0.25, rel=0.03)
    sd = np.sqrt(np.diag(found.fit.covariance))
    for name, error in zip(found.fit.names, sd, strict=True):
        truth = {**TRUE, "J": 0.25}[name]
        assert abs(found.fit.values[name] - truth) < 4 * error
        assert error < 0.1 * truth


def test_several_parameters_that_moved_are_not_taken_for_one():
    rows = motion(10, 4, change=lambda _: {"J": 0.25, "mgl": 4.2})
    found = diagnose(since(rows, DISTURBANCE), VERIFIED)
    assert (found.verdict, found.because) == ("undetermined", "several parameters moved")
    assert found.parameters["mgl"] == pytest.approx(4.2, rel=0.03)


@pytest.mark.parametrize("stated", [None, DISTURBANCE])
def test_friction_does_not_pass_for_a_disturbance(stated):
    """Innovations alone explain this record by a large one, and name nothing."""
    rows = motion(10, 3, friction=lambda _: 0.3, command=slow)
    found = diagnose(since(rows, stated), VERIFIED)
    assert (found.verdict, found.name) == ("effect", "CoulombFriction@joint")
    assert found.parameters["tau_c"] == pytest.approx(0.3, rel=0.15)


def slow(time):
    return 2.4 * np.sin(1.3 * time) + 1.0 * np.sin(3.1 * time)
