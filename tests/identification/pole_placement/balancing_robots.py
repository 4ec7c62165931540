"""The dissertation's two robots, nonlinear, with its misprints corrected; shares no product code.

P. E. E. Shwe, "A Numerical Simulation Study of Data-driven Pole Placement", Kanazawa University,
2017. Corrections: the 2-D state is [θ_b, θ_m, θ_b', θ_m'], a = 6.28e-2, M_w, J_w, J_m are totals of
both wheels; in 3-D d_b = g_r² K_t K_e / R_m + g_r d_m and the input gain is 1 b_v; the noise's
printed variances are standard deviations.

All runs of a batch are simulated at once: states have shape (n, runs).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.signal import cont2discrete

G = 9.81


def runge_kutta(rates: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float, steps: int):
    for _ in range(steps):
        d = h / steps
        k1 = rates(x)
        k2 = rates(x + d / 2 * k1)
        k3 = rates(x + d / 2 * k2)
        k4 = rates(x + d * k3)
        x = x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def linearised(J, D, K, zeta, h):
    """J q'' + D q' + K q = ζ u, sampled with a zero-order hold; state [q, q']."""
    n = len(J)
    inverse = np.linalg.inv(J)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
    B = np.vstack([np.zeros_like(zeta), inverse @ zeta])
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(2 * n), np.zeros((2 * n, B.shape[1]))), h)
    return Ad, Bd


class Robot2D:
    """Chapters 2 and 4: x = [θ_b, θ_m, θ_b', θ_m'], h = 0.01 s."""

    h = 0.01
    poles = (0.8, 0.9, 0.9 + 0.05j, 0.9 - 0.05j)
    start = (np.deg2rad(6), 0.0, 0.0, 0.0)
    Mw, Mb, Jb, Jw, Jm = 0.071, 0.5392, 2.16e-3, 8.63e-6, 1.3e-7
    length, r, c, gear, a = 0.1073, 0.0249, 1e-4, 30, 6.28e-2

    def inertia(self, theta_b):
        cosine = np.cos(theta_b)
        wheels = (self.Mw + self.Mb) * self.r**2 + self.Jw
        lever = self.Mb * self.length * self.r
        J11 = wheels + self.gear**2 * self.Jm
        J12 = wheels + lever * cosine + self.gear * self.Jm
        J22 = wheels + self.Mb * self.length**2 + 2 * lever * cosine + self.Jb + self.Jm
        return J11, J12, J22

    def rates(self, x, u):
        """(A.262) with its sign corrected: g + r θ_b'²."""
        theta_b, _, omega_b, omega_m = x
        sine = np.sin(theta_b)
        J11, J12, J22 = self.inertia(theta_b)
        weight = self.Mb * self.length * sine
        motor = self.a * u - self.c * omega_m + weight * self.r * omega_b**2
        body = weight * (G + self.r * omega_b**2)
        det = J11 * J22 - J12**2
        return np.array(
            [
                omega_b,
                omega_m,
                (J11 * body - J12 * motor) / det,
                (J22 * motor - J12 * body) / det,
            ]
        )

    def step(self, x, u):
        return runge_kutta(lambda y: self.rates(y, u), x, self.h, 4)

    def linear(self):
        """(2.9): A0, B0 from the corrected parameters."""
        J11, J12, J22 = self.inertia(0.0)
        K = np.array([[-self.Mb * self.length * G, 0], [0, 0]])
        J, D = np.array([[J22, J12], [J12, J11]]), np.diag([0, self.c])
        return linearised(J, D, K, np.array([[0], [self.a]]), self.h)


class Robot3D:
    """Chapter 3: x = [θ_w, θ_b, θ_w', θ_b', φ, φ'], u = [u1, u2], h = 0.1 s."""

    h = 0.1
    poles1 = (6.0355e-5, 0.5253, 0.5745, 0.7630)
    poles2 = (6.0426e-5, 0.7835)
    F1 = np.array([[1.5216, 124.181, 2.3915, 18.3089]])
    F2 = np.array([[-6.2764, -0.0646]])
    noise = (1e-3, 0.0, 0.0, 1e-4, 1e-4, 0.0)
    Mb, Mw, r, Jw, d, length = 0.5, 0.07, 0.025, 8.75e-5, 0.06, 0.1073
    Jb, Jphi, Jm, Rm, Ke, gear, dm = 6.7e-3, 6e-4, 1.3e-4, 0.035, 0.02, 30, 0.0022

    def __init__(self, uncertainty: float = 1.0):
        """The "10 % uncertainty" of the initial model divides the inertias by 1.1."""
        self.uncertainty = uncertainty
        self.bv = self.gear * self.Ke / self.Rm
        self.db = self.gear**2 * self.Ke**2 / self.Rm + self.gear * self.dm

    def inertia(self, theta_b):
        rotor = 2 * self.gear**2 * self.Jm
        J11 = (2 * self.Mw + self.Mb) * self.r**2 + 2 * self.Jw + rotor
        J12 = self.Mb * self.length * self.r * np.cos(theta_b) - rotor
        J22 = self.Mb * self.length**2 + self.Jb + rotor
        yaw = 2 * self.Mw * self.d**2 + self.Mb * self.length**2 * np.sin(theta_b) ** 2 + self.Jphi
        yaw += 2 * (self.d / self.r) ** 2 * (self.Jw + self.gear**2 * self.Jm)
        return J11, J12, J22, yaw

    def rates(self, x, u):
        """(A.180) with the corrected input gain."""
        theta_b, omega_w, omega_b, yaw_rate = x[1], x[2], x[3], x[5]
        sine, cosine = np.sin(theta_b), np.cos(theta_b)
        J11, J12, J22, Jyaw = self.inertia(theta_b)
        weight = self.Mb * self.length * sine
        torque = self.bv * u[0] - 2 * self.db * (omega_w - omega_b)
        wheel = torque + weight * self.r * omega_b**2
        body = -torque + weight * (G + self.length * cosine * yaw_rate**2)
        det = J11 * J22 - J12**2
        ratio = self.d / self.r
        turn = ratio * self.bv * u[1] - 2 * ratio**2 * self.db * yaw_rate
        turn = turn - 2 * weight * self.length * cosine * omega_b * yaw_rate
        return np.array(
            [
                omega_w,
                omega_b,
                (J22 * wheel - J12 * body) / det,
                (J11 * body - J12 * wheel) / det,
                yaw_rate,
                turn / Jyaw,
            ]
        )

    def step(self, x, u):
        return runge_kutta(lambda y: self.rates(y, u), x, self.h, 12)

    def linear(self):
        """(3.31): A1, B1, A2, B2."""
        J11, J12, J22, Jyaw = (j / self.uncertainty for j in self.inertia(0.0))
        K = np.diag([0, -self.Mb * self.length * G])
        D = 2 * self.db * np.array([[1, -1], [-1, 1]])
        zeta = self.bv * np.array([[1], [-1]])
        ratio = self.d / self.r
        first = linearised(np.array([[J11, J12], [J12, J22]]), D, K, zeta, self.h)
        second = linearised(
            np.array([[Jyaw]]),
            np.array([[2 * ratio**2 * self.db]]),
            np.zeros((1, 1)),
            np.array([[ratio * self.bv]]),
            self.h,
        )
        return *first, *second


@dataclass(frozen=True)
class Runs:
    """Measured states (runs, N+1, n), inputs and excitation (runs, N, m), true states."""

    states: np.ndarray
    inputs: np.ndarray
    excitation: np.ndarray
    truth: np.ndarray


def run_3d(
    runs: int,
    seed: int,
    *,
    noise: float = 1.0,
    chirp: float | None = None,
    samples: int = 451,
    amplitude: float = 1.0,
) -> Runs:
    """Closed loop (3.27) from rest; random excitation, or a chirp from 0 to `chirp` Hz."""
    robot, rng = Robot3D(), np.random.default_rng(seed)
    sd = noise * np.array(robot.noise)[:, None]
    x = np.zeros((6, runs))
    states, truth = np.empty((2, samples + 1, 6, runs))
    inputs, excitation = np.empty((2, samples, 2, runs))
    time = np.arange(samples) * robot.h
    for k in range(samples + 1):
        truth[k] = x
        states[k] = x + sd * rng.standard_normal((6, runs))
        if k == samples:
            break
        if chirp is None:
            v = rng.uniform(-1, 1, (2, runs))
        else:
            v = np.full((2, runs), np.sin(np.pi * chirp * time[k] ** 2 / 50))
        v = amplitude * np.array([[0.5], [0.1]]) * v
        u = np.vstack([robot.F1 @ states[k, :4], robot.F2 @ states[k, 4:]]) + v
        inputs[k], excitation[k] = u, v
        x = robot.step(x, u)
    return Runs(*(np.moveaxis(a, -1, 0) for a in (states, inputs, excitation, truth)))


def run_2d(
    runs: int,
    seed: int,
    gain: np.ndarray,
    *,
    excitation: float = 0.02,
    noise: float = 0.0,
    samples: int = 130,
    tilt: float = 6.0,
) -> Runs:
    """Chapter 2: u = F0 x + v, v ~ U(-excitation, excitation), noise on both angles."""
    robot, rng = Robot2D(), np.random.default_rng(seed)
    x = np.zeros((4, runs))
    x[0] = np.deg2rad(tilt)
    sd = noise * np.array([1, 1, 0, 0])[:, None]
    states, truth = np.empty((2, samples + 1, 4, runs))
    inputs, exciting = np.empty((2, samples, 1, runs))
    for k in range(samples + 1):
        truth[k], states[k] = x, x + sd * rng.standard_normal((4, runs))
        if k == samples:
            break
        v = rng.uniform(-excitation, excitation, (1, runs))
        u = gain @ states[k] + v
        inputs[k], exciting[k] = u, v
        x = robot.step(x, u[0])
    return Runs(*(np.moveaxis(a, -1, 0) for a in (states, inputs, exciting, truth)))


@dataclass(frozen=True)
class OnlineRun:
    """One on-line run: whether it stayed up, true states (K+1, n), gains (K, n), models' errors."""

    stable: bool
    states: np.ndarray
    gains: np.ndarray
    model_error: np.ndarray
    input_error: np.ndarray


def run_online(updater, seed: int, *, noise: float = 0.0, samples: int = 300) -> OnlineRun:
    """Chapter 4: from 6 deg without a gain; `updater(x, u)` gives (A, B, F), None before a model.

    Stable: the body stays within 90 deg.
    """
    robot, rng = Robot2D(), np.random.default_rng(seed)
    A0, B0 = robot.linear()
    x, u = np.array(robot.start), None
    sd = noise * np.array([1, 1, 0, 0])
    states, gains, errors = [x], [], []
    for _ in range(samples):
        measured = x + sd * rng.standard_normal(4)
        A, B, F = updater(measured, u)
        gains.append(F[0])
        errors.append(
            (np.nan, np.nan)
            if A is None
            else (np.linalg.norm(A - A0, 2), np.linalg.norm(B - B0, 2))
        )
        u = F @ measured + rng.uniform(-0.05, 0.05, 1)
        with np.errstate(over="ignore", invalid="ignore"):  # a wild gain is an outcome
            x = robot.step(x, u[0])
        states.append(x)
        if not np.all(np.isfinite(x)) or abs(x[0]) > np.pi / 2:
            break
    stable = bool(np.all(np.isfinite(x)) and abs(x[0]) <= np.pi / 2)
    delta = np.array(errors)
    return OnlineRun(stable, np.array(states), np.array(gains), delta[:, 0], delta[:, 1])


def matlab_sorted(values) -> np.ndarray:
    """By magnitude, equal ones by phase, as MATLAB's `sort`."""
    values = np.asarray(values, complex)
    return values[np.lexsort((np.angle(values), np.round(np.abs(values), 9)))]


def pole_error(got, wanted) -> float:
    """(3.36), paired by `sort` as in the dissertation."""
    return float(np.max(np.abs(matlab_sorted(got) - matlab_sorted(wanted))))


def matched_pole_error(got, wanted) -> float:
    """(2.19) with the best pairing: `sort` mispairs complex poles of like magnitude."""
    got = np.asarray(got, complex)
    return min(float(np.max(np.abs(got[list(p)] - wanted))) for p in permutations(range(len(got))))


def impulse_response(A, B, steps: int = 10):
    """x(0) = 0, x(1) = B / h for a pulse of unit area at h = 0.1 s."""
    x, out = 10 * B, [np.zeros_like(B)]
    for _ in range(steps):
        out.append(x)
        x = A @ x
    return np.array(out)


def table_errors(A, B, F, true_A, true_B, poles) -> list[float]:
    """A column of Table 3.1: δλ(A_d), ΔA, ΔB, δλ(A), ΔG."""
    return [
        pole_error(np.linalg.eigvals(true_A + true_B @ F), poles),
        float(np.linalg.norm(A - true_A, 2)),
        float(np.linalg.norm(B - true_B, 2)),
        pole_error(np.linalg.eigvals(A), np.linalg.eigvals(true_A)),
        float(np.linalg.norm(impulse_response(A, B) - impulse_response(true_A, true_B))),
    ]
