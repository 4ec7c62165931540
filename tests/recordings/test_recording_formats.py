"""One suite that every reader passes: a known recording, written by others, comes back."""

import gzip

import asammdf
import can
import cantools
import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io

from foundation.errors import FormatError, RecordingError, TwinproofError
from recordings import Recording, load
from recordings.readers import READERS, reader_for

DBC = """VERSION ""
BU_: X
BO_ 256 Motion: 8 X
 SG_ q : 0|32@1- (0.001,0) [0|0] "m" X
 SG_ v : 39|32@0- (0.01,0) [0|0] "m/s" X
"""
TIME = np.arange(200) * 0.005
Q = np.round(np.sin(TIME) * 1000)
V = np.round(np.cos(TIME) * 100)


def write_csv(path):
    pd.DataFrame({"time": TIME, "q": Q / 1000, "v": V / 100}).to_csv(path, index=False)


def write_mat(path):
    scipy.io.savemat(path, {"time": TIME, "q": Q / 1000, "v": V / 100})


def can_messages():
    message = cantools.database.load_string(DBC).messages[0]
    for t, q, v in zip(TIME, Q, V, strict=True):
        data = message.encode({"q": int(q), "v": int(v)}, scaling=False)
        yield can.Message(
            timestamp=t + 0.5e-9, arbitration_id=256, is_extended_id=False, data=data, channel=0
        )


def write_can(path):
    with can.Logger(path) as log:
        for message in can_messages():
            log(message)


def write_packed(path):
    plain = path.with_suffix("")
    write_can(plain)
    path.write_bytes(gzip.compress(plain.read_bytes()))
    plain.unlink()


def write_parquet(path):
    frame = pd.DataFrame({"time": TIME, "q": Q / 1000, "v": V / 100})
    table = pyarrow.Table.from_pandas(frame, preserve_index=False)
    units = {"q": "m", "v": "m/s"}
    fields = [
        f.with_metadata({"unit": units[f.name]} if f.name in units else {}) for f in table.schema
    ]
    pyarrow.parquet.write_table(table.cast(pyarrow.schema(fields)), path)


def write_mf4(path):
    with asammdf.MDF(version="4.10") as file:
        signals = [("q", Q / 1000, "m"), ("v", V / 100, "m/s")]
        file.append([asammdf.Signal(x, TIME, name=n, unit=u) for n, x, u in signals])
        file.save(path, overwrite=True)


WRITERS = {
    ".csv": write_csv,
    ".parquet": write_parquet,
    ".mat": write_mat,
    ".mf4": write_mf4,
    ".asc": write_can,
    ".trc": write_can,
    ".log": write_can,
    ".log.gz": write_packed,
    ".blf": write_can,
}


@pytest.fixture(params=WRITERS)
def written(request, tmp_path):
    path = tmp_path / f"run{request.param}"
    WRITERS[request.param](path)
    dbc = tmp_path / "bus.dbc"
    dbc.write_text(DBC)
    return path, dbc


def test_every_suffix_of_every_reader_is_tried():
    assert sorted(WRITERS) == sorted(s for reader in READERS for s in reader.suffixes)


def test_round_trip(written):
    path, dbc = written
    run = load(path, dbc=dbc, variables={"v": "m/s", "q": "m"})
    assert list(run.channels) == ["v", "q"]
    # PEAK's stamps are days since 1899 and milliseconds.
    np.testing.assert_allclose(run.time, TIME, rtol=0, atol=1e-6 if path.suffix == ".trc" else 1e-9)
    np.testing.assert_allclose(run["q"].values, Q / 1000, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(run["v"].values, V / 100, rtol=1e-14, atol=1e-15)
    assert run.origin == str(path)


def test_units_are_converted(written):
    path, dbc = written
    mapping = path.parent / "map.toml"
    mapping.write_text('[channels.speed]\nsource = "v"\nunit = "m/s"\nsd = 0.5')
    run = load(path, dbc=dbc, variables={"speed": "km/h"}, channel_map=mapping)
    np.testing.assert_allclose(run["speed"].values, V / 100 * 3.6, rtol=1e-13, atol=1e-13)
    assert run["speed"].sensor.sd == 0.5


def test_everything_is_read_without_a_model(written):
    path, dbc = written
    assert sorted(load(path, dbc=dbc).channels) == ["q", "v"]


def attempt(path, dbc):
    """The recording, or the error of ours; anything else fails the test that called."""
    try:
        return load(path, dbc=dbc, variables={"q": "m", "v": "m/s"})
    except TwinproofError as error:
        return error


@pytest.mark.parametrize("size", [0, 1, 7, 100, 0.5, 0.9, -1])
def test_a_cut_file_is_an_error_with_place_and_remedy(written, size):
    path, dbc = written
    content = path.read_bytes()
    path.write_bytes(content[: int(size * len(content)) if isinstance(size, float) else size])
    result = attempt(path, dbc)
    if isinstance(result, Recording):
        # Text cut within its last number, or between two bytes, cannot be told from a whole file.
        assert path.suffix in (".csv", ".log", ".asc", ".trc")
        sure = len(result) - (path.suffix == ".csv")
        np.testing.assert_allclose(result["q"].values[:sure], Q[:sure] / 1000, atol=1e-15)
        np.testing.assert_allclose(result["v"].values[:sure], V[:sure] / 100, atol=1e-15)
    else:
        assert result.where
        assert result.remedy
        assert result.exit_status == 2


@pytest.mark.parametrize("seed", range(10))
def test_a_damaged_file_never_raises_anything_else(written, seed):
    path, dbc = written
    rng = np.random.default_rng(seed)
    content = bytearray(path.read_bytes())
    for k in rng.integers(len(content), size=8):
        content[k] = int(rng.integers(256))
    path.write_bytes(content)
    assert isinstance(attempt(path, dbc), (Recording, TwinproofError))


def test_an_empty_file_says_so(written):
    path, dbc = written
    path.write_bytes(b"")
    with pytest.raises(FormatError) as caught:
        load(path, dbc=dbc)
    assert str(path) in str(caught.value)
    assert caught.value.remedy


def test_a_missing_file_offers_its_neighbours(written):
    path, dbc = written
    with pytest.raises(RecordingError, match="no such file") as caught:
        load(path.with_name("ran" + path.name[3:]), dbc=dbc)
    assert path.name in caught.value.remedy


def test_unknown_suffix_lists_the_known_ones(tmp_path):
    path = tmp_path / "run.xlsx"
    path.write_bytes(b"PK")
    with pytest.raises(
        FormatError, match=r"'\.xlsx'.*convert it to one of: \.csv, \.parquet, \.mat"
    ):
        load(path)
    assert reader_for(path.with_name("RUN.LOG.GZ")) is reader_for(path.with_name("a.log"))
