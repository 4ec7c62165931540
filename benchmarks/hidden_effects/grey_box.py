"""A baseline: stochastic grey-box model, its diffusion the sign that something is missing.

After N. R. Kristensen, H. Madsen, S. B. Jørgensen, "A method for systematic improvement of
stochastic grey-box models", Computers and Chemical Engineering 28 (2004) 1431-1449: an extended
Kalman filter over the states, the model's parameters and a random-walk force at every flange. If a
diffusion makes the record more likely than none does, something is missing there; the smoothed
force, regressed on every law, says what.

In the method's favour: the sensors' noise is known to it, parameters and forces get the scales
that are usual for the machine, the filter passes three times so that it is linearised at its own
estimates, and what a change of the parameters could do is taken out of force and laws alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.cases import Case
from benchmarks.hidden_effects.library import (
    Given,
    candidates,
    caused,
    sensitivities,
    without,
    work,
)
from benchmarks.hidden_effects.simulation import SAMPLE

Array = NDArray[np.float64]
_LEVELS = {1: (0.0, 0.004, 0.01, 0.03, 0.1, 0.3), 2: (0.0, 0.01, 0.05, 0.25)}
"""Diffusions at each of one or two flanges, in usual forces per root second."""
_START = 0.2  # Force at the start, standard deviation in usual forces.
_KNOWN = (1.0, 0.3, 0.1)  # Of the parameters, in their scales, from pass to pass.
_PRESENT = 10.0
"""Log-likelihood ratio above which a force is there [nats]: p = 5e-4 for two of them, each with a
diffusion and a value at the start (chi-squared of 4 degrees of freedom)."""
_EXPLAINED = 0.5
"""Share of the force that a law must explain to be named."""
_INDEPENDENT = 0.05  # A law of which less is left beside the parameters is one of theirs.
_STEP = 1e-5  # Of differences, in each variable's scale.


def baseline(case: Case) -> dict[str, object]:
    """Work a case: see `library.work` for what is returned."""
    return work(case, named)


def named(g: Given) -> str:
    """Return the label of what is missing; empty for nothing."""
    levels, count = _LEVELS[len(g.plant.flanges)], len(g.plant.flanges)
    # Linearised at what is known before, then at each pass's own estimates.
    start, equal = np.zeros(len(g.parameters)), np.array(levels)[:, None] * np.ones(count)
    for known in _KNOWN[:-1]:
        found = _filter(g, equal, start, known)
        start = found.parameters[int(np.argmax(found.likelihood))]
    grid = np.array(list(product(levels, repeat=count)))
    found = _filter(g, grid, start, _KNOWN[-1])
    best = int(np.argmax(found.likelihood))
    if not found.likelihood[best] - found.likelihood[0] > _PRESENT:
        return ""
    level = grid[best : best + 1]
    chosen = _filter(g, level, start, _KNOWN[-1], keep=True)
    return _law(g, _smooth(g, chosen), level[0] > 0)


@dataclass(frozen=True)
class _Pass:
    """What a pass of the filter leaves: of the members, and of a single member's steps."""

    likelihood: Array
    parameters: Array
    predicted: list[tuple[Array, Array]]
    transitions: list[Array]


def _filter(g: Given, levels: Array, start: Array, known: float, *, keep: bool = False) -> _Pass:
    """Run the extended Kalman filter for many diffusions at once.

    Args:
        levels: (members, flanges) in usual forces per root second.
        start: (parameters,) off the model's, in their scales.
        known: To what the parameters are known (one standard deviation), in their scales.
        keep: Keep the steps, for the smoother.
    """
    flanges = list(g.plant.flanges.values())
    nx, nt, nf = g.plant.states, len(g.parameters), len(flanges)
    nz, members, h = nx + nt + nf, len(levels), SAMPLE
    shown = _shown(g)
    scale = np.ones(nx)
    for f in flanges:
        scale[f.position], scale[f.speed] = f.position_scale, f.speed_scale
    sd = np.ones((members, nz))
    sd[:, :nx] = scale
    sd[:, nx : nx + nt] = known
    sd[:, nx + nt :] = _START * (levels > 0)
    z = np.zeros((members, nz))
    z[:, nx : nx + nt] = start
    z[:, shown] = g.measured[0]
    covariance = sd[:, :, None] ** 2 * np.eye(nz)
    diffusion = np.zeros((members, nz, nz))
    rows = np.arange(nx + nt, nz)
    diffusion[:, rows, rows] = h * levels**2
    noise = np.diag(g.sd**2)
    likelihood = np.zeros(members)
    step = np.concatenate([_STEP * scale, np.full(nt + nf, _STEP)])
    lanes = np.vstack([np.zeros(nz), np.diag(step)])
    predicted: list[tuple[Array, Array]] = []
    transitions: list[Array] = []
    with np.errstate(all="ignore"):
        for k, y in enumerate(g.measured):
            if keep:
                predicted.append((z[0], covariance[0]))
            innovation = y - z[:, shown]
            cross = covariance[:, :, shown]
            total = cross[:, shown] + noise
            # A member that has lost its way is out; the others go on.
            lost = ~(np.linalg.det(total) > 0) | ~np.isfinite(z).all(axis=1)
            likelihood[lost], total[lost] = -np.inf, noise
            inverse = np.linalg.inv(total)
            gain = cross @ inverse
            weighted = (inverse @ innovation[:, :, None])[:, :, 0]
            likelihood -= 0.5 * (
                np.sum(innovation * weighted, axis=1) + np.log(np.linalg.det(total))
            )
            z = z + (gain @ innovation[:, :, None])[:, :, 0]
            covariance = covariance - gain @ cross.transpose(0, 2, 1)
            around = z[:, None, :] + lanes
            ahead = _ahead(g, around, g.command[k], h)
            z = ahead[:, 0]
            transition = ((ahead[:, 1:] - ahead[:, :1]) / step[:, None]).transpose(0, 2, 1)
            covariance = transition @ covariance @ transition.transpose(0, 2, 1) + diffusion
            covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
            if keep:
                transitions.append(transition[0])
    likelihood[np.isnan(likelihood)] = -np.inf
    return _Pass(likelihood, np.nan_to_num(z[:, nx : nx + nt]), predicted, transitions)


def _ahead(g: Given, z: Array, command: float, h: float) -> Array:
    """Return what (…, nz) becomes a step later; parameters and forces stay."""
    nx = g.plant.states
    flat = z.reshape(-1, z.shape[-1]).T
    x, u = flat[:nx], np.full(flat.shape[1], command)
    values = _values(g, flat[nx:])
    first = nx + len(values)
    force = {
        place: f.force_scale * flat[first + j]
        for j, (place, f) in enumerate(g.plant.flanges.items())
    }
    k1 = g.rates(x, u, values, force)
    k2 = g.rates(x + h / 2 * k1, u, values, force)
    k3 = g.rates(x + h / 2 * k2, u, values, force)
    k4 = g.rates(x + h * k3, u, values, force)
    x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.concatenate([x, flat[nx:]]).T.reshape(z.shape)


def _shown(g: Given) -> list[int]:
    """Return the states that the sensors show."""
    return [s.state for s in g.plant.sensors.values()]


def _values(g: Given, off: Array) -> dict[str, Array]:
    """Return the parameters for how far off they are (parameters, …); positive ones stay so."""
    return {
        k: v * np.exp(g.scales[k] / v * off[i]) if v > 0 else v + g.scales[k] * off[i]
        for i, (k, v) in enumerate(g.parameters.items())
    }


def _smooth(g: Given, p: _Pass) -> tuple[Array, Array]:
    """Return smoothed means and variances (n, nz), by the modified Bryson-Frazier recursion."""
    n, nz, shown = len(g.time), len(p.predicted[0][0]), _shown(g)
    means, variances = np.zeros((n, nz)), np.zeros((n, nz))
    noise, one = np.diag(g.sd**2), np.eye(nz)
    slope, curvature = np.zeros(nz), np.zeros((nz, nz))
    for k in range(n - 1, -1, -1):
        z, covariance = p.predicted[k]
        slope = p.transitions[k].T @ slope
        curvature = p.transitions[k].T @ curvature @ p.transitions[k]
        inverse = np.linalg.inv(covariance[np.ix_(shown, shown)] + noise)
        left = one.copy()
        left[:, shown] -= covariance[:, shown] @ inverse
        slope = left.T @ slope
        slope[shown] -= inverse @ (g.measured[k] - z[shown])
        curvature = left.T @ curvature @ left
        curvature[np.ix_(shown, shown)] += inverse
        means[k] = z - covariance @ slope
        variances[k] = np.diag(covariance - covariance @ curvature @ covariance)
    return means, variances


def _law(g: Given, smoothed: tuple[Array, Array], active: NDArray[np.bool_]) -> str:
    """Return the law that explains most of the force at the flanges that have one."""
    means, variances = smoothed
    nx, nt = g.plant.states, len(g.parameters)
    x, u = means[:, :nx].T, g.command
    middle = np.median(means[:, nx : nx + nt], axis=0)
    p = _values(g, middle)
    scale = np.array([f.force_scale for f in g.plant.flanges.values()])
    sd = np.sqrt(np.median(variances[:, nx + nt :], axis=0).clip(1e-300))
    ones = np.ones_like(u)
    # (flanges, flanges, n): the force that each acceleration takes.
    effect = np.array([caused(g, x, u, p, place, ones) for place in g.plant.flanges])
    taken = np.linalg.inv(effect.transpose(2, 1, 0))

    def rows(accelerations: Array) -> Array:
        force = (taken @ accelerations.T[:, :, None])[:, :, 0] / (scale * sd)
        return force[:, active].T.ravel()

    force = (means[:, nx + nt :] / sd)[:, active].T.ravel()
    nuisance = np.array([rows(a) for a in sensitivities(g, x, u, p)]).T
    force = without(force[:, None], nuisance=nuisance)[:, 0]
    best, label = _EXPLAINED, ""
    for c in candidates(g, x, u, g.time):
        for law in c.variants:
            whole = rows(caused(g, x, u, p, c.place, law))
            rest = without(whole[:, None], nuisance=nuisance)[:, 0]
            size = np.linalg.norm(rest)
            if size <= _INDEPENDENT * np.linalg.norm(whole) or not size > 0:
                continue
            alike = float(force @ rest) / size / np.linalg.norm(force)
            if alike**2 > best and (alike > 0 or not c.positive):
                best, label = alike**2, c.label
    return label
