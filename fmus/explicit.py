"""The flat model solved for its derivatives and algebraic variables, as CasADi expressions.

Blocks of the incidence matrix are solved in order; a linear block symbolically, others by Newton's
method in the generated code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from fmus.blocks import Loop, solve_blocks
from fmus.casadi_expressions import SX, CasadiFold
from fmus.dae import Dae, Role, Variable
from fmus.expressions import Delayed, Derivative, Expression, Previous, Relation, Symbol, Time, walk
from fmus.index_reduction import reduce_index


@dataclass(frozen=True, eq=False)
class ExplicitModel:
    """dx = f(t, x, u, p, d, r), z = g(t, x, u, p, d, r) as CasADi SX.

    Attributes:
        dae: The model this was made from.
        time: Scalar symbol [s].
        x, u, p: Column symbols of states, inputs, independent parameters, in the order of
            `state_names`, `input_names`, `parameter_names`.
        delayed: Column symbol of the values of the delay operators.
        relations: Column symbol of frozen relations (0 or 1); empty if evaluated in place.
        discrete: Column symbol of the discrete variables, in the order of `discrete_names`.
        previous: Column symbol of `pre(…)` values, in the order of `previous_names`.
        derivatives: Column (nx,) of state derivatives.
        algebraics: Name → expression, for every algebraic variable.
        dependent: Name → expression of `p`, for every dependent parameter.
        loops: Column symbol of the unknowns of nonlinear blocks, which derivatives and algebraics
            are also given in; empty unless relations are frozen.
        loop_residual: Column of as many expressions, zero at the solution, block lower triangular.
        loop_sizes: Sizes of the blocks.
        loop_names: Names of the unknowns; `der(x)` for derivatives.
        fold: Turns any further expression of the model into SX of the symbols above.
    """

    dae: Dae
    time: SX
    x: SX
    u: SX
    p: SX
    delayed: SX
    relations: SX
    discrete: SX
    previous: SX
    previous_names: tuple[str, ...]
    derivatives: SX
    algebraics: Mapping[str, SX]
    dependent: Mapping[str, SX]
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    discrete_names: tuple[str, ...]
    loops: SX
    loop_residual: SX
    loop_sizes: tuple[int, ...]
    loop_names: tuple[str, ...]
    fold: _SolvedFold

    def along(self, expression: SX, variables: SX, direction: SX) -> SX:
        """Return the derivative of an expression as `variables` move in a direction.

        The unknowns of nonlinear blocks follow (implicit function theorem).
        """
        total = ca.jtimes(expression, variables, direction)
        if not self.loop_sizes:
            return total
        moved = ca.jtimes(self.loop_residual, variables, direction)
        change, begin = ca.SX(0, 1), 0
        for size in self.loop_sizes:
            block = slice(begin, begin + size)
            rest = moved[block]
            if begin:
                rest += ca.jtimes(self.loop_residual[block], self.loops[:begin], change)
            matrix = ca.jacobian(self.loop_residual[block], self.loops[block])
            own = -rest / matrix if size == 1 else ca.solve(matrix, -rest)
            change, begin = ca.vertcat(change, own), begin + size
        return total + ca.jtimes(expression, self.loops, change)

    def value(self, name: str) -> SX:
        """Return the expression of any variable, aliases included."""
        alias = self.dae.aliases.get(name)
        if alias is not None:
            return alias.sign * self.value(alias.of)
        constant = self.dae.constant_values.get(name)
        if constant is not None:
            return ca.SX(constant.value)
        return self.fold(Symbol(name))


class _SolvedFold:
    """Folds expressions after the unknowns have been solved for."""

    def __init__(self, fold: CasadiFold, unknowns: Sequence[SX], values: Sequence[SX]) -> None:
        self._fold = fold
        self._unknowns = ca.vertcat(*unknowns)
        self._values = ca.vertcat(*values)

    def __call__(self, expression: Expression) -> SX:
        raw = self._fold(expression)
        return ca.substitute(raw, self._unknowns, self._values)


def explicit(dae: Dae, *, freeze_relations: bool = False) -> ExplicitModel:
    """Solve a flat model for its derivatives and algebraic variables.

    Args:
        dae: The flat model, without aliases.
        freeze_relations: For code with event iteration: keep each event relation as a symbol
            instead of evaluating it in place, and the unknowns of nonlinear blocks as well.

    Raises:
        UnsupportedModelError: The equations are structurally singular (a higher index, or more
            than one solution), or a block is nonlinear in its unknowns and has to be solved.
    """
    dae = reduce_index(dae)
    states = dae.states
    inputs = dae.inputs
    independent = [
        v for v in dae.with_role(Role.PARAMETER) if v.name not in dae.dependent_parameters
    ]
    discrete = dae.with_role(Role.DISCRETE)
    x, u, p, d = (_column(part) for part in (states, inputs, independent, discrete))
    time = ca.SX.sym("time")
    delayed = ca.SX.sym("delayed", len(dae.delays))
    relations = ca.SX.sym("relation", len(dae.relations))
    derivative_of = {v.name: ca.SX.sym(f"der({v.name})") for v in states}
    algebraic = {v.name: ca.SX.sym(v.name) for v in dae.with_role(Role.ALGEBRAIC)}
    previous = {name: ca.SX.sym(f"pre({name})") for name in _previous_names(dae)}
    leaves: dict[str, SX] = {
        **{v.name: x[i] for i, v in enumerate(states)},
        **{v.name: u[i] for i, v in enumerate(inputs)},
        **{v.name: p[i] for i, v in enumerate(independent)},
        **{v.name: d[i] for i, v in enumerate(discrete)},
        **algebraic,
    }

    def leaf(node: Expression) -> SX:
        match node:
            case Time():
                return time
            case Symbol(name=name):
                if name in leaves:
                    return leaves[name]
                binding = dae.variables[name].binding
                if name in dae.dependent_parameters and binding is not None:
                    leaves[name] = fold(binding)
                else:
                    leaves[name] = ca.SX(dae.parameter_values[name])
                return leaves[name]
            case Derivative(name=name):
                return derivative_of[name]
            case Previous(name=name):
                return previous[name]
            case Delayed(index=index):
                return delayed[index]
            case _:
                raise AssertionError(node)

    def relation(node: Relation) -> SX:
        return relations[node.index]

    fold = CasadiFold(leaf, relation if freeze_relations else None)
    residuals = [fold(r) for r in dae.residuals]
    unknowns = [*derivative_of.values(), *algebraic.values()]
    blocks: list[Loop] | None = [] if freeze_relations else None
    values = solve_blocks(residuals, unknowns, where=dae.name, loops=blocks)
    in_loops = [j for block in blocks or () for j in block.unknowns]
    n = len(states)
    return ExplicitModel(
        dae=dae,
        time=time,
        x=x,
        u=u,
        p=p,
        delayed=delayed,
        relations=relations,
        discrete=d,
        previous=ca.vertcat(*previous.values()) if previous else ca.SX(0, 1),
        previous_names=tuple(previous),
        derivatives=ca.vertcat(*values[:n]) if n else ca.SX(0, 1),
        algebraics=dict(zip(algebraic, values[n:], strict=True)),
        dependent={name: fold(Symbol(name)) for name in sorted(dae.dependent_parameters)},
        state_names=tuple(v.name for v in states),
        input_names=tuple(v.name for v in inputs),
        parameter_names=tuple(v.name for v in independent),
        discrete_names=tuple(v.name for v in discrete),
        loops=ca.vertcat(*(unknowns[j] for j in in_loops)) if in_loops else ca.SX(0, 1),
        loop_residual=ca.vertcat(*(b.residual for b in blocks or ())) if blocks else ca.SX(0, 1),
        loop_sizes=tuple(len(block.unknowns) for block in blocks or ()),
        loop_names=tuple(str(unknowns[j].name()) for j in in_loops),
        fold=_SolvedFold(fold, unknowns, values),
    )


def _previous_names(dae: Dae) -> tuple[str, ...]:
    nodes = (node for e in dae.expressions() for node in walk(e))
    return tuple(dict.fromkeys(node.name for node in nodes if isinstance(node, Previous)))


def _column(variables: Sequence[Variable]) -> SX:
    if not variables:
        return ca.SX(0, 1)
    return ca.vertcat(*(ca.SX.sym(v.name) for v in variables))
