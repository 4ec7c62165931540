"""Systems of equations solved block by block, linear blocks symbolically."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.casadi_expressions import SX
from foundation.errors import UnsupportedModelError

LARGEST_SYMBOLIC = 8
"""Linear blocks beyond this size grow too long as formulas."""


@dataclass(frozen=True)
class Loop:
    """A block that is left to Newton's method.

    Attributes:
        unknowns: Indices into the unknowns of the whole system.
        residual: Column of as many expressions, in terms of these unknowns and of those of
            earlier loops.
    """

    unknowns: tuple[int, ...]
    residual: SX


def solve_blocks(
    residuals: Sequence[SX],
    unknowns: Sequence[SX],
    *,
    where: str,
    loops: list[Loop] | None = None,
) -> list[SX]:
    """Solve 0 = residuals(unknowns) symbolically, block by block of the incidence matrix.

    Args:
        residuals: Scalar expressions, one for each unknown.
        unknowns: Scalar symbols.
        where: The model, for messages.
        loops: Takes up the blocks that are nonlinear or large; None to refuse them.

    Returns:
        One expression for each unknown, free of all unknowns but those of `loops`.

    Raises:
        UnsupportedModelError: The equations are structurally singular, or a block is nonlinear
            and `loops` is None.
    """
    if len(residuals) != len(unknowns):
        raise UnsupportedModelError(
            f"{where} has {len(residuals)} equations for {len(unknowns)} unknowns",
            remedy="remove or add equations until the model is balanced",
        )
    if not unknowns:
        return []
    g, z = ca.vertcat(*residuals), ca.vertcat(*unknowns)
    blocks, rows, columns, row_begin, column_begin, *_ = ca.jacobian(g, z).sparsity().btf()
    # A structurally singular system decomposes into rectangular blocks.
    if (
        any(
            row_begin[k + 1] - row_begin[k] != column_begin[k + 1] - column_begin[k]
            for k in range(blocks)
        )
        or blocks != len(row_begin) - 1
        or not _structurally_regular(ca.jacobian(g, z))
    ):
        raise UnsupportedModelError(
            f"{where}: the equations do not determine every derivative and algebraic variable "
            "(a constraint between states, index > 1)",
            remedy="model the constraint by a stiff spring, or choose independent coordinates",
        )
    solved: list[SX] = []
    solutions: list[SX] = []
    value: dict[int, SX] = {}
    for k in range(blocks):
        block_rows = rows[row_begin[k] : row_begin[k + 1]]
        block_columns = columns[column_begin[k] : column_begin[k + 1]]
        y = ca.vertcat(*(unknowns[j] for j in block_columns))
        equations = ca.vertcat(*(residuals[i] for i in block_rows))
        if solved:
            equations = ca.substitute(equations, ca.vertcat(*solved), ca.vertcat(*solutions))
        matrix = ca.jacobian(equations, y)
        is_linear = not ca.depends_on(matrix, y)
        if loops is not None and (not is_linear or len(block_columns) > LARGEST_SYMBOLIC):
            loops.append(Loop(tuple(block_columns), equations))
            value |= {j: unknowns[j] for j in block_columns}
            continue
        if not is_linear:
            named = ", ".join(unknowns[j].name() for j in block_columns)
            raise UnsupportedModelError(
                f"{where}: the equations for {named} are nonlinear in them, which is solved in "
                "FMUs only",
                remedy="solve them for these variables in the model",
            )
        constant = ca.substitute(equations, y, ca.SX.zeros(*y.shape))
        solution = -constant / matrix if len(block_columns) == 1 else ca.solve(matrix, -constant)
        for position, j in enumerate(block_columns):
            value[j] = ca.densify(solution)[position]
            solved.append(unknowns[j])
            solutions.append(value[j])
    return [value[j] for j in range(len(unknowns))]


def _structurally_regular(matrix: SX) -> bool:
    return int(ca.sprank(matrix)) == int(matrix.shape[0])
