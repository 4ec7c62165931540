"""Reduced versions of the figures: Table 3.1, Ch. 2, what better methods gain, honest doubts."""

import balancing_robots as truth
import numpy as np
import pytest

from identification.pole_placement import METHODS, Samples, gain, place, region
from identification.pole_placement.base import jackknife
from identification.pole_placement.gains import pole_distance

POLES1 = np.array(truth.Robot3D.poles1, complex)
A1, B1, A2, B2 = truth.Robot3D().linear()
RUNS = 16


@pytest.fixture(scope="module")
def noisy():
    return truth.run_3d(RUNS, seed=31)


def first_part(runs, s, first=50, last=450):
    return Samples(runs.states[s, first : last + 1, :4], runs.inputs[s, first:last, :1], step=0.1)


def medians(runs, word, prefilter, count=RUNS):
    rows = []
    for s in range(count):
        found = METHODS[word](prefilter).solve(first_part(runs, s), POLES1)
        rows.append(truth.table_errors(found.A, found.B, found.F, A1, B1, POLES1))
    return np.median(rows, axis=0)


@pytest.mark.parametrize(
    ("word", "prefilter", "expected"),
    [
        ("published", 1, (0.471, 36.5, 0.348, 0.402, 633.0)),
        ("total-least-squares", 1, (0.1385, 1.71, 0.049, 0.022, 47.7)),
        ("total-least-squares", 6, (0.0453, 2.14, 0.048, 0.021, 33.1)),
    ],
)
def test_table_3_1(noisy, word, prefilter, expected):
    np.testing.assert_allclose(medians(noisy, word, prefilter), expected, rtol=0.35)


def test_table_3_1_without_noise():
    exact = truth.run_3d(3, seed=32, noise=0.0)
    found = medians(exact, "published", 1, 3)
    assert found[0] < 0.002
    assert found[1] < 0.001


def test_a_slow_chirp_is_worse_than_random():
    chirp = truth.run_3d(4, seed=33, chirp=1.5)
    assert medians(chirp, "total-least-squares", 6, 4)[0] > 0.7


def test_better_methods_are_better(noisy):
    """Limits: twice the medians over 120 seeds of the benchmark, less for `auto`."""
    two_step = medians(noisy, "two-step", 6)
    instrumental = medians(noisy, "instrumental", 1)
    best = medians(noisy, "auto", 1, 6)
    assert two_step[0] < 0.045
    assert two_step[1] < 0.03
    assert instrumental[1] < 0.05
    assert best[0] < 0.04
    assert best[1] < 0.025
    assert best[3] < 0.3 * two_step[3]


def test_chapter_2():
    """The nearer to the equilibrium, the better the model: medians 392, 1.04, 6e-5."""
    robot = truth.Robot2D()
    A0, B0 = robot.linear()
    wanted = np.array(robot.poles)
    F0 = gain(A0, B0, wanted)
    np.testing.assert_allclose(F0, [[32.258, 1.763, 4.3125, 0.5216]], rtol=2e-4)
    count = 41
    runs = truth.run_2d(count, 34, F0)
    for first, expected in ((10, 392.0), (50, 1.04), (90, 6e-5)):
        errors = [
            np.linalg.norm(
                METHODS["published"](1)
                .solve(
                    Samples(runs.states[s, first : first + 11], runs.inputs[s, first : first + 10]),
                    wanted,
                )
                .A
                - A0,
                2,
            )
            for s in range(count)
        ]
        assert expected / 6 < np.median(errors) < expected * 6


def linear_runs(count, noise):
    rng = np.random.default_rng(35)
    A = np.array([[1.0, 0.1], [0.15, 0.9]])
    B = np.array([[0.02], [0.3]])
    F = np.array([[-2.0, -1.2]])
    for _ in range(count):
        x, states, inputs = np.zeros(2), [], []
        for _ in range(250):
            y = x + noise * rng.standard_normal(2)
            u = F @ y + rng.standard_normal(1)
            states.append(y)
            inputs.append(u)
            x = A @ x + B @ u + 0.02 * rng.standard_normal(2)
        states.append(x + noise * rng.standard_normal(2))
        yield A, B, Samples(np.array(states), np.array(inputs))


@pytest.mark.parametrize(
    ("word", "noise"), [("two-step", 0.0), ("instrumental", 0.1), ("prediction-error", 0.1)]
)
def test_doubts_are_honest(word, noise):
    """|error| <= 2 sd in about 95 % of runs, for every entry of A and B and for the poles."""
    inside, poles_inside = [], []
    for A, B, samples in linear_runs(50, noise):
        found = place(samples, [0.6, 0.5], method=word)
        error = np.abs(np.hstack([found.A - A, found.B - B]))
        inside.append(error <= 2 * np.hstack([found.A_sd, found.B_sd]))
        reached = np.linalg.eigvals(A + B @ found.F).astype(complex)
        poles_inside.append(pole_distance(reached, found.poles) <= 2.5 * np.max(found.poles_sd))
    share = np.mean(inside, axis=0)
    assert np.all(share >= 0.85)
    assert 0.88 <= np.mean(share) <= 0.99
    assert np.mean(poles_inside) >= 0.85


def test_jackknife_agrees_with_textbook_least_squares():
    _, _, samples = next(linear_runs(1, 0.0))
    method = METHODS["two-step"](1)
    rows = method.rows(samples)
    Z = rows.regressors
    residual = rows.after - Z @ np.linalg.lstsq(Z, rows.after, rcond=None)[0]
    variance = np.sum(residual**2, axis=0) / (len(Z) - 3)
    textbook = np.sqrt(np.outer(variance, np.diag(np.linalg.inv(Z.T @ Z)))).ravel()
    covariance = jackknife(lambda part: np.hstack(method.model(part)), rows)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), textbook, rtol=0.6)


def bent_run(bend, noise=1e-3):
    """A driven oscillator whose spring changes beyond |x1| = 0.5."""
    rng = np.random.default_rng(37)
    A, B = np.array([[1.0, 0.1], [-0.3, 0.9]]), np.array([[0.0], [0.25]])
    x, states, inputs = np.zeros(2), [], []
    for _ in range(3000):
        u = rng.standard_normal(1)
        states.append(x + noise * rng.standard_normal(2))
        inputs.append(u)
        excess = max(abs(x[0]) - 0.5, 0) * np.sign(x[0])
        x = A @ x + B @ u - np.array([0.0, bend * excess])
    states.append(x)
    return A, B, Samples(np.array(states), np.array(inputs))


def test_region_ends_where_the_plant_bends():
    A, B, samples = bent_run(0.5)
    reach = region(samples, A, B)
    assert 0.4 < reach["x1"].holds_to < 0.7
    assert np.isinf(reach["x2"].holds_to)
    assert reach["x1"].seen_to == np.abs(samples.states[:-1, 0]).max()
    found = place(samples, [0.5, 0.4], method="two-step")
    assert any("holds for |x1| up to" in w for w in found.warnings)


def test_region_of_a_linear_plant_has_no_end():
    A, B, samples = bent_run(0.0)
    assert samples.states[:, 0].max() > 1.0
    assert all(np.isinf(reach.holds_to) for reach in region(samples, A, B).values())


@pytest.mark.parametrize(("tilt", "ends"), [(6.0, False), (25.0, True)])
def test_region_of_the_robot(tilt, ends):
    """sin θ_b departs from θ_b: at 6 deg the linear model holds, at 25 it does not."""
    robot = truth.Robot2D()
    A0, B0 = robot.linear()
    run = truth.run_2d(1, 39, gain(A0, B0, np.array(robot.poles)), tilt=tilt)
    reach = region(Samples(run.states[0], run.inputs[0]), A0, B0)["x1"]
    assert reach.seen_to >= np.deg2rad(tilt)
    assert np.isfinite(reach.holds_to) == ends
    if ends:
        assert np.deg2rad(5) < reach.holds_to < np.deg2rad(tilt)


def test_region_needs_eighty_steps():
    A, B, samples = bent_run(0.0)
    assert region(samples.between(0, 79), A, B) == {}
    assert set(region(samples.between(0, 80), A, B)) == {"x1", "x2"}
