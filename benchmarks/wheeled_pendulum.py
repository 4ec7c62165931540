"""The reference experiment: errors, honesty of standard deviations, and speed of the estimators.

The wheeled pendulum under the paper's controller (Electronics 12 (2023) 4569), 20 s at 1 kHz,
simulated by `examples.make_demo_recording`, which shares nothing with the product.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

from benchmarks.figures import Figure
from examples import make_demo_recording as rig
from fmus.frontend import load
from fmus.sources import library_class
from identification.estimators import estimator
from identification.innovations import Disturbance, with_input_disturbances
from identification.likelihood import Likelihood, expand
from identification.online import OnlineKalman, RecursiveFilter
from identification.problem import Problem, fitted_by_default
from identification.regressors import derive

STEP = 1e-3
TRUE = {f"X{i}": getattr(rig, f"X{i}") for i in range(1, 8)}
NAMES = ("theta_w", "theta_p", "omega_p")
_PITCH = float(np.hypot(rig.PITCH_NOISE, rig.ANGLE_STEP / np.sqrt(12)))
NOISE = np.array([rig.COUNT / np.sqrt(12), _PITCH, _PITCH])
WRONG = 1.3
"""Factor by which the starting values are off."""


def gauss_markov(
    sd: float, seed: int, rate: float = 3.0, duration: float = 20.0
) -> Callable[[float], float]:
    """Return a low-pass disturbance by time: `rate` in rad/s, stationary deviation `sd`."""
    random = np.random.default_rng([seed, 77])
    decay = np.exp(-rate * STEP)
    values = [sd * random.standard_normal()]
    for step in sd * np.sqrt(1 - decay**2) * random.standard_normal(round(duration / STEP) + 2):
        values.append(decay * values[-1] + step)
    return lambda t: float(values[round(t / STEP - 0.499)])


@cache
def problem(reference: str, seed: int, disturbance: float = 0.0, duration: float = 20.0) -> Problem:
    """Simulate and match one record."""
    run = rig.simulate(
        {},
        seed=seed,
        duration=duration,
        reference=getattr(rig, reference),
        disturbance=gauss_markov(disturbance, seed, duration=duration) if disturbance else None,
    )
    dae = load(library_class("Twinproof.Plants.WheeledPendulum"))
    free = fitted_by_default(dae)
    values = {
        name: value * (WRONG if name in free else 1.0)
        for name, value in dae.parameter_values.items()
        if name not in dae.dependent_parameters
    }
    volts = run.channels["V"][:, None]
    outputs = np.column_stack([run.channels[name] for name in NAMES])
    return Problem(dae, run.time, volts, outputs, NAMES, NOISE, free, values)


@dataclass(frozen=True)
class Trial:
    """Errors of one seed, relative to the truth, and the standard deviations reported."""

    errors: np.ndarray
    sd: np.ndarray
    seconds: float


def trial(
    method: str, reference: str, seed: int, disturbance: float = 0.0, duration: float = 20.0
) -> Trial:
    """Identify one record."""
    given = problem(reference, seed, disturbance, duration)
    began = time.perf_counter()
    found = estimator(method).estimate(given).parameters
    seconds = time.perf_counter() - began
    problem.cache_clear()
    truth = np.array(list(TRUE.values()))
    return Trial(
        np.array([found[n].value for n in TRUE]) / truth - 1,
        np.array([found[n].sd for n in TRUE]) / truth,
        seconds,
    )


def trials(
    method: str, reference: str, seeds: Sequence[int], disturbance: float = 0.0
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return errors and standard deviations (seeds, 7), and the median time [s]."""
    n = len(seeds)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        found = list(pool.map(trial, [method] * n, [reference] * n, seeds, [disturbance] * n))
    return (
        np.array([t.errors for t in found]),
        np.array([t.sd for t in found]),
        float(np.median([t.seconds for t in found])),
    )


def bound(reference: str) -> np.ndarray:
    """Return the Cramér–Rao bound of a record without disturbance, relative to the truth."""
    given = problem(reference, 1).with_values(TRUE)
    dae, added = with_input_disturbances(given.dae)
    values = {**given.values, added[0]: 0.0}
    disturbed = Problem(
        dae, given.time, given.inputs, given.outputs, NAMES, NOISE, given.free, values
    )
    likelihood = Likelihood.of(disturbed, added)
    steps = {name: 1e-5 * value for name, value in TRUE.items()}
    expansion = expand(likelihood, values, [Disturbance(1.0, 0.0)], steps, shape=False)
    covariance = np.linalg.inv(expansion.information)
    return np.sqrt(np.diag(covariance)) / np.array(list(TRUE.values()))


def _accuracy(
    label: str, errors: np.ndarray, sd: np.ndarray, limits: dict[str, float]
) -> Iterator[Figure]:
    for k, name in enumerate(TRUE):
        yield Figure(
            f"{label}: median |error| of {name}",
            100 * float(np.median(np.abs(errors[:, k]))),
            limits.get(name),
            "%",
        )
    if len(errors) < 100:
        return
    for k, name in enumerate(TRUE):
        inside = 100 * float(np.mean(np.abs(errors[:, k]) <= 2 * sd[:, k]))
        yield Figure(f"{label}: {name} within 2 sd, at least", inside, 90, "%", True)
        yield Figure(f"{label}: {name} within 2 sd, at most", inside, 99, "%")


def run(seeds: int = 100) -> Iterator[Figure]:
    fine = {n: 0.3 if n in ("X1", "X2") else 0.1 for n in TRUE}
    errors, sd, seconds = trials("auto", "aggressive", range(1000, 1000 + seeds))
    yield from _accuracy("aggressive", errors, sd, fine)
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound("aggressive")
    for name, value in zip(TRUE, ratio, strict=True):
        yield Figure(f"aggressive: rms error of {name} / Cramér–Rao bound", float(value), 1.2)
    yield Figure("identify --method auto, 20 s at 1 kHz", seconds, 20.0, "s")

    coarse = {n: 12.0 if n in ("X1", "X2") else 4.0 for n in TRUE}
    errors, sd, seconds = trials("auto", "aggressive", range(2000, 2000 + seeds), 0.02)
    yield from _accuracy("0.02 V disturbance", errors, sd, coarse)
    yield Figure("the same with the disturbance", seconds, 20.0, "s")

    errors, sd, _ = trials("auto", "simple", range(3000, 3000 + max(seeds // 4, 3)))
    yield from _accuracy("simple", errors, sd, dict.fromkeys(("X3", "X4", "X5"), 0.5))
    yield from speed()


def speed() -> Iterator[Figure]:
    """On-line estimators, one sample at a time, in processor time of one core."""
    given = problem("aggressive", 1)
    samples = list(zip(given.inputs.tolist(), given.outputs.tolist(), strict=True))
    regression = derive(given.dae, free=given.free, values=given.values, measured=NAMES)
    recursive = RecursiveFilter(regression, NAMES, given.values, tau=(0.3, 0.3), sample_time=STEP)
    kalman = OnlineKalman(
        given.dae,
        NAMES,
        given.free,
        {**given.values, **TRUE},
        sample_time=STEP,
        noise_sd=NOISE,
        disturbances=[Disturbance(3.0, 0.02)],
    )
    for label, online, limit in (
        ("recursive filter + least squares, 7 parameters, 2 equations", recursive, 20.0),
        ("Kalman filter, 7 parameters, disturbance", kalman, 10.0),
    ):
        began = time.process_time()
        for inputs, outputs in samples:
            online.update(inputs, outputs)
        seconds = time.process_time() - began
        yield Figure(f"{label}: times real time", len(samples) * STEP / seconds, limit, "", True)
