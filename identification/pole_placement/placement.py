"""Data-driven pole placement as a user meets it: answer, uncertainty, warnings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from foundation.errors import InputError, UnknownNameError
from identification.pole_placement.auto import Auto
from identification.pole_placement.base import Method, column_scales, rows_of
from identification.pole_placement.bias_compensated import BiasCompensated
from identification.pole_placement.gains import Poles, check_poles, matching
from identification.pole_placement.generalised import GeneralisedTotalLeastSquares
from identification.pole_placement.instrumental import Instrumental
from identification.pole_placement.noise import feedback, noise_variances
from identification.pole_placement.prediction_error import PredictionError
from identification.pole_placement.published import Published
from identification.pole_placement.region import Reach, region
from identification.pole_placement.samples import Matrix, Samples, Vector
from identification.pole_placement.total_least_squares import TotalLeastSquares
from identification.pole_placement.two_step import TwoStep, regress
from identification.pole_placement.uncertainty import entry_sd, poles_with_sd

METHODS: Mapping[str, Callable[[int], Method]] = {
    Auto.word: Auto,
    Published.word: Published,
    TotalLeastSquares.word: TotalLeastSquares,
    TwoStep.word: TwoStep,
    GeneralisedTotalLeastSquares.word: GeneralisedTotalLeastSquares,
    BiasCompensated.word: BiasCompensated,
    Instrumental.word: Instrumental,
    PredictionError.word: lambda order: PredictionError(TwoStep(order)),
}
"""Every method by its word in `--method`, made from the order of the prefilter."""

_BIASED = frozenset({Published.word, TotalLeastSquares.word, TwoStep.word})
_ILL_CONDITIONED = 1e6
_LITTLE_EXCITATION = 1e-3
_NOISE_SHARE, _LEAST_NOISE = 0.3, 1e-4
_FEW = 50
_OFFSET, _OFFSET_SHARE = 4.0, 0.2
"""Constant term beyond which there is an offset: in standard errors, and in the residual's sd."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A linear model from data and the gain that places its poles.

    Attributes:
        method: Word of the method.
        samples: The data.
        A: (n, n) of x(k+1) = A x(k) + B u(k).
        B: (n, m).
        F: (m, n) of u = F x + v.
        covariance: Of the rows of [A B], (n(n+m), n(n+m)); infinite if unknown.
        desired: (n,) the desired poles.
        poles: (n,) poles of A + B F, in the order of `desired`.
        poles_sd: (n,) how far from there the plant's may be, given what the data leave open.
        open_loop_poles: (n,) poles of A.
        open_loop_poles_sd: (n,).
        condition_number: Of the scaled table of states and inputs.
        region: How far a linear model holds, by state.
        warnings: What the user should know, one sentence each.
    """

    method: str
    samples: Samples
    A: Matrix
    B: Matrix
    F: Matrix
    covariance: Matrix
    desired: Poles
    poles: Poles
    poles_sd: Vector
    open_loop_poles: Poles
    open_loop_poles_sd: Vector
    condition_number: float
    region: Mapping[str, Reach] = field(default_factory=dict[str, Reach])
    warnings: tuple[str, ...] = ()

    @property
    def A_sd(self) -> Matrix:  # noqa: N802 - the standard deviation of A
        """Standard deviations of A, (n, n)."""
        return entry_sd(self.covariance, *self.B.shape)[0]

    @property
    def B_sd(self) -> Matrix:  # noqa: N802 - the standard deviation of B
        """Standard deviations of B, (n, m)."""
        return entry_sd(self.covariance, *self.B.shape)[1]


def method_of(word: str, prefilter: int = 1) -> Method:
    """Return the method of a word.

    Args:
        word: One of `METHODS`.
        prefilter: Order M of the FIR prefilter; 1 is none.

    Raises:
        UnknownNameError: There is none of that word.
        InputError: The order is less than 1.

    Example:
        >>> method_of("two-step", 6)
        TwoStep(prefilter=6)
    """
    if word not in METHODS:
        raise UnknownNameError("method", word, METHODS, where="--method")
    if prefilter < 1:
        raise InputError(
            f"a prefilter of order {prefilter}", where="--prefilter", remedy="give 1 (none) or more"
        )
    return METHODS[word](prefilter)


def place(
    samples: Samples,
    poles: Sequence[complex],
    *,
    method: str | Method = "auto",
    prefilter: int = 1,
) -> Placement:
    """Return a linear model and the gain F of u = F x + v that places its poles, from data alone.

    Args:
        samples: States and inputs, recorded with or without feedback, with some excitation.
        poles: n desired poles of the sampled closed loop, inside the unit circle.
        method: A word of `METHODS`, or a method.
        prefilter: Order M of the FIR prefilter; 1 is none.

    Raises:
        InputError: Poles, method or prefilter do not fit.
        ExcitationError: The data cannot answer.
        ComputationError: No answer was reached.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> u, x = rng.normal(size=(200, 1)), np.zeros((201, 2))
        >>> A, B = np.array([[1.0, 0.1], [0.2, 0.9]]), np.array([[0.0], [0.1]])
        >>> for k in range(200):
        ...     x[k + 1] = A @ x[k] + B @ u[k]
        >>> found = place(Samples(x, u), [0.5, 0.6], method="two-step")
        >>> sorted(np.linalg.eigvals(A + B @ found.F).round(6).tolist())
        [0.5, 0.6]
    """
    wanted = check_poles(poles, samples.n, samples.m, samples.step)
    chosen = method_of(method, prefilter) if isinstance(method, str) else method
    solution = chosen.solve(samples, wanted)
    A, B, F = solution.A, solution.B, solution.F
    placed, placed_sd = poles_with_sd(A, B, F, solution.covariance)
    order = matching(wanted, placed)
    own, own_sd = poles_with_sd(A, B, np.zeros_like(F), solution.covariance)
    scaled = rows_of(samples).regressors
    # The best model of one step, whatever the method: errors of a biased model are its own.
    reach = region(samples, *regress(rows_of(samples)))
    found = Placement(
        method=chosen.word,
        samples=samples,
        A=A,
        B=B,
        F=F,
        covariance=solution.covariance,
        desired=wanted,
        poles=placed[order],
        poles_sd=placed_sd[order],
        open_loop_poles=own,
        open_loop_poles_sd=own_sd,
        condition_number=float(np.linalg.cond(scaled / column_scales(scaled))),
        region=reach,
    )
    warnings = (*solution.notes, *_warnings(found, prefilter))
    return replace(found, warnings=warnings)


def _warnings(found: Placement, prefilter: int) -> list[str]:
    samples, said = found.samples, list[str]()
    if found.condition_number > _ILL_CONDITIONED:
        said.append(
            f"states and inputs nearly depend on one another (condition number "
            f"{found.condition_number:.1g}): excite more, or leave out a redundant state"
        )
    seen = samples.prefiltered(prefilter)
    left, whole = feedback(seen)[1], column_scales(seen.inputs)
    for name, share in zip(samples.input_names, column_scales(left) / whole, strict=True):
        if share < _LITTLE_EXCITATION:
            said.append(
                f"'{name}' is a function of the states but for {share:.1g} of it: "
                "add an excitation v to u = F x + v"
            )
    if not np.all(np.isfinite(found.covariance)):
        said.append(f"{len(samples)} steps are too few to tell standard deviations: record longer")
    elif np.any(np.abs(found.poles) + 2 * found.poles_sd >= 1):
        worst = int(np.argmax(np.abs(found.poles) + 2 * found.poles_sd))
        said.append(
            f"the data leave open whether this gain stabilises the plant: pole "
            f"{found.poles[worst]:.3g} ± {found.poles_sd[worst]:.2g}; record longer, or excite more"
        )
    said += _offset_warning(found)
    if found.method in _BIASED and len(samples) >= _FEW:
        said += _noise_warning(found)
    for name, reach in found.region.items():
        if np.isfinite(reach.holds_to):
            said.append(
                f"a linear model holds for |{name}| up to {reach.holds_to:.3g}; the data reach "
                f"{reach.seen_to:.3g}: fit to samples near the equilibrium"
            )
    return said


def _offset_warning(found: Placement) -> list[str]:
    """Say so if a regression with a constant term finds one."""
    rows = rows_of(found.samples)
    if len(rows) < _FEW:
        return []
    scales = column_scales(rows.regressors)
    table = np.column_stack([rows.regressors / scales, np.ones(len(rows))])
    solved = np.linalg.lstsq(table, rows.after, rcond=None)[0]
    sd = np.std(rows.after - table @ solved, axis=0)
    share = np.linalg.pinv(table.T @ table)[-1, -1]
    constant = np.abs(solved[-1])
    shifted = constant > np.maximum(_OFFSET * np.sqrt(share), _OFFSET_SHARE) * sd
    # Arithmetic leaves a constant too.
    shifted &= constant > 1e-9 * column_scales(rows.after)
    if not shifted.any():
        return []
    pairs = zip(found.samples.state_names, shifted, strict=True)
    names = ", ".join(name for name, is_shifted in pairs if is_shifted)
    return [
        f"the equilibrium is not at zero ({names} drift without cause): "
        "subtract the values of states and inputs at rest"
    ]


def _noise_warning(found: Placement) -> list[str]:
    """Say so if the residual of the best model of one step is noise of the states."""
    samples, rows = found.samples, rows_of(found.samples)
    A, B = regress(rows)
    r, _ = noise_variances(samples, A, B)
    residual = rows.after - rows.before @ A.T - rows.inputs @ B.T
    noisy = r > _NOISE_SHARE * np.mean(residual**2, axis=0)
    # A plant that is not quite linear leaves a residual too.
    noisy &= np.sqrt(r) > _LEAST_NOISE * column_scales(samples.states)
    if not noisy.any():
        return []
    names = ", ".join(
        f"{name} (sd about {np.sqrt(v):.2g})"
        for name, v, is_noisy in zip(samples.state_names, r, noisy, strict=True)
        if is_noisy
    )
    return [f"noise on {names} biases {found.method}: use --method auto"]
