"""Initial equations: which states they determine, and the equations as residuals."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.casadi_expressions import SX
from fmus.dae import Role
from fmus.explicit import ExplicitModel
from foundation.errors import UnsupportedModelError


@dataclass(frozen=True)
class InitialSystem:
    """0 = residual(t, x, u, p, …) at the start, to be solved for some of the states.

    Attributes:
        states: Indices of the states it determines; the others begin at their start values.
        residual: Column of as many equations.
        jacobian: Their derivatives by those states.
    """

    states: tuple[int, ...]
    residual: SX
    jacobian: SX


def initial_system(model: ExplicitModel) -> InitialSystem:
    """Collect `initial equation`s and fixed starts of variables that are no states.

    States with `fixed=true` keep their start values. If fewer equations than other states are
    there, those states are determined that have no start value of their own.

    Raises:
        UnsupportedModelError: There are more equations than states to determine by them.
    """
    dae = model.dae
    residuals = [model.fold(r) for r in dae.initial_residuals]
    residuals += [
        model.value(v.name) - model.fold(v.start)
        for v in dae.with_role(Role.ALGEBRAIC)
        if v.fixed and v.start is not None
    ]
    if not residuals:
        return InitialSystem((), ca.SX(0, 1), ca.SX(0, 0))
    residual = ca.vertcat(*residuals)
    free = [i for i, v in enumerate(dae.states) if not v.fixed]
    # Those without a start value of their own are given up last.
    free.sort(key=lambda i: dae.states[i].start is None)
    for i in list(free):
        rest = [k for k in free if k != i]
        if len(free) > len(residuals) and _rank(model, residual, rest) == len(residuals):
            free = rest
    if len(free) != len(residuals) or _rank(model, residual, free) != len(residuals):
        raise UnsupportedModelError(
            f"{dae.name}: {len(residuals)} initial equations do not determine the "
            f"{len(free)} states that are not fixed",
            remedy="set fixed=false on the start of a state that they shall determine",
        )
    states = tuple(sorted(free))
    return InitialSystem(states, residual, _jacobian(model, residual, states))


def _jacobian(model: ExplicitModel, residual: SX, states: tuple[int, ...] | list[int]) -> SX:
    columns = ca.vertcat(*(model.x[i] for i in states))
    unit = ca.SX.eye(len(states))
    return ca.horzcat(*(model.along(residual, columns, unit[:, k]) for k in range(len(states))))


def _rank(model: ExplicitModel, residual: SX, states: list[int]) -> int:
    return int(ca.sprank(_jacobian(model, residual, states))) if states else 0
