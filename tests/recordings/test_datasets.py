"""The registered data sets: their entries, how files are found, and the real files if there are."""

import hashlib
import http.server
import os
import re
import tomllib
from functools import partial
from pathlib import Path
from threading import Thread

import numpy as np
import pandas as pd
import pooch
import pytest
import scipy.io

from foundation.errors import FormatError, RecordingError, UnknownNameError
from recordings import fetch, list_sets, load, load_signals, parse_map
from recordings.datasets import DataFile, DataSet, files

NAMES = [data_set.name for data_set in list_sets()]
PLANTS = {
    "emps": {"q": "m", "v": "m/s", "vir": "V"},
    "dfki": {"theta": "rad", "omega": "rad/s", "tau": "N.m"},
    "silverbox": {"u": "V", "y": "V"},
    "motec": {"v": "m/s", "delta": "rad", "yaw_rate": "rad/s"},
}
FOLDER = os.environ.get("TWINPROOF_DATA")
real = pytest.mark.skipif(not FOLDER, reason="TWINPROOF_DATA does not name the data sets' folder")


@pytest.mark.parametrize("data_set", list_sets(), ids=NAMES)
def test_entries_are_complete(data_set):
    assert re.fullmatch(r"[0-9a-f]{40}", data_set.commit)
    assert data_set.licence in {"MIT", "BSD-3-Clause", "WTFPL"}
    assert data_set.title
    assert data_set.citation
    assert data_set.url(data_set.data).startswith(
        f"https://raw.githubusercontent.com/{data_set.repository}/"
    )
    for file in filter(None, (data_set.data, data_set.dbc)):
        assert re.fullmatch(r"[0-9a-f]{64}", file.sha256)
    parse_map(data_set.map_text)


def test_names_are_those_of_the_command_line():
    assert {"emps", "emps-pulses", "silverbox", "motec-car", "dfki-ddp"} <= set(NAMES)
    with pytest.raises(UnknownNameError, match="did you mean emps"):
        fetch("emsp")


CONTENT = b"time,x\n0,1\n1,2\n"


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A registered set of a few bytes; neither in a local folder nor in the empty cache."""
    file = DataFile("dir/a.csv", "Small/a.csv", hashlib.sha256(CONTENT).hexdigest())
    entry = DataSet(
        "small", "t", "o/r", "0" * 40, "MIT", "c", file, None, '[channels.y]\nsource = "x"'
    )
    monkeypatch.setattr(files, "find", lambda name: entry)
    monkeypatch.setattr("recordings.datasets.find", lambda name: entry)
    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / "cache" / name)
    monkeypatch.setenv("TWINPROOF_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setattr(DataSet, "url", lambda self, file: "http://127.0.0.1:9/none")
    return tmp_path


@pytest.fixture
def served(tmp_path, monkeypatch):
    """Serves a folder in the origin's place; gives the folder and the requests there were."""
    origin, asked = tmp_path / "origin", []
    origin.mkdir()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args):
            asked.append(self.path)

    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Handler, directory=origin)
    ) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        url = f"http://127.0.0.1:{server.server_address[1]}/a.csv"
        monkeypatch.setattr(DataSet, "url", lambda self, file: url)
        yield origin, asked
        server.shutdown()
        thread.join()


def local(folder, content):
    path = folder / "data" / "Small" / "a.csv"
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    return path


def test_the_local_folder_comes_first(small):
    path = local(small, CONTENT)
    assert fetch("small").data == path
    run = load("small")
    assert run["y"].values.tolist() == [1, 2]
    assert run.origin == "small (o/r@0000000, dir/a.csv)"


def test_a_local_file_of_other_content_is_refused(small):
    path = local(small, CONTENT)
    assert fetch("small").data == path
    path.write_bytes(CONTENT + b"2,3\n")
    with pytest.raises(FormatError, match=r"SHA-256 differs\) .*a\.csv.*TWINPROOF_DATA"):
        fetch("small")


def test_offline_names_the_variable_and_the_file(small):
    with pytest.raises(
        RecordingError, match=r"'small' is not on this machine .*TWINPROOF_DATA .*Small/a\.csv"
    ):
        fetch("small")
    assert not list((small / "cache").rglob("*.csv"))


def test_download_once_into_the_cache(small, served):
    origin, asked = served
    (origin / "a.csv").write_bytes(CONTENT)
    path = fetch("small").data
    assert path.read_bytes() == CONTENT
    assert path.is_relative_to(small / "cache" / "twinproof" / "Small")
    assert fetch("small").data == path
    assert len(asked) == 1


def test_a_wrong_download_is_refused_and_not_kept(small, served):
    origin, _ = served
    (origin / "a.csv").write_bytes(b"<html>log in</html>")
    with pytest.raises(FormatError, match="not the registered file"):
        fetch("small")
    assert not list((small / "cache").rglob("*.csv"))
    (origin / "a.csv").unlink()
    with pytest.raises(RecordingError, match="cannot be downloaded: HTTPError"):
        fetch("small")


@real
@pytest.mark.parametrize("name", [n for n in NAMES if n != "css-gnss"])
def test_every_set_is_read_into_its_plants_variables(name):
    variables = next(v for k, v in PLANTS.items() if name.startswith(k))
    run = load(name, variables=variables)
    assert set(run.channels) >= set(variables) - {"v" if name.startswith("emps") else ""}
    assert all(run[n].unit == variables[n] for n in run.channels)
    assert name in run.origin
    even = run.uniform()
    assert abs(len(even) - len(run)) <= 0.002 * len(run)
    assert even.uniform() is even


@real
@pytest.mark.parametrize("name", ["emps", "emps-pulses"])
def test_emps_is_what_scipy_reads(name):
    run = load(name, variables=PLANTS["emps"])
    expected = scipy.io.loadmat(fetch(name).data)
    for channel, source in {"q": "qm", "vir": "vir"}.items():
        assert np.array_equal(run[channel].values, expected[source].ravel())
    assert np.array_equal(run.time, expected["t"].ravel())
    assert run.duration == pytest.approx(24.84)
    assert "qg" in run.notes[0]


@real
def test_dfki_is_what_pandas_reads_with_its_true_resolution():
    run = load("dfki-ddp", variables=PLANTS["dfki"])
    table = pd.read_csv(fetch("dfki-ddp").data)
    assert np.array_equal(run["theta"].values, table["position"])
    for channel in run.channels.values():
        steps = np.diff(np.unique(channel.values)) / channel.sensor.resolution
        steps = steps[steps > 1e-3]
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)


@real
def test_the_car_is_what_python_can_and_cantools_read():
    import can
    import cantools

    run = load("motec-car", variables=PLANTS["motec"])
    where = fetch("motec-car")
    message = cantools.database.load_file(where.dbc).get_message_by_name("ID_D0")
    frames = list(can.LogReader(where.data))
    start = frames[0].timestamp
    chosen = [f for f in frames if f.arbitration_id == message.frame_id]
    time = np.array([f.timestamp - start for f in chosen])
    steering = -np.deg2rad([message.decode(f.data)["STEER_ANGLE"] for f in chosen])
    np.testing.assert_allclose(run["delta"].values, np.interp(run.time, time, steering), atol=1e-6)
    assert run["delta"].sensor.resolution == pytest.approx(np.deg2rad(0.1))
    assert run.duration == pytest.approx(90.24, abs=0.01)


@real
def test_the_logger_is_what_asammdf_and_cantools_read():
    import asammdf

    files_of_set = fetch("css-gnss")
    run = load_signals("css-gnss", variables={"Speed": "m/s", "AngularRateZ": "deg/s"})
    with asammdf.MDF(files_of_set.data) as file:
        names = [c.name for c in file.groups[0].channels]
        start = file.get(group=0, index=names.index("CAN_DataFrame")).timestamps[0]
        decoded = file.extract_bus_logging({"CAN": [(files_of_set.dbc, 0)]})
        for name, signal in run.samples.items():
            expected = decoded.get(name)
            np.testing.assert_allclose(signal.time, expected.timestamps - start, atol=1e-9)
            np.testing.assert_allclose(signal.values, expected.samples, rtol=1e-12)
        decoded.close()
    assert len(run["Speed"]) == 355
    assert len(run["AngularRateZ"]) == 36884
    recording = load("css-gnss", variables={"Speed": "m/s", "AngularRateZ": "rad/s"})
    assert "interpolated to the times of 'AngularRateZ': Speed" in recording.notes
    assert len(recording.raw["Speed"]) == 355


@real
def test_the_users_map_adds_to_that_of_the_set(tmp_path):
    mapping = tmp_path / "map.toml"
    mapping.write_text('[channels.reference]\nsource = "qg"\nsd = 1e-6')
    run = load("emps", variables={"q": "m", "reference": "m"}, channel_map=mapping)
    assert list(run.channels) == ["q", "reference"]
    assert run["reference"].sensor.sd == 1e-6
    mapping.write_text("[channels.q]\nsd = 2e-6")
    run = load("emps", variables={"q": "m"}, channel_map=mapping)
    assert run["q"].sensor.sd == 2e-6
    assert run["q"].values[0] == 7.45e-6


def test_the_registry_has_no_unused_origin_or_map():
    folder = Path(files.__file__).parent
    document = tomllib.loads((folder / "registry.toml").read_text())
    sets = document["sets"].values()
    assert {s["origin"] for s in sets} == set(document["origins"])
    assert {s["map"] for s in sets} == {path.stem for path in (folder / "maps").iterdir()}
