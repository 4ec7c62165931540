"""CSV: the shapes it comes in, and every way in which it can be wrong."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import ChannelError, FormatError, TimeError
from recordings import load

MODEL = {"q": "m"}


@pytest.fixture
def csv(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "run.csv"
        path.write_bytes(text.encode(encoding))
        return path

    return write


@pytest.mark.parametrize(
    "text",
    [
        "time,q\n0,1\n0.5,2\n",
        "time;q\n0;1\n0.5;2",
        "time\tq\r\n0\t1\r\n0.5\t2\r\n\r\n\n",
        '"time" , "q",\n0, 1,\n0.5, 2,\n',
        "\ufefftime,q\n0,1\n0.5,2\n",
        "note,time,q\nstart,0,1\n,0.5,2\n",
    ],
)
def test_shapes_that_are_read(csv, text):
    run = load(csv(text), variables=MODEL)
    assert run.time.tolist() == [0.0, 0.5]
    assert run["q"].values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "error", "fragments"),
    [
        ("", FormatError, ["empty"]),
        ("  \n\n", FormatError, ["empty"]),
        ("time,q\n", FormatError, ["no row"]),
        ("0,1\n1,2\n", FormatError, ["line 1", "header", "time,q,v"]),
        ("time,q\n0,1\n1,2,3\n2,3\n", FormatError, ["line 3", "saw 3"]),
        ("time,q\n0,1,2\n1,2,3\n", FormatError, ["header of 2 columns"]),
        ("time,q\n0,1\n1,two\n", ChannelError, ["'q' is 'two'", "line 3", "repair"]),
        ("time;q\n0;1\n1;2,5\n", ChannelError, ["'2,5'", "line 3", "with a point"]),
        ("time,q\n0,1\n1,\n2,3\n", ChannelError, ["'q' is empty or NaN", "line 3"]),
        ("time,q\n0,1\n1,nan\n", ChannelError, ["'q' is empty or NaN", "line 3"]),
        ("time,q\n0,1\n1,inf\n", ChannelError, ["'q' is 'inf'", "line 3"]),
        ("time,q\n0,1\n1\n", ChannelError, ["'q' is empty", "line 3"]),
        ("time,q\n0,1\n\n1,2\n", ChannelError, ["line 3"]),
        ("time,q\n0,1\nx,2\n", ChannelError, ["'time' is 'x'", "line 3"]),
        ("time,q,q\n0,1,2\n1,2,3\n", ChannelError, ["columns 2 and 3", "'q'", "rename"]),
        ("t,q\n0,1\n1,2\n", TimeError, ["no column 'time'", "[time] source"]),
        ("times,q\n0,1\n1,2\n", TimeError, ["did you mean times?"]),
        ("time,q\n0,1\n1,2\n1,3\n", TimeError, ["repeats", "row 3"]),
        ("time,q\n0,1\n1,2\n0.5,3\n", TimeError, ["goes back", "row 3"]),
        ("time,qq\n0,1\n1,2\n", ChannelError, ["(q)", "--map", "qq"]),
    ],
)
def test_malformed_files_name_place_and_remedy(csv, text, error, fragments):
    with pytest.raises(error) as caught:
        load(csv(text), variables=MODEL)
    message = str(caught.value)
    assert "run.csv" in message
    assert caught.value.remedy
    for fragment in fragments:
        assert fragment in message


def test_other_encodings_are_refused(csv):
    with pytest.raises(FormatError, match="UTF-8"):
        load(csv("time,q\n0,1\n1,2\n# °", "latin-1"), variables=MODEL)


def test_a_broken_column_that_is_not_used_does_no_harm(csv):
    run = load(csv("time,spare,q\n0,oops,1\n1,,2\n"), variables=MODEL)
    assert run["q"].values.tolist() == [1.0, 2.0]
    assert run.notes == ("ignored, not of the model: spare",)


FLOATS = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e300, max_value=1e300)


@settings(max_examples=50)
@given(st.lists(FLOATS, min_size=2, max_size=20))
def test_what_pandas_writes_is_read_back(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("csv") / "run.csv"
    pd.DataFrame({"time": np.arange(len(values)), "q": values}).to_csv(path, index=False)
    np.testing.assert_allclose(load(path)["q"].values, values, rtol=1e-15)
