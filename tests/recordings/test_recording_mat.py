"""MATLAB files: vectors, structs, and what cannot be a channel."""

import numpy as np
import pytest
import scipy.io

from foundation.errors import ChannelError, FormatError, TimeError, TwinproofError
from recordings import load

TIME = np.arange(5) * 0.1


@pytest.fixture
def mat(tmp_path):
    def write(**variables):
        path = tmp_path / "run.mat"
        scipy.io.savemat(path, variables)
        return path

    return write


@pytest.mark.parametrize("shape", [(5, 1), (1, 5)])
def test_rows_and_columns_are_vectors(mat, shape):
    path = mat(time=TIME.reshape(shape), q=np.arange(5, dtype=np.uint8).reshape(shape), gain=3.0)
    run = load(path, variables={"q": "m"})
    assert run["q"].values.tolist() == [0, 1, 2, 3, 4]
    assert run.notes == ()


def test_fields_of_structs_have_dotted_names(mat, tmp_path):
    path = mat(log={"t": TIME, "axis": {"q": TIME * 2}})
    mapping = tmp_path / "map.toml"
    mapping.write_text('[channels.q]\nsource = "log.axis.q"\n[time]\nsource = "log.t"\nunit = "ms"')
    run = load(path, variables={"q": "m"}, channel_map=mapping)
    np.testing.assert_allclose(run.time, TIME / 1000)
    assert run["q"].values.tolist() == (TIME * 2).tolist()


def test_matrices_are_left_out_and_said(mat):
    path = mat(time=TIME, q=TIME, states=np.zeros((5, 3)), text="hello", z=TIME * 1j)
    run = load(path, variables={"q": "m"})
    assert run.notes == ("matrices are not read: states 5x3",)


@pytest.mark.parametrize(
    ("variables", "error", "text"),
    [
        ({"gain": 1.0, "name": "x"}, FormatError, "no vector in the file: no numeric variable"),
        ({"x": np.zeros((5, 3))}, FormatError, "only x 5x3.*vector of its own"),
        ({"time": TIME, "q": TIME[:4]}, ChannelError, "'q' has 4 values, time .* has 5"),
        ({"q": TIME}, TimeError, "no column 'time'"),
        ({"time": TIME, "q": TIME * np.nan}, ChannelError, "'q' is nan .*row 1, 0 s"),
        ({"time": TIME[::-1].copy(), "q": TIME}, TimeError, "goes back"),
    ],
)
def test_unusable_content(mat, variables, error, text):
    with pytest.raises(error, match=text):
        load(mat(**variables), variables={"q": "m"})


@pytest.mark.parametrize("compressed", [False, True])
def test_no_damage_ends_the_process(tmp_path, compressed):
    # SciPy's reader crashes, rather than raises, on many of these files: see mat5.
    path = tmp_path / "run.mat"
    content = {"time": TIME, "s": {"q": TIME, "name": "abc"}, "c": np.array([TIME, "x"], object)}
    scipy.io.savemat(path, content, do_compression=compressed)
    whole = path.read_bytes()
    assert load(path)["s.q"].values.tolist() == TIME.tolist()
    refused = 0
    for k in range(128, len(whole)):
        for value in (0, 14, 255):
            path.write_bytes(whole[:k] + bytes([value]) + whole[k + 1 :])
            try:
                load(path)
            except TwinproofError:
                refused += 1
    assert refused > 100


def test_version_7_3_says_how_to_save(tmp_path):
    path = tmp_path / "run.mat"
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(header.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n" + bytes(64))
    with pytest.raises(FormatError, match=r"MATLAB 7\.3 file .*-v7"):
        load(path)
