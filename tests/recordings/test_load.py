"""From a file to the model's names and units."""

import numpy as np
import pytest

from foundation.errors import ChannelError, RecordingError, UnitError, UnknownNameError
from recordings import Sensor, load

CSV = "time,theta,rate,spare\n0,0,10,9\n0.5,90,20,9\n1,180,30,9\n"


@pytest.fixture
def run(tmp_path):
    path, mapping = tmp_path / "run.csv", tmp_path / "map.toml"
    path.write_text(CSV)

    def loader(text=None, **options):
        if text is not None:
            mapping.write_text(text)
            options["channel_map"] = mapping
        return load(path, **options)

    return loader


def test_a_column_of_unknown_unit_is_in_the_models(run):
    recording = run(variables={"theta": "rad"})
    assert recording["theta"].values.tolist() == [0, 90, 180]
    assert recording["theta"].unit == "rad"


def test_maps_name_convert_and_describe(run):
    recording = run(
        '[channels.phi]\nsource = "theta"\nunit = "deg"\nsd = 0.01\n[channels.rate]\nunit = "rpm"',
        variables={"phi": "rad", "rate": "rad/s"},
    )
    np.testing.assert_allclose(recording["phi"].values, [0, np.pi / 2, np.pi], rtol=1e-15)
    np.testing.assert_allclose(
        recording["rate"].values, np.array([1, 2, 3]) * np.pi / 3, rtol=1e-12
    )
    assert recording["phi"].sensor == Sensor(sd=0.01)


def test_offsets_of_temperatures(run):
    recording = run('[channels.T]\nsource = "theta"\nunit = "degC"', variables={"T": "K"})
    np.testing.assert_allclose(recording["T"].values, [273.15, 363.15, 453.15])


def test_a_model_without_units_takes_the_recorded_ones(run):
    recording = run('[channels.theta]\nunit = "deg"', variables={"theta": ""})
    assert recording["theta"].unit == "deg"
    assert recording["theta"].values.tolist() == [0, 90, 180]


def test_order_is_the_models_and_the_rest_is_said(run):
    recording = run(variables={"rate": "rad/s", "omega": "rad/s", "theta": "rad"})
    assert list(recording.channels) == ["rate", "theta"]
    assert recording.notes == ("ignored, not of the model: spare", "not recorded: omega")


def test_without_a_model_everything_is_there_under_mapped_names(run):
    recording = run('[channels.phi]\nsource = "theta"\nunit = "deg"')
    assert sorted(recording.channels) == ["phi", "rate", "spare"]
    assert recording["phi"].unit == "deg"


def test_time_may_be_in_other_units_or_steps(run):
    ms = run('[time]\nsource = "rate"\nunit = "ms"', variables={"theta": "rad"})
    np.testing.assert_allclose(ms.time, [0.01, 0.02, 0.03])
    steps = run("[time]\nstep = 0.25", variables={"theta": "rad"})
    assert steps.time.tolist() == [0, 0.25, 0.5]


@pytest.mark.parametrize(
    ("text", "error", "pattern"),
    [
        ('[channels.phi]\nsource = "thet"', ChannelError, "no column 'thet'.*did you mean theta"),
        (
            '[channels.psi]\nsource = "theta"',
            ChannelError,
            r"no variable 'psi' .*\[channels.psi\].*phi",
        ),
        (
            '[channels.phi]\nsource = "theta"\nunit = "m"',
            UnitError,
            "'m' cannot be .* 'rad'.*theta",
        ),
        ('[channels.phi]\nsource = "theta"\nunit = "furlongg"', UnitError, "not known"),
        (
            '[time]\nsource = "theta"\nunit = "m"\n[channels.phi]\nsource = "rate"',
            UnitError,
            "time",
        ),
    ],
)
def test_wrong_maps(run, text, error, pattern):
    with pytest.raises(error, match=pattern):
        run(text, variables={"phi": "rad"})


def test_neither_file_nor_data_set(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        UnknownNameError, match=r"unknown data set or file 'empss'; did you mean emps"
    ):
        load("empss")
    with pytest.raises(RecordingError, match=r"no such file \(runs/a.csv\)"):
        load("runs/a.csv")
    with pytest.raises(RecordingError, match=r"a folder"):
        load(tmp_path)
    (tmp_path / "run1.csv").write_text(CSV)
    with pytest.raises(RecordingError, match=r"did you mean run1.csv"):
        load("run.csv")
