"""Whether a record shows an effect at all: the log-likelihood ratio at the truth.

Computed from the benchmark's own simulator. The machine without the effect is fitted to what ideal
sensors would have shown, its parameters once for the record and its state anew in every window of
one second; half the weighted square of what remains is the expected ΔlogL of the effect [nats].
A record holds more than its windows do, so the figure is a lower one. Of two effects each has to
show beside the other: the machine that lacks one has the other, whose size is fitted too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.hidden_effects.plants import Plant
from benchmarks.hidden_effects.simulation import SAMPLE, Hidden, Run, windows

# Windows of growing length: over the whole one, an unstable machine forgives no parameter.
_WINDOWS = (0.25, 0.5, 1.0)
_ITERATIONS = 30
DETECTABLE = 5.0
"""Above this many nats an effect counts as detectable."""


def log_likelihood_ratio(
    plant: Plant,
    parameters: Mapping[str, float],
    run: Run,
    noise: float,
    known: Sequence[Hidden] = (),
) -> float:
    """Return the expected ΔlogL [nats] of what a record hides over a machine that lacks it.

    Args:
        known: Effects that the fitted machine has.
    """
    names = [*parameters, *known]
    theta = np.array([*parameters.values(), *(e.size for e in known)], dtype=float)
    nats = np.inf
    x0 = run.states.T
    before = 1
    for window in _WINDOWS:
        length = round(window / SAMPLE)
        theta, x0, nats = _fit(plant, names, theta, x0[:, :: length // before], run, noise, length)
        before = length
    return nats


def _fit(
    plant: Plant,
    names: Sequence[str | Hidden],
    theta: np.ndarray,
    starts: np.ndarray,
    run: Run,
    noise: float,
    length: int,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit parameters and the windows' initial states; return them and the cost [nats]."""
    count = (len(run.time) - 1) // length
    begins = np.arange(count) * length
    index = begins[None, :] + np.arange(length)[:, None]
    command, target = run.command[index], run.exact[index]  # (n, w), (n, w, ny)
    sensors = list(plant.sensors.values())
    sd = np.array([np.hypot(noise * s.sd, s.resolution / np.sqrt(12)) for s in sensors])
    shown = [s.state for s in sensors]
    x0 = starts[:, :count].copy()
    best, damping = np.inf, 0.0
    nx, nt = plant.states, len(names)
    best_theta, best_x0 = theta, x0
    for _ in range(_ITERATIONS):
        # Lanes: as is, each parameter stepped, each initial state stepped; for every window.
        lanes = 1 + nt + nx
        p = {k: np.full((lanes, count), theta[i]) for i, k in enumerate(names)}
        start = np.repeat(x0[:, None, :], lanes, axis=1)
        steps_t = 1e-5 * np.fmax(np.abs(theta), 1e-9)
        for i, k in enumerate(names):
            p[k][1 + i] += steps_t[i]
        for i in range(nx):
            start[i, 1 + nt + i] += 1e-6
        flat = {k: v.ravel() for k, v in p.items() if isinstance(k, str)}
        sizes = {k: v.ravel() for k, v in p.items() if isinstance(k, Hidden)}
        with np.errstate(all="ignore"):
            x = windows(plant, flat, start.reshape(nx, -1), np.tile(command, (1, lanes)), sizes)
        y = x[:, shown].reshape(length, len(shown), lanes, count)
        residual = (target.transpose(0, 2, 1) - y[:, :, 0]) / sd[None, :, None]
        cost = 0.5 * float(np.sum(residual**2)) if np.all(np.isfinite(y)) else np.inf
        if not cost < best:
            damping = max(10 * damping, 1e-3)
            if damping > 1e6 or not np.isfinite(best):
                break
        else:
            gained = best - cost
            best, best_theta, best_x0 = cost, theta, x0
            damping *= 0.1
            steps = np.concatenate([steps_t, np.full(nx, 1e-6)])
            jacobian = (y[:, :, 1:] - y[:, :, :1]) / (sd[None, :, None, None] * steps[:, None])
            kept = (residual, jacobian)
            if gained < 0.01 * (1 + 0.01 * cost):
                break
        theta, x0 = _step(*kept, best_theta, best_x0, nt, damping)
    return best_theta, best_x0, best


def _step(
    residual: np.ndarray,
    jacobian: np.ndarray,
    theta: np.ndarray,
    x0: np.ndarray,
    nt: int,
    damping: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Newton with the windows' states eliminated."""
    count = x0.shape[1]
    a = np.zeros((nt, nt))
    g = np.zeros(nt)
    parts = []
    for w in range(count):
        jw = jacobian[:, :, :, w].reshape(-1, jacobian.shape[2])
        rw = residual[:, :, w].ravel()
        scale = np.sqrt(np.sum(jw * jw, axis=0)) + 1e-300
        js = jw / scale
        jt, jx = js[:, :nt] * scale[:nt], js[:, nt:]
        hxx = jx.T @ jx + (damping + 1e-12) * np.eye(jx.shape[1])
        hxt = jx.T @ jt
        gx = jx.T @ rw
        solve = np.linalg.solve(hxx, np.column_stack([hxt, gx]))
        a += jt.T @ jt - hxt.T @ solve[:, :-1]
        g += jt.T @ rw - hxt.T @ solve[:, -1]
        parts.append((solve, scale[nt:]))
    size = np.sqrt(np.diag(a).clip(1e-300))
    scaled = a / np.outer(size, size) + (damping + 1e-10) * np.eye(nt)
    dt = np.linalg.lstsq(scaled, g / size, rcond=1e-12)[0] / size
    new = x0.copy()
    for w, (solve, scale) in enumerate(parts):
        new[:, w] += (solve[:, -1] - solve[:, :-1] @ dt) / scale
    return theta + dt, new
