"""Independent right-hand sides, integrated with SciPy's DOP853 at 1e-10."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from fmus.sources import ModelicaSource


def source(text, name="T"):
    return ModelicaSource(text, name, f"{name}.mo", f"{name}.mo:{name}")


def integrate(rhs, start, breaks, value_at, times):
    """States at `times`, shape (n, nx); between two `breaks` the input is constant."""
    breaks = np.union1d(breaks, times)
    state, states = np.asarray(start, float), {breaks[0]: np.asarray(start, float)}
    for a, b in pairwise(breaks):
        u = value_at(0.5 * (a + b))
        run = solve_ivp(
            lambda t, x, u=u: rhs(t, x, u), (a, b), state, method="DOP853", rtol=1e-10, atol=1e-12
        )
        assert run.success
        state = run.y[:, -1]
        states[b] = state
    return np.array([states[t] for t in times])


def staircase(times, values):
    return lambda t: values[np.searchsorted(times, t, side="right") - 1]
