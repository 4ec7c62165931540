"""Sensors against the calibration tables they come from, and against kinematics."""

from __future__ import annotations

import numpy as np
import pytest
from front_end import EXPLICIT, load, simulate

from fmus.frontend import load as load_dae
from fmus.sources import library_class

Array = np.ndarray
DEGREE = np.pi / 180


def sense(
    sensor: str, stop: float, inputs: dict[str, str], points: int = 2001, **parameters: float
) -> dict[str, Array]:
    """Readings of a sensor `s`; the fast state keeps the steps short."""
    set_inputs = " ".join(f"s.{name} = {law};" for name, law in inputs.items())
    model = load(
        f"model Q Twinproof.Sensors.{sensor} s; Real x(start = 0, fixed = true); equation"
        f" der(x) = cos(100 * time); {set_inputs} end Q;"
    )
    return simulate(model, stop, points, {f"s.{k}": v for k, v in parameters.items()}, EXPLICIT)


@pytest.mark.parametrize("sensor", ["Encoder", "Potentiometer", "Gyroscope", "Accelerometer"])
def test_loads_through_the_front_end_without_events(sensor: str) -> None:
    dae = load_dae(library_class(f"Twinproof.Sensors.{sensor}"))
    assert not dae.when_equations
    assert all(v.unit for v in (*dae.inputs, *dae.outputs, *dae.parameters))


def test_encoder_counts_edges() -> None:
    """Eight turns of setup 1 are 52330 counts (Table 3.1), to the count that was rounded away."""
    found = sense("Encoder", 1.0, {"phi": "50.26548245743669 * time + 0.1"}, phi_0=0.1)
    assert found["s.counts"][0] == 0
    assert found["s.counts"][-1] == pytest.approx(52330, abs=8)
    np.testing.assert_array_equal(found["s.counts"], np.rint(found["s.counts"]))
    assert np.max(np.abs(found["s.angle"] - (found["s.phi"] - 0.1))) <= np.pi / 6541 * (1 + 1e-9)


def turn(first: float, last: float, **parameters: float) -> tuple[Array, Array]:
    """Angle [deg] and counts of a potentiometer that turns steadily from `first` to `last`."""
    speed = (last - first) * DEGREE
    found = sense(
        "Potentiometer",
        1.0,
        {"phi": f"{first * DEGREE} + ({speed}) * time"},
        20001,
        T=1e-4,
        x_start=first * DEGREE - np.sign(speed) * 1e-3,
        **parameters,
    )
    return found["s.phi"] / DEGREE, found["s.counts"]


SETUP_2 = {"N": 1091.0, "low": -322.0, "high_up": 701.0, "high_down": 701.0}


@pytest.mark.parametrize(
    ("setup", "exit_up", "enter_up", "exit_down", "enter_down"),
    [({}, 717, -306, -306, 640), (SETUP_2, 701, -322, -322, 701)],
    ids=["setup 1", "setup 2"],
)
def test_potentiometer_leaves_and_enters_as_tabled(
    setup: dict[str, float], exit_up: int, enter_up: int, exit_down: int, enter_down: int
) -> None:
    """Tables A.4 and A.5: the largest jump of a full turn, in both directions."""
    for first, last, before, after in (
        (0, 340, exit_up, enter_up),
        (0, -340, exit_down, enter_down),
    ):
        _, counts = turn(first, last, **setup)
        jump = int(np.argmax(np.abs(np.diff(counts))))
        assert counts[jump] == before
        assert abs(counts[jump + 1] - after) <= 1


def test_potentiometer_is_blind_for_27_degrees_downwards() -> None:
    for last, blind in ((340, 1.0), (-340, 27.4)):
        angle, counts = turn(0, last)
        edge = counts.max() if last > 0 else counts.min()
        held = angle[counts == edge]
        assert np.ptp(held) == pytest.approx(blind, abs=0.5)


def test_potentiometer_reads_quarter_turns() -> None:
    """Table A.3: about 256 counts each, and the same after whole turns."""
    angle, counts = turn(-80, 800)
    for degrees, expected in ((90, 256), (-45, -128), (360, 0), (450, 256), (720, 0)):
        assert counts[np.argmin(np.abs(angle - degrees))] == pytest.approx(expected, abs=1)


def test_gyroscope_has_bias_drift_scale_and_range() -> None:
    found = sense("Gyroscope", 2.0, {"omega": "4 * time"}, b=0.1, b_t=0.05, k=-0.1, range=5)
    time = found["time"]
    np.testing.assert_allclose(found["s.rate"], np.minimum(3.65 * time + 0.1, 5), atol=1e-12)
    assert found["s.rate"][-1] == 5


def test_accelerometer_measures_specific_force() -> None:
    """Second differences of the place of the sensor, less gravity, in the axes of the body."""
    lean = "0.3 * sin(2 * time)"
    inputs = {
        "theta": lean,
        "omega": "0.6 * cos(2 * time)",
        "alpha": "-1.2 * sin(2 * time)",
        "a": "0.8 * cos(4 * time)",
    }
    found = sense("Accelerometer", 2.0, inputs, r=0.2, b_x=0.05, b_z=-0.02)
    time, theta = found["time"], found["s.theta"]
    axis = -0.05 * np.cos(4 * time)
    place = np.array([axis + 0.2 * np.sin(theta), 0.2 * np.cos(theta)])
    step = time[1] - time[0]
    felt = np.diff(place, 2, axis=1) / step**2 + np.array([[0.0], [9.81]])
    middle = theta[1:-1]
    across = felt[0] * np.cos(middle) - felt[1] * np.sin(middle)
    along = felt[0] * np.sin(middle) + felt[1] * np.cos(middle)
    np.testing.assert_allclose(found["s.a_x"][1:-1], across + 0.05, atol=1e-5)
    np.testing.assert_allclose(found["s.a_z"][1:-1], along - 0.02, atol=1e-5)
