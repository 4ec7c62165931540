"""A model as the on-line filters take it: an unknown disturbance at every input, sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmus.dae import Dae
from foundation.errors import InputError, UnsupportedModelError
from identification.innovations import Disturbance, with_input_disturbances
from identification.problem import Vector


@dataclass(frozen=True, eq=False)
class Disturbed:
    """A model with disturbances at its inputs.

    Attributes:
        dae: The model.
        added: The disturbances' names, in the order of the inputs.
        noise_sd: (ny,) of the sensors.
        sd: (nd,) stationary standard deviations.
        decay: (nd,) over a sample.
        added_variance: (nd,) that a sample adds.
    """

    dae: Dae
    added: tuple[str, ...]
    noise_sd: Vector
    sd: Vector
    decay: Vector
    added_variance: Vector


def disturbed(
    dae: Dae,
    noise_sd: Sequence[float] | Vector,
    disturbances: Sequence[Disturbance],
    sample_time: float,
) -> Disturbed:
    """Return the model with these disturbances, one an input.

    Raises:
        UnsupportedModelError: The model has delays.
        InputError: A sensor without noise, or of unknown noise; not one disturbance an input.
    """
    noise = np.asarray(noise_sd, dtype=float)
    if not np.all(np.isfinite(noise) & (noise > 0)):
        raise InputError(
            "a Kalman filter needs every sensor's noise",
            where="noise_sd",
            remedy="give positive standard deviations, as from FilteredLeastSquares' details",
        )
    if dae.delays:
        raise UnsupportedModelError(
            f"{dae.name} has delays, which the on-line filter does not keep",
            remedy="put a first-order lag there, or use --method kalman on a record",
        )
    model, added = with_input_disturbances(dae)
    if len(disturbances) != len(added):
        raise InputError(
            f"{len(disturbances)} disturbances for {len(added)} inputs", remedy="give one an input"
        )
    sd = np.array([d.sd for d in disturbances], dtype=float)
    decay = np.exp(-np.array([d.rate for d in disturbances], dtype=float) * sample_time)
    return Disturbed(model, added, noise, sd, decay, sd**2 * (1 - decay**2))
