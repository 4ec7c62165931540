"""Gains against eigenvalues; poles as users write them."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from foundation.errors import ExcitationError, InputError
from identification.pole_placement.gains import (
    check_poles,
    companion,
    controllability,
    gain,
    pole_distance,
    read_poles,
)


@settings(deadline=None, max_examples=60)
@given(n=st.integers(1, 6), m=st.integers(1, 3), seed=st.integers(0, 2**32 - 1))
def test_the_closed_loop_has_the_poles(n, m, seed):
    assume(m <= n)
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    assume(np.min(controllability(A, B)) > 1e-3)
    pairs = n // 2
    z = rng.uniform(0.1, 0.9, pairs) * np.exp(1j * rng.uniform(0.2, 3, pairs))
    wanted = np.concatenate([z, z.conj(), rng.uniform(-0.9, 0.9, n - 2 * pairs)])
    assume(np.min(np.abs(wanted[:, None] - wanted) + 2 * np.eye(n)) > 0.05)
    F = gain(A, B, check_poles(wanted, n, m))
    assert F.shape == (m, n)
    assert pole_distance(np.linalg.eigvals(A + B @ F), wanted) < 1e-5


def test_badly_scaled_states_do_no_harm():
    rng = np.random.default_rng(2)
    A, B = rng.normal(size=(4, 4)), rng.normal(size=(4, 1))
    wanted = np.array([0.1, 0.3, 0.5 + 0.2j, 0.5 - 0.2j])
    scale = np.array([1e-6, 1.0, 1e5, 1e-3])
    F = gain(A, B, wanted)
    scaled = gain(A * scale[:, None] / scale, B * scale[:, None], wanted)
    np.testing.assert_allclose(scaled * scale, F, rtol=1e-6)


def test_a_dead_beat_gain_of_one_input():
    A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
    closed = A + B @ gain(A, B, check_poles([0, 0], 2, 1))
    np.testing.assert_allclose(closed @ closed, 0, atol=1e-9)


def test_a_pole_that_no_input_reaches_is_named():
    with pytest.raises(ExcitationError, match=r"1\.3"):
        gain(np.diag([0.5, 1.3]), np.array([[1.0], [0.0]]), np.array([0.1, 0.2]))


def test_companion_has_the_poles():
    wanted = np.array([0.8, 0.9, 0.9 + 0.05j, 0.9 - 0.05j])
    A_d, B_d = companion(wanted)
    assert pole_distance(np.linalg.eigvals(A_d), wanted) < 1e-6
    assert B_d.ravel().tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.8, 0.9", (0.8, 0.9)),
        ("0.9+0.05j,0.9-0.05j", (0.9 + 0.05j, 0.9 - 0.05j)),
        ("0.9 ± 0.05i", (0.9 + 0.05j, 0.9 - 0.05j)),
        ("-0.2,6.0355e-5", (-0.2, 6.0355e-5)),
    ],
)
def test_poles_are_read_as_people_write_them(text, expected):
    assert read_poles(text) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("poles", "message"),
    [
        ([0.5], "1 poles for 2 states"),
        ([-2.0, -3.0], "not inside the unit circle"),
        ([1.0, 0.5], "not inside the unit circle"),
        ([float("nan"), 0.5], "not inside the unit circle"),
        ([0.5 + 0.1j, 0.5], "conjugate"),
        ([0.5 + 0.1j, 0.4 - 0.1j], "conjugate"),
    ],
)
def test_poles_that_cannot_be_placed_are_refused(poles, message):
    with pytest.raises(InputError, match=message):
        check_poles(poles, 2, 1)


def test_poles_of_continuous_time_are_explained():
    with pytest.raises(InputError, match=r"z = exp\(s h\); s = -2\+3j .* at h = 0\.1 s"):
        check_poles([-2 + 3j, -2 - 3j], 2, 1, 0.1)


def test_more_repetitions_than_inputs_are_refused():
    with pytest.raises(InputError, match="repeated 3 times with 2 inputs"):
        check_poles([0.5, 0.5, 0.5], 3, 2)


@pytest.mark.parametrize("text", ["", "0.5,", "fast", "0.5;0.6"])
def test_words_that_are_no_poles_are_refused(text):
    with pytest.raises(InputError, match="is not a pole"):
        read_poles(text)
