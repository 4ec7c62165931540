"""On-line update: on exact data, under noise on the dissertation's robot, on bad input."""

import balancing_robots as truth
import numpy as np
import pytest

from foundation.errors import InputError
from identification.pole_placement import ONLINE, PublishedUpdate, WindowedUpdate

A = np.array([[1.1, 0.1], [0.2, 0.9]])
B = np.array([[0.0], [0.5]])
POLES = [0.5, 0.4]
ALL = pytest.mark.parametrize("form", ONLINE.values())


def drive(online, steps, rng, change_at=None):
    """Run the loop; the plant's input gain halves at `change_at`."""
    x, u, models = np.array([1.0, 0.0]), None, []
    for k in range(steps):
        model = online.update(x, u)
        models.append(model)
        u = model.F @ x + 0.1 * rng.standard_normal(1)
        x = A @ x + B @ u * (0.5 if change_at is not None and k >= change_at else 1.0)
    return models


@ALL
def test_exact_data_are_enough_once_there_are_as_many_steps_as_it_needs(form):
    online = form(POLES)
    first = getattr(online, "start", online.window)
    models = drive(online, 12, np.random.default_rng(1))
    assert not any(m.updated for m in models[:first])
    assert models[0].because
    assert models[0].A is None
    assert models[first].updated
    np.testing.assert_allclose(models[first].A, A, atol=1e-8)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(A + B @ models[first].F)), [0.4, 0.5])


@ALL
def test_a_changed_plant_is_followed(form):
    models = drive(form(POLES), 120, np.random.default_rng(2), change_at=60)
    np.testing.assert_allclose(models[59].B, B, atol=1e-6)
    np.testing.assert_allclose(models[-1].B, B / 2, atol=1e-6)


@ALL
def test_without_excitation_the_last_gain_stays(form):
    online, x = form(POLES), np.array([1.0, 0.0])
    u = None
    for k in range(60):
        model = online.update(x, u)
        # After the start the input is a function of the state, and then all is still.
        u = np.array([1.0, -1.0, 0.5, 0.2, -0.3, 0.6, 0.1])[k : k + 1] if k < 7 else model.F @ x
        x = A @ x + B @ u
    assert model.because
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(A + B @ model.F)), [0.4, 0.5], atol=1e-3)


@ALL
def test_a_gap_starts_the_window_anew(form):
    online = form(POLES)
    models = drive(online, 12, np.random.default_rng(3))
    after = online.update([5.0, 5.0])
    assert not after.updated
    np.testing.assert_array_equal(after.F, models[-1].F)


@ALL
def test_memory_is_constant(form):
    online = form(POLES)
    drive(online, 200, np.random.default_rng(3))
    assert len(online._states) == online.window + 1
    assert len(online._inputs) == online.window


@ALL
def test_bad_input_is_refused(form):
    with pytest.raises(InputError, match="not finite"):
        form(POLES).update([np.nan, 0.0])
    with pytest.raises(InputError, match="shape"):
        form(POLES).update([1.0, 0.0, 0.0])
    with pytest.raises(InputError, match="unit circle"):
        form([1.5, 0.1])
    with pytest.raises(InputError, match="F has shape"):
        form(POLES, F=[1.0])


def test_a_window_below_n_plus_m_is_refused():
    with pytest.raises(InputError, match="give 3 or more"):
        WindowedUpdate(POLES, window=2)


def test_a_start_outside_the_window_is_refused():
    assert WindowedUpdate(POLES, window=3).start == 3
    for start in (2, 11):
        with pytest.raises(InputError, match=r"give 3 … 10"):
            WindowedUpdate(POLES, window=10, start=start)


def test_the_published_rank_test_allows_one_window_only():
    """rank 𝒳 = n N cannot hold for N > n + m: 𝒳 has n (n + m) columns."""
    assert PublishedUpdate(POLES).window == 3
    with pytest.raises(TypeError):
        PublishedUpdate(POLES, window=5)


def stable(make, noise, seeds):
    count = 0
    for seed in seeds:
        online = make(truth.Robot2D.poles)

        def update(x, u, online=online):
            model = online.update(x, u)
            return model.A, model.B, model.F

        count += truth.run_online(update, seed, noise=noise, samples=150).stable
    return count


def test_the_windowed_form_bears_a_hundred_times_the_noise():
    seeds = range(700, 710)
    assert stable(PublishedUpdate, 0.0, seeds) >= 7
    assert stable(PublishedUpdate, 4e-6, seeds) <= 5
    assert stable(WindowedUpdate, 4e-5, seeds) >= 8
