"""The simulators against SciPy's integrator and against what the dissertation prints, corrected."""

import balancing_robots as truth
import numpy as np
import pytest
from scipy.integrate import solve_ivp


@pytest.mark.parametrize("robot", [truth.Robot2D(), truth.Robot3D()])
def test_one_step_agrees_with_dop853(robot):
    rng = np.random.default_rng(1)
    n, m = (4, 1) if isinstance(robot, truth.Robot2D) else (6, 2)
    x, u = 0.3 * rng.standard_normal(n), rng.standard_normal(m)
    u = u[0] if m == 1 else u
    exact = solve_ivp(
        lambda _, y: robot.rates(y, u), (0, robot.h), x, "DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1]
    assert np.max(np.abs(exact - x)) > 1e-3
    # Fixed steps cost 5e-5 of a step in the stiff 3-D robot: of no matter, they are the truth.
    np.testing.assert_allclose(robot.step(x, u), exact, atol=2e-4 * np.max(np.abs(exact - x)))


@pytest.mark.parametrize("robot", [truth.Robot2D(), truth.Robot3D()])
def test_linear_models_are_the_slope_at_the_upright_rest(robot):
    n = 4 if isinstance(robot, truth.Robot2D) else 6
    still = np.zeros(2) if n == 6 else 0.0
    moves = [(robot.step(e, still) - robot.step(-e, still)) / 2e-6 for e in 1e-6 * np.eye(n)]
    slope = np.column_stack(moves)
    parts = robot.linear()
    np.testing.assert_allclose(slope[:4, :4], parts[0], atol=1e-3)
    if n == 6:
        np.testing.assert_allclose(slope[4:, 4:], parts[2], atol=1e-3)


def test_the_printed_models_follow():
    A0, B0 = truth.Robot2D().linear()
    printed = [[1.0057, 0, 0.01, 0], [-0.0207, 1, -0.0001, 0.01]]
    printed += [[1.1388, 0, 1.0057, 0.0007], [-4.1369, 0, -0.0207, 0.9954]]
    np.testing.assert_allclose(A0, printed, rtol=1.4e-3, atol=6e-5)
    np.testing.assert_allclose(B0.ravel(), [-0.0023, 0.0146, -0.4577, 2.9109], rtol=2e-3, atol=6e-5)
    A1, B1, A2, B2 = truth.Robot3D().linear()
    # (3.31), its A1(4,2) = 3.5299 corrected.
    printed = [[1, 0.1719, 0.0226, 0.0830], [0, 1.1722, 0.0113, 0.0944]]
    printed += [[0, 3.5363, 0.1388, 1.0332], [0, 3.5399, 0.1386, 1.0336]]
    np.testing.assert_allclose(A1, printed, atol=6e-5)
    np.testing.assert_allclose(B1.ravel(), [0.0641, -0.0094, 0.7131, -0.1148], atol=6e-5)
    np.testing.assert_allclose(A2, [[1, 0.0113], [0, 0.0001]], atol=6e-5)
    np.testing.assert_allclose(B2.ravel(), [0.0306, 0.3450], atol=6e-5)


def test_the_initial_column_of_table_3_1_follows():
    A1, B1, A2, B2 = truth.Robot3D().linear()
    a1, b1, a2, b2 = truth.Robot3D(1.1).linear()
    robot = truth.Robot3D
    first = truth.table_errors(a1, b1, robot.F1, A1, B1, robot.poles1)
    second = truth.table_errors(a2, b2, robot.F2, A2, B2, robot.poles2)
    # Printed ΔG is 10 times these units' pulse; ΔA2 is printed as 0.0001.
    np.testing.assert_allclose(first, [0.2426, 0.5317, 0.0025, 0.0511, 42.333], rtol=0.02)
    np.testing.assert_allclose(second, [0.0029, 0.0010, 0.0004, 0.0001, 0.0036], atol=6e-5)
