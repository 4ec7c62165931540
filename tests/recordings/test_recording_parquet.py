"""Parquet: units from the metadata, types of columns, and what cannot be a channel."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import ChannelError, FormatError, TimeError, TwinproofError
from recordings import Kind, load, load_signals
from recordings.readers import optional

TIME = np.arange(50) * 0.1


def write(path, columns, units=None):
    table = pa.table(columns)
    units = units or {}
    fields = [
        f.with_metadata({"unit": units[f.name]}) if f.name in units else f for f in table.schema
    ]
    pq.write_table(table.cast(pa.schema(fields)), path)
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.parquet"


def test_units_of_columns_are_converted(path):
    write(path, {"time": TIME, "q": TIME * 90, "n": np.arange(50)}, {"q": "deg"})
    run = load(path, variables={"q": "rad"})
    np.testing.assert_allclose(run["q"].values, TIME * np.pi / 2)
    assert run.notes == ("ignored, not of the model: n",)
    assert load(path)["q"].unit == "deg"


def test_time_in_its_own_unit(path):
    write(path, {"time": TIME * 1000, "q": TIME}, {"time": "ms"})
    np.testing.assert_allclose(load(path).time, TIME)


def test_time_stamps_and_durations(path):
    stamps = pd.Timestamp("2024-01-01") + pd.to_timedelta(TIME, unit="s")
    write(path, {"time": pa.array(stamps), "q": TIME})
    np.testing.assert_allclose(load(path).time, TIME, atol=1e-9)
    write(path, {"time": pa.array(pd.to_timedelta(TIME + 5, unit="s")), "q": TIME})
    np.testing.assert_allclose(load(path).time, TIME + 5, atol=1e-9)


def test_an_index_of_pandas_is_a_column(path):
    pd.DataFrame({"q": TIME}, index=pd.Index(TIME, name="time")).to_parquet(path)
    assert np.array_equal(load(path).time, TIME)


def test_truth_values_are_states(path):
    write(path, {"time": TIME, "on": TIME > 2})
    assert load_signals(path)["on"].kind is Kind.STATE
    assert load(path)["on"].values.sum() == 29


def test_columns_that_are_not_used_are_not_read(path):
    write(path, {"time": TIME, "q": TIME, "name": ["x"] * 50, "hole": [None, *TIME[1:]]})
    assert list(load(path, variables={"q": "m"}).channels) == ["q"]


@pytest.mark.parametrize(
    ("columns", "error", "text"),
    [
        ({"time": TIME, "q": [None, *TIME[1:]]}, ChannelError, "'q' is empty .*row 1"),
        ({"time": TIME, "q": ["a"] * 50}, ChannelError, "'q' is of string, not numbers"),
        ({"time": TIME, "q": [[1.0]] * 50}, ChannelError, "'q' is of list.*not numbers"),
        ({"time": TIME, "q": np.full(50, np.nan)}, ChannelError, "'q' is nan"),
        ({"t": TIME, "q": TIME}, TimeError, "no column 'time'"),
        ({"time": TIME[:0], "q": TIME[:0]}, FormatError, "no row"),
    ],
)
def test_unusable_content(path, columns, error, text):
    with pytest.raises(error, match=text):
        load(write(path, columns), variables={"q": "m"})


def test_bus_and_address_belong_to_can_logs(path, tmp_path):
    write(path, {"time": TIME, "q": TIME})
    (tmp_path / "m.toml").write_text('[channels.q]\nbus = "can0"')
    with pytest.raises(ChannelError, match=r"asked for by 'bus', but the file is no CAN log"):
        load(path, channel_map=tmp_path / "m.toml")


def test_a_library_that_is_not_there_says_how_to_get_it(path, monkeypatch):
    write(path, {"time": TIME, "q": TIME})

    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(optional, "import_module", missing)
    with pytest.raises(FormatError, match=r'not installed .*pip install "twinproof\[parquet\]"'):
        load(path)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=100),
    st.sampled_from(["snappy", "zstd", "gzip", "none"]),
)
def test_any_numbers_come_back(tmp_path_factory, values, compression):
    path = tmp_path_factory.mktemp("pq") / "run.parquet"
    table = pa.table({"time": np.arange(len(values)), "x": values})
    pq.write_table(table, path, compression=compression)
    assert load(path)["x"].values.tolist() == values


def was_refused(path):
    """Whether a file is refused with an error of ours; anything else fails the test."""
    try:
        load(path)
    except TwinproofError as error:
        return bool(error.remedy)
    return False


def test_no_damage_crashes_or_hangs(path):
    whole = write(path, {"time": TIME, "q": np.sin(TIME)}, {"q": "m"}).read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for k in range(400):
        content = bytearray(whole)
        content[int(rng.integers(len(whole)))] = int(rng.integers(256))
        path.write_bytes(content if k % 4 else content[: int(rng.integers(len(whole)))])
        refused += was_refused(path)
    assert refused > 100
