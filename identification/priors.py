"""What is known of a parameter before the record speaks: a Gaussian."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from foundation.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    # A problem has priors.
    from identification.problem import Problem


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior, as from a data sheet or a weighing.

    Attributes:
        value: In the parameter's unit.
        sd: Standard deviation, larger than zero.

    Raises:
        InputError: A number is not finite, or `sd` is not positive.

    Example:
        >>> Prior(95.0, 0.5).precision
        4.0
    """

    value: float
    sd: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and math.isfinite(self.sd) and self.sd > 0):
            raise InputError(
                f"a prior of {self.value:g} ± {self.sd:g} says nothing",
                where="--prior",
                remedy="give a finite value and a standard deviation above 0; to hold a parameter, "
                "give it with --param and leave it out of --free",
            )

    @property
    def precision(self) -> float:
        """1/sd²."""
        return 1.0 / self.sd**2


NO_PRIORS: Mapping[str, Prior] = MappingProxyType({})


def check_priors(problem: Problem, priors: Mapping[str, Prior]) -> None:
    """Refuse priors that cannot act.

    Raises:
        UnknownNameError: One is of no fitted parameter.
        InputError: One lies outside its parameter's declared range.
    """
    for name, prior in priors.items():
        if name not in problem.free:
            raise UnknownNameError("fitted parameter", name, problem.free, where="--prior")
        variable = problem.dae.variables[name]
        low = problem.dae.number(variable.minimum, -math.inf)
        high = problem.dae.number(variable.maximum, math.inf)
        if not low <= prior.value <= high:
            raise InputError(
                f"the prior of {name}, {prior.value:g}, is outside its range {low:g} … {high:g}",
                where="--prior",
                remedy="check its unit, or widen the range in the model",
            )


def densities(priors: Mapping[str, Prior], names: Sequence[str]) -> tuple[list[float], list[float]]:
    """Return values and precisions in the order of some parameters; precision 0 where none is."""
    known = [priors.get(name) for name in names]
    return [p.value if p else 0.0 for p in known], [p.precision if p else 0.0 for p in known]
