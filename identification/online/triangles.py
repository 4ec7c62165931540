"""Recursive least squares in square-root form: rows are kept as orthogonal triangles.

[A y] = Q R, and R takes up further rows by another orthogonal transformation
(G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. V). Nothing is
squared, so the precision is that of a batch solution by QR. Rows are collected in blocks, each with
a triangle of its own, which gives three things that one triangle does not: a window of fixed length
without the unstable downdating, residuals' sums by block for honest standard deviations, and all
that in constant memory: when there are many blocks, neighbours are merged.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foundation.errors import InputError
from foundation.resumable import Resumable

Array = NDArray[np.float64]

_BUFFERED = 32  # rows that share one orthogonal transformation
BLOCKS = 32
"""Blocks that are kept at least, once there are that many rows; at most twice as many."""


class Triangles(Resumable):
    """Triangles of blocks of rows, for several equations at once.

    Args:
        equations: m.
        width: Columns of a row, right-hand side included.
        forgetting: Weight of a squared residual falls by this factor a row, at most 1.
        memory: Rows in the window, all of them if None; up to a 32nd more are in it.

    Raises:
        InputError: A factor outside (0, 1], or a window too short.
    """

    _changes = (
        "_buffer",
        "_buffered",
        "_current",
        "_current_rows",
        "_blocks",
        "_whole",
        "_length",
    )

    def __init__(
        self, equations: int, width: int, *, forgetting: float = 1.0, memory: int | None = None
    ) -> None:
        if not 0 < forgetting <= 1:
            raise InputError(
                f"a forgetting factor of {forgetting}",
                remedy="give a number of at most 1, such as 0.9999",
            )
        if memory is not None and memory < BLOCKS:
            raise InputError(
                f"a memory of {memory} rows", remedy=f"keep at least {BLOCKS} rows in memory"
            )
        self._fade = float(np.sqrt(forgetting))
        self._memory = memory
        self._zero = np.zeros((equations, width, width))
        self._buffer = np.zeros((equations, _BUFFERED, width))
        self._weights = self._fade ** np.arange(_BUFFERED)[::-1]
        self._buffered = 0
        self._current, self._current_rows = self._zero, 0
        self._blocks: list[tuple[Array, int]] = []
        self._whole = self._zero
        self._length = _BUFFERED if memory is None else -(-memory // BLOCKS)

    def add(self, rows: Array) -> None:
        """Take up one row (equations, width)."""
        self._buffer[:, self._buffered] = rows
        self._buffered += 1
        if self._buffered == _BUFFERED or self._current_rows + self._buffered == self._length:
            self._flush()

    @property
    def rows(self) -> int:
        """How many rows there are for each equation."""
        return sum(n for _, n in self._blocks) + self._current_rows + self._buffered

    def triangle(self) -> Array:
        """Return (equations, width, width): the triangle of all rows."""
        self._flush()
        if self._current_rows == 0:
            return self._whole
        return _joined(self._whole, self._current, self._fade**self._current_rows)

    def blocks(self, least: int) -> tuple[Array, Array]:
        """Return triangles (blocks, equations, width, width) and their rows (blocks,).

        Args:
            least: Rows that a block shall hold; shorter ones are merged with the next.
        """
        self._flush()
        found: list[tuple[Array, int]] = []
        rest = [
            *self._blocks,
            *([(self._current, self._current_rows)] if self._current_rows else []),
        ]
        age = 0
        aged: list[tuple[Array, int]] = []
        for triangle, n in reversed(rest):
            aged.append((triangle * self._fade**age, n))
            age += n
        held, rows = self._zero, 0
        for triangle, n in reversed(aged):
            held = triangle if rows == 0 else _joined(held, triangle, 1.0)
            rows += n
            if rows >= least:
                found.append((held, rows))
                held, rows = self._zero, 0
        if rows and found:
            last, n = found.pop()
            held, rows = _joined(last, held, 1.0), n + rows
        if rows:
            found.append((held, rows))
        return np.array([t for t, _ in found]), np.array([n for _, n in found])

    def _flush(self) -> None:
        n = self._buffered
        if n:
            fresh = self._buffer[:, :n] * self._weights[-n:, None]
            old = self._current * self._fade**n
            self._current = _triangle(np.concatenate([old, fresh], axis=1))
            self._current_rows += n
            self._buffered = 0
        if self._current_rows >= self._length:
            self._close()

    def _close(self) -> None:
        """Begin a new block; let the oldest go or merge neighbours where there are too many."""
        self._whole = _joined(self._whole, self._current, self._fade**self._current_rows)
        self._blocks.append((self._current, self._current_rows))
        self._current, self._current_rows = self._zero, 0
        if self._memory is not None:
            while len(self._blocks) > BLOCKS:
                del self._blocks[0]
                self._whole = self._zero
                for triangle, n in self._blocks:
                    self._whole = _joined(self._whole, triangle, self._fade**n)
        elif len(self._blocks) == 2 * BLOCKS:
            pairs = zip(self._blocks[::2], self._blocks[1::2], strict=True)
            self._blocks = [
                (_joined(a, b, self._fade**n_b), n_a + n_b) for (a, n_a), (b, n_b) in pairs
            ]
            self._length *= 2


def _joined(older: Array, newer: Array, fade: float) -> Array:
    return _triangle(np.concatenate([older * fade, newer], axis=1))


def _triangle(rows: Array) -> Array:
    """Return (m, w, w) triangles of (m, r, w) rows, r ≥ w."""
    return np.asarray(np.linalg.qr(rows, "r"))
