"""Which input acts on which output at once, and algebraic loops.

An output that depends directly on an input of its unit closes a loop when that input comes, over
other units, from this very output. The inputs of a loop then solve u = F y(u) + g, by Newton's
method with the FMUs' directional derivatives, or differences where an FMU has none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from fmus.stepping import Loop
from foundation.errors import FmuError

Array: TypeAlias = npt.NDArray[np.float64]

_MOST_ITERATIONS = 30
_CONVERGED = 1e-11


class Differentiable(Protocol):
    """What Newton's method needs of a unit."""

    def partial(self, output: str, given: str) -> float | None:
        """∂output/∂input now, or None if the FMU does not provide it."""
        ...


@dataclass(frozen=True, eq=False)
class Wiring:
    """A system in places of `Loop.u` and `Loop.y`.

    Attributes:
        names: Of the units.
        inputs, outputs: (unit, variable) at each place.
        sources, factors, offsets: As `Loop`.
        starts: Of all inputs.
        external, external_starts: Names and values of the inputs from outside.
        shown: Names of what is recorded → place in `y`.
        feedthrough: For each unit: output → the inputs that act on it at once.
    """

    names: Sequence[str]
    inputs: Sequence[tuple[int, str]]
    outputs: Sequence[tuple[int, str]]
    sources: Sequence[int]
    factors: Array
    offsets: Array
    starts: Array
    external: Sequence[str]
    external_starts: Array
    shown: Mapping[str, int]
    feedthrough: Sequence[Mapping[str, frozenset[str]]]

    @cached_property
    def _acts_on(self) -> list[list[int]]:
        """For each input the inputs that it acts on at once, over its unit's outputs."""
        targets: dict[int, list[int]] = {}
        for place, source in enumerate(self.sources):
            if source >= 0:
                targets.setdefault(source, []).append(place)
        return [
            [
                target
                for place, (owner, output) in enumerate(self.outputs)
                if owner == unit and name in self.feedthrough[unit][output]
                for target in targets.get(place, ())
            ]
            for unit, name in self.inputs
        ]

    @cached_property
    def cycles(self) -> list[list[int]]:
        """Places of the inputs of each algebraic loop."""
        n = len(self.inputs)
        pairs = [(i, j) for i, targets in enumerate(self._acts_on) for j in targets]
        rows, columns = np.array(pairs, int).reshape(-1, 2).T
        graph = csr_array((np.ones(len(pairs)), (rows, columns)), shape=(n, n))
        _, label = connected_components(graph, directed=True, connection="strong")
        groups = [np.flatnonzero(label == k).tolist() for k in np.unique(label)]
        return [g for g in groups if len(g) > 1 or g[0] in self._acts_on[g[0]]]

    @cached_property
    def order(self) -> list[int]:
        """Units, those first whose outputs act at once on others; loops in any order."""
        after: dict[int, set[int]] = {k: set() for k in range(len(self.names))}
        for i, targets in enumerate(self._acts_on):
            for j in targets:
                if self.inputs[i][0] != self.inputs[j][0]:
                    after[self.inputs[j][0]].add(self.inputs[i][0])
        # A unit must also come after units whose outputs its own direct outputs use.
        for place, source in enumerate(self.sources):
            unit, name = self.inputs[place]
            if source >= 0 and any(name in acting for acting in self.feedthrough[unit].values()):
                owner = self.outputs[source][0]
                if owner != unit:
                    after[unit].add(owner)
        done: list[int] = []
        left = list(after)
        while left:
            free = [k for k in left if after[k] <= set(done)] or left[:1]
            done.append(free[0])
            left.remove(free[0])
        return done


def solve_loops(
    loop: Loop, wiring: Wiring, plants: Sequence[Differentiable], external: Array
) -> None:
    """Make all inputs and outputs agree, at one point in time.

    Raises:
        FmuError: Newton's method does not converge; or an FMU refuses.
    """
    if not wiring.cycles:
        return
    unknown = sorted(place for cycle in wiring.cycles for place in cycle)
    residual = _residual(loop, wiring, unknown, external)
    for _ in range(_MOST_ITERATIONS):
        scale = 1.0 + np.abs(loop.u[unknown])
        if np.all(np.abs(residual) <= _CONVERGED * scale):
            return
        jacobian = _jacobian(loop, wiring, plants, unknown, external, residual)
        try:
            step = np.linalg.solve(jacobian, -residual)
        except np.linalg.LinAlgError:
            break
        before, norm = loop.u[unknown].copy(), float(np.max(np.abs(residual) / scale))
        for shrink in (1.0, 0.5, 0.25, 0.125):
            loop.u[unknown] = before + shrink * step
            residual = _residual(loop, wiring, unknown, external)
            if np.max(np.abs(residual) / scale) < norm:
                break
    names = [f"{wiring.names[u]}.{n}" for u, n in (wiring.inputs[p] for p in unknown)]
    raise FmuError(
        "the algebraic loop does not converge",
        where=", ".join(names),
        remedy="put a delay or a filter in the loop, or give better start values",
    )


def arrive(
    loop: Loop,
    wiring: Wiring,
    plants: Sequence[Differentiable],
    external: Array,
    last: Array | None = None,
) -> None:
    """Make all agree at a point where inputs from outside may jump from `last` to `external`.

    Errors as `solve_loops`.
    """
    jumps = last is not None and not np.array_equal(last, external)
    before = last if last is not None and jumps else external
    loop.settle(before)
    solve_loops(loop, wiring, plants, before)
    loop.note_rise()
    if jumps:
        loop.settle(external)
        solve_loops(loop, wiring, plants, external)


def _residual(loop: Loop, wiring: Wiring, unknown: Sequence[int], external: Array) -> Array:
    """F y(u) + g − u at the unknown inputs; the other inputs follow."""
    free = set(unknown)
    for _ in range(2):
        for unit in wiring.order:
            for place, (owner, _) in enumerate(wiring.inputs):
                if owner == unit and place not in free:
                    loop.u[place] = _arriving(loop, wiring, place, external)
            loop.evaluate(unit)
    arriving = np.array([_arriving(loop, wiring, place, external) for place in unknown])
    return arriving - loop.u[list(unknown)]


def _arriving(loop: Loop, wiring: Wiring, place: int, external: Array) -> float:
    source = wiring.sources[place]
    value = loop.y[source] if source >= 0 else external[-1 - source]
    return float(wiring.factors[place] * value + wiring.offsets[place])


def _jacobian(
    loop: Loop,
    wiring: Wiring,
    plants: Sequence[Differentiable],
    unknown: Sequence[int],
    external: Array,
    residual: Array,
) -> Array:
    """∂residual/∂unknown: from the FMUs where loops are direct, else by differences."""
    n = len(unknown)
    jacobian = -np.eye(n)
    for row, place in enumerate(unknown):
        source = wiring.sources[place]
        unit, output = wiring.outputs[source]
        for column, other in enumerate(unknown):
            owner, name = wiring.inputs[other]
            if owner != unit or name not in wiring.feedthrough[unit][output]:
                continue
            partial = plants[unit].partial(output, name)
            if partial is None:
                return _by_differences(loop, wiring, unknown, external, residual)
            jacobian[row, column] += wiring.factors[place] * partial
    return jacobian


def _by_differences(
    loop: Loop, wiring: Wiring, unknown: Sequence[int], external: Array, residual: Array
) -> Array:
    jacobian = np.empty((len(unknown), len(unknown)))
    for column, place in enumerate(unknown):
        value = loop.u[place]
        width = 1e-6 * (1.0 + abs(value))
        loop.u[place] = value + width
        jacobian[:, column] = (_residual(loop, wiring, unknown, external) - residual) / width
        loop.u[place] = value
    _residual(loop, wiring, unknown, external)
    return jacobian
