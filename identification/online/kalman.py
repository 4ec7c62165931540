"""States, parameters and unknown disturbances together: an extended Kalman filter, on-line.

The compiled filter of `identification.innovations`, one sample at a time, with the free parameters
as further states that hardly vary. One pass linearises each parameter once; where a record is at
hand, `--method kalman` goes over it until the likelihood has its maximum.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence

import numpy as np

from fmus.dae import Dae
from foundation.errors import DivergenceError
from identification.innovations import Disturbance, InnovationFilter, disturbed_values, pointer
from identification.online.base import OnlineEstimate, OnlineEstimator
from identification.online.disturbed import disturbed
from identification.problem import Matrix, Vector
from identification.shooting import substeps

_PRIOR = 0.2
_ONE = 1.0


class OnlineKalman(OnlineEstimator):
    """On-line joint estimation; memory and the time of an update are constant.

    Args:
        dae: The model.
        output_names: Measured channels, in the order of the samples.
        free: Parameters to estimate.
        values: Every independent parameter.
        sample_time: Between samples [s].
        noise_sd: (ny,) of the sensors, in the model's units.
        disturbances: An unknown offset at every input, in the model's order; None: none acts.
        prior_sd: Standard deviations of the free parameters beforehand; a fifth of the value where
            none is given, of 1 where the value is 0.
        drift: What the parameters may change by: standard deviation of the change in one second, as
            a share of `prior_sd`. 0: they are constant, and old samples count as much as new ones.

    Raises:
        UnsupportedModelError: The model jumps at events or has delays.
        InputError: A sensor without noise, or of unknown noise.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> dae = load(library_class("Twinproof.Plants.Pendulum"))
        >>> online = OnlineKalman(
        ...     dae, ["theta"], ["J"], dae.parameter_values, sample_time=1e-3, noise_sd=[1e-3]
        ... )
        >>> online.update([0.1], [0.0]).samples
        1
    """

    def __init__(
        self,
        dae: Dae,
        output_names: Sequence[str],
        free: Sequence[str],
        values: Mapping[str, float],
        *,
        sample_time: float,
        noise_sd: Sequence[float] | Vector,
        disturbances: Sequence[Disturbance] | None = None,
        prior_sd: Mapping[str, float] | None = None,
        drift: float = 0.0,
    ) -> None:
        given = list(disturbances or [Disturbance(_ONE, 0.0)] * len(dae.inputs))
        model = disturbed(dae, noise_sd, given, sample_time)
        self.free = tuple(free)
        self._filter = InnovationFilter(model.dae, output_names, (*model.added, *self.free))
        start = {**model.dae.parameter_values, **disturbed_values(values, model.added)}
        self._p = self._filter.parameter_vector(start)
        prior = {n: _PRIOR * (abs(start[n]) or 1.0) for n in self.free} | dict(prior_sd or {})
        widths = np.array([prior[n] for n in self.free])
        self._nx, self._nd, self._np = self._filter.nx, len(given), len(self.free)
        self._h, self._samples = sample_time, 0
        self._noise_sd = model.noise_sd
        self._phi = np.concatenate([model.decay, np.ones(self._np)])
        self._q = np.concatenate([model.added_variance, (drift * widths) ** 2 * sample_time])
        nz = self._nx + self._nd + self._np
        self._z = np.concatenate([np.zeros(self._nx + self._nd), [start[n] for n in self.free]])
        self._variance = np.concatenate([np.ones(self._nx), model.sd**2, widths**2])
        self._states_from(start)
        self._covariance = np.diag(self._variance)
        ny = len(model.noise_sd)
        self._u, self._y = np.zeros((2, len(dae.inputs))), np.full((2, ny), np.nan)
        self._v, self._s = np.zeros((2, ny)), np.ones((2, ny))
        self._means, self._spreads = np.zeros((2, nz)), np.zeros((2, nz))
        self._bind()

    def _states_from(self, start: Mapping[str, float]) -> None:
        dae = self._filter.dae
        for i, name in enumerate(self._filter.state_names):
            self._z[i] = dae.number(dae.variables[name].start, 0.0)
        for parameter, state in dae.start_parameters.items():
            if state in self._filter.state_names:
                self._z[self._filter.state_names.index(state)] = start[parameter]

    def _bind(self) -> None:
        """Prepare the call: every array stays where it is."""
        where = [self._filter.parameter_names.index(name) for name in self._filter.sensitive]
        self._kept: list[Matrix | np.ndarray] = [
            np.array(where, dtype=np.int32),
            np.zeros(self._nx),
            self._noise_sd**2,
            np.zeros(len(self._p)),
        ]
        places, none, r, scratch = self._kept
        head = (2, substeps(self._h), ctypes.c_double(self._h))
        measured = (self._u, self._filter.ramps, self._y, self._p)
        model = (places, self._phi, self._q, none, r, self._z, self._covariance)
        found = (self._v, self._s, self._means, self._spreads, scratch)
        tail = (*map(pointer, measured), len(self._p), *map(pointer, (*model, *found)))
        self._head, self._tail = head, tail

    def update(self, inputs: Sequence[float], outputs: Sequence[float]) -> OnlineEstimate:
        """Take one sample.

        Raises:
            DivergenceError: The filter left the finite numbers.
        """
        self._y[0] = outputs
        self._u[:] = inputs
        if self._samples == 0:
            self._begin()
        # The second sample of the call has no measurement: it predicts, and waits for the next.
        finite = self._filter.library.twinproof_innovations(
            *self._head, ctypes.c_double(self._samples * self._h), *self._tail
        )
        if finite < 2:
            raise DivergenceError(
                f"the on-line filter of {self._filter.dae.name} left the finite numbers after "
                f"{self._samples} samples",
                remedy="check units and signs of the inputs, or start from a fit of a record",
            )
        self._samples += 1
        first = self._nx + self._nd
        means, sd = self._means[0, first:].tolist(), np.sqrt(self._spreads[0, first:]).tolist()
        missing = np.isnan(self._y[0])
        return OnlineEstimate(
            self._samples,
            dict(zip(self.free, means, strict=True)),
            dict(zip(self.free, sd, strict=True)),
            np.where(missing, np.nan, self._v[0]),
            np.where(missing, np.nan, np.sqrt(self._s[0])),
        )

    def _begin(self) -> None:
        """Take measured states from the first sample."""
        for i, (output, gain) in self._filter.measured_states.items():
            if np.isfinite(self._y[0, output]):
                self._z[i] = self._y[0, output] / gain
                self._covariance[i, i] = (3 * self._noise_sd[output] / gain) ** 2

    @property
    def states(self) -> dict[str, tuple[float, float]]:
        """State → (value, standard deviation) at the last sample."""
        return self._part(self._filter.state_names, 0)

    @property
    def disturbances(self) -> dict[str, tuple[float, float]]:
        """Input → (what acts beside it, standard deviation) at the last sample, its unit."""
        return self._part([v.name for v in self._filter.dae.inputs], self._nx)

    def _part(self, names: Sequence[str], first: int) -> dict[str, tuple[float, float]]:
        rows = zip(names, self._means[0, first:], self._spreads[0, first:], strict=False)
        return {name: (float(mean), float(np.sqrt(variance))) for name, mean, variance in rows}

    @property
    def covariance(self) -> Matrix:
        """(k, k) of the free parameters, as predicted for the next sample."""
        first = self._nx + self._nd
        return self._covariance[first:, first:].copy()
