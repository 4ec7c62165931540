"""Maximum likelihood over a filter's innovations (prediction-error method).

Parameters and the disturbances' two numbers each are found together by Fisher scoring: for scalar
innovations v with variance S the information is Σ ∂v∂v/S + ½ ∂S∂S/S² (Segal and Weinstein 1989),
with derivatives by differences of whole filter runs. The inverse information at the maximum is the
covariance of everything estimated, the disturbance's own numbers included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from identification.innovations import Disturbance, InnovationFilter, Innovations
from identification.prediction import noise_estimate
from identification.problem import Matrix, Problem, Vector
from identification.windows import Window, guess_states

Tensor = NDArray[np.float64]

_WORKERS = 2
_DIFFERENCE = 1e-5
_FASTEST = 300.0  # [1/s] of a disturbance
# A disturbance changes several times in a record: what keeps its value for longer than this share
# of it is an offset, which has a name.
_LONGEST_MEMORY = 0.25
# A change of the log-likelihood that is not worth another step [nats].
_SMALL_GAIN = 0.01
_BLOCKS = 200  # over which scores are summed
_DETERMINED = 1e-14  # smallest share of the largest eigenvalue that is not rounding
# Parameters that are hard to tell apart move slowly under more than this.
_FIRST_DAMPING = 1e-9
_TRIES = 12


@dataclass(frozen=True)
class Likelihood:
    """A record, a filter, and what is to be estimated.

    Attributes:
        problem: The record; its model has the disturbances as parameters.
        filter: Compiled.
        free: Parameters to estimate.
        noise_sd: (ny,) of the sensors.
        mean, variance: (nx,) prior of the first state.
    """

    problem: Problem
    filter: InnovationFilter
    free: tuple[str, ...]
    noise_sd: Vector
    mean: Vector
    variance: Vector

    @property
    def slowest(self) -> float:
        """Rate of the slowest disturbance that is told from an offset [1/s]."""
        time = self.problem.time
        return 1.0 / (_LONGEST_MEMORY * float(time[-1] - time[0]))

    @classmethod
    def of(cls, problem: Problem, disturbances: Sequence[str]) -> Likelihood:
        """Compile the filter of a problem.

        Args:
            problem: Its model has the disturbances as parameters, its free ones are estimated.
            disturbances: Their names.
        """
        compiled = InnovationFilter(
            problem.dae,
            problem.output_names,
            disturbances,
            measured_inputs=problem.measured_inputs,
        )
        window = Window(0, len(problem.time))
        mean = guess_states(problem, compiled, (window,))[0]
        noise = noise_estimate(problem)
        # Wide: the first samples may hold a start-up transient that no polynomial follows, and a
        # few samples tell the state whatever it was thought to be before.
        variance = np.maximum(np.abs(mean), 1.0) ** 2
        for i, (output, gain) in compiled.measured_states.items():
            span = float(np.std(problem.outputs[:, output]))
            variance[i] = max(10 * noise[output], 0.1 * span) ** 2 / gain**2
        free = tuple(n for n in problem.free if n not in disturbances)
        return cls(problem, compiled, free, noise, mean, variance)

    def run(
        self,
        values: Mapping[str, float],
        disturbances: Sequence[Disturbance],
        *,
        track: bool = False,
    ) -> Innovations:
        """Filter the record with given parameters."""
        problem = self.problem
        p = self.filter.parameter_vector(values)
        inputs = self.filter.inputs_with_delays(problem.inputs, problem.sample_time, p)
        return self.filter.filter(
            self.mean,
            self.variance,
            inputs,
            problem.outputs,
            p,
            problem.sample_time,
            self.noise_sd,
            disturbances,
            track=track,
        )


@dataclass(frozen=True)
class Expansion:
    """Innovations and their derivatives at one point.

    Attributes:
        at: The run there.
        score: (k,) gradient of the log-likelihood.
        information: (k, k).
        slope, spread: (k, n, ny) derivatives of the innovations over their standard deviations, and
            of the logarithms of their variances.
    """

    at: Innovations
    score: Vector
    information: Matrix
    slope: Tensor
    spread: Tensor

    def part(self, samples: NDArray[np.intp]) -> tuple[float, Vector, Matrix]:
        """Return some samples' share of log-likelihood, score and information."""
        v, k = self.at.normalised[samples].ravel(), len(self.score)
        slope = self.slope[:, samples].reshape(k, -1)
        spread = self.spread[:, samples].reshape(k, -1)
        log_likelihood = -0.5 * float(np.sum(v * v + np.log(self.at.variances[samples].ravel())))
        score = -slope @ v + 0.5 * spread @ (v * v - 1.0)
        return log_likelihood, score, slope @ slope.T + 0.5 * spread @ spread.T


def expand(
    likelihood: Likelihood,
    values: Mapping[str, float],
    disturbances: Sequence[Disturbance],
    steps: Mapping[str, float],
    *,
    shape: bool = True,
) -> Expansion:
    """Differentiate the innovations with respect to parameters and the disturbances' numbers.

    Args:
        likelihood: What is estimated.
        values: Every independent parameter.
        disturbances: Present processes.
        steps: Difference step of each parameter to differentiate by.
        shape: Also differentiate by the logarithms of every disturbance's rate and deviation.

    Returns:
        In the order of `steps`, then (log rate, log sd) of each disturbance.
    """
    at = likelihood.run(values, disturbances)

    def moved(name: str) -> Innovations:
        return likelihood.run({**values, name: values[name] + steps[name]}, disturbances)

    def reshaped(which: tuple[int, str]) -> Innovations:
        index, part = which
        new = list(disturbances)
        factor = np.exp(_DIFFERENCE)
        old = new[index]
        new[index] = (
            Disturbance(old.rate * factor, old.sd)
            if part == "rate"
            else Disturbance(old.rate, old.sd * factor)
        )
        return likelihood.run(values, new)

    shapes = [(i, part) for i in range(len(disturbances)) for part in ("rate", "sd")]
    with ThreadPoolExecutor(_WORKERS) as pool:
        runs = list(pool.map(moved, steps))
        others = list(pool.map(reshaped, shapes)) if shape else []
    widths = [*steps.values(), *([_DIFFERENCE] * len(others))]
    weight = 1.0 / np.sqrt(at.variances)
    dv = [
        ((run.innovations - at.innovations) * weight / w).ravel()
        for run, w in zip((*runs, *others), widths, strict=True)
    ]
    ds = [
        ((run.variances - at.variances) / at.variances / w).ravel()
        for run, w in zip((*runs, *others), widths, strict=True)
    ]
    v = at.normalised.ravel()
    slope, spread = np.array(dv).reshape(len(widths), -1), np.array(ds).reshape(len(widths), -1)
    score = -slope @ v + 0.5 * spread @ (v * v - 1.0)
    information = slope @ slope.T + 0.5 * spread @ spread.T
    tensor = (len(widths), *at.innovations.shape)
    return Expansion(at, score, information, slope.reshape(tensor), spread.reshape(tensor))


def left_out(
    likelihood: Likelihood,
    values: Mapping[str, float],
    disturbances: Sequence[Disturbance],
    blocks: Sequence[NDArray[np.intp]],
) -> Vector:
    """Return (blocks,) the log-likelihood of each block at the maximum of all the others.

    By one Newton step from the maximum of the whole, and to second order: with a block's score s
    and information B of all information I, the others' maximum is -(I - B)⁻¹s away. Nothing is
    filtered with samples missing, which on an unstable machine loses the state.

    Args:
        likelihood: What was estimated.
        values, disturbances: Its maximum.
        blocks: Indices of each block's samples.
    """
    steps = {n: _DIFFERENCE * max(abs(values[n]), 1e-3) for n in likelihood.free}
    shape = any(d.sd > 0 for d in disturbances)
    expansion = expand(likelihood, values, disturbances, steps, shape=shape)
    scale = np.sqrt(np.maximum(np.diag(expansion.information), 1e-300))
    found: list[float] = []
    for block in blocks:
        log_likelihood, score, information = expansion.part(block)
        rest = (expansion.information - information) / np.outer(scale, scale)
        inverse = np.linalg.pinv(rest, rcond=1e-10, hermitian=True)
        move = inverse @ ((expansion.score - score) / scale) / scale
        found.append(log_likelihood + float(score @ move - 0.5 * move @ information @ move))
    return np.array(found)


def covariance_at(expansion: Expansion) -> Matrix:
    """Return (k, k), in no direction narrower than the inverse information.

    Where the blocks' scores scatter more than the information says (noise that is not quite what
    it is taken for, a record whose first kick tells most), theirs is the truth: the sandwich of
    H. White, Econometrica 50 (1982) 1.
    """
    information = expansion.information
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    sizes, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = sizes > _DETERMINED * sizes[-1]
    root = vectors[:, kept] / np.sqrt(sizes[kept])
    v, k = expansion.at.normalised.ravel(), len(scale)
    slope, spread = expansion.slope.reshape(k, -1), expansion.spread.reshape(k, -1)
    scores = -slope * v + 0.5 * spread * (v * v - 1.0)
    edges = np.unique(np.linspace(0, len(v), _BLOCKS, endpoint=False).astype(int))
    whitened = (np.add.reduceat(scores, edges, axis=1).T / scale) @ root
    scatter, directions = np.linalg.eigh(whitened.T @ whitened)
    half = root @ (directions * np.sqrt(np.maximum(scatter, 1.0))) / scale[:, None]
    return np.asarray(half @ half.T, dtype=np.float64)


@dataclass(frozen=True)
class Maximum:
    """A maximum of the likelihood.

    Attributes:
        values: Every independent parameter.
        disturbances: The processes.
        free: Estimated parameters, in the order of `covariance`.
        covariance: (k, k) with the disturbances' numbers estimated as well.
        information: (k + 2·disturbances,) square, at the maximum.
        innovations: The run at the maximum.
        converged: The last step was small against the standard deviations.
    """

    values: Mapping[str, float]
    disturbances: tuple[Disturbance, ...]
    free: tuple[str, ...]
    covariance: Matrix
    information: Matrix
    innovations: Innovations
    converged: bool

    @property
    def log_likelihood(self) -> float:
        """Of the record, without its constant."""
        return self.innovations.log_likelihood


def maximise(
    likelihood: Likelihood,
    values: Mapping[str, float],
    disturbances: Sequence[Disturbance],
    *,
    iterations: int = 25,
) -> Maximum:
    """Maximise the likelihood by damped Fisher scoring.

    A disturbance that the record does not need shrinks without end; once the likelihood no longer
    notices it, it is set to zero and its two numbers are no longer estimated.

    Args:
        likelihood: What is estimated.
        values: Start; every independent parameter.
        disturbances: Start.
    """
    free = likelihood.free
    current, processes = dict(values), tuple(disturbances)
    steps = {n: _DIFFERENCE * max(abs(current[n]), 1e-3) for n in free}
    shape = any(d.sd > 0 for d in processes)
    expansion = expand(likelihood, current, processes, steps, shape=shape)
    damping, converged = _FIRST_DAMPING, False
    for _ in range(iterations):
        if shape and _needless(likelihood, current, processes, expansion):
            processes, shape = tuple(Disturbance(d.rate, 0.0) for d in processes), False
            expansion = expand(likelihood, current, processes, steps, shape=False)
            damping = _FIRST_DAMPING
        found = _ascend(likelihood, expansion, current, processes, damping)
        if found is None:
            converged = True
            break
        current, processes, _, damping = found
        expansion = expand(likelihood, current, processes, steps, shape=shape)
        # A damped step may gain little far from the maximum: what is left to gain decides.
        if _left_to_gain(likelihood, expansion, processes) < _SMALL_GAIN:
            converged = True
            break
    covariance = covariance_at(expansion)
    k = len(free)
    return Maximum(
        current, processes, free, covariance[:k, :k], expansion.information, expansion.at, converged
    )


def _left_to_gain(
    likelihood: Likelihood, expansion: Expansion, disturbances: Sequence[Disturbance]
) -> float:
    """Return how much the likelihood would rise to its maximum if it were quadratic [nats]."""
    return 0.5 * float(
        expansion.score @ _solve(likelihood, expansion, disturbances, _FIRST_DAMPING)
    )


def _ascend(
    likelihood: Likelihood,
    expansion: Expansion,
    values: Mapping[str, float],
    disturbances: tuple[Disturbance, ...],
    damping: float,
) -> tuple[dict[str, float], tuple[Disturbance, ...], Innovations, float] | None:
    """Return a point of larger likelihood and the damping to go on with; None if there is none."""
    for _ in range(_TRIES):
        move = _solve(likelihood, expansion, disturbances, damping)
        new, shaped = _moved(likelihood, values, disturbances, move)
        run = likelihood.run(new, shaped)
        if run.log_likelihood > expansion.at.log_likelihood:
            return new, shaped, run, damping / 10
        damping = max(10 * damping, 1e-7)
    return None


def _needless(
    likelihood: Likelihood,
    values: Mapping[str, float],
    disturbances: tuple[Disturbance, ...],
    expansion: Expansion,
) -> bool:
    without = likelihood.run(values, [Disturbance(d.rate, 0.0) for d in disturbances])
    return without.log_likelihood > expansion.at.log_likelihood - _SMALL_GAIN


def _solve(
    likelihood: Likelihood,
    expansion: Expansion,
    disturbances: Sequence[Disturbance],
    damping: float,
) -> Vector:
    """Return the damped step; a disturbance's rate that is at its bound only moves back inside."""
    inside = np.ones(len(expansion.score), dtype=bool)
    if len(expansion.score) > len(likelihood.free):
        for i, d in enumerate(disturbances):
            rate = len(likelihood.free) + 2 * i
            uphill = expansion.score[rate]
            inside[rate] = not (
                (d.rate <= likelihood.slowest and uphill < 0) or (d.rate >= _FASTEST and uphill > 0)
            )
    information = expansion.information[np.ix_(inside, inside)]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    damped = information / np.outer(scale, scale) + damping * np.eye(len(scale))
    move = np.zeros(len(inside))
    move[inside] = np.linalg.solve(damped, expansion.score[inside] / scale) / scale
    return move


def _moved(
    likelihood: Likelihood,
    values: Mapping[str, float],
    disturbances: Sequence[Disturbance],
    move: Vector,
) -> tuple[dict[str, float], tuple[Disturbance, ...]]:
    free, slowest = likelihood.free, likelihood.slowest
    new = {**values, **{n: values[n] + float(m) for n, m in zip(free, move, strict=False)}}
    if len(move) == len(free):
        return new, tuple(disturbances)
    # The logarithms move by at most one at a time.
    logs = np.clip(move[len(free) :], -1.0, 1.0)
    shaped = tuple(
        Disturbance(
            float(np.clip(d.rate * np.exp(logs[2 * i]), slowest, _FASTEST)),
            float(d.sd * np.exp(logs[2 * i + 1])),
        )
        for i, d in enumerate(disturbances)
    )
    return new, shaped
