"""What every estimator returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ParameterEstimate:
    """One fitted number with its doubt.

    Attributes:
        value: In SI units of the model.
        sd: Standard deviation; infinite if the data do not see the parameter.
        unit: As the model declares it.
        identifiable: False if the data cannot tell this parameter (it is held at its start value).
    """

    value: float
    sd: float
    unit: str = ""
    identifiable: bool = True


@dataclass(frozen=True)
class Estimate:
    """The result of one estimator.

    Attributes:
        method: The estimator's word, as in `--method`.
        parameters: Every free parameter.
        covariance: (k, k) in the order of `parameters`; rows of unseen parameters are NaN.
        condition_number: Of the scaled normal matrix's square root (1 is best).
        warnings: Sentences that say what is doubtful and what to try.
        details: What else a method has to say.
    """

    method: str
    parameters: Mapping[str, ParameterEstimate]
    covariance: NDArray[np.float64]
    condition_number: float
    warnings: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def values(self) -> dict[str, float]:
        """Name → value."""
        return {name: p.value for name, p in self.parameters.items()}
