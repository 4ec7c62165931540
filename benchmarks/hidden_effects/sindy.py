"""A baseline: sparse identification (SINDy) on the residual of the equations of motion.

The measured outputs are smoothed (Savitzky–Golay), rates and accelerations that are not measured
come from their derivatives, and what the user's model does not explain of the accelerations is
regressed on every law at every place. Errors of the parameters are taken up by the accelerations'
sensitivities to them, which are neither thresholded nor shrunk. PySINDy's STLSQ does the sparse
regression; its threshold and ridge are those of the smallest extended BIC.

In the method's favour: the model's parameters are first refitted to the accelerations, so that the
sensitivities hold; both sides of the equation go through the same smoothing; every signal is
smoothed as much as its known noise allows; and a coefficient outside the library's range is
dropped.

Reference:
    S. L. Brunton, J. L. Proctor, J. N. Kutz, PNAS 113 (2016) 3932-3937.
    A. A. Kaptanoglu et al., PySINDy, Journal of Open Source Software 7 (2022) 3994.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve, savgol_coeffs, savgol_filter

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
_WINDOWS = (7, 11, 15, 21, 31, 45, 61, 81, 121)  # [samples]
_SHORTEST = 15  # For accelerations, which noise spoils more than states [samples].
_ORDER = 4
_NEWS = 4  # Independent values in one window.
_THRESHOLDS = np.geomspace(0.01, 1.0, 25)  # of the residual's rms
_RIDGES = (1e-6, 1e-4, 1e-2)
_INDEPENDENT = 0.05  # A column of which less is left beside the parameters is one of theirs.


def baseline(case: Case) -> dict[str, object]:
    """Work a case: see `library.work` for what is returned."""
    return work(case, named)


def named(g: Given) -> str:
    """Return the label of what is missing; empty for nothing."""
    x, rows = _states(g), _Rows(g)
    u = _centred(g.command)
    p = dict(g.parameters)
    for _ in range(5):
        nuisance = np.array([rows.model(c) for c in sensitivities(g, x, u, p)]).T
        y = rows.measured - rows.model(g.rates(x, u, p, {})[g.accelerations])
        step = np.linalg.lstsq(
            # The prior holds what the record does not show.
            np.vstack([nuisance, np.eye(len(p))]),
            np.append(y, np.zeros(len(p))),
        )[0]
        for (name, value), change in zip(p.items(), np.clip(step, -1, 1), strict=True):
            p[name] = value + change * g.scales[name]
    nuisance = np.array([rows.model(c) for c in sensitivities(g, x, u, p)]).T
    y = rows.measured - rows.model(g.rates(x, u, p, {})[g.accelerations])
    y = without(y[:, None], nuisance=nuisance)[:, 0]
    y /= np.linalg.norm(y)
    labels, positive, columns = [], [], []
    for c in candidates(g, x, g.command, g.time):
        laws = c.variants if c.place in g.plant.flanges else [_centred(v) for v in c.variants]
        effects = [rows.model(caused(g, x, u, p, c.place, law)) for law in laws]
        whole = np.array(effects).T
        size = np.linalg.norm(whole, axis=0)
        whole = whole[:, size > 0] / size[size > 0]
        rest = without(whole, nuisance=nuisance)
        left = np.linalg.norm(rest, axis=0)
        if not np.any(left > _INDEPENDENT):
            continue
        # Of a law's shapes the one that lies nearest the residual.
        alike = np.where(left > _INDEPENDENT, y @ rest / np.fmax(left, _INDEPENDENT), 0.0)
        best = int(np.argmax(alike if c.positive else np.abs(alike)))
        labels.append(c.label)
        positive.append(c.positive)
        columns.append(rest[:, best] / left[best])
    coefficients = _sparse(np.array(columns).T, y, np.array(positive))
    shares = np.abs(coefficients)
    return labels[int(np.argmax(shares))] if np.any(shares > 0) else ""


class _Rows:
    """The equations of motion, smoothed, weighted by their noise and thinned to new information."""

    def __init__(self, g: Given) -> None:
        sensors = {s.state: k for k, s in enumerate(g.plant.sensors.values())}
        self.kernels: list[Array] = []
        parts: list[Array] = []
        # What is smoothed over a window is news after a share of it, be it a state or a rate.
        windows = {k: max(_window(g, k), _SHORTEST) for k in sensors.values()}
        longest = max(windows.values())
        self.kept = np.arange(longest, len(g.time) - longest, longest // _NEWS)
        for f in g.plant.flanges.values():
            order, k = (1, sensors[f.speed]) if f.speed in sensors else (2, sensors[f.position])
            slope = savgol_coeffs(windows[k], _ORDER, deriv=order, delta=SAMPLE)
            slope /= g.sd[k] * np.linalg.norm(slope)
            parts.append(oaconvolve(g.measured[:, k], slope, "same")[self.kept])
            for _ in range(order):
                # Sums by parts: what does to a rate what the slope does to its integral.
                slope = SAMPLE / 2 * np.convolve(np.cumsum(slope)[:-1], [1, 1])
            self.kernels.append(slope)
        self.measured = np.concatenate(parts)

    def model(self, accelerations: Array) -> Array:
        """Return a model's accelerations (flanges, n) as rows (m,) like the measured ones."""
        parts = zip(accelerations, self.kernels, strict=True)
        return np.concatenate([oaconvolve(a, kernel, "same")[self.kept] for a, kernel in parts])


def _states(g: Given) -> Array:
    """Return states (nx, n) from the smoothed outputs."""
    x = np.zeros((g.plant.states, len(g.time)))
    smoothed = {s.state: _smoothed(g, k, 0) for k, s in enumerate(g.plant.sensors.values())}
    sensors = {s.state: k for k, s in enumerate(g.plant.sensors.values())}
    for f in g.plant.flanges.values():
        x[f.position] = smoothed[f.position]
        known = f.speed in smoothed
        x[f.speed] = smoothed[f.speed] if known else _smoothed(g, sensors[f.position], 1)
    return x


def _smoothed(g: Given, sensor: int, order: int) -> Array:
    """Return an output or its slope, smoothed."""
    window = _window(g, sensor)
    return savgol_filter(g.measured[:, sensor], window, _ORDER, deriv=order, delta=SAMPLE)


def _window(g: Given, sensor: int) -> int:
    """Return the longest window that takes no more away than the sensor's noise."""
    y, sd = g.measured[:, sensor], g.sd[sensor]
    fitting = [w for w in _WINDOWS if np.std(y - savgol_filter(y, w, _ORDER)) < 1.05 * sd]
    return max(fitting, default=_WINDOWS[0])


def _centred(u: Array) -> Array:
    """Return a held signal's mean about each sample."""
    return 0.5 * (u + np.append(u[0], u[:-1]))


def _sparse(columns: Array, y: Array, positive: NDArray[np.bool_]) -> Array:
    """Return the coefficients of the smallest extended BIC over STLSQ's thresholds and ridges."""
    n = len(y)
    # Extended (J. Chen, Z. Chen, Biometrika 95 (2008) 759-771): there are many laws to pick from.
    price = np.log(n) + 2 * np.log(columns.shape[1])
    # The same least-squares problem in as many rows as there are columns.
    q, r = np.linalg.qr(columns)
    short = q.T @ y
    beyond = float(y @ y - short @ short)
    best, chosen = n * np.log(float(y @ y) / n), np.zeros(columns.shape[1])
    for ridge in _RIDGES:
        for threshold in _THRESHOLDS:
            coefficients = _stlsq(r, short, threshold, ridge, positive)
            count = np.count_nonzero(coefficients)
            left = beyond + float(np.sum((short - r @ coefficients) ** 2))
            bic = n * np.log(left / n) + count * price
            if bic < best:
                best, chosen = bic, coefficients
            if not count:
                break
    return chosen


def _stlsq(
    columns: Array, y: Array, threshold: float, ridge: float, positive: NDArray[np.bool_]
) -> Array:
    """Return STLSQ's coefficients, columns with one of the wrong sign dropped."""
    optimizers = _pysindy()
    used = np.arange(columns.shape[1])
    coefficients = np.zeros(columns.shape[1])
    while len(used):
        with warnings.catch_warnings():
            # That everything fell below the threshold is an answer.
            warnings.simplefilter("ignore")
            fit = optimizers.STLSQ(threshold=threshold, alpha=ridge).fit(columns[:, used], y)
        found = np.ravel(fit.coef_)
        wrong = positive[used] & (found < 0)
        if not np.any(wrong):
            coefficients[used] = found
            break
        used = used[~wrong]
    return coefficients


def _pysindy() -> Any:
    try:
        from pysindy import optimizers  # noqa: PLC0415 -- not needed by anything else here
    except ImportError as error:
        raise SystemExit(
            "the baseline needs PySINDy, which the project does not depend on: pip install pysindy"
        ) from error
    return optimizers
