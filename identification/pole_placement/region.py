"""The region of the state space in which a linear model holds: where its one-step errors grow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from identification.pole_placement.samples import Matrix, Samples, Vector

_BINS = 10
_LEAST_IN_BIN = 8
_INNER = 3
_GROWTH = 2.0


@dataclass(frozen=True, eq=False)
class Reach:
    """How far from the equilibrium the model holds along one state.

    Attributes:
        holds_to: |x| up to which it does, in the state's unit; infinite if no end was seen.
        seen_to: Largest |x| in the data.
        amplitudes: (bins+1,) edges of |x|, equally many samples between two.
        errors: (bins, n) root-mean-square one-step errors of all states there, each relative to the
            root mean square of that state's change from sample to sample.
    """

    holds_to: float
    seen_to: float
    amplitudes: Vector
    errors: Matrix


def region(
    samples: Samples, A: Matrix, B: Matrix, *, tolerance: float = 0.05
) -> Mapping[str, Reach]:
    """Return, for every state, how far the model x(k+1) = A x(k) + B u(k) holds.

    Along each state it ends where, from some |x| on outwards, the one-step error of some state is
    both twice that among the three tenths of the samples with the least |x|, and more than
    `tolerance` of what the erring state changes from sample to sample: noise alone does not grow
    outwards, and growth that is too small to matter is no end. States that grow together end
    together.

    Args:
        samples: Steps to judge by, not only those of the fit.
        A: (n, n).
        B: (n, m).
        tolerance: Error that matters, relative to a state's change.

    Returns:
        Reach by state; none if there are fewer than 80 steps.

    Example:
        >>> x = np.linspace(-1, 1, 400)[np.random.default_rng(1).permutation(400)]
        >>> bent = np.column_stack([x[:-1], np.where(np.abs(x) < 0.5, x, x**3)[:-1]])
        >>> none = np.zeros((1, 1))
        >>> found = region(Samples(x[:, None], np.zeros((399, 1))), none, none)
        >>> found["x1"].seen_to
        1.0
    """
    count = len(samples)
    if count < _BINS * _LEAST_IN_BIN:
        return {}
    before, after = samples.states[:-1], samples.states[1:]
    residual = after - before @ A.T - samples.inputs @ B.T
    change = np.sqrt(np.mean((after - before) ** 2, axis=0))
    change = np.where(change > 0, change, 1.0)
    squares = (residual / change) ** 2
    found: dict[str, Reach] = {}
    for i, name in enumerate(samples.state_names):
        amplitude = np.abs(before[:, i])
        order = np.argsort(amplitude, kind="stable")
        cuts = np.linspace(0, count, _BINS + 1).astype(int)
        parts = [order[a:b] for a, b in pairwise(cuts.tolist())]
        errors = np.sqrt([np.mean(squares[part], axis=0) for part in parts])
        edges = np.array([amplitude[part[0]] for part in parts] + [amplitude[order[-1]]])
        reference = np.sqrt(np.mean(errors[:_INNER] ** 2, axis=0))
        bad = np.any((errors > _GROWTH * reference) & (errors > tolerance), axis=1)
        outwards = np.logical_and.accumulate(bad[::-1])[::-1]
        end = float(edges[int(np.argmax(outwards))]) if outwards.any() else np.inf
        found[name] = Reach(end, float(edges[-1]), edges, errors)
    return found
