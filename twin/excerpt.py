"""What a plant did over a while, with the model that it is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.frontend import load
from fmus.sources import ModelicaSource, find_source
from identification.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Samples of a plant, and its model.

    Attributes:
        model: MODEL.
        roots: Folders of further Modelica libraries.
        sample_time: [s].
        inputs: (n, nu).
        outputs: (n, ny); NaN where missing.
        output_names: Measured variables.
        noise_sd: (ny,) of the sensors.
        free: Parameters that may be fitted.
        values: Every parameter.
        disturbance_sd: (nu,) of the unknown disturbances that are usual; None: not known.
    """

    model: str
    roots: tuple[Path, ...]
    sample_time: float
    inputs: Array
    outputs: Array
    output_names: tuple[str, ...]
    noise_sd: Array
    free: tuple[str, ...]
    values: Mapping[str, float]
    disturbance_sd: Array | None = None

    @property
    def source(self) -> ModelicaSource:
        """The model's text."""
        return find_source(self.model, self.roots)

    def problem(self, *, whole: bool = False) -> Problem:
        """Return the fit of the model to the samples, without outputs that nobody measured.

        Args:
            whole: For estimators that need every sample: missing ones are put on the line between
                their neighbours.

        Raises:
            TwinproofError: As for every MODEL.
        """
        count = len(self.output_names)
        kept = [j for j in range(count) if np.any(np.isfinite(self.outputs[:, j]))]
        outputs = np.ascontiguousarray(self.outputs[:, kept])
        return Problem(
            load(self.source),
            self.sample_time * np.arange(len(self.outputs), dtype=np.float64),
            self.inputs,
            _filled(outputs) if whole else outputs,
            tuple(self.output_names[j] for j in kept),
            self.noise_sd[kept],
            self.free,
            dict(self.values),
        )


def _filled(columns: Array) -> Array:
    rows = np.arange(len(columns))
    filled = [np.interp(rows, rows[there], c[there]) for c in columns.T for there in [~np.isnan(c)]]
    return np.column_stack(filled) if filled else columns
