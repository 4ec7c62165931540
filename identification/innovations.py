"""The innovations form of a model: an extended Kalman filter with unknown slow disturbances.

A disturbance is a parameter of the model that varies as a first-order Gauss–Markov process
(Ornstein–Uhlenbeck): an offset at an input, a torque at a flange. What the filter cannot predict
from the past, the innovations, is white if the model is right, whatever the disturbance did; so
their likelihood compares models and parameters where residuals of a simulation would be coloured.
"""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fmus.compiler import shared_library
from fmus.dae import Dae, Role, Variable
from fmus.expressions import Expression, Literal, Operation, Symbol, substitute
from foundation.errors import UnsupportedModelError
from identification.delayed_outputs import at_outputs
from identification.problem import Matrix, Vector
from identification.shooting import LONGEST_STEP, ExplicitModel, Shooting, step_code

_PREFIX = "disturbance_of_"


@dataclass(frozen=True)
class Disturbance:
    """A first-order Gauss–Markov process: dd = -rate·d dt + …, standard deviation `sd`.

    Attributes:
        rate: λ [1/s].
        sd: Stationary standard deviation, in the unit of what it is added to.
    """

    rate: float
    sd: float


@dataclass(frozen=True)
class Innovations:
    """What a filter run leaves.

    Attributes:
        innovations: (n, ny); 0 where a measurement was missing.
        variances: (n, ny) predicted variances of the innovations; 1 where missing.
        means: (n, nz) filtered states and disturbances; (0, nz) unless asked for.
        variances_of_means: (n, nz) likewise.
        finite: Samples before the filter left the finite numbers.
    """

    innovations: Matrix
    variances: Matrix
    means: Matrix
    variances_of_means: Matrix
    finite: int

    @property
    def log_likelihood(self) -> float:
        """Gaussian log-likelihood of the record without its constant; -inf if it diverged."""
        if self.finite < len(self.innovations):
            return -np.inf
        return float(-0.5 * np.sum(self.innovations**2 / self.variances + np.log(self.variances)))

    @property
    def normalised(self) -> Matrix:
        """(n, ny) innovations over their predicted standard deviation."""
        return self.innovations / np.sqrt(self.variances)


def with_input_disturbances(dae: Dae) -> tuple[Dae, tuple[str, ...]]:
    """Return the model with an unknown value added to every input, and the names of those values.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> with_input_disturbances(load(library_class("Twinproof.Plants.Positioner")))[1]
        ('disturbance_of_vir',)
    """
    added = {v.name: f"{_PREFIX}{v.name}" for v in dae.inputs}

    def swap(node: Expression) -> Expression | None:
        if isinstance(node, Symbol) and node.name in added:
            return Operation("add", (node, Symbol(added[node.name])))
        return None

    variables = dict(dae.variables)
    for v in dae.inputs:
        variables[added[v.name]] = Variable(
            added[v.name], Role.PARAMETER, unit=v.unit, binding=Literal(0.0)
        )
    disturbed = replace(
        dae, variables=variables, residuals=tuple(substitute(r, swap) for r in dae.residuals)
    )
    return disturbed, tuple(added.values())


class InnovationFilter(Shooting):
    """A model compiled for filtering.

    Args:
        dae: The model.
        output_names: Measured variables.
        disturbances: Parameters of the model that vary as disturbances.
        measured_inputs: Inputs that run in straight lines between samples; others hold.

    Raises:
        UnsupportedModelError: See `Shooting`.
        CompilerError: No C compiler.
    """

    def __init__(
        self,
        dae: Dae,
        output_names: Sequence[str],
        disturbances: Sequence[str],
        *,
        measured_inputs: Collection[str] = (),
    ) -> None:
        super().__init__(dae, output_names, disturbances, measured_inputs=measured_inputs)
        self.library = filter_library(
            *(self.model, self.output_names, self.sensitive),
            *("innovations.c", "twinproof_innovations"),
        )

    def filter(
        self,
        mean: Vector,
        variance: Vector,
        inputs: Matrix,
        outputs: Matrix,
        p: Vector,
        h: float,
        noise_sd: Vector,
        disturbances: Sequence[Disturbance],
        *,
        state_noise: Vector | None = None,
        track: bool = False,
    ) -> Innovations:
        """Filter a record.

        Args:
            mean: (nx,) state at the first sample; disturbances start at zero.
            variance: (nx,) of that state; a disturbance starts with its stationary variance.
            inputs: (n, …) from `inputs_with_delays`.
            outputs: (n, ny) measured; NaN where missing.
            p: (np,) parameters.
            h: Sample time [s].
            noise_sd: (ny,) of the sensors.
            disturbances: One for each name given to the constructor.
            state_noise: (nx,) standard deviation that a sample adds to each state.
            track: Also return filtered means and variances.
        """
        n, ny, nz = len(outputs), outputs.shape[1], self.nx + len(self.sensitive)
        sd = np.array([d.sd for d in disturbances], dtype=float)
        decay = np.exp(-np.array([d.rate for d in disturbances], dtype=float) * h)
        z = np.concatenate([mean, np.zeros(len(sd))]).astype(float)
        covariance = np.diag(np.concatenate([variance, sd**2])).astype(float)
        where = np.array(
            [self.parameter_names.index(name) for name in self.sensitive], dtype=np.int32
        )
        added = np.zeros(self.nx) if state_noise is None else state_noise**2
        v, s = np.zeros((n, ny)), np.ones((n, ny))
        rows = n if track else 0
        means, spreads = np.zeros((rows, nz)), np.zeros((rows, nz))
        arrays = [
            np.ascontiguousarray(a, dtype=float)
            for a in (inputs, outputs, p, decay, sd**2 * (1 - decay**2), added, noise_sd**2)
        ]
        u, y, p0, phi, q, qx, r = (pointer(a) for a in arrays)
        scratch = np.zeros(len(p))
        finite = self.library.twinproof_innovations(
            n,
            max(1, round(h / LONGEST_STEP)),
            ctypes.c_double(h),
            ctypes.c_double(0.0),
            *(u, pointer(self.ramps), y, p0),
            len(p),
            pointer(where),
            *(phi, q, qx, r),
            *(pointer(z), pointer(covariance), pointer(v), pointer(s)),
            *((pointer(means), pointer(spreads)) if track else (None, None)),
            pointer(scratch),
        )
        return Innovations(v, s, means, spreads, int(finite))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return where an array's numbers are, for a call of C; keep the array until it returns."""
    return ctypes.c_void_p(array.ctypes.data)


@lru_cache(maxsize=256)
def filter_library(
    model: ExplicitModel,
    output_names: tuple[str, ...],
    sensitive: tuple[str, ...],
    driver: str,
    function: str,
) -> ctypes.CDLL:
    """Compile a model with a driver whose function returns a number of samples.

    Raises:
        UnsupportedModelError: An output shows a delayed motion, which is no function of the state.
        CompilerError: No C compiler.
    """
    if at_outputs(model):
        raise UnsupportedModelError(
            f"{model.dae.name} delays an output, which a filter cannot predict from the state",
            remedy="choose --method output-error",
        )
    source = step_code(model, output_names, sensitive, driver)
    library = ctypes.CDLL(str(shared_library(source)))
    library[function].restype = ctypes.c_int
    return library


def disturbed_values(values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return parameter values with the disturbances at zero."""
    return {**values, **dict.fromkeys(names, 0.0)}
