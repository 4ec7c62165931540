"""What every estimator starts from: a model and a recording, matched and checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fmus.dae import Dae, Role, ScalarType
from foundation.errors import ChannelError, ExcitationError, UnknownNameError
from identification.priors import NO_PRIORS, Prior
from recordings.recording import Recording
from recordings.resample import Kind

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_SHORTEST = 20


@dataclass(frozen=True)
class Problem:
    """A model beside the record that is to explain it, on a uniform grid.

    Attributes:
        dae: The model.
        time: (n,) uniform [s].
        inputs: (n, nu) in the order of `dae.inputs`, model's units.
        outputs: (n, ny) measured, model's units.
        output_names: The ny measured variables.
        noise_sd: (ny,) standard deviation of each sensor, NaN where nothing is known.
        free: Names of the parameters to be fitted.
        values: Every independent parameter's starting value.
        notes: What was ignored or assumed while matching.
        measured_inputs: Inputs that were measured, not commanded: between their samples they run in
            straight lines, others hold.
        following: States of sensors, whose start follows from the signal that they filter.
        priors: What is known of parameters beforehand.
    """

    dae: Dae
    time: Vector
    inputs: Matrix
    outputs: Matrix
    output_names: tuple[str, ...]
    noise_sd: Vector
    free: tuple[str, ...]
    values: Mapping[str, float]
    notes: tuple[str, ...] = ()
    measured_inputs: tuple[str, ...] = ()
    following: tuple[str, ...] = ()
    priors: Mapping[str, Prior] = field(default_factory=lambda: NO_PRIORS)

    @property
    def sample_time(self) -> float:
        """Step of the grid [s]."""
        return float(self.time[1] - self.time[0])

    def part(self, begin: int, end: int) -> Problem:
        """Return the samples `begin` to `end` (exclusive) as a problem of their own."""
        part = slice(begin, end)
        return replace(
            self, time=self.time[part], inputs=self.inputs[part], outputs=self.outputs[part]
        )

    def with_values(self, values: Mapping[str, float]) -> Problem:
        """Return the problem with other starting values."""
        return replace(self, values={**self.values, **values})


def fitted_by_default(dae: Dae) -> tuple[str, ...]:
    """Return the parameters that are fitted unless the user says otherwise.

    Every tunable Real parameter that is independent, not declared known, and not a state's start.
    """
    return tuple(
        v.name
        for v in dae.with_role(Role.PARAMETER)
        if v.tunable
        and not v.known
        and v.type is ScalarType.REAL
        and v.name not in dae.dependent_parameters
        and v.name not in dae.start_parameters
    )


def match(
    dae: Dae,
    recording: Recording,
    *,
    free: Collection[str] | None = None,
    values: Mapping[str, float] | None = None,
) -> Problem:
    """Match a model's inputs and outputs with a recording's channels.

    Args:
        dae: The model.
        recording: Channels in the model's units; resampled to a uniform grid where it is not.
        free: Parameters to fit; None for the default choice.
        values: Starting values that replace the declared ones.

    Raises:
        ChannelError: An input is not recorded, or no output is.
        UnknownNameError: `free` or `values` names no independent parameter.
        ExcitationError: Fewer than 20 samples.
    """
    declared = {
        v.name: dae.parameter_values[v.name]
        for v in dae.with_role(Role.PARAMETER)
        if v.name not in dae.dependent_parameters
    }
    for name in (*(free or ()), *(values or ())):
        if name not in declared:
            raise UnknownNameError("parameter", name, declared, where=dae.name)
    uniform = recording.uniform()
    if len(uniform.time) < _SHORTEST:
        raise ExcitationError(
            f"the recording has {len(uniform.time)} samples",
            where=recording.origin,
            remedy=f"record at least {_SHORTEST}",
        )
    missing = [v.name for v in dae.inputs if v.name not in uniform.channels]
    if missing:
        raise ChannelError(
            f"no channel for the input '{missing[0]}' of {dae.name}",
            where=recording.origin,
            remedy=f'name its column in a channel map: [channels.{missing[0]}] source = "…"',
        )
    output_names = tuple(v.name for v in dae.outputs if v.name in uniform.channels)
    if not output_names:
        raise ChannelError(
            f"none of the outputs of {dae.name} is recorded",
            where=recording.origin,
            remedy="map at least one of: " + ", ".join(v.name for v in dae.outputs),
        )
    n = len(uniform.time)
    columns = [uniform[v.name].values for v in dae.inputs]
    sensors = [uniform[name].sensor for name in output_names]
    sd = [
        float("nan")
        if s.sd is None and s.resolution is None
        # A quantiser of step q adds q²/12 where the signal moves over several steps.
        else float(np.hypot(s.sd or 0.0, (s.resolution or 0.0) / np.sqrt(12)))
        for s in sensors
    ]
    return Problem(
        dae=dae,
        time=uniform.time - uniform.time[0],
        inputs=np.column_stack(columns) if columns else np.zeros((n, 0)),
        outputs=np.column_stack([uniform[name].values for name in output_names]),
        output_names=output_names,
        noise_sd=np.array(sd),
        free=tuple(dict.fromkeys(free)) if free is not None else fitted_by_default(dae),
        values={**declared, **(values or {})},
        notes=uniform.notes,
        measured_inputs=tuple(v.name for v in dae.inputs if uniform[v.name].kind is Kind.MEASURED),
    )
