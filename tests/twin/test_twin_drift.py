"""Drift tests and recursive fits, on scores of known distribution, and against likelihoods."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from fmus.frontend import load
from fmus.sources import ModelicaSource, library_class
from foundation.errors import DivergenceError, InputError
from identification.innovations import Disturbance, InnovationFilter, with_input_disturbances
from identification.online.scored_filter import Scored, ScoredFilter
from twin.drift import DriftMonitor
from twin.estimation import KalmanFit
from twin.excitation import relative_sd

NAMES = ("a", "b", "c")
VALUES = {"a": 2.0, "b": -5.0, "c": 0.5}
SIZE = np.array([2.0, 5.0, 0.5])


def _information(rng: np.random.Generator) -> NDArray[np.float64]:
    rows = rng.standard_normal((20, 3)) @ np.array([[3, 2.9, 0], [0, 0.5, 0.4], [0, 0, 1.0]])
    return rows.T @ rows / np.outer(SIZE, SIZE)


def _scored(
    rng: np.random.Generator, change: NDArray[np.float64], noise: float = 1.0, n: int = 10
) -> Scored:
    information = _information(rng)
    score = rng.multivariate_normal(information @ change, information)
    innovations = noise * rng.standard_normal((n, 1))
    return Scored(innovations, np.ones((n, 1)), score, information, np.zeros((n, 1)))


def _monitor(rate: float, covariance: NDArray[np.float64] | None = None) -> DriftMonitor:
    return DriftMonitor(
        NAMES,
        VALUES,
        np.zeros((3, 3)) if covariance is None else covariance,
        block=0.1,
        window=5.0,
        false_alarms_per_hour=rate,
        channels=["y"],
    )


def test_alarms_are_no_more_frequent_than_stated() -> None:
    rng, rate, hours = np.random.default_rng(1), 200.0, 0.2
    monitor, alarms, rung = _monitor(rate), 0, False
    for _ in range(round(hours * 36_000)):
        alarm = monitor.take(_scored(rng, np.zeros(3)))
        alarms += alarm is not None and not rung
        rung = alarm is not None
    assert alarms <= stats.poisson.ppf(0.999, rate * hours)
    # A bound, but no idle one: the threshold is where single tests would just do.
    assert alarms > 0


def test_statistics_are_standard_normal_with_uncertain_verified_parameters() -> None:
    rng = np.random.default_rng(2)
    covariance = np.diag((0.02 * SIZE) ** 2)
    found: list[list[float]] = []
    for _ in range(300):
        monitor = _monitor(1e-6, covariance)
        truth = 0.02 * SIZE * rng.standard_normal(3)
        blocks = [_scored(rng, truth) for _ in range(6)]
        for block in blocks:
            monitor.take(block)
        found.append([monitor.statistics[n] for n in NAMES])
    for column in np.array(found).T:
        assert stats.kstest(column, stats.halfnorm.cdf).pvalue > 1e-3


@pytest.mark.parametrize("j", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_the_parameter_that_moved_is_named_and_measured(j: int, sign: int) -> None:
    rng, monitor = np.random.default_rng(3 + j), _monitor(0.01)
    for _ in range(60):
        assert monitor.take(_scored(rng, np.zeros(3))) is None
    change = np.zeros(3)
    # Ten standard deviations of what all parameters together leave open after five seconds.
    sd = np.sqrt(np.diag(np.linalg.inv(50 * np.mean([_information(rng) for _ in range(99)], 0))))
    change[j] = sign * 10 * sd[j]
    alarms = [monitor.take(_scored(rng, change)) for _ in range(50)]
    alarm = alarms[-1]
    assert alarm is not None
    assert alarm.parameter == NAMES[j]
    assert alarm.change == pytest.approx(change[j], rel=0.15)
    assert alarm.statistic > alarm.threshold


def test_a_change_within_the_margin_is_none() -> None:
    rng = np.random.default_rng(4)
    monitor = DriftMonitor(
        NAMES, VALUES, np.zeros((3, 3)), block=0.1, window=5.0, false_alarms_per_hour=0.01,
        margin=0.1,
    )  # fmt: skip
    change = np.array([0.1 * SIZE[0], 0, 0])
    assert not any(monitor.take(_scored(rng, change)) for _ in range(100))


def test_several_that_move_and_noise_that_grows_are_said_as_such() -> None:
    rng, monitor = np.random.default_rng(5), _monitor(0.01)
    alarms = [monitor.take(_scored(rng, np.zeros(3), noise=1.8)) for _ in range(50)]
    last = alarms[-1]
    assert last is not None
    assert (last.parameter, last.channel) == ("", "y")


def test_a_recursive_fit_is_the_weighted_batch_fit() -> None:
    """With a linear score the recursion is exponentially weighted least squares."""
    rng = np.random.default_rng(6)
    fading, truth = 0.98, np.array([0.05, -0.03, 0.02]) * SIZE
    start = np.array(list(VALUES.values()))
    fit = KalmanFit(NAMES, VALUES, np.zeros((3, 3)), fading=fading, wanted=10.0)
    whole, right = np.zeros((3, 3)), np.zeros(3)
    for _ in range(400):
        information = _information(rng)
        noise = rng.multivariate_normal(np.zeros(3), information)
        here = np.array([fit.values[n] for n in NAMES]) - start
        score = information @ (truth - here) + noise
        fit.take(
            np.zeros((2, 1)),
            np.zeros((1, 1)),
            Scored(np.zeros((1, 1)), np.ones((1, 1)), score, information, np.zeros((1, 1))),
        )
        whole = fading * whole + information
        right = fading * right + information @ truth + noise
    batch = np.linalg.solve(whole, right)
    found = np.array([fit.values[n] for n in NAMES]) - start
    # What fades ends as loosely known rather than unknown, which shows in the fourth digit.
    assert found == pytest.approx(batch, rel=0.05, abs=1e-3)
    sd = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(found - truth) < 4 * sd)
    assert np.all(sd < 0.05 * SIZE)


def test_promised_deviations_are_those_of_the_inverse() -> None:
    rng = np.random.default_rng(7)
    information = _information(rng)
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    assert relative_sd(information) == pytest.approx(expected, rel=1e-9)
    hidden = np.array([[1.0, 1.0, 0], [1.0, 1.0, 0], [0, 0, 4.0]])
    assert relative_sd(hidden).tolist() == [np.inf, np.inf, 0.5]


CART = """
model Cart
  parameter Real m = 2;
  parameter Real b = 0.3 "constant force";
  parameter Real x_start = 0;
  parameter Real v_start = 0;
  Twinproof.Interfaces.RealInput u;
  Twinproof.Interfaces.RealOutput x(start = x_start, fixed = true);
  Twinproof.Interfaces.RealOutput v(start = v_start, fixed = true);
equation
  der(x) = v;
  m * der(v) = u + b - 0.5 * v;
end Cart;
"""


def _log_likelihood(dae, value: float, u, y, noise) -> float:
    disturbed, added = with_input_disturbances(dae)
    model = InnovationFilter(disturbed, ["x", "v"], added)
    p = model.parameter_vector({**disturbed.parameter_values, "b": value})
    begun = np.array([y[0, 0], y[0, 1]])
    run = model.filter(begun, (3 * noise) ** 2, u, y, p, 0.01, noise, [Disturbance(2.0, 0.05)])
    return run.log_likelihood


def test_score_and_information_are_the_likelihoods_derivatives() -> None:
    """Of a parameter that no gain depends on, against finite differences of another filter."""
    dae = load(ModelicaSource(CART, "Cart", "cart.mo", "cart.mo"))
    rng, n = np.random.default_rng(8), 300
    noise = np.array([0.01, 0.02])
    u = rng.standard_normal((n + 1, 1))
    y = np.cumsum(rng.standard_normal((n, 2)), axis=0) * 0.01
    y[50:60, 0] = np.nan
    f = ScoredFilter(
        dae, ["x", "v"], ["b"], dae.parameter_values, sample_time=0.01, noise_sd=noise,
        disturbances=[Disturbance(2.0, 0.05)],
    )  # fmt: skip
    parts = [f.block(u[k : k + 51], y[k : k + 50]) for k in range(0, n, 50)]
    score = sum(float(s.score[0]) for s in parts)
    information = sum(float(s.information[0, 0]) for s in parts)
    step = 0.05
    low, mid, high = (_log_likelihood(dae, 0.3 + d, u[:-1], y, noise) for d in (-step, 0.0, step))
    assert score == pytest.approx((high - low) / (2 * step), rel=1e-5)
    assert information == pytest.approx(-(high - 2 * mid + low) / step**2, rel=1e-5)
    assert np.all(parts[1].innovations[:10, 0] == 0)


def test_a_filter_that_diverges_says_so_and_begins_anew() -> None:
    dae = load(library_class("Twinproof.Plants.Pendulum"))
    f = ScoredFilter(
        dae, ["theta"], ["J"], dae.parameter_values, sample_time=0.01, noise_sd=[0.01],
        disturbances=[Disturbance(1.0, 0.1)],
    )  # fmt: skip
    with pytest.raises(DivergenceError):
        f.block(np.full((6, 1), 1e300), np.zeros((5, 1)))
    assert np.all(np.isfinite(f.block(np.zeros((6, 1)), np.zeros((5, 1))).score))


def test_a_sensor_of_unknown_noise_is_refused() -> None:
    dae = load(library_class("Twinproof.Plants.Pendulum"))
    with pytest.raises(InputError, match="noise"):
        ScoredFilter(
            dae, ["theta"], ["J"], dae.parameter_values, sample_time=0.01, noise_sd=[np.nan],
            disturbances=[Disturbance(1.0, 0.1)],
        )  # fmt: skip
