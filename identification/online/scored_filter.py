"""A Kalman filter at given parameters that says, block by block, what its innovations say of them.

If parameters are θ₀ + δ, the innovations v of a filter that believes θ₀ are shifted by ψ·δ, where
ψ is the sensitivity of the prediction with the filter's gains as they are. From a block's samples
come the score r = Σ ψ'v/s and the information F = Σ ψ'ψ/s: E r = F·δ and cov r = F. Sums over
blocks give the Gauss–Newton step F⁻¹r, its covariance, and every likelihood-ratio test against θ₀
(M. Basseville, I. V. Nikiforov, Detection of Abrupt Changes, 1993, chapter 8: the local approach).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.dae import Dae
from foundation.errors import DivergenceError
from foundation.resumable import Resumable
from identification.innovations import Disturbance, disturbed_values, filter_library, pointer
from identification.online.disturbed import disturbed
from identification.problem import Matrix, Vector
from identification.shooting import Shooting, substeps

_UNKNOWN_RATE = 3.0
"""Standard deviation of a state that no sensor shows at once, over the size of its start or 1."""


@dataclass(frozen=True)
class Scored:
    """What a block of n samples says.

    Attributes:
        innovations: (n, ny); 0 where a measurement is missing.
        variances: (n, ny) as predicted; 1 where missing.
        score: (k,) r.
        information: (k, k) F.
        states: (n, nx) filtered.
    """

    innovations: Matrix
    variances: Matrix
    score: Vector
    information: Matrix
    states: Matrix


class ScoredFilter(Shooting, Resumable):
    """An extended Kalman filter with a disturbance at every input, in blocks of samples.

    Args:
        dae: The model.
        output_names: Measured channels, in the order of the samples.
        free: The k parameters whose score is wanted.
        values: Every independent parameter.
        sample_time: Between samples [s].
        noise_sd: (ny,) of the sensors, in the model's units.
        disturbances: At every input, in the model's order.

    Raises:
        UnsupportedModelError: The model jumps at events or has delays.
        InputError: A sensor without noise, or of unknown noise.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> dae = load(library_class("Twinproof.Plants.Pendulum"))
        >>> f = ScoredFilter(dae, ["theta"], ["J"], dae.parameter_values, sample_time=1e-3,
        ...     noise_sd=[1e-3], disturbances=[Disturbance(1.0, 0.0)])
        >>> f.block(np.zeros((11, 1)), np.zeros((10, 1))).information.shape
        (1, 1)
    """

    _changes = (
        "values",
        "_p",
        "_z",
        "_P",
        "_Z",
        "_time",
        "_begun",
    )

    def __init__(
        self,
        dae: Dae,
        output_names: Sequence[str],
        free: Sequence[str],
        values: Mapping[str, float],
        *,
        sample_time: float,
        noise_sd: Sequence[float] | Vector,
        disturbances: Sequence[Disturbance],
    ) -> None:
        model = disturbed(dae, noise_sd, disturbances, sample_time)
        super().__init__(model.dae, output_names, (*model.added, *free))
        self.free = tuple(free)
        self.h = sample_time
        self._disturbed, self._nd = model, len(model.added)
        self._scoring = filter_library(
            *(self.model, self.output_names, self.sensitive),
            *("scored_innovations.c", "twinproof_scored"),
        )
        self._where = np.array(
            [self.parameter_names.index(name) for name in self.sensitive], dtype=np.int32
        )
        self.set_values(values)
        self.restart()

    def set_values(self, values: Mapping[str, float]) -> None:
        """Believe other parameters from the next sample on; the state stays."""
        given = {**self.dae.parameter_values, **disturbed_values(values, self._disturbed.added)}
        self.values = {name: given[name] for name in self.parameter_names}
        self._p = self.parameter_vector(given)

    def forget(self) -> None:
        """Let earlier samples have no part in the score of later ones."""
        self._Z[:] = 0.0

    def restart(self) -> None:
        """Forget the state; the next sample is the first."""
        m, k = self.nx + self._nd, len(self.free)
        self._z, self._P, self._Z = np.zeros(m), np.zeros((m, m)), np.zeros((m, k))
        self._time = 0.0
        self._begun = False

    @property
    def state(self) -> dict[str, float]:
        """State → its prediction for the next sample."""
        return dict(zip(self.state_names, self._z.tolist(), strict=False))

    def block(self, inputs: Matrix, outputs: Matrix) -> Scored:
        """Take n samples.

        Args:
            inputs: (n + 1, nu); the last row is that of the next block's first sample.
            outputs: (n, ny) measured; NaN where missing.

        Raises:
            DivergenceError: The filter left the finite numbers; it begins anew with the next block.
        """
        if not self._begun:
            self._begin(outputs)
        n, k = len(outputs), len(self.free)
        u, y = np.ascontiguousarray(inputs, float), np.ascontiguousarray(outputs, float)
        v, s = np.empty(y.shape), np.empty(y.shape)
        score, information, states = np.empty(k), np.empty((k, k)), np.empty((n, self.nx))
        d = self._disturbed
        none, r = np.zeros(self.nx), d.noise_sd**2
        scratch = np.empty(len(self._p))
        finite = self._scoring.twinproof_scored(
            *(n, self._nd, substeps(self.h), ctypes.c_double(self.h), ctypes.c_double(self._time)),
            *(pointer(a) for a in (u, self.ramps, y, self._p)),
            len(self._p),
            *(pointer(a) for a in (self._where, d.decay, d.added_variance, none, r)),
            *(pointer(a) for a in (self._z, self._P, self._Z, v, s, score, information, states)),
            pointer(scratch),
        )
        self._time += n * self.h
        if finite < n or not np.all(np.isfinite(score)):
            self.restart()
            raise DivergenceError(
                f"the on-line filter of {self.dae.name} left the finite numbers",
                remedy="check units and signs of the inputs, or start from a fit of a record",
            )
        return Scored(v, s, score, information, states)

    def _begin(self, outputs: Matrix) -> None:
        """Take measured states from the first sample that has them."""
        nx = self.nx
        for i, name in enumerate(self.state_names):
            start = self.dae.number(self.dae.variables[name].start, 0.0)
            self._z[i], self._P[i, i] = start, (_UNKNOWN_RATE * (abs(start) or 1.0)) ** 2
        for i, (output, gain) in self.measured_states.items():
            seen = outputs[0, output]
            if np.isfinite(seen):
                self._z[i] = seen / gain
                self._P[i, i] = (3 * self._disturbed.noise_sd[output] / gain) ** 2
        self._P[nx:, nx:] = np.diag(self._disturbed.sd**2)
        self._begun = True
