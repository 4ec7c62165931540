"""A model beside a recording: what is matched, noted and refused."""

import numpy as np
import pytest
import truth_records as truth

from fmus.frontend import load
from foundation.errors import ChannelError, ExcitationError, UnknownNameError
from identification.problem import fitted_by_default, match
from recordings import Channel, Recording, Sensor

DAE = load(truth.library("Pendulum"))


def recording(n=100, step=1e-3, channels=("tau", "theta", "omega"), sensors=None):
    time = 5.0 + np.arange(n) * step
    rng = np.random.default_rng(0)
    return Recording(
        time,
        {
            name: Channel(name, rng.normal(size=n), sensor=(sensors or {}).get(name, Sensor()))
            for name in channels
        },
        "bench.csv",
    )


def test_inputs_and_outputs_are_in_the_models_order():
    given = recording(channels=("omega", "theta", "tau"))
    found = match(DAE, given)
    assert found.output_names == ("theta", "omega")
    np.testing.assert_array_equal(found.inputs[:, 0], given["tau"].values)
    np.testing.assert_array_equal(found.outputs[:, 1], given["omega"].values)
    assert found.time[0] == 0.0
    assert found.sample_time == pytest.approx(1e-3)
    assert found.free == ("J", "mgl", "d")
    assert found.values["J"] == 0.185


def test_spare_channels_do_no_harm():
    found = match(DAE, recording(channels=("tau", "theta", "reference")))
    assert found.output_names == ("theta",)


def test_known_and_start_parameters_are_not_fitted():
    dae = load(truth.library("WheeledPendulum"))
    assert fitted_by_default(dae) == ("X1", "X2", "X3", "X4", "X5", "X6", "X7")


def test_noise_joins_sensor_and_quantiser():
    sensors = {"theta": Sensor(3e-3, 4e-3 * np.sqrt(12), 0.0), "omega": Sensor(None, None, 0.0)}
    found = match(DAE, recording(sensors=sensors))
    assert found.noise_sd[0] == pytest.approx(5e-3)
    assert np.isnan(found.noise_sd[1])


def test_what_the_user_frees_and_sets():
    found = match(DAE, recording(), free=["mgl", "mgl"], values={"d": 0.5})
    assert found.free == ("mgl",)
    assert found.values["d"] == 0.5


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"free": ["mlg"]}, UnknownNameError, "mgl"),
        ({"values": {"j": 1.0}}, UnknownNameError, "parameter 'j'"),
    ],
)
def test_unknown_parameters_are_refused(options, error, words):
    with pytest.raises(error, match=words):
        match(DAE, recording(), **options)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (recording(channels=("theta", "omega")), ChannelError, "input 'tau'"),
        (recording(channels=("tau", "speed")), ChannelError, "none of the outputs"),
        (recording(n=19), ExcitationError, "19 samples"),
    ],
)
def test_recordings_that_do_not_fit_are_refused(given, error, words):
    with pytest.raises(error, match=words) as caught:
        match(DAE, given)
    assert caught.value.where == "bench.csv"
    assert caught.value.remedy


def test_uneven_steps_are_made_equal_and_noted():
    base = recording(400)
    jitter = base.time + 1e-5 * np.random.default_rng(1).uniform(size=400)
    found = match(DAE, Recording(jitter, dict(base.channels), "bench.csv"))
    assert np.ptp(np.diff(found.time)) < 1e-12
    assert any("interpolated" in note for note in found.notes)


def test_a_part_keeps_its_times():
    found = match(DAE, recording()).part(20, 60)
    assert len(found.time) == len(found.inputs) == len(found.outputs) == 40
    assert found.time[0] == pytest.approx(0.020)
