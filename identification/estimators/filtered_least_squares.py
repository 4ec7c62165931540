"""The output-filtering method: least squares on equations of motion that have been filtered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from foundation.errors import ExcitationError, InputError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.output_filter import Array, OutputFilter, choose_tau, correlated_samples
from identification.problem import Problem
from identification.regressors import Regression, derive
from identification.regressors.least_squares import noise_share, solve, to_estimate
from identification.regressors.signals import Rows, filtered_rows, signals

_SETTLED = 10.0  # time constants after which unknown initial values have died out
_TRIED = (1.0, 1 / 3, 3.0, 1 / 9, 9.0)  # time constants, in units of the motion's own
_CLEAN = 0.05  # noise share at which no other time constant is tried
_NOISY = 0.1  # noise share beyond which the bias is worth a warning


@dataclass(frozen=True)
class Filtered:
    """A regression, filtered, on a record.

    Attributes:
        regression: Derived from the model.
        noise_sd: (ny,) of the sensors.
        tau: Time constants τ1, τ2 [s].
        rows: The filtered terms.
        share: Noise in the worst combination of columns, about the relative bias of least squares.
        weights: (columns,) of that combination.
    """

    regression: Regression
    noise_sd: Array
    tau: tuple[float, float]
    rows: Rows
    share: float
    weights: Array

    def details(self, problem: Problem) -> dict[str, object]:
        """Return what an estimate's details say of the filter."""
        return {
            "tau": self.tau,
            "noise_sd": dict(zip(problem.output_names, self.noise_sd.tolist(), strict=True)),
            "noise_share": self.share,
        }


@dataclass(frozen=True)
class FilteredLeastSquares(Estimator):
    """Least squares on filtered equations of motion.

    Every equation is passed through I(s) = 1/((τ1 s + 1)(τ2 s + 1)); accelerations become filtered
    positions or rates (C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12 (2023) 4569, with the
    corrections named in `identification.output_filter`). No iteration, no start values, no
    simulation: unstable and chaotic plants are no special case, and a start for methods that need
    one comes out.

    Noise in the regressors pulls least squares towards zero, and standard deviations do not show
    it. The regressors are therefore formed once more with as much noise added as the sensors have;
    the largest share of noise in any combination of columns (`noise_share`) is about the relative
    bias. It chooses τ, is reported, and is warned of. Output error has no such bias.

    Args:
        tau: Time constants τ1, τ2 [s]. None: 1/ω of the motion's band (`choose_tau`), or the one
            with the smallest noise share among a ninth to nine times that.
        initial_columns: True lets each equation hold the filter's two transients in any amount, so
            that initial values need not be known; False discards the first 10 τ.
        use_rates: Where a rate is recorded, its derivative is the acceleration; False
            differentiates positions twice, as the paper does.
        seed: Of the noise that is added.

    Example:
        >>> FilteredLeastSquares(tau=(0.05, 0.08)).method
        'output-filter'
    """

    tau: tuple[float, float] | None = None
    initial_columns: bool = True
    use_rates: bool = True
    seed: int = 0

    method: ClassVar[str] = "output-filter"

    def __post_init__(self) -> None:
        if self.tau is not None and not all(np.isfinite(t) and t > 0 for t in self.tau):
            raise InputError(
                f"filter time constants {self.tau} s",
                remedy="give two positive numbers of seconds",
            )

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model has no linear regression in recorded signals.
            ExcitationError: The record is too short or shows none of the parameters.
            DivergenceError: A term is not finite on the record.
        """
        made = self.prepare(problem)
        correlation = correlated_samples(made.tau, problem.sample_time)
        solution = solve(made.regression, made.rows, problem.values, correlation=correlation)
        warnings = (*solution.warnings, *_noise_warning(made))
        return to_estimate(
            self.method,
            problem.dae,
            made.regression,
            replace(solution, warnings=warnings),
            problem.values,
            {**made.details(problem), "initial_columns": self.initial_columns},
        )

    def prepare(self, problem: Problem) -> Filtered:
        """Derive the regression, choose τ and form the filtered rows.

        Raises:
            UnsupportedModelError, ExcitationError, DivergenceError: As `estimate`.
        """
        regression = derive(
            problem.dae,
            free=problem.free,
            values=problem.values,
            measured=problem.output_names,
            use_rates=self.use_rates,
        )
        noise_sd = sensor_noise(problem)
        noise = np.random.default_rng(self.seed).standard_normal(problem.outputs.shape)
        noisier = replace(problem, outputs=problem.outputs + noise * noise_sd)
        best: Filtered | None = None
        for tau in [self.tau] if self.tau is not None else _candidates(regression, problem):
            rows = self.rows(regression, problem, tau)
            share, weights = noise_share(rows, self.rows(regression, noisier, tau))
            if best is None or share < best.share:
                best = Filtered(regression, noise_sd, tau, rows, share, weights)
            if share < _CLEAN:
                break
        assert best is not None
        return best

    def rows(self, regression: Regression, problem: Problem, tau: tuple[float, float]) -> Rows:
        """Return the regression's terms, filtered."""
        output_filter = OutputFilter(*tau, problem.sample_time)

        def operator(start: Array, end: Array, order: int) -> Array:
            return output_filter.apply(start, end, order=order)

        n = len(problem.time)
        if self.initial_columns:
            return filtered_rows(regression, problem, operator, output_filter.transients(n))
        rows = filtered_rows(regression, problem, operator, np.zeros((n, 0)))
        settling = _SETTLED * max(output_filter.tau1, output_filter.tau2)
        begin = int(np.ceil(settling / problem.sample_time))
        if begin >= n:
            raise ExcitationError(
                f"the record of {n * problem.sample_time:.3g} s is shorter than the filter's "
                f"settling time of {settling:.3g} s",
                remedy="choose shorter time constants, or initial_columns=True",
            )
        return replace(
            rows,
            matrix=rows.matrix[:, begin:],
            right=rows.right[:, begin:],
            nuisance=rows.nuisance[begin:],
        )


def sensor_noise(problem: Problem) -> Array:
    """Return (ny,) standard deviations of the sensors' noise, estimated where not known.

    The estimate is the scatter of fourth differences, in which motion is negligible and white noise
    of variance 1 has variance 70. Where sampling is coarse it errs on the large side.
    """
    if len(problem.time) < 5:
        return np.zeros(len(problem.output_names))
    scatter = np.sqrt(np.mean(np.diff(problem.outputs, 4, axis=0) ** 2, axis=0) / 70)
    return np.where(np.isfinite(problem.noise_sd), problem.noise_sd, scatter)


def _candidates(regression: Regression, problem: Problem) -> list[tuple[float, float]]:
    known = signals(regression, problem)
    positions = [known[c.position] for c in regression.coordinates]
    own, shortest, longest = choose_tau(positions, problem.sample_time)
    tried = [float(np.clip(own * factor, shortest, longest)) for factor in _TRIED]
    return [(tau, tau) for tau in dict.fromkeys(tried)]


def _noise_warning(made: Filtered) -> list[str]:
    if made.share < _NOISY:
        return []
    pairs = zip(made.regression.columns, made.weights, strict=True)
    names = [str(column.lump) for column, weight in pairs if weight > 0.3]
    return [
        f"sensor noise makes up {min(made.share, 1.0):.0%} of what the filtered record shows of "
        f"{', '.join(names)}, and biases them by about as much; use --method output-error, or "
        "record larger motion or the rates too"
    ]
