"""The output filter against ODE integration, SciPy's discretisation and its own symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import subspace_angles
from scipy.signal import cont2discrete, dlsim

from foundation.errors import InputError
from identification.output_filter import OutputFilter, choose_tau

TAUS = [(0.05, 0.08), (0.3, 0.3), (2.25, 6.5), (0.02, 0.02 * (1 + 1e-9))]


def phi(t):
    """A signal whose value and slope at the start are not zero, with its derivatives."""
    value = np.sin(2 * t + 0.4) + 0.3 * np.cos(0.7 * t)
    first = 2 * np.cos(2 * t + 0.4) - 0.21 * np.sin(0.7 * t)
    second = -4 * np.sin(2 * t + 0.4) - 0.147 * np.cos(0.7 * t)
    return value, first, second


def integrate(tau1, tau2, drive, start, t):
    """y'' + ν y' + y/(τ1 τ2) = drive/(τ1 τ2), the form of the paper's (41)."""

    def rates(time, y):
        return [y[1], (drive(time) - y[0]) / (tau1 * tau2) - (1 / tau1 + 1 / tau2) * y[1]]

    solution = solve_ivp(
        rates, (0, t[-1]), start, "DOP853", t_eval=t, rtol=1e-12, atol=1e-13, max_step=0.05
    )
    return solution.y[0]


@pytest.mark.parametrize("taus", TAUS)
@pytest.mark.parametrize("order", [0, 1, 2])
def test_outputs_agree_with_ode_integration(taus, order):
    """I·φ⁽ᵏ⁾ by integration; for k = 2 the filter lacks I·φ'(0), an impulse response."""
    tau1, tau2 = taus
    step = min(tau1 / 2000, 2e-4)  # what straight lines between samples lose is (step/τ)²/12
    t = np.arange(30_001) * step
    expected = integrate(tau1, tau2, lambda time: phi(time)[order], [0, 0], t)
    got = OutputFilter(tau1, tau2, step).apply(phi(t)[0], order=order)
    if order == 2:
        slope = phi(0.0)[1]
        got = got - integrate(tau1, tau2, lambda time: 0.0, [0, slope / (tau1 * tau2)], t)
    assert np.max(np.abs(expected)) > 0.01
    np.testing.assert_allclose(got, expected, atol=1e-6 * np.max(np.abs(expected)))


@pytest.mark.parametrize("taus", TAUS)
def test_the_hold_is_exact_on_a_coarse_grid(taus):
    """Integrated in controller form: s²·I = (1 - I - (τ1 + τ2) s·I) / (τ1 τ2)."""
    step, n = 0.05, 60
    u = np.cumsum(np.random.default_rng(3).standard_normal(n))
    u -= u[0]
    product, total = taus[0] * taus[1], taus[0] + taus[1]
    y = np.zeros((n, 2))
    for k in range(n - 1):

        def rates(time, y, a=u[k], slope=(u[k + 1] - u[k]) / step):
            return [y[1], (a + slope * time - y[0] - total * y[1]) / product]

        piece = solve_ivp(rates, (0, step), y[k], "DOP853", rtol=1e-13, atol=1e-15)
        y[k + 1] = piece.y[:, -1]
    expected = [y[:, 0], y[:, 1], (u - y[:, 0] - total * y[:, 1]) / product]
    for order in range(3):
        got = OutputFilter(*taus, step).apply(u, order=order)
        size = np.max(np.abs(expected[order]))
        np.testing.assert_allclose(got, expected[order], atol=1e-9 * size)


def test_first_order_hold_is_exact_for_straight_lines():
    t = np.arange(200) * 0.1  # a coarse grid: only exactness passes
    got = OutputFilter(0.2, 0.5, 0.1).apply(3 * t - 1, order=0)
    expected = integrate(0.2, 0.5, lambda time: 3 * time - 1, [0, 0], t)
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_held_signals_agree_with_scipys_zero_order_hold():
    u = np.random.default_rng(1).standard_normal(500)
    got = OutputFilter(0.03, 0.07, 0.01).apply(u, u)
    a = np.array([[0, 1], [-1 / 0.0021, -0.1 / 0.0021]])
    b = np.array([[0], [1 / 0.0021]])
    system = cont2discrete((a, b, np.array([[1, 0]]), np.array([[0]])), 0.01, "zoh")
    np.testing.assert_allclose(got, dlsim(system, u)[1][:, 0], atol=1e-12)


def test_a_product_of_a_held_and_a_straight_signal_is_exact():
    t = np.arange(300) * 0.02
    u = np.sign(np.sin(5 * t))
    x = 1 + 2 * t
    got = OutputFilter(0.1, 0.1, 0.02).apply(u * x, u * np.append(x[1:], x[-1]))
    state = np.zeros(2)
    exact = [0.0]
    for k in range(len(t) - 1):
        piece = solve_ivp(
            lambda time, y, k=k: [y[1], (u[k] * (1 + 2 * time) - y[0]) / 0.01 - 20 * y[1]],
            (t[k], t[k + 1]),
            state,
            "DOP853",
            rtol=1e-12,
            atol=1e-14,
        )
        state = piece.y[:, -1]
        exact.append(state[0])
    np.testing.assert_allclose(got, exact, atol=1e-11)


@pytest.mark.parametrize("taus", TAUS)
def test_transients_span_the_unforced_motions(taus):
    t = np.arange(2000) * 1e-3
    first, second = np.exp(-t / taus[0]), np.exp(-t / taus[1])
    if abs(taus[0] - taus[1]) < 1e-6:
        second = t * first
    got = OutputFilter(*taus, 1e-3).transients(len(t))
    expected = np.column_stack([first, second])
    assert np.max(subspace_angles(got, expected)) < 1e-6
    assert np.linalg.cond(got / np.linalg.norm(got, axis=0)) < 1e6


@settings(max_examples=40, deadline=None)
@given(
    tau1=st.floats(0.02, 5),
    tau2=st.floats(0.02, 5),
    scale=st.floats(1e-3, 1e3),
    order=st.integers(0, 2),
    seed=st.integers(0, 99),
)
def test_the_unit_of_time_does_not_matter(tau1, tau2, scale, order, seed):
    signal = np.cumsum(np.random.default_rng(seed).standard_normal(200))
    here = OutputFilter(tau1, tau2, 0.01).apply(signal, order=order)
    there = OutputFilter(tau1 * scale, tau2 * scale, 0.01 * scale).apply(signal, order=order)
    tolerance = 1e-9 * np.max(np.abs(here))
    np.testing.assert_allclose(there * scale**order, here, rtol=1e-8, atol=tolerance)


@settings(max_examples=40, deadline=None)
@given(
    tau1=st.floats(0.02, 5), tau2=st.floats(0.02, 5), order=st.integers(0, 2), c=st.floats(-9, 9)
)
def test_it_is_linear_and_its_sections_commute(tau1, tau2, order, c):
    a, b = np.random.default_rng(0).standard_normal((2, 100)).cumsum(axis=1)
    one, other = OutputFilter(tau1, tau2, 0.01), OutputFilter(tau2, tau1, 0.01)
    together = one.apply(np.column_stack([a, b, a + c * b]), order=order)
    size = np.max(np.abs(together)) + 1
    np.testing.assert_allclose(
        together[:, 2], together[:, 0] + c * together[:, 1], atol=1e-9 * size
    )
    np.testing.assert_allclose(other.apply(a, order=order), together[:, 0], atol=1e-8 * size)


@pytest.mark.parametrize("bad", [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (np.inf, 1.0)])
def test_time_constants_have_to_be_positive(bad):
    with pytest.raises(InputError, match="give a positive number of seconds"):
        OutputFilter(*bad, 1e-3)


def test_the_choice_of_tau_follows_the_motion_not_the_noise():
    t = np.arange(20_000) * 1e-3
    noise = np.random.default_rng(0).standard_normal(len(t))
    for omega in (3.0, 10.0):
        clean = choose_tau([np.sin(omega * t)], 1e-3)[0]
        noisy = choose_tau([np.sin(omega * t) + 0.05 * noise], 1e-3)[0]
        assert 0.7 / omega < clean < 1.4 / omega
        assert 0.7 / omega < noisy < 1.4 / omega


def test_a_record_at_rest_still_gets_a_tau():
    tau, shortest, longest = choose_tau([np.zeros(1000)], 1e-3)
    assert shortest <= tau <= longest <= 0.1 + 1e-12
