"""Gains from models: place the poles of x(k+1) = A x(k) + B u(k) by u = F x + v."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance
from scipy.optimize import linear_sum_assignment
from scipy.signal import place_poles

from foundation.errors import ComputationError, ExcitationError, InputError
from identification.pole_placement.samples import Matrix, Vector, floats

Poles = NDArray[np.complex128]

_CONJUGATE = 1e-9
_UNCONTROLLABLE = 1e-10


def read_poles(text: str) -> tuple[complex, ...]:
    """Read poles as people write them: `0.8, 0.9+0.05j`, `0.9±0.05j` for a pair.

    Raises:
        InputError: A word is not a number.

    Example:
        >>> read_poles("0.8,0.9±0.05j")
        ((0.8+0j), (0.9+0.05j), (0.9-0.05j))
    """
    poles: list[complex] = []
    for word in text.split(","):
        clean = "".join(word.split()).replace("i", "j").replace("−", "-")
        forms = [clean.replace("±", sign) for sign in "+-"] if "±" in clean else [clean]
        try:
            poles += [complex(form) for form in forms]
        except ValueError:
            raise InputError(
                f"'{word.strip()}' is not a pole",
                where="--poles",
                remedy="write them like 0.8,0.9+0.05j,0.9-0.05j",
            ) from None
    return tuple(poles)


def check_poles(poles: Sequence[complex], n: int, m: int, step: float = 1.0) -> Poles:
    """Return n desired poles as an array, if a real gain for m inputs can place them.

    Args:
        poles: Desired poles z of the sampled closed loop.
        n: Number of states.
        m: Number of inputs; a pole may be repeated at most m times if m > 1.
        step: Sample time [s], for the remedy.

    Raises:
        InputError: Their number is wrong, one is not inside the unit circle, one lacks its
            conjugate, or one is repeated too often.

    Example:
        >>> check_poles([0.5, 0.2 + 0.1j, 0.2 - 0.1j], 3, 1).size
        3
    """
    wanted = np.asarray(list(poles), np.complex128)
    if wanted.size != n:
        raise InputError(
            f"{wanted.size} poles for {n} states",
            where="--poles",
            remedy="give one pole for each state, and both of a complex pair",
        )
    outside = wanted[~(np.abs(wanted) < 1)]
    if outside.size:
        z = np.exp(np.clip(outside[0].real, -1e3, -1.0) * step + 1j * outside[0].imag * step)
        raise InputError(
            f"the pole {outside[0]:.4g} is not inside the unit circle",
            where="--poles",
            remedy="give poles of the sampled system, z = exp(s h); "
            f"s = {min(outside[0].real, -1.0) + 1j * outside[0].imag:.4g} is {z:.4g} "
            f"at h = {step:g} s",
        )
    pairs = matching(wanted, wanted.conj())
    if np.max(np.abs(wanted - wanted.conj()[pairs])) > _CONJUGATE:
        raise InputError(
            "a complex pole lacks its conjugate",
            where="--poles",
            remedy="give both, like 0.9+0.05j,0.9-0.05j",
        )
    times = max(int(np.sum(np.abs(wanted - p) < _CONJUGATE)) for p in wanted)
    if m > 1 and times > m:
        raise InputError(
            f"a pole is repeated {times} times with {m} inputs",
            where="--poles",
            remedy=f"repeat it at most {m} times, or move the others a little",
        )
    return wanted


def matching(values: Poles, targets: Poles) -> NDArray[np.intp]:
    """Return the order of `targets` that is nearest to `values`, in total.

    Example:
        >>> matching(np.array([0.1 + 0j, 0.9]), np.array([0.8 + 0j, 0.2])).tolist()
        [1, 0]
    """
    return linear_sum_assignment(np.abs(values[:, None] - targets[None, :]))[1]


def pole_distance(values: Poles, targets: Poles) -> float:
    """Return the largest distance of paired poles, δλ of (2.19).

    Example:
        >>> pole_distance(np.array([0.1 + 0j, 0.9]), np.array([0.9 + 0j, 0.3]))
        0.19999999999999998
    """
    return float(np.max(np.abs(values - targets[matching(values, targets)])))


def controllability(A: Matrix, B: Matrix) -> Vector:
    """Return, for every pole of A, how well the inputs reach it: 0 is not at all.

    The smallest singular value of [A - λI, B], with states and inputs scaled to balance it
    (Popov, Belevitch and Hautus).

    Example:
        >>> controllability(np.diag([0.5, 2.0]), np.array([[1.0], [0.0]])).round(3).tolist()
        [0.75, 0.0]
    """
    scale = max(float(np.linalg.norm(A, 2)), 1e-300)
    inputs = B / max(float(np.linalg.norm(B, 2)), 1e-300)
    identity = np.eye(len(A))
    return np.array(
        [
            np.linalg.svd(np.hstack([(A - p * identity) / scale, inputs]), compute_uv=False)[-1]
            for p in np.linalg.eigvals(A)
        ]
    )


def gain(A: Matrix, B: Matrix, poles: Poles) -> Matrix:
    """Return F, (m, n), that gives A + B F the poles.

    SciPy's `place_poles` (Kautsky and Nichols; Tits and Yang), which needs poles repeated at most
    m times; a single input's repeated poles by Ackermann's formula.

    Args:
        A: (n, n).
        B: (n, m).
        poles: n poles as `check_poles` returns them.

    Raises:
        ExcitationError: The model has a pole that its inputs do not reach.
        ComputationError: The poles are missed.

    Example:
        >>> F = gain(np.array([[1, 0.1], [0, 1]]), np.array([[0.0], [0.1]]), np.array([0.5, 0.6]))
        >>> F.round(6).tolist()
        [[-20.0, -9.0]]
    """
    # Balanced by the states' own scales: gains of badly scaled states are as good as any.
    scale = _balance(A, B)
    a, b = A * scale[None, :] / scale[:, None], B / scale[:, None]
    reach = controllability(a, b)
    if np.min(reach) < _UNCONTROLLABLE:
        pole = np.linalg.eigvals(A)[int(np.argmin(reach))]
        raise ExcitationError(
            f"no input reaches the pole {pole:.4g} of the model from the data",
            remedy="excite every input, and leave out states that the inputs do not move",
        )
    repeated = np.min(np.abs(poles[:, None] - poles) + np.eye(poles.size) * 2) < 1e-12
    if b.shape[1] == 1 and repeated:
        f = _ackermann(a, b, poles)
    else:
        with warnings.catch_warnings():
            # Its convergence is about robustness; whether the poles are met is checked below.
            warnings.simplefilter("ignore", UserWarning)
            try:
                placed: Any = place_poles(a, b, poles)
                f = -floats(placed.gain_matrix)
            except ValueError as error:
                raise ComputationError(
                    f"the poles cannot be placed: {error}", remedy="choose other poles"
                ) from error
    F = f / scale[None, :]
    # Near a pole of multiplicity r an error ε shows as ε^(1/r): only gross misses are told here.
    if not pole_distance(np.linalg.eigvals(A + B @ F).astype(np.complex128), poles) < 0.05:
        raise ComputationError(
            "the poles were missed: the model is too nearly uncontrollable",
            remedy="excite the plant more, or choose poles nearer to its own",
        )
    return F


def _balance(A: Matrix, B: Matrix) -> Vector:
    """Return scales of the states in which A and B have rows and columns of like size."""
    joint = np.block([[A, B], [np.zeros((B.shape[1], sum(B.shape)))]])
    _, (scale, _) = matrix_balance(joint, permute=False, separate=True)
    return floats(scale[: len(A)])


def _ackermann(A: Matrix, B: Matrix, poles: Poles) -> Matrix:
    n = len(A)
    reach = np.hstack([np.linalg.matrix_power(A, i) @ B for i in range(n)])
    polynomial = np.eye(n, dtype=np.complex128)
    for p in poles:
        polynomial = polynomial @ (A - p * np.eye(n))
    last = np.linalg.solve(reach.T, np.eye(n)[-1])
    return -(last @ polynomial.real)[None, :]


def companion(poles: Poles) -> tuple[Matrix, Matrix]:
    """Return the controllable companion pair (A_d, B_d) of one input that has the poles.

    The published least squares weight their equations by this choice; its Table 3.1 needs it.

    Example:
        >>> A_d, B_d = companion(np.array([0.5 + 0j, 0.25]))
        >>> A_d.tolist(), B_d.ravel().tolist()
        ([[0.0, 1.0], [-0.125, 0.75]], [0.0, 1.0])
    """
    n = poles.size
    A_d, B_d = np.eye(n, k=1), np.zeros((n, 1))
    A_d[-1] = -np.poly(poles).real[:0:-1]
    B_d[-1] = 1.0
    return A_d, B_d
