"""Windows of a record: where they begin, and the state each begins in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.problem import Matrix, Problem, Vector
from identification.simulator import Simulator

# Share of a window that may be used to estimate its initial state, and is therefore not scored.
SETTLING_SHARE = 0.1
_SHORTEST_SETTLING = 8
_ITERATIONS = 12
# Windows of a fit hold at least this many samples, however slowly a plant was sampled.
_FEWEST = 20
# Duration of the local polynomial that guesses a state [s].
_LOCAL = 0.04


@dataclass(frozen=True)
class Window:
    """Samples `begin` to `end` (exclusive) of a record."""

    begin: int
    end: int

    def __len__(self) -> int:
        return self.end - self.begin


def cut(n: int, sample_time: float, horizon: float | None) -> tuple[Window, ...]:
    """Cut `n` samples into windows of `horizon` seconds; None: one window.

    A remainder shorter than half a window, or of a single sample, joins the one before it.

    Example:
        >>> [(w.begin, w.end) for w in cut(2300, 1e-3, 1.0)]
        [(0, 1000), (1000, 2300)]
    """
    if horizon is None:
        return (Window(0, n),)
    length = max(2, round(horizon / sample_time))
    begins = list(range(0, n, length))
    if len(begins) > 1 and n - begins[-1] < max(length / 2, 2):
        begins.pop()
    ends = [*begins[1:], n]
    return tuple(Window(b, e) for b, e in zip(begins, ends, strict=True))


def fitting_length(seconds: float, sample_time: float) -> float:
    """Return a window length [s], longer than asked where it would hold too few samples to fit.

    Example:
        >>> fitting_length(0.25, 1e-3), fitting_length(0.25, 2.0)
        (0.25, 40.0)
    """
    return max(seconds, _FEWEST * sample_time)


def settling_samples(window: Window, horizon_samples: int | None = None) -> int:
    """Return how many first samples of a window serve its initial state only."""
    length = len(window) if horizon_samples is None else min(len(window), horizon_samples)
    return min(max(_SHORTEST_SETTLING, round(SETTLING_SHARE * length)), len(window) // 2)


def guess_states(problem: Problem, shooting: Simulator, windows: Sequence[Window]) -> Matrix:
    """Guess each window's initial state from the measurement alone, by local polynomials.

    Measured states take the fitted value, a state that is the derivative of a measured state its
    slope, any other its start.

    Returns:
        (windows, nx).
    """
    dae, h = problem.dae, problem.sample_time
    start = {v.name: dae.number(v.start, 0.0) for v in dae.states}
    for parameter, state in dae.start_parameters.items():
        start[state] = problem.values.get(parameter, start[state])
    states = list(shooting.state_names)
    measured = shooting.measured_states
    guesses = np.tile([start[name] for name in states], (len(windows), 1))
    for row, window in enumerate(windows):
        n = min(len(window), max(6, round(_LOCAL / h)))
        t = np.arange(n) * h
        for i, (output, gain) in measured.items():
            y = problem.outputs[window.begin : window.begin + n, output] / gain
            value, slope = np.polynomial.polynomial.polyfit(t, y, min(2, n - 1))[:2]
            guesses[row, i] = value
            rate = shooting.rate_of.get(states[i])
            if rate is not None and states.index(rate) not in measured:
                guesses[row, states.index(rate)] = slope
    return guesses


def settle(
    problem: Problem,
    shooting: Simulator,
    window: Window,
    samples: int,
    guess: Vector,
    inputs: Matrix,
    p: Vector,
    sd: Vector,
) -> Vector:
    """Estimate a window's initial state from its first samples, through the model.

    Gauss–Newton with a weak pull to the guess, so that what these samples do not see stays there.

    Args:
        samples: How many samples may be used.
        guess: (nx,).
        inputs: (n, …) of the whole record, with delays.
        p: (np,).
        sd: (ny,) weights.

    Returns:
        (nx,); the guess where the iteration did not improve on it.
    """
    part = slice(window.begin, window.begin + samples)
    y, u = problem.outputs[part], np.ascontiguousarray(inputs[part])
    scale = 1.0 + np.abs(guess)

    def cost(x0: Vector) -> tuple[float, Matrix, Vector]:
        response = shooting.run(
            x0, u, p, problem.sample_time, t0=float(problem.time[window.begin]), sensitivities=True
        )
        residual = ((y - response.outputs) / sd).ravel()
        jacobian = (response.sensitivities[:, :, : shooting.nx] / sd[:, None]).reshape(
            len(residual), shooting.nx
        )
        if response.finite < samples:
            return np.inf, jacobian, residual
        return float(residual @ residual), jacobian, residual

    best, x0 = np.inf, guess.copy()
    trial = guess.copy()
    damping = 1e-9
    jacobian, residual = np.zeros((0, shooting.nx)), np.zeros(0)
    for _ in range(_ITERATIONS):
        value, j, r = cost(trial)
        if value < best:
            if best - value < 1e-9 * max(best, 1e-300) and np.isfinite(best):
                x0 = trial
                break
            best, x0, jacobian, residual = value, trial, j, r
            damping = max(damping / 10, 1e-12)
        elif not np.isfinite(best):
            break
        else:
            damping = max(damping * 100, 1e-6)
        normal = jacobian.T @ jacobian
        ridge = damping * np.diag(normal) + 1e-9 * np.max(np.diag(normal), initial=1e-30) / scale**2
        trial = x0 + np.linalg.solve(normal + np.diag(ridge + 1e-300), jacobian.T @ residual)
    return x0
