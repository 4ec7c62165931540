"""Least squares on filtered equations with the sensors' noise taken out of the normal equations.

Filtered noise in the columns A and the right-hand side y adds its Gram matrix C to [A y]ᵀ[A y], and
least squares tends to zero. Two cures that share everything else:

- bias compensation subtracts C as the sensors' noise makes it
  (P. Stoica, T. Söderström, IEEE Trans. Automatic Control 27 (1982) 213-215);
- total least squares subtracts λ C, where λ is the smallest generalised eigenvalue of the two: only
  the *shape* of the noise need be known, its size is found (G. H. Golub, C. F. Van Loan, SIAM J.
  Numerical Analysis 17 (1980) 883-893; S. Van Huffel, J. Vandewalle, SIAM J. Matrix Analysis 10
  (1989) 294-315, for columns of unequal and of no noise).

C is formed by putting as much noise into the record again, several times. The record's own noise is
in the columns already, so this is right to first order in the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.linalg import cho_factor, eigh, solve_triangular

from foundation.errors import ExcitationError
from identification.estimate import Estimate
from identification.estimators.base import Estimator
from identification.estimators.filtered_least_squares import (
    Filtered,
    FilteredLeastSquares,
)
from identification.output_filter import Array, correlated_samples
from identification.problem import Problem
from identification.regressors.least_squares import (
    Reduced,
    Reduction,
    solve,
    to_estimate,
    without_nuisance,
)

_DRAWS = 10
_SHARE = 0.5  # of noise in any combination of columns beyond which what is left is not worth much


@dataclass(frozen=True)
class Compensated(Estimator):
    """What bias compensation and total least squares share.

    Args:
        tau: Time constants τ1, τ2 of the filter [s]; None: see `FilteredLeastSquares`.
        draws: How many times noise is put in to find its Gram matrix.
        seed: Of that noise.
    """

    tau: tuple[float, float] | None = None
    draws: int = _DRAWS
    seed: int = 0

    scale_is_known: ClassVar[bool]

    def estimate(self, problem: Problem) -> Estimate:
        """Fit the free parameters of a problem.

        Raises:
            UnsupportedModelError: The model has no linear regression in recorded signals.
            ExcitationError: The record is too short or shows none of the parameters, or there is
                more noise in it than motion.
            DivergenceError: A term is not finite on the record.
        """
        least_squares = FilteredLeastSquares(tau=self.tau, seed=self.seed)
        made = least_squares.prepare(problem)
        gram = self._noise_gram(least_squares, made, problem)
        found: dict[str, float] = {}
        reduction = _compensated(gram, scale_is_known=self.scale_is_known, said=found)
        solution = solve(
            made.regression,
            made.rows,
            problem.values,
            correlation=correlated_samples(made.tau, problem.sample_time),
            reduction=reduction,
        )
        warnings = list(solution.warnings)
        if made.share > _SHARE:
            warnings.append(
                f"sensor noise makes up {min(made.share, 1.0):.0%} of what the filtered record "
                "shows of some combination of the parameters; taking it out leaves little: use "
                "--method output-error, or record larger motion"
            )
        return to_estimate(
            self.method,
            problem.dae,
            made.regression,
            replace(solution, warnings=tuple(warnings)),
            problem.values,
            {**made.details(problem), **found},
        )

    def _noise_gram(
        self, least_squares: FilteredLeastSquares, made: Filtered, problem: Problem
    ) -> Array:
        """Return (m, k + 1, k + 1): the noise's share of [A y]ᵀ[A y] in each equation."""
        draw = np.random.default_rng(self.seed + 1)
        clean = np.concatenate(_columns(made))
        total = np.zeros((len(made.rows.right), clean.shape[-1], clean.shape[-1]))
        for _ in range(self.draws):
            noise = draw.standard_normal(problem.outputs.shape) * made.noise_sd
            noisier = replace(problem, outputs=problem.outputs + noise)
            rows = least_squares.rows(made.regression, noisier, made.tau)
            added = _columns(replace(made, rows=rows)) - _columns(made)
            total += np.transpose(added, (0, 2, 1)) @ added
        return total / self.draws


def _columns(made: Filtered) -> Array:
    matrix, right = without_nuisance(made.rows)
    return np.concatenate([matrix, right[:, :, None]], axis=2)


def _compensated(gram: Array, *, scale_is_known: bool, said: dict[str, float]) -> Reduction:
    def reduction(matrix: Array, right: Array) -> Callable[[Array], Reduced]:
        n, k = matrix.shape[1:]
        columns = np.concatenate([matrix, right[:, :, None]], axis=2)
        whole = np.transpose(columns, (0, 2, 1)) @ columns
        # A column that is zero on the record holds no noise either.
        still = np.append(np.all(matrix == 0, axis=(0, 1)), False)

        def reduced(weights: Array) -> Reduced:
            total = np.einsum("m,mij->ij", weights**2, whole)
            noise = np.einsum("m,mij->ij", weights**2, gram)
            noise[still, :] = noise[:, still] = 0.0
            scale = 1.0 if scale_is_known else _smallest(total, noise, still)
            said["noise_scale"] = scale
            left = weights[:, None, None] * matrix
            factor, target = _root(total - scale * noise, still)
            return Reduced(factor, target, left, -scale * noise[:k] / n)

        return reduced

    return reduction


def _smallest(total: Array, noise: Array, still: Array) -> float:
    """Return the smallest λ at which total - λ noise is singular."""
    moving = ~still.astype(bool)
    scale = np.sqrt(np.diag(total)[moving])
    scale[scale == 0] = 1.0
    whole = total[np.ix_(moving, moving)] / np.outer(scale, scale)
    part = noise[np.ix_(moving, moving)] / np.outer(scale, scale)
    # The other way round, since noise may be singular; rounding must not make the whole so.
    whole = whole + 1e-15 * np.eye(len(whole))
    largest = float(eigh(part, whole, eigvals_only=True)[-1])
    return 0.0 if largest <= 0 else 1 / largest


def _root(gram: Array, still: Array) -> tuple[Array, Array]:
    """Return factor and target whose normal equations are those of a compensated Gram matrix."""
    k = len(gram) - 1
    normal, right = gram[:k, :k], gram[:k, k]
    moving = np.flatnonzero(~still[:k].astype(bool))
    factor, target = np.zeros((k, k)), np.zeros(k)
    if len(moving):
        block = normal[np.ix_(moving, moving)]
        scale = np.sqrt(np.maximum(np.diag(block), 0.0))
        if np.any(scale == 0):
            raise _drowned()
        try:
            upper, _ = cho_factor(block / np.outer(scale, scale), lower=False)
        except np.linalg.LinAlgError:
            raise _drowned() from None
        upper = np.triu(upper)
        factor[np.ix_(moving, moving)] = upper * scale
        target[moving] = solve_triangular(upper, right[moving] / scale, trans=1)
    return factor, target


def _drowned() -> ExcitationError:
    return ExcitationError(
        "the sensors' noise is as large as what the filtered record shows of some combination of "
        "the parameters",
        remedy="use --method output-error, record larger motion, or give each sensor's sd in a map",
    )
