"""The Recording type: what it refuses, and what its helpers do to the numbers."""

import pickle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foundation.errors import ChannelError, TimeError
from recordings import Channel, Recording, Sensor


def recording(time, **values):
    time = np.asarray(time, float)
    channels = {n: Channel(n, np.asarray(v, float), "m", Sensor(0.1)) for n, v in values.items()}
    return Recording(time, channels, "bench.csv")


@pytest.mark.parametrize(
    ("time", "fragments"),
    [
        ([0.0, 1.0, 1.0], ["repeats", "1 s follows 1 s", "row 3", "remove repeated"]),
        ([0.0, 2.0, 1.0], ["goes back", "1 s follows 2 s", "row 3", "sort"]),
        ([0.0, np.nan, 1.0], ["time is nan", "row 2", "remove the row"]),
        ([0.0, 1.0, np.inf], ["time is inf", "row 3"]),
        ([0.0], ["two samples"]),
        ([[0.0, 1.0]], ["shape (1, 2)"]),
    ],
)
def test_bad_time_is_refused_with_its_row(time, fragments):
    with pytest.raises(TimeError) as caught:
        recording(time)
    assert all(f in str(caught.value) for f in ["bench.csv", *fragments])


@pytest.mark.parametrize(
    ("values", "fragments"),
    [
        ([1.0, np.nan, np.inf], ["'q' is nan", "row 2", "0.5 s", "2 of its 3"]),
        ([1.0, 2.0], ["'q' has 2 values for 3 times"]),
        ([[1.0, 2.0, 3.0]], ["'q' has shape (1, 3)"]),
    ],
)
def test_bad_values_are_refused_with_channel_row_and_time(values, fragments):
    with pytest.raises(ChannelError) as caught:
        recording([0.0, 0.5, 1.0], q=values)
    assert all(f in str(caught.value) for f in fragments)


def test_a_channel_must_be_filed_under_its_own_name():
    with pytest.raises(ChannelError, match="'a' is filed as 'b'"):
        Recording(np.arange(2.0), {"b": Channel("a", np.zeros(2))})


def test_arrays_are_read_only_and_the_callers_stay_writeable():
    mine = np.arange(3.0)
    run = recording(mine, q=mine)
    with pytest.raises(ValueError, match="read-only"):
        run["q"].values[0] = 9.0
    mine[0] = -1.0


def test_unknown_channel_offers_the_nearest():
    with pytest.raises(
        ChannelError, match=r"no channel 'pitsch' \(bench.csv\); did you mean pitch"
    ):
        recording([0, 1], pitch=[0, 0])["pitsch"]


def test_between_keeps_both_ends_and_says_what_there_is():
    run = recording(np.arange(11) / 10, q=np.arange(11))
    part = run.between(0.2, 0.5)
    assert part["q"].values.tolist() == [2, 3, 4, 5]
    assert part["q"].sensor == Sensor(0.1)
    with pytest.raises(TimeError, match="spans 0 s to 1 s"):
        run.between(0.25, 0.35)


def test_select_orders_and_replace_values_keeps_the_rest():
    run = recording([0, 1], a=[1, 2], b=[3, 4])
    assert list(run.select(["b", "a"]).channels) == ["b", "a"]
    new = run.replace_values({"b": [5, 6]})
    assert new["b"].values.tolist() == [5, 6]
    assert new["b"].unit == "m"
    assert new["a"] is run["a"]
    with pytest.raises(ChannelError, match="'b' has 3 values"):
        run.replace_values({"b": [1, 2, 3]})


def test_it_survives_pickling_with_everything():
    run = recording([0, 1], a=[1, 2]).with_notes("one")
    copy = pickle.loads(pickle.dumps(run))
    assert (copy.origin, copy.notes, len(copy)) == ("bench.csv", ("one",), 2)
    assert copy["a"].sensor == run["a"].sensor
    assert copy.to_frame().equals(run.to_frame())


def test_frame_round_trip_and_time_as_column_or_index():
    frame = pd.DataFrame({"time": [0.0, 0.1, 0.3], "a": [1, 2, 3], "b": [True, False, True]})
    run = Recording.from_frame(frame, units={"a": "rad"})
    again = Recording.from_frame(run.to_frame(), units={"a": "rad"})
    for copy in (run, again):
        assert copy.time.tolist() == [0.0, 0.1, 0.3]
        assert copy["a"].unit == "rad"
        assert copy["b"].values.tolist() == [1, 0, 1]


def test_frame_with_text_is_refused():
    with pytest.raises(ChannelError, match="'a' is not numeric"):
        Recording.from_frame(pd.DataFrame({"time": [0.0, 1.0], "a": ["x", "y"]}))
    with pytest.raises(TimeError, match="not time in s"):
        Recording.from_frame(pd.DataFrame({"a": [1.0, 2.0]}, index=["x", "y"]))


def test_uniform_returns_an_even_recording_itself():
    time = 5.0 + np.arange(1000) * 0.001
    run = recording(time * (1 + 1e-9), q=time)
    assert run.uniform() is run


@given(
    st.lists(st.floats(0.5, 1.5), min_size=3, max_size=60),
    st.floats(-5, 5),
    st.floats(-5, 5),
)
def test_uniform_is_exact_on_straight_lines_and_keeps_the_ends(steps, slope, offset):
    time = np.concatenate([[0.0], np.cumsum(steps)])
    even = recording(time, q=slope * time + offset).uniform()
    assert even.time[0] == time[0]
    assert even.time[-1] == time[-1]
    np.testing.assert_allclose(np.diff(even.time), np.diff(even.time)[0], rtol=1e-9)
    assert abs(even.time.size - 1 - time[-1] / np.median(steps)) <= 0.5 + 1e-9
    np.testing.assert_allclose(even["q"].values, slope * even.time + offset, atol=1e-9)


def test_uniform_refuses_to_bridge_a_gap():
    time = np.concatenate([np.arange(10), 16.0 + np.arange(10)])
    with pytest.raises(
        TimeError, match=r"a gap of 7 s where the usual step is 1 s .*after 9 s.*cut"
    ):
        recording(time, q=time).uniform()
    assert recording(np.append(np.arange(10), 14.0), q=np.arange(11)).uniform().time.size == 15


def test_sample_time_is_the_median_step():
    run = recording([0.0, 1.0, 2.0, 3.0, 10.0])
    assert (run.sample_time, run.duration) == (1.0, 10.0)
