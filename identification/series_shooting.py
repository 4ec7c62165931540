"""Windowed simulation of a foreign FMU with blocks before and behind it, with sensitivities.

The blocks are compiled like any model and run twice: from the inputs to what the FMU gets, and from
what the FMU says to the outputs. The blocks' own sensitivities are exact. What passes through the
FMU is a difference of its runs: in a parameter of its own, or along the change of its inputs that a
block before it makes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.in_series import SeriesModel
from identification.fmu_shooting import FmuShooting
from identification.problem import Matrix, Problem, Vector
from identification.shooting import LONGEST_STEP, Response, Shooting

_SHARE = 1e-3
"""Of the largest value of a signal, by which it is changed for a difference: well above the error
of the FMU's own integrator."""


@dataclass(frozen=True)
class _Begin:
    """Where the blocks begin a window: their state (nx,) and parameters, sample and start time."""

    x0: Vector
    p: Vector
    h: float
    t0: float

    def run(
        self, chain: Shooting, inputs: Matrix, *, past: int = 0, derived: bool = False
    ) -> Response:
        """Run the blocks, from `past` samples before."""
        return chain.run(
            self.x0, inputs, self.p, self.h, t0=self.t0 - past * self.h, sensitivities=derived
        )


class SeriesShooting:
    """A foreign FMU in its chain of blocks; the counterpart of `Shooting`.

    Args:
        model: FMU and blocks.
        output_names: Measured variables, in the order of the answer.
        sensitive: Parameters with respect to which sensitivities are wanted, of both.
        following: As for `Shooting`.
        briefly: As for `Shooting`.

    Raises:
        UnsupportedModelError: As `Shooting`, for the blocks.
        FmuError: The FMU does not load.
    """

    def __init__(
        self,
        model: SeriesModel,
        output_names: Sequence[str],
        sensitive: Sequence[str],
        *,
        following: Collection[str] = (),
        briefly: bool = False,
    ) -> None:
        self.model = model
        self.output_names = tuple(output_names)
        self.sensitive = tuple(sensitive)
        chain = model.chain
        self._sent = tuple(state for _, state in model.means)
        # An output that is not recorded need not be asked for.
        self._said = tuple(pair for pair in model.computed if pair[0] in self.output_names)
        self._own = tuple(name for name in self.sensitive if name in chain.variables)
        inner = tuple(name for name in self.sensitive if name not in chain.variables)
        is_memory = [v.name for v in chain.states if v.name not in self._sent]
        # Nothing in it but integrals of what is held or straight: one step is exact.
        longest = LONGEST_STEP if is_memory else math.inf
        self._remembers = bool(chain.delays or following)
        self._chain = Shooting(
            chain,
            (*self._sent, *self.output_names),
            self._own,
            measured_inputs=[name for _, name in model.computed],
            following=following,
            briefly=briefly,
            longest_step=longest,
        )
        self._fmu = FmuShooting(model.box, [name for name, _ in self._said], inner)
        names = self._chain.state_names
        self._blocks = [k for k, name in enumerate(names) if name not in self._sent]
        self._columns = {v.name: k for k, v in enumerate(chain.inputs)}
        self.state_names = (*(names[k] for k in self._blocks), *self._fmu.state_names)
        self.nx = len(self.state_names)
        self._parameters = len(self._chain.parameter_names)

    @classmethod
    def of(
        cls,
        problem: Problem,
        model: SeriesModel,
        sensitive: Sequence[str] | None = None,
        *,
        briefly: bool = False,
    ) -> SeriesShooting:
        """Compile a problem's blocks; see `Shooting.of`."""
        return cls(
            model,
            problem.output_names,
            problem.free if sensitive is None else sensitive,
            following=problem.following,
            briefly=briefly,
        )

    @property
    def measured_states(self) -> Mapping[int, tuple[int, float]]:
        """State → (output, 1) where a state of the FMU is an output, or nearly so."""
        found = self._fmu.measured_states
        return {
            len(self._blocks) + i: (self.output_names.index(self._said[k][0]), gain)
            for i, (k, gain) in found.items()
        }

    @property
    def rate_of(self) -> Mapping[str, str]:
        """Nothing: an FMU does not say which state is another's derivative."""
        return {}

    @property
    def begins_anywhere(self) -> bool:
        """Not if no state of the FMU can be set."""
        return self._fmu.begins_anywhere

    def parameter_vector(self, values: Mapping[str, float]) -> Vector:
        """Return the (np,) vector of all independent parameters, the blocks' first."""
        return np.concatenate(
            [self._chain.parameter_vector(values), self._fmu.parameter_vector(values)]
        )

    def inputs_with_delays(self, inputs: Matrix, h: float, p: Vector) -> Matrix:
        """Return the (n, …) inputs as the blocks take them; what the FMU says is still missing."""
        whole = np.zeros((len(inputs), len(self._columns)))
        for column, v in zip(inputs.T, self.model.inputs, strict=True):
            whole[:, self._columns[v.name]] = column
        return self._chain.inputs_with_delays(whole, h, p[: self._parameters])

    def run(
        self,
        x0: Vector,
        inputs: Matrix,
        p: Vector,
        h: float,
        *,
        t0: float = 0.0,
        sensitivities: bool = False,
    ) -> Response:
        """Simulate one window; see `Shooting.run`. The FMU gets the mean over each sample."""
        n, ny = len(inputs), len(self.output_names)
        own_x0 = np.zeros(self._chain.nx)
        own_x0[self._blocks] = x0[: len(self._blocks)]
        begin = _Begin(own_x0, p[: self._parameters], h, t0)
        nothing = np.zeros((0, ny, self.nx + len(self.sensitive)))

        def by_fmu(signals: Matrix, *, derived: bool = False) -> Response:
            x0_fmu, p_fmu = x0[len(self._blocks) :], p[self._parameters :]
            return self._fmu.run(x0_fmu, signals, p_fmu, h, t0=t0, sensitivities=derived)

        sent = self._before(begin, inputs, derived=sensitivities)
        if sent.finite < n:
            return Response(np.full((n, ny), np.nan), nothing, 0)
        said = by_fmu(sent.outputs, derived=sensitivities)
        if said.finite < n:
            return Response(np.full((n, ny), np.nan), nothing, said.finite)
        shown = self._behind(begin, inputs, said.outputs, derived=sensitivities)
        if not sensitivities or shown.finite < n:
            return Response(shown.outputs, nothing, shown.finite)
        through = self._through(begin, inputs, said.outputs, shown.outputs)
        found = np.zeros((n, ny, self.nx + len(self.sensitive)))
        own = (self.nx + self.sensitive.index(name) for name in self._own)
        columns = [*self._blocks, *range(self._chain.nx, self._chain.nx + len(self._own))]
        for place, column in zip((*range(len(self._blocks)), *own), columns, strict=True):
            found[:, :, place] = shown.sensitivities[:, :, column]
            change = sent.sensitivities[:, :, column]
            step = _step(sent.outputs, change)
            if step > 0.0:
                moved = by_fmu(sent.outputs + step * change).outputs
                found[:, :, place] += through((moved - said.outputs) / step)
        inner = (self.nx + self.sensitive.index(name) for name in self._fmu.sensitive)
        for column, place in enumerate((*range(len(self._blocks), self.nx), *inner)):
            found[:, :, place] = through(said.sensitivities[:, :, column])
        return Response(shown.outputs, np.where(np.isfinite(found), found, 0.0), shown.finite)

    def _before(self, begin: _Begin, inputs: Matrix, *, derived: bool) -> Response:
        """Return what goes into the FMU: the mean over each sample."""
        # One sample more: the last mean is that of the sample after it.
        longer = np.vstack([inputs, inputs[-1:]])
        run = begin.run(self._chain, longer, derived=derived)
        sent = slice(len(self._sent))
        return Response(
            np.diff(run.outputs[:, sent], axis=0) / begin.h,
            np.diff(run.sensitivities[:, sent], axis=0) / begin.h,
            run.finite - 1,
        )

    def _behind(
        self, begin: _Begin, inputs: Matrix, said: Matrix, *, derived: bool = False
    ) -> Response:
        """Return the outputs for what the FMU says."""
        whole = self._with_said(inputs, said, begin)
        past = len(whole) - len(inputs)
        run = begin.run(self._chain, whole, past=past, derived=derived)
        shown = slice(len(self._sent), None)
        return Response(
            run.outputs[past:, shown], run.sensitivities[past:, shown], max(run.finite - past, 0)
        )

    def _through(
        self, begin: _Begin, inputs: Matrix, said: Matrix, outputs: Matrix
    ) -> Callable[[Matrix], Matrix]:
        """Return what tells how outputs (n, ny) change with what the FMU says (n, …)."""

        def by_difference(change: Matrix) -> Matrix:
            step = _step(said, change)
            if step == 0.0:
                return np.zeros_like(outputs)
            return (self._behind(begin, inputs, said + step * change).outputs - outputs) / step

        if self._remembers:
            return by_difference
        # Every sample by itself: one run for each of the FMU's outputs tells all.
        ones = [np.tile(unit, (len(said), 1)) for unit in np.eye(said.shape[1])]
        slopes = np.stack([by_difference(one) for one in ones], axis=2)
        return lambda change: np.einsum("nyz,nz->ny", slopes, change)

    def _with_said(self, inputs: Matrix, said: Matrix, begin: _Begin) -> Matrix:
        """Return the blocks' inputs with what the FMU says: (n, …), or more with a past before.

        Where blocks behind the FMU remember, a past as long as the window goes before it, in which
        signals ran in straight lines: a filter and a delay then begin as if they had seen it.
        """
        n = len(inputs)
        whole = np.array(inputs[:, : len(self._columns)])
        for column, (_, name) in zip(said.T, self._said, strict=True):
            whole[:, self._columns[name]] = column
        if not self.model.chain.delays and not self._chain.following:
            return whole
        slope = np.gradient(whole, axis=0, edge_order=2 if n > 2 else 1)[0] if n > 1 else 0.0
        past = whole[0] - np.arange(n, 0, -1)[:, None] * slope
        return self._chain.inputs_with_delays(np.vstack([past, whole]), begin.h, begin.p)


def _step(signals: Matrix, change: Matrix) -> float:
    """Return the multiple of a change that moves no signal by more than its share; 0 for none."""
    largest = np.max(np.abs(change), axis=0)
    moving = largest > 0
    if not np.any(moving):
        return 0.0
    sizes = np.max(np.abs(signals), axis=0)
    return _SHARE * float(np.min(np.where(sizes > 0, sizes, 1.0)[moving] / largest[moving]))
