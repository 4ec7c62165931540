"""Least squares for regressions in lumps, with what the record cannot see found and said.

The record is compressed to a triangular factor an equation once; parameters, identifiability and
weights are then matters of a few small matrices. Equations are weighted by their residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fmus.dae import Dae
from foundation.errors import DivergenceError, ExcitationError
from identification.estimate import Estimate, ParameterEstimate
from identification.regressors.regression import Regression
from identification.regressors.signals import Rows
from identification.regressors.sympy_fold import names_of

Array = NDArray[np.float64]

_ZERO_COLUMN = 1e-11  # of the size it would have without cancellation
_COLLINEAR = 1e-7  # sine of the angle between a column and the span of the others
_HARDLY_TOLD_APART = 1e4  # scaled condition number beyond which the faintest noise decides
WEIGHTINGS = 3
_REMEDY = (
    "try a record with larger and faster motion of the parts they act on, "
    "or leave one of them out of --free"
)


@dataclass(frozen=True)
class Reduced:
    """Weighted equations, reduced to factor @ lumps = target in the sense of least squares.

    Attributes:
        factor: (r, k).
        target: (r,).
        left: (m, n, k) what the weighted residuals are multiplied with: Σ left · residual = shift
            at the solution.
        shift: (k, k + 1) share of one sample in that sum, as a function of (lumps, -1).
    """

    factor: Array
    target: Array
    left: Array
    shift: Array | None = None


Reduction: TypeAlias = "Callable[[Array, Array], Callable[[Array], Reduced]]"
"""(matrix (m, n, k), right (m, n)) → (weights (m,) → reduced)."""


def least_squares_reduction(matrix: Array, right: Array) -> Callable[[Array], Reduced]:
    """Reduce by orthogonal triangles, one an equation, formed once."""
    k = matrix.shape[2]
    factors = [
        np.linalg.qr(np.column_stack([a, y]), "r") for a, y in zip(matrix, right, strict=True)
    ]

    def reduced(weights: Array) -> Reduced:
        stacked = np.vstack([w * f for w, f in zip(weights, factors, strict=True)])
        triangle: Array = np.asarray(np.linalg.qr(stacked, "r"))
        return Reduced(triangle[:, :k], triangle[:, k], weights[:, None, None] * matrix)

    return reduced


@dataclass(frozen=True)
class Solution:
    """Least-squares parameters.

    Attributes:
        values: Every parameter in lumps; held ones at their start.
        fitted: Names of those that were fitted, in the order of `covariance`.
        covariance: (fitted, fitted), allowing for residuals that are correlated in time.
        condition_number: Of the weighted Jacobian with columns scaled to one.
        residual_sd: (equations,) in each equation's unit.
        lumps: (columns,) at the solution.
        warnings: What could not be seen or told apart.
    """

    values: Mapping[str, float]
    fitted: tuple[str, ...]
    covariance: Array
    condition_number: float
    residual_sd: Array
    lumps: Array
    warnings: tuple[str, ...]


def solve(
    regression: Regression,
    rows: Rows,
    start: Mapping[str, float],
    *,
    correlation: int,
    reduction: Reduction = least_squares_reduction,
) -> Solution:
    """Fit the parameters in the lumps of a regression.

    Args:
        regression: Its columns.
        rows: The columns on a record.
        start: Starting values; exact for lumps that are parameters of their own.
        correlation: Samples over which residuals may be correlated.
        reduction: Which estimating equations are solved.

    Raises:
        ExcitationError: Too few samples, or the record shows none of the parameters.
        DivergenceError: The fit left the finite numbers.
    """
    m, n, k = rows.matrix.shape
    if m * (n - rows.nuisance.shape[1]) <= k:
        raise ExcitationError(
            f"{n} samples for {k} unknowns", remedy="record for longer, or free fewer parameters"
        )
    matrix, right = without_nuisance(rows)
    matrix = np.where(_is_zero(matrix, rows)[:, None, :], 0.0, matrix)
    reduce = reduction(matrix, right)
    names = regression.parameters
    seen = Seen(regression, start, np.any(matrix != 0, axis=(0, 1)))
    weights = first_weights(right)
    values = dict(start)
    fitted: list[str] = []
    sd = weights
    # Residuals depend on the weights and the weights on residuals; three rounds settle both.
    for _ in range(WEIGHTINGS):
        reduced = reduce(weights)
        fitted = seen.fitted(reduced.factor)
        values = fit_lumps(regression, reduced.factor, reduced.target, start, fitted)
        lumps = regression.lumps(values)
        residuals = right - matrix @ lumps
        sd = residual_sd(
            np.mean(residuals**2, axis=1),
            np.mean(right**2, axis=1) + np.mean(matrix**2, axis=1) @ lumps**2,
        )
        weights = 1 / sd
    lumps = regression.lumps(values)
    if not np.all(np.isfinite(lumps)):
        raise DivergenceError(
            "the fit left the finite numbers", remedy="start it from values nearer to the truth"
        )
    chosen = [names.index(name) for name in fitted]
    jacobian = regression.lump_jacobian(values)[:, chosen]
    reduced = reduce(weights)
    residuals = (right - matrix @ lumps) * weights[:, None]
    scores = np.einsum("mt,mtk->tk", residuals, reduced.left @ jacobian)
    if reduced.shift is not None:
        scores = scores - (reduced.shift @ np.append(lumps, -1.0)) @ jacobian
    samples = m * n - len(chosen) - rows.nuisance.shape[1] * m
    covariance, condition, weakest = _sandwich(reduced.factor @ jacobian, scores, correlation)
    covariance = covariance * (m * n / max(samples, 1))
    warnings = [*seen.warnings(), *hardly_told_apart(fitted, condition, weakest)]
    return Solution(values, tuple(fitted), covariance, condition, sd, lumps, tuple(warnings))


def residual_sd(mean_square: Array, size: Array) -> Array:
    """Return (equations,) residuals' standard deviations, never below rounding of their terms.

    Args:
        mean_square: (equations,) of the residuals.
        size: (equations,) mean square of the terms whose difference the residuals are.
    """
    floor = 1e-14 * np.sqrt(size)
    return np.maximum(np.sqrt(mean_square), np.maximum(floor, 1e-300))


def hardly_told_apart(fitted: Sequence[str], condition: float, weakest: Array) -> list[str]:
    """Warn of a condition number at which the faintest noise decides."""
    if condition <= _HARDLY_TOLD_APART:
        return []
    weak = [name for name, part in zip(fitted, weakest, strict=True) if abs(part) > 0.3]
    return [
        f"{_listed(weak)} can hardly be told apart in this record "
        f"(condition number {condition:.2g}); {_REMEDY}"
    ]


def noise_share(rows: Rows, noisier: Rows) -> tuple[float, Array]:
    """Return the largest share of noise in any combination of columns, and which columns that is.

    Args:
        rows: The regression on a record.
        noisier: The same with as much noise added to the record as is thought to be in it.

    Returns:
        The largest eigenvalue of the noise's Gram matrix relative to the record's: about the
        relative bias of least squares in that direction, 1 or more if there is nothing but noise.
        And the (columns,) weights of the scaled columns in it, the largest 1.
    """
    (matrix, right), (other, _) = without_nuisance(rows), without_nuisance(noisier)
    k = matrix.shape[2]
    weights = first_weights(right)[:, None, None]
    stacked = (weights * matrix).reshape(-1, k)
    noise = (weights * (other - matrix)).reshape(-1, k)
    norms = np.linalg.norm(stacked, axis=0)
    norms[np.all(_is_zero(matrix, rows), axis=0) | (norms == 0)] = np.inf
    _, s, vt = np.linalg.svd(stacked / norms, full_matrices=False)
    if s[0] == 0:
        return 0.0, np.zeros(k)
    kept = s > _COLLINEAR * s[0]
    basis = vt[kept].T / s[kept]
    _, shares, directions = np.linalg.svd((noise / norms) @ basis, full_matrices=False)
    worst = np.abs(basis @ directions[0])
    return float(shares[0] ** 2), worst / np.max(worst)


def first_weights(right: Array) -> Array:
    """Return (equations,) weights that make the fit free of the units of each equation."""
    size = np.sqrt(np.mean(right**2, axis=1))
    return 1 / np.where(size > 0, size, np.max(size) or 1.0)


def without_nuisance(rows: Rows) -> tuple[Array, Array]:
    """Return matrix and right-hand side with the nuisance motions projected out."""
    if rows.nuisance.shape[1] == 0:
        return rows.matrix, rows.right
    scale = np.linalg.norm(rows.nuisance, axis=0)
    u, s, _ = np.linalg.svd(rows.nuisance[:, scale > 0] / scale[scale > 0], full_matrices=False)
    q = u[:, s > 1e-12]
    matrix = rows.matrix - q @ (q.T @ rows.matrix)
    right = rows.right - (rows.right @ q) @ q.T
    return matrix, right


def _is_zero(matrix: Array, rows: Rows) -> NDArray[np.bool_]:
    return np.max(np.abs(matrix), axis=1) <= _ZERO_COLUMN * rows.size


class Seen:
    """Sorts parameters into those that a record shows and those that have to be held."""

    def __init__(
        self, regression: Regression, start: Mapping[str, float], moving: NDArray[np.bool_]
    ) -> None:
        self._regression = regression
        self._start = start
        self._moving = moving
        names = regression.parameters
        # At a parameter of 0 a product of two shows neither: look at a point in general position.
        general = {name: start[name] if start[name] != 0 else 1.0 for name in names}
        self._jacobian = regression.lump_jacobian(general)
        below = names_of(*(sp.denom(c.lump) for c in regression.columns))
        # What others are ratios to is held first, then what was asked for last.
        self._order = sorted(range(len(names)), key=lambda j: (names[j] in below, j))
        # What could be told apart if every column were seen perfectly.
        self._by_any = self._greedy(np.eye(len(regression.columns)))[0]
        self._partners: dict[int, list[int]] = {}
        self._zero: list[int] = []

    def fitted(self, factor: Array) -> list[str]:
        """Return the parameters that a weighted factor (k, k) determines."""
        kept, self._partners, self._zero = self._greedy(factor)
        if not kept:
            names = _listed(list(self._regression.parameters))
            raise ExcitationError(
                f"the record shows nothing of {names}: every term they are in stays zero",
                remedy="record while the plant moves and its input changes",
            )
        return [self._regression.parameters[j] for j in sorted(kept)]

    def _greedy(self, factor: Array) -> tuple[list[int], dict[int, list[int]], list[int]]:
        columns = factor @ self._jacobian
        norms = np.linalg.norm(columns, axis=0)
        kept: list[int] = []
        partners: dict[int, list[int]] = {}
        zero: list[int] = []
        for j in self._order:
            if norms[j] == 0 or not np.any(self._jacobian[self._moving, j]):
                zero.append(j)
                continue
            target = columns[:, j] / norms[j]
            if kept:
                basis = columns[:, kept] / norms[kept]
                share, *_ = np.linalg.lstsq(basis, target, rcond=None)
                if np.linalg.norm(target - basis @ share) < _COLLINEAR:
                    big = 1e-3 * float(np.max(np.abs(share)))
                    partners[j] = [i for i, s in zip(kept, share, strict=True) if abs(s) > big]
                    continue
            kept.append(j)
        return kept, partners, zero

    def warnings(self) -> list[str]:
        """Say which parameters are held and why."""
        names = self._regression.parameters
        texts: list[str] = []
        for j in self._zero:
            needs = {
                need
                for c in self._regression.columns
                if names[j] in names_of(c.lump)
                for need in c.needs
            }
            texts.append(
                f"{names[j]} has no effect in this record and is held at "
                f"{self._start[names[j]]:g}: its term stays zero; excite "
                f"{_listed(sorted(needs)) or 'the plant'}, or leave it out of --free"
            )
        for j, partners in self._partners.items():
            group = _listed([names[j], *(names[i] for i in partners)])
            held = f"{names[j]} is held at {self._start[names[j]]:g} and the other follows"
            if j in self._by_any:
                texts.append(f"{group} cannot be told apart in this record: {held}; {_REMEDY}")
            else:
                lumps = [
                    str(c.lump) for c in self._regression.columns if names[j] in names_of(c.lump)
                ]
                texts.append(
                    f"no record can tell {group} apart, only {_listed(lumps)}: {held}; "
                    f"give {names[j]} its true value and leave it out of --free"
                )
        return texts


def fit_lumps(
    regression: Regression,
    factor: Array,
    target: Array,
    start: Mapping[str, float],
    fitted: Sequence[str],
) -> dict[str, float]:
    """Minimise |factor @ lumps(p) - target| over the fitted parameters."""
    names = regression.parameters
    chosen = [names.index(name) for name in fitted]
    values = {**start}

    def lumps(p: Array) -> Array:
        return regression.lumps({**start, **dict(zip(fitted, p.tolist(), strict=True))})

    def jacobian(p: Array) -> Array:
        full = regression.lump_jacobian({**start, **dict(zip(fitted, p.tolist(), strict=True))})
        return factor @ full[:, chosen]

    first = np.array([start[name] for name in fitted])
    if regression.is_affine(fitted):
        slope = jacobian(first)
        norms = np.linalg.norm(slope, axis=0)
        step, *_ = np.linalg.lstsq(slope / norms, target - factor @ lumps(first), rcond=None)
        found = first + step / norms
    else:
        # Products of zeros have no slope: start beside them.
        first = np.where(first == 0, 1e-3, first)
        scale = np.linalg.norm(target) or 1.0

        def residual(p: Array) -> Array:
            return (factor @ lumps(p) - target) / scale

        def slope_of(p: Array) -> Any:
            return jacobian(p) / scale

        result: Any = least_squares(
            residual,
            first,
            jac=slope_of,  # pyright: ignore[reportArgumentType] - the stubs know only strings
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        found = result.x
    values.update(zip(fitted, found.tolist(), strict=True))
    return values


def _sandwich(factor: Array, scores: Array, correlation: int) -> tuple[Array, float, Array]:
    """Covariance (JᵀJ)⁻¹ S (JᵀJ)⁻¹ with the long-run variance S of the scores; condition number.

    S has Bartlett's kernel (W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708), written as
    the mean square of sums over overlapping blocks, which is the same number in linear time. Long
    blocks leave few of them; the factor for that is the one of N. M. Kiefer, T. J. Vogelsang,
    Econometric Theory 21 (2005) 1130-1164, table 1 (Bartlett, two-sided 5 %).
    """
    bread, condition, weakest = scaled_condition(factor)
    n, k = scores.shape
    length = int(np.clip(correlation, 1, max(n // 4, 1)))
    padded = np.concatenate([np.zeros((length, k)), scores, np.zeros((length, k))])
    total = np.cumsum(padded, axis=0)
    blocks = total[length:] - total[:-length]
    meat = blocks.T @ blocks / length * few_blocks_factor(length / n) ** 2
    return bread @ meat @ bread, condition, weakest


def scaled_condition(factor: Array) -> tuple[Array, float, Array]:
    """Return (JᵀJ)⁻¹, the condition number of J with scaled columns, and the weakest direction."""
    norms = np.linalg.norm(factor, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    _, s, vt = np.linalg.svd(factor / norms, full_matrices=False)
    half = vt / s[:, None] / norms
    return half.T @ half, float(s[0] / s[-1]), vt[-1]


def few_blocks_factor(share: float) -> float:
    """Return by how much a standard deviation from blocks of this share of the record is short."""
    b = share
    return (1.9600 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3) / 1.9600


def to_estimate(
    method: str,
    dae: Dae,
    regression: Regression,
    solution: Solution,
    start: Mapping[str, float],
    details: Mapping[str, object],
) -> Estimate:
    """Report a solution for every free parameter, those outside the regression included."""
    sd = dict(zip(solution.fitted, np.sqrt(np.diag(solution.covariance)).tolist(), strict=True))
    parameters = {
        name: ParameterEstimate(
            value=float(solution.values[name] if name in sd else start[name]),
            sd=float(sd.get(name, np.inf)),
            unit=dae.variables[name].unit,
            identifiable=name in sd,
        )
        for name in regression.free
    }
    covariance = np.full((len(regression.free), len(regression.free)), np.nan)
    places = [regression.free.index(name) for name in solution.fitted]
    covariance[np.ix_(places, places)] = solution.covariance
    outside = [
        f"{name} sits inside a nonlinear function of the signals, which a regression cannot fit: "
        f"held at {start[name]:g}; --method output-error fits it"
        for name in regression.shape
    ] + [
        f"{name} enters none of the equations of motion and is held at {start[name]:g}; "
        "leave it out of --free"
        for name in regression.inert
    ]
    known = {*regression.parameters, *regression.shape, *regression.inert}
    outside += [
        f"{name} acts only in a part of the state space far from rest and is held at "
        f"{start[name]:g}; --method output-error fits it if the record goes there"
        for name in regression.free
        if name not in known
    ]
    lumps = {
        str(column.lump): float(value)
        for column, value in zip(regression.columns, solution.lumps, strict=True)
    }
    return Estimate(
        method=method,
        parameters=parameters,
        covariance=covariance,
        condition_number=solution.condition_number,
        warnings=(*solution.warnings, *outside),
        details={
            "lumps": lumps,
            "residual_sd": solution.residual_sd.tolist(),
            "differenced": regression.differenced,
            "notes": regression.notes,
            **details,
        },
    )


def _listed(names: Sequence[str]) -> str:
    if len(names) < 2:
        return "".join(names)
    return ", ".join(names[:-1]) + " and " + names[-1]
