"""Resampling: what each kind of signal keeps, against SciPy and exact integrals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal as filters
from scipy.interpolate import interp1d

from recordings import Channel, Kind, Recording
from recordings.resample import held, low_passed, resample, step_means

times = st.lists(st.floats(0.001, 2), min_size=1, max_size=30).map(
    lambda steps: np.concatenate([[0.0], np.cumsum(steps)])
)


@settings(max_examples=60)
@given(times, times, st.integers(0, 1000))
def test_states_are_held_as_scipy_holds(time, grid, seed):
    grid = grid * (time[-1] / grid[-1])
    values = np.random.default_rng(seed).normal(size=time.size)
    # Where grid and samples meet to rounding, both neighbours are right.
    apart = np.min(np.abs(grid[:, None] - time), axis=1) > 1e-5
    expected = interp1d(time, values, kind="previous", fill_value="extrapolate")(grid)
    assert np.array_equal(held(time, values, grid)[apart], expected[apart])


def test_stamps_that_differ_by_rounding_are_the_same_instant():
    time = np.arange(1000) * 0.001
    grid = np.linspace(0, 0.999, 1000) - 1e-16
    assert np.array_equal(held(time, time, grid), time)


@settings(max_examples=60)
@given(times, times, st.integers(0, 1000))
def test_commands_keep_their_integral(time, grid, seed):
    grid = grid * (time[-1] / grid[-1])
    values = np.random.default_rng(seed).normal(size=time.size)
    means = step_means(time, values, grid)
    exact = np.sum(np.diff(time) * values[:-1])
    assert np.sum(np.diff(grid) * means[:-1]) == pytest.approx(exact, abs=1e-9)


def test_commands_on_their_own_times_keep_every_number():
    time, values = np.arange(20) * 0.01, np.random.default_rng(0).normal(size=20)
    shifted = time[1:-1] + 1e-12
    np.testing.assert_allclose(step_means(time, values, shifted), values[1:-1], atol=1e-8)
    fine = np.arange(0, 0.19, 0.001)
    put = resample(time, values, fine, Kind.COMMAND)
    assert put.what == "held"
    assert set(put.values) <= set(values)


@pytest.mark.parametrize("slower", [2, 5, 10, 37])
def test_what_would_alias_is_filtered_off_and_the_rest_stays(slower):
    time = np.arange(20_000) * 0.001
    grid = np.arange(0, time[-1], 0.001 * slower)
    nyquist = 0.5 / (0.001 * slower)
    inner = slice(grid.size // 5, -grid.size // 5)
    slow, fast = np.sin(2 * np.pi * 0.7 * nyquist * time), np.sin(2 * np.pi * 1.3 * nyquist * time)
    kept = resample(time, slow, grid, Kind.MEASURED).values
    lost = resample(time, fast, grid, Kind.MEASURED).values
    # Straight lines between fine samples miss a sine by (omega h)^2 / 8; on a sample, by nothing.
    np.testing.assert_allclose(
        kept[inner], np.sin(2 * np.pi * 0.7 * nyquist * grid)[inner], atol=2e-3
    )
    assert np.max(np.abs(lost[inner])) < 2e-3
    picked = np.interp(grid, time, fast)
    assert np.sqrt(np.mean(picked**2)) > 0.5


def test_the_filter_is_as_sharp_as_it_says():
    time = np.arange(4001) * 0.001
    impulse = np.zeros(4001)
    impulse[2000] = 1.0
    (_, response), gain = low_passed(time, impulse, 40.0)
    frequency, magnitude = filters.freqz(response, worN=8192, fs=1000.0)
    decibel = 20 * np.log10(np.abs(magnitude) + 1e-12)
    assert np.max(np.abs(decibel[frequency < 40])) < 0.01
    assert np.max(decibel[frequency > 50]) < -79
    assert gain == pytest.approx(np.sqrt(np.sum(response**2)), rel=1e-9)
    noise = np.random.default_rng(1).normal(size=200_000)
    (_, smooth), gain = low_passed(np.arange(200_000) * 0.001, noise, 40.0)
    assert np.std(smooth) == pytest.approx(gain, rel=0.02)


@pytest.mark.parametrize("size", [2, 3, 10, 50])
def test_ramps_and_short_records_survive_the_filter(size):
    time = np.arange(size) * 0.01
    (even, smooth), _ = low_passed(time, 3 * time + 1, 2.0)
    np.testing.assert_allclose(smooth, 3 * even + 1, atol=1e-9)


def test_uniform_treats_each_channel_by_its_kind():
    time = np.array([0.0, 1.1, 1.9, 3.0])
    run = Recording(
        time,
        {
            "x": Channel("x", 2 * time),
            "u": Channel("u", np.array([0.0, 1.0, 0.0, 0.0]), kind=Kind.COMMAND),
            "gear": Channel("gear", np.array([1.0, 2.0, 3.0, 3.0]), kind=Kind.STATE),
        },
    ).uniform()
    np.testing.assert_allclose(run["x"].values, 2 * run.time)
    np.testing.assert_allclose(run["u"].values, [0.0, 0.8, 0.0, 0.0], atol=1e-12)
    assert run["gear"].values.tolist() == [1, 1, 3, 3]
