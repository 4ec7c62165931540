"""The filter's likelihood against SciPy's joint Gaussian density; its slopes by differences."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from foundation.errors import DivergenceError
from identification.pole_placement.kalman import (
    Directions,
    Noisy,
    linearise,
    minus_log_likelihood,
    run_filter,
)

RNG = np.random.default_rng(4)
A = np.array([[0.9, 0.2], [-0.1, 0.7]])
B = np.array([[0.3], [1.0]])
Q, R = np.array([0.02, 0.05]), np.array([0.1, 0.03])
N = 12
INPUTS = RNG.standard_normal((N, 1))
STATES = RNG.standard_normal((N + 1, 2))
STATES[0] = 0.0


def dense():
    """-log density of the measured states given the first, whose error has covariance R."""
    power = [np.linalg.matrix_power(A, k) for k in range(N + 1)]
    mean, x = [], STATES[0]
    for k in range(N):
        x = A @ x + B @ INPUTS[k]
        mean.append(x)
    covariance = np.zeros((2 * N, 2 * N))
    for i in range(1, N + 1):
        for j in range(1, N + 1):
            block = power[i] @ np.diag(R) @ power[j].T
            for s in range(1, min(i, j) + 1):
                block = block + power[i - s] @ np.diag(Q) @ power[j - s].T
            if i == j:
                block = block + np.diag(R)
            covariance[2 * i - 2 : 2 * i, 2 * j - 2 : 2 * j] = block
    density = multivariate_normal(np.concatenate(mean), covariance)
    return -density.logpdf(STATES[1:].ravel()) - N * np.log(2 * np.pi)


def test_the_likelihood_is_the_joint_density():
    value = minus_log_likelihood(run_filter(Noisy(A, B, Q, R), STATES, INPUTS))
    assert value == pytest.approx(dense(), rel=1e-10)


@pytest.mark.parametrize("steps", [12, 600])
def test_slopes_agree_with_differences(steps):
    """600 steps: long after the filter has settled."""
    rng = np.random.default_rng(5)
    inputs, states = rng.standard_normal((steps, 1)), rng.standard_normal((steps + 1, 2))
    units = np.eye(10)
    directions = Directions(
        units[:, :4].reshape(10, 2, 2), units[:, 4:6].reshape(10, 2, 1), units[:, 6:8], units[:, 8:]
    )

    def value(move):
        model = Noisy(
            A + move[:4].reshape(2, 2), B + move[4:6].reshape(2, 1), Q + move[6:8], R + move[8:]
        )
        return minus_log_likelihood(run_filter(model, states, inputs))

    local = linearise(Noisy(A, B, Q, R), directions, states, inputs)
    step = 1e-5
    expected = [(value(step * e) - value(-step * e)) / (2 * step) for e in units]
    assert local.value == pytest.approx(value(np.zeros(10)))
    np.testing.assert_allclose(local.gradient, expected, rtol=1e-5, atol=1e-4)


def test_information_is_the_scatter_of_the_gradient():
    """Fisher's identity, over data drawn from the model."""
    units = np.eye(10)
    directions = Directions(
        units[:, :4].reshape(10, 2, 2), units[:, 4:6].reshape(10, 2, 1), units[:, 6:8], units[:, 8:]
    )
    rng = np.random.default_rng(6)
    scores, information = [], np.zeros((10, 10))
    for _ in range(400):
        inputs = rng.standard_normal((30, 1))
        # Measured first state exact: y(0) = 0 given; x(0) has the sensor's error.
        x = np.sqrt(R) * rng.standard_normal(2)
        states = [np.zeros(2)]
        for k in range(30):
            x = A @ x + B @ inputs[k] + np.sqrt(Q) * rng.standard_normal(2)
            states.append(x + np.sqrt(R) * rng.standard_normal(2))
        local = linearise(Noisy(A, B, Q, R), directions, np.array(states), inputs)
        scores.append(local.gradient)
        information += local.information / 400
    scores = np.array(scores)
    scatter = scores.T @ scores / 400
    np.testing.assert_allclose(np.diag(scatter) / np.diag(information), 1, atol=0.3)
    assert np.all(np.abs(scores.mean(0)) < 4 * np.sqrt(np.diag(information) / 400))


def test_a_filter_that_cannot_run_says_so():
    with pytest.raises(DivergenceError):
        run_filter(Noisy(1e200 * A, B, Q, R), STATES, INPUTS)
