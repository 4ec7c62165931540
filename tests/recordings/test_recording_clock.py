"""Software stamps: the even beat behind them, also with lost frames, stalls and long records."""

import numpy as np
import pytest

from recordings.clock import even_beat


@pytest.mark.parametrize("period", [0.01, 0.00999, 0.0100003])
@pytest.mark.parametrize("size", [8, 100, 200_000])
def test_late_stamps_of_a_long_record_with_losses(period, size):
    rng = np.random.default_rng(size)
    beat = np.arange(size)
    if size > 8:
        beat = beat[rng.random(size) > 0.02]
    late = rng.exponential(3e-4, beat.size)
    found = even_beat(5.0 + beat * period + late)
    assert found is not None
    # With few stamps, the edge of the lateness is known as well as its spread over their number.
    allowed = 1e-3 if size == 8 else 3e-4 if size == 100 else 1e-5
    np.testing.assert_allclose(found.time, 5.0 + beat * period, atol=allowed)
    assert found.period == pytest.approx(period, rel=3e-2 if size == 8 else 1e-3)


def test_frames_that_waited_together_keep_their_beats():
    stamps = np.arange(500) * 0.01
    for stall in (100, 300):
        stamps[stall : stall + 4] = stamps[stall + 4] + np.arange(-4, 0) * 1e-6
    found = even_beat(stamps)
    np.testing.assert_allclose(found.time, np.arange(500) * 0.01, atol=2e-3)
    assert np.all(np.diff(found.time) > 0.009)


def test_hardware_stamps_stay():
    stamps = np.arange(1000) * 0.005
    np.testing.assert_allclose(even_beat(stamps).time, stamps, atol=1e-9)


def test_no_beat():
    rng = np.random.default_rng(0)
    assert even_beat(np.cumsum(rng.exponential(1, 200))) is None
    assert even_beat(np.arange(5.0)) is None
