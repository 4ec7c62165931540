"""How well a model explains a record, and where it fails: in time and in the state space."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import signal, stats

from identification.prediction import Prediction
from identification.problem import Matrix, Problem, Vector
from identification.simulator import Simulator

_SPANS = 50
_SHOWN = 3
_LAGS = 20
_SMOOTHING = 0.05


@dataclass(frozen=True)
class ChannelError:
    """One channel's error over the scored samples.

    Attributes:
        rmse: In the channel's unit.
        nrmse: RMSE over the standard deviation of the measurement; NaN if it is constant.
        bias: Mean error, measured minus simulated.
        white_p: Probability of residuals this correlated if they were white (Ljung–Box, 20 lags).
    """

    rmse: float
    nrmse: float
    bias: float
    white_p: float


@dataclass(frozen=True)
class Failure:
    """A span of time in which the model is at its worst.

    Attributes:
        begin, end: Span [s].
        channel: The channel with the largest error there, relative to its deviation.
        rmse: Its error there.
        where: Variable → the range it stays in during the span, for the variables whose range there
            is narrowest compared to the whole record.
    """

    begin: float
    end: float
    channel: str
    rmse: float
    where: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Comparison:
    """A model against a record.

    Attributes:
        channels: Name → error.
        nrmse: Root mean square of the channels' NRMSE.
        worst: Where it fails, worst first.
        prediction: What was simulated.
        states: Name → (n,) measured or differentiated variables, for drawing errors against them.
    """

    channels: Mapping[str, ChannelError]
    nrmse: float
    worst: tuple[Failure, ...]
    prediction: Prediction
    states: Mapping[str, Vector]


def compare(
    problem: Problem,
    shooting: Simulator,
    prediction: Prediction,
    *,
    user_name: Callable[[str], str] = str,
) -> Comparison:
    """Summarise a prediction's errors.

    Args:
        problem: The record.
        shooting: The model that predicted it.
        prediction: From `identification.prediction.predict`.
        user_name: What the user calls a variable of the model.
    """
    error = prediction.error[prediction.scored]
    channels = {
        name: ChannelError(
            rmse=float(prediction.rmse[k]),
            nrmse=float(prediction.nrmse[k]),
            bias=float(np.mean(error[:, k])),
            white_p=whiteness(error[:, k]),
        )
        for k, name in enumerate(problem.output_names)
    }
    states = observed_variables(problem, shooting, user_name=user_name)
    return Comparison(
        channels, prediction.total_nrmse, _worst(problem, prediction, states), prediction, states
    )


def whiteness(residual: Vector) -> float:
    """Return the Ljung–Box p-value of a residual over 20 lags (or a fifth of its length).

    Example:
        >>> whiteness(np.random.default_rng(0).standard_normal(2000)) > 0.01
        True
        >>> whiteness(np.sin(np.arange(2000) / 50)) < 1e-6
        True
    """
    n = len(residual)
    lags = min(_LAGS, n // 5)
    centred = residual - np.mean(residual)
    power = float(centred @ centred)
    if lags < 1 or not np.isfinite(power) or power == 0.0:
        return float("nan")
    k = np.arange(1, lags + 1)
    rho = np.array([float(centred[:-i] @ centred[i:]) for i in k]) / power
    statistic = n * (n + 2) * float(np.sum(rho**2 / (n - k)))
    return float(stats.chi2.sf(statistic, lags))


def observed_variables(
    problem: Problem, shooting: Simulator, *, user_name: Callable[[str], str] = str
) -> Mapping[str, Vector]:
    """Return inputs, measured outputs, and the rates that can be had by differentiating them.

    Returns:
        Name → (n,). A rate that is not measured is the slope of a local quadratic over 50 ms.
    """
    found = {v.name: problem.inputs[:, k] for k, v in enumerate(problem.dae.inputs)}
    found.update({name: problem.outputs[:, k] for k, name in enumerate(problem.output_names)})
    width = max(5, 2 * round(_SMOOTHING / problem.sample_time / 2) + 1)
    for i, (output, gain) in shooting.measured_states.items():
        rate = shooting.rate_of.get(shooting.state_names[i])
        if rate is None or width > len(problem.time):
            continue
        name = user_name(rate)
        if name not in found:
            found[name] = np.asarray(
                signal.savgol_filter(
                    problem.outputs[:, output] / gain, width, 2, deriv=1, delta=problem.sample_time
                )
            )
    return found


def _worst(
    problem: Problem, prediction: Prediction, states: Mapping[str, Vector]
) -> tuple[Failure, ...]:
    n = len(problem.time)
    scaled = prediction.error / np.where(prediction.moves, prediction.deviation, np.inf)
    scaled = np.where(prediction.scored[:, None], scaled, 0.0)
    scaled = np.where(np.isfinite(scaled), scaled, 1e6)
    edges = np.linspace(0, n, min(_SPANS, n) + 1).astype(int)
    energy = np.array([np.mean(scaled[b:e] ** 2) for b, e in pairwise(edges)])
    failures: list[Failure] = []
    taken = np.zeros(len(energy), dtype=bool)
    for _ in range(_SHOWN):
        if np.all(taken):
            break
        peak = int(np.argmax(np.where(taken, -np.inf, energy)))
        first, last = peak, peak
        while first > 0 and not taken[first - 1] and energy[first - 1] > 0.5 * energy[peak]:
            first -= 1
        while (
            last + 1 < len(energy)
            and not taken[last + 1]
            and (energy[last + 1] > 0.5 * energy[peak])
        ):
            last += 1
        taken[first : last + 1] = True
        failures.append(
            _failure(problem, prediction, states, scaled, edges[first], edges[last + 1])
        )
    return tuple(failures)


def _failure(
    problem: Problem,
    prediction: Prediction,
    states: Mapping[str, Vector],
    scaled: Matrix,
    begin: int,
    end: int,
) -> Failure:
    part = slice(begin, end)
    channel = int(np.argmax(np.mean(scaled[part] ** 2, axis=0)))
    spread: dict[str, float] = {}
    where: dict[str, tuple[float, float]] = {}
    for name, values in states.items():
        low, high = np.quantile(values[part], [0.05, 0.95])
        whole = np.quantile(values, [0.05, 0.95])
        where[name] = (float(low), float(high))
        spread[name] = float((high - low) / max(whole[1] - whole[0], 1e-300))
    narrow = sorted(spread, key=lambda name: spread[name])[:2]
    error = prediction.error[part, channel]
    return Failure(
        begin=float(problem.time[begin]),
        end=float(problem.time[min(end, len(problem.time)) - 1]),
        channel=problem.output_names[channel],
        rmse=float(np.sqrt(np.mean(error**2))),
        where={name: where[name] for name in narrow},
    )
