"""The published form: gain and model at once from one linear equation, by least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foundation.errors import ComputationError, ExcitationError, UnsupportedModelError
from identification.pole_placement.base import RowMethod, Rows, Triple
from identification.pole_placement.gains import Poles, companion
from identification.pole_placement.samples import Matrix, Vector, floats


def linear_equation(rows: Rows, A_d: Matrix, B_d: Matrix) -> tuple[Matrix, Vector]:
    """Return 𝒳 and 𝒰 of 𝒳 η = 𝒰, η = [t_1 … t_n f_1 … f_m]: (1.15)–(1.18).

    From T x(k+1) = A_d T x(k) + B_d (u(k) - F x(k)) with x_d = T x; in the print, (1.8) lacks its
    last P2 and (1.9) starts with i+1 after i.

    Args:
        rows: R equations.
        A_d: (n, n) any matrix with the desired poles.
        B_d: (n, m) so that (A_d, B_d) is controllable.

    Returns:
        (nR, n(n+m)) and (nR,).
    """
    n, m = A_d.shape[0], B_d.shape[1]
    S1 = np.hstack([np.eye(n), np.zeros((n, m))])
    S2 = np.hstack([-A_d, B_d])
    table = np.kron(S1, rows.after) + np.kron(S2, rows.before)
    return table, (rows.inputs @ B_d.T).T.ravel()


def unpack(eta: Vector, A_d: Matrix, B_d: Matrix) -> Triple:
    """Return A, B, F of a solution η: (1.19).

    Raises:
        ComputationError: T is singular.
    """
    n, m = A_d.shape[0], B_d.shape[1]
    T, F = eta[: n * n].reshape(n, n), eta[n * n :].reshape(m, n)
    try:
        model = floats(np.linalg.solve(T, np.hstack([A_d @ T - B_d @ F, B_d])))
    except np.linalg.LinAlgError:
        model = np.full((n, n + m), np.nan)
    if not (np.all(np.isfinite(model)) and np.all(np.isfinite(F))):
        raise ComputationError(
            "the published equation has a singular transformation T",
            remedy="use --method two-step or auto",
        )
    return model[:, :n], model[:, n:], F


def desired_pair(poles: Poles, m: int) -> tuple[Matrix, Matrix]:
    """Return the companion pair (A_d, B_d) of one input.

    Raises:
        UnsupportedModelError: There are several inputs: without a transformation of the inputs,
            few pairs are equivalent to the plant, and which ones is not known beforehand.
    """
    if m > 1:
        raise UnsupportedModelError(
            f"the published form serves one input, and there are {m}",
            remedy="use --method two-step or auto, or treat decoupled subsystems one by one",
        )
    return companion(poles)


@dataclass(frozen=True)
class Published(RowMethod):
    """Least squares of the published equation, (1.15).

    Reference: P. E. E. Shwe, dissertation, Kanazawa University, 2017, Ch. 1 and 2. Exact without
    noise. With noise it is biased, and more so than `two-step`: the error that it makes small is
    that of T x(k+1), weighted by the unknown T.

    Example:
        >>> from identification.pole_placement.samples import Samples
        >>> rng = np.random.default_rng(1)
        >>> u, x = rng.normal(size=(20, 1)), np.zeros((21, 1))
        >>> for k in range(20):
        ...     x[k + 1] = 1.1 * x[k] + 0.5 * u[k]
        >>> Published().solve(Samples(x, u), np.array([0.5 + 0j])).F.round(9).tolist()
        [[-1.2]]
    """

    word: ClassVar[str] = "published"

    def fit(self, rows: Rows, poles: Poles) -> Triple:
        """Return A, B and F."""
        return solve_published(rows, *desired_pair(poles, rows.inputs.shape[1]))


def solve_published(rows: Rows, A_d: Matrix, B_d: Matrix) -> Triple:
    """Return A, B, F by least squares of the published equation.

    Raises:
        ExcitationError: The equation is singular.
        ComputationError: T is singular.
    """
    table, right = linear_equation(rows, A_d, B_d)
    # The published Matlab has no scaling; columns of like size leave the solution as it is and
    # the rank test to the data.
    scales = np.sqrt(np.mean(table**2, axis=0))
    scales = np.where(scales > 0, scales, 1.0)
    eta, _, rank, _ = np.linalg.lstsq(table / scales, right, rcond=1e-15)
    if rank < table.shape[1]:
        raise ExcitationError(
            "the published equation is singular",
            remedy="add an independent excitation v to u = F x + v while recording",
        )
    return unpack(eta / scales, A_d, B_d)
