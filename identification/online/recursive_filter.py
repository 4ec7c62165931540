"""The output-filtering method on-line: a row a sample, least squares in square-root form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from foundation.errors import ExcitationError, TwinproofError
from foundation.resumable import Resumable
from identification.online.base import OnlineEstimate, OnlineEstimator
from identification.online.filtered_rows import NUISANCE, StreamingRows
from identification.online.triangles import Array, Triangles
from identification.output_filter import correlated_samples
from identification.regressors.least_squares import (
    WEIGHTINGS,
    Seen,
    Solution,
    few_blocks_factor,
    fit_lumps,
    hardly_told_apart,
    residual_sd,
    scaled_condition,
)
from identification.regressors.regression import Regression

_SETTLED = 10.0  # time constants after a gap until the filter's transients have died out
_LOOK = 8  # the share of the rows by which they grow until everything is looked at anew
_COLUMN_IS_ZERO = 1e-11


class RecursiveFilter(OnlineEstimator, Resumable):
    """Recursive output filter and least squares: after any number of samples, the batch's answer.

    Args:
        regression: Derived from the model.
        output_names: Measured channels, in the order of the samples.
        start: Every independent parameter; what is not seen stays there.
        tau: Time constants τ1, τ2 of the output filter [s].
        sample_time: Between samples [s].
        forgetting: Time over which old samples lose weight by 1/e [s]; None: they keep it.
        memory: Length of the window [s]; None: since the beginning.
        ramps: Which inputs run in straight lines between samples; others hold.
        every: Samples between two solutions; in between the last one is held. Which parameters
            are seen, the equations' weights and the standard deviations are looked at anew
            whenever the samples have become an eighth more, and at least that often in a window.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> from identification.regressors import derive
        >>> dae = load(library_class("Twinproof.Plants.Positioner"))
        >>> regression = derive(dae, free=["M", "Fv"], values={}, measured=["q", "v"])
        >>> online = RecursiveFilter(
        ...     regression, ["q", "v"], dae.parameter_values, tau=(0.05, 0.05), sample_time=1e-3
        ... )
        >>> online.update([0.1], [0.0, 0.0]).samples
        1
    """

    _changes = (
        "_rows",
        "_triangles",
        "_waiting",
        "_samples",
        "_next_look",
        "_last",
        "_lumps",
        "_innovation_sd",
        "_values",
        "_sd",
    )

    def __init__(
        self,
        regression: Regression,
        output_names: Sequence[str],
        start: Mapping[str, float],
        *,
        tau: tuple[float, float],
        sample_time: float,
        forgetting: float | None = None,
        memory: float | None = None,
        ramps: Sequence[bool] = (),
        every: int = 20,
    ) -> None:
        self.regression = regression
        self._rows = StreamingRows(regression, output_names, tau, sample_time, ramps)
        m, k = len(regression.known), len(regression.columns)
        self._triangles = Triangles(
            m,
            NUISANCE + k + 1,
            forgetting=1.0 if forgetting is None else float(np.exp(-sample_time / forgetting)),
            memory=None if memory is None else round(memory / sample_time),
        )
        self._start = {name: float(start[name]) for name in start}
        self._names = tuple(n for n in regression.free if n in regression.parameters)
        self._correlation = correlated_samples(tau, sample_time)
        self._settling = int(np.ceil(_SETTLED * max(tau) / sample_time))
        self._waiting = 0
        self._every = every
        self._samples = 0
        self._next_look = 0
        self._last: Solution | None = None
        self._lumps: Array | None = None
        self._innovation_sd = np.full(m, np.nan)
        self._values = {n: self._start[n] for n in regression.free}
        self._sd = dict.fromkeys(regression.free, np.inf)

    def update(self, inputs: Sequence[float], outputs: Sequence[float]) -> OnlineEstimate:
        """Take one sample; after a gap the filter settles before its rows count again."""
        self._samples += 1
        m = len(self.regression.known)
        innovation = np.full(m, np.nan)
        if not math.isfinite(sum(outputs) + sum(inputs)):
            self._rows.restart()
            self._waiting = self._settling
            return self._estimate(innovation)
        rows = self._rows.push(inputs, outputs)
        if self._waiting > 0:
            self._waiting -= 1
            return self._estimate(innovation)
        if self._lumps is not None:
            innovation = rows[:, -1] - rows[:, NUISANCE:-1] @ self._lumps
        self._triangles.add(rows)
        if self._samples % self._every == 0:
            self._refresh()
        return self._estimate(innovation)

    def _estimate(self, innovation: Array) -> OnlineEstimate:
        return OnlineEstimate(
            self._samples, self._values, self._sd, innovation, self._innovation_sd
        )

    def _refresh(self) -> None:
        """Renew the estimate: thoroughly now and then, in between with what was seen then."""
        if self._samples < self._next_look and self._last is not None:
            self._take(self._quick(self._last))
            return
        rows = self._triangles.rows
        self._next_look = self._samples + max(self._every, rows // _LOOK)
        try:
            self._last = self.solution()
        except TwinproofError:
            return  # too little seen yet
        self._take(self._last)
        sd = np.sqrt(np.diag(self._last.covariance))
        found = dict(zip(self._last.fitted, sd.tolist(), strict=True))
        self._sd = {n: found.get(n, np.inf) for n in self.regression.free}

    def _take(self, solution: Solution) -> None:
        self._lumps = solution.lumps
        self._innovation_sd = solution.residual_sd
        fitted = set(solution.fitted)
        self._values = {
            n: solution.values[n] if n in fitted else self._start[n] for n in self.regression.free
        }

    def _quick(self, last: Solution) -> Solution:
        """Return a solution of all rows with the weights and parameters of the last one."""
        k = len(self.regression.columns)
        inner = self._triangles.triangle()[:, NUISANCE:, NUISANCE:]
        stacked = (inner / last.residual_sd[:, None, None]).reshape(-1, k + 1)
        values = fit_lumps(self.regression, stacked[:, :k], stacked[:, k], self._start, last.fitted)
        return replace(last, values=values, lumps=self.regression.lumps(values))

    def solution(self) -> Solution:
        """Return the solution of the rows so far, as `regressors.least_squares.solve` would.

        Raises:
            ExcitationError: Too few samples, or they show none of the parameters.
        """
        regression = self.regression
        m, k = len(regression.known), len(regression.columns)
        if m * (self._triangles.rows - NUISANCE) <= k:
            raise ExcitationError(
                f"{self._triangles.rows} samples for {k} unknowns", remedy="go on recording"
            )
        whole = self._triangles.triangle()
        # The first rows belong to the transients: without them these are projected out.
        inner = whole[:, NUISANCE:, NUISANCE:]
        norms = np.linalg.norm(inner, axis=1)
        size = np.linalg.norm(whole, axis=1)[:, NUISANCE:]
        gone = norms[:, :k] <= _COLUMN_IS_ZERO * size[:, :k]
        inner = np.where(np.pad(gone, ((0, 0), (0, 1)))[:, None, :], 0.0, inner)
        n = self._triangles.rows
        seen = Seen(regression, self._start, np.any(~gone & (norms[:, :k] > 0), axis=0))
        right = norms[:, k] / np.sqrt(n)
        weights = 1 / np.where(right > 0, right, np.max(right) or 1.0)
        fitted: list[str] = []
        values, lumps, sd = dict(self._start), np.zeros(k), weights
        factor = np.zeros((0, k))
        for _ in range(WEIGHTINGS):
            stacked = (weights[:, None, None] * inner).reshape(-1, k + 1)
            triangle = np.asarray(np.linalg.qr(stacked, "r"))
            factor, target = triangle[:, :k], triangle[:, k]
            fitted = seen.fitted(factor)
            values = fit_lumps(regression, factor, target, self._start, fitted)
            lumps = regression.lumps(values)
            residual = inner @ np.append(-lumps, 1.0)
            sd = residual_sd(
                np.sum(residual**2, axis=1) / n,
                norms[:, k] ** 2 / n + norms[:, :k] ** 2 / n @ lumps**2,
            )
            weights = 1 / sd
        jacobian = regression.lump_jacobian(values)[
            :, [regression.parameters.index(name) for name in fitted]
        ]
        covariance, condition, weakest = self._covariance(
            factor @ jacobian, whole, lumps, jacobian, weights
        )
        warnings = [*seen.warnings(), *hardly_told_apart(fitted, condition, weakest)]
        return Solution(values, tuple(fitted), covariance, condition, sd, lumps, tuple(warnings))

    def _covariance(
        self, factor: Array, whole: Array, lumps: Array, jacobian: Array, weights: Array
    ) -> tuple[Array, float, Array]:
        """Sandwich with the scores summed over blocks as long as residuals are correlated."""
        m, n = len(whole), self._triangles.rows
        least = max(1, min(self._correlation, n // 4))
        triangles, rows = self._triangles.blocks(least)
        scores = np.zeros((len(triangles), jacobian.shape[1]))
        for i in range(m):
            inner = whole[i, :NUISANCE]
            on_transients = np.linalg.lstsq(inner[:, :NUISANCE], inner[:, NUISANCE:], rcond=1e-12)[
                0
            ]
            # Columns and right-hand side with their share in the transients taken out.
            free = np.concatenate([-on_transients, np.eye(inner.shape[1] - NUISANCE)])
            residual = triangles[:, i] @ (free @ np.append(-lumps, 1.0))
            columns = triangles[:, i] @ free[:, :-1]
            scores += weights[i] ** 2 * (np.einsum("bij,bi->bj", columns, residual) @ jacobian)
        bread, condition, weakest = scaled_condition(factor)
        meat = scores.T @ scores * few_blocks_factor(float(np.mean(rows)) / n) ** 2
        unknowns = jacobian.shape[1] + NUISANCE * m
        meat *= m * n / max(m * n - unknowns, 1)
        # At the solution the scores add up to zero: one block fewer is free to scatter.
        count = len(triangles)
        meat *= count / max(count - 1, 0.5)
        sandwich, white = bread @ meat @ bread, bread
        # Few blocks leave directions without any: there all share one ratio to white residuals.
        p = jacobian.shape[1]
        ratio = float(np.trace(factor @ bread @ meat @ bread @ factor.T)) / p
        few = min(1.0, p / count)
        if few == 1.0:
            # Nothing but the filter's own memory tells how far residuals are correlated.
            ratio = max(ratio, self._correlation / 8)
        covariance = (1 - few) * sandwich + few * ratio * white
        return covariance, condition, weakest
