"""The contract of a method of data-driven pole placement.

A new method
1. subclasses `Method` in a file of its own and sets `word`, its word in `--method`; one that is a
   function of rows x(k+1), x(k), u(k) subclasses `RowMethod`, which adds the covariance;
2. implements `solve(samples, poles)`: a pure function, nothing random (a `ModelMethod` only
   `model(rows)`);
3. raises `ExcitationError` for data that cannot answer, `ComputationError` where no answer is
   reached; it never returns NaN in A, B or F;
4. gives the covariance of [A B]; infinite where the data are too few to tell;
5. is listed in `METHODS`, whence the conformance suite takes it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from foundation.errors import ExcitationError, TwinproofError
from identification.pole_placement.gains import Poles, gain
from identification.pole_placement.samples import Matrix, Samples, Vector

_BLOCKS, _LEAST_BLOCKS = 20, 4
RANK_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """A linear model x(k+1) = A x(k) + B u(k) and a gain u = F x + v for it.

    Attributes:
        A: (n, n).
        B: (n, m).
        F: (m, n).
        covariance: Of the rows of [A B] one after the other, (n(n+m), n(n+m)).
        notes: What the user should know, one sentence each.
    """

    A: Matrix
    B: Matrix
    F: Matrix
    covariance: Matrix
    notes: tuple[str, ...] = ()


class Method(ABC):
    """From sampled states and inputs to a linear model and a gain."""

    word: ClassVar[str]

    @abstractmethod
    def solve(self, samples: Samples, poles: Poles) -> Solution:
        """Fit the model and place the poles.

        Args:
            samples: N steps of n states and m inputs.
            poles: n poles as `check_poles` returns them.

        Raises:
            ExcitationError: The data cannot answer.
            ComputationError: No answer was reached.
        """


@dataclass(frozen=True, eq=False)
class Rows:
    """Equations after = A before + B inputs, one a row.

    Attributes:
        after: (R, n) states x(k+1).
        before: (R, n) states x(k).
        inputs: (R, m) inputs u(k).
        instruments: (R, p), of methods that use them.
        noise: (n,) variances of the states' noise before any prefilter, of methods that use them.
        feedback: (m, n) gain under which was recorded, of methods that use it.
    """

    after: Matrix
    before: Matrix
    inputs: Matrix
    instruments: Matrix | None = None
    noise: Vector | None = None
    feedback: Matrix | None = None

    def __len__(self) -> int:
        return len(self.after)

    @property
    def regressors(self) -> Matrix:
        """[x u], (R, n+m)."""
        return np.hstack([self.before, self.inputs])

    def without(self, first: int, last: int) -> Rows:
        """Return the rows but for first … last-1."""
        kept = np.r_[0:first, last : len(self)]
        return replace(
            self,
            after=self.after[kept],
            before=self.before[kept],
            inputs=self.inputs[kept],
            instruments=None if self.instruments is None else self.instruments[kept],
        )


def rows_of(samples: Samples) -> Rows:
    """Return the equations in samples."""
    return Rows(samples.states[1:], samples.states[:-1], samples.inputs)


Triple = tuple[Matrix, Matrix, Matrix]


@dataclass(frozen=True)
class RowMethod(Method):
    """A method that is a function of rows: its covariance is a jackknife over blocks of time.

    Attributes:
        prefilter: Order M of the FIR prefilter; 1 is none.
    """

    prefilter: int = 1

    def rows(self, samples: Samples) -> Rows:
        """Return the (prefiltered) equations, with all else that `fit` needs."""
        return rows_of(samples.prefiltered(self.prefilter))

    @abstractmethod
    def fit(self, rows: Rows, poles: Poles) -> Triple:
        """Return A, B and F."""

    def solve(self, samples: Samples, poles: Poles) -> Solution:
        """Fit the model and place the poles."""
        rows = self.rows(samples)
        require_rank(rows, samples)
        A, B, F = self.fit(rows, poles)

        def model(part: Rows) -> Matrix:
            return np.hstack(self.fit(part, poles)[:2])

        return Solution(A, B, F, jackknife(model, rows, self.prefilter))


class ModelMethod(RowMethod):
    """A method of two steps: a model whatever the poles, then a gain for it."""

    @abstractmethod
    def model(self, rows: Rows) -> tuple[Matrix, Matrix]:
        """Return A and B."""

    def fit(self, rows: Rows, poles: Poles) -> Triple:
        """Return A, B and F."""
        A, B = self.model(rows)
        return A, B, gain(A, B, poles)

    def solve(self, samples: Samples, poles: Poles) -> Solution:
        """Fit the model and place the poles."""
        rows = self.rows(samples)
        require_rank(rows, samples)
        A, B, F = self.fit(rows, poles)
        covariance = jackknife(lambda part: np.hstack(self.model(part)), rows, self.prefilter)
        return Solution(A, B, F, covariance)


def require_rank(rows: Rows, samples: Samples) -> None:
    """Raise if states and inputs are not independent, the published rank condition (4.1).

    Raises:
        ExcitationError: There are fewer than n + m independent samples.
    """
    size = samples.n + samples.m
    if len(rows) < size:
        raise ExcitationError(
            f"{len(rows)} steps for {size} unknowns in each equation",
            remedy=f"record at least {size} steps, better {20 * size}",
        )
    scaled = rows.regressors / column_scales(rows.regressors)
    values = np.linalg.svd(scaled, compute_uv=False)
    if values[-1] > RANK_TOLERANCE * values[0]:
        return
    mix = np.linalg.svd(scaled)[2][-1]
    names = (*samples.state_names, *samples.input_names)
    involved = [name for name, weight in zip(names, mix, strict=True) if abs(weight) > 0.05]
    raise ExcitationError(
        "states and inputs depend on one another: " + ", ".join(involved),
        remedy="add an independent excitation v to u = F x + v while recording, "
        "or leave out a redundant state",
    )


def column_scales(table: Matrix) -> Matrix:
    """Return the root mean squares of columns, 1 for a column of zeros."""
    scales = np.sqrt(np.mean(table**2, axis=0))
    return np.where(scales > 0, scales, 1.0)


def jackknife(model: Callable[[Rows], Matrix], rows: Rows, span: int = 1) -> Matrix:
    """Return the covariance of [A B] by leaving out one block of time after the other.

    Künsch, "The jackknife and the bootstrap for general stationary observations", Ann. Stat. 17
    (1989): blocks, since the errors of neighbouring rows depend on one another. It tells the
    scatter from record to record, not a bias that all records share.

    Args:
        model: From rows to [A B], (n, n+m).
        rows: All rows.
        span: Rows over which neighbours share samples; blocks are several times longer.

    Returns:
        (k, k) with k = n(n+m); infinite on the diagonal if there are too few rows.
    """
    n, width = rows.after.shape[1], rows.regressors.shape[1]
    unknown = np.diag(np.full(n * width, np.inf))
    blocks = min(_BLOCKS, len(rows) // max(5, 3 * span))
    if blocks < _LEAST_BLOCKS:
        return unknown
    edges = np.linspace(0, len(rows), blocks + 1).astype(int)
    if len(rows) - int(np.max(np.diff(edges))) <= width:
        return unknown
    values: list[Matrix] = []
    for first, last in pairwise(edges.tolist()):
        try:
            values.append(model(rows.without(first, last)).ravel())
        except (TwinproofError, np.linalg.LinAlgError):
            return unknown
    deviations = np.array(values) - np.mean(values, axis=0)
    return (blocks - 1) / blocks * deviations.T @ deviations
