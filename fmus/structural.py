"""Parameters that the front end has put in: they decided which equations there are."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import replace

from fmus.dae import Dae, Role, ScalarType
from fmus.expressions import names

_ELEMENT = re.compile(r"\[[\d,]+\]\Z")


def without_structural(dae: Dae, structural: Collection[str]) -> Dae:
    """Return the model with everything that decides on its structure fixed.

    Setting `kind` in `parameter Boolean has_spring = kind == Kind.Spring; Spring s if has_spring`
    could have no effect, so it must not be offered.

    Args:
        dae: As read; a parameter is tunable unless it is structural itself or declared final.
        structural: Parameters that the front end calls so, arrays as a whole. In addition, Boolean
            and Integer parameters that are not tunable and that no equation asks for are taken for
            such.
    """
    live = {name for expression in dae.expressions() for name in names(expression)}
    decisive = [
        v.name
        for v in dae.with_role(Role.PARAMETER)
        if _ELEMENT.sub("", v.name) in structural
        or (v.type is not ScalarType.REAL and not v.tunable and v.name not in live)
    ]
    variables = dict(dae.variables)
    for name in _above(dae, decisive):
        if variables[name].role is Role.PARAMETER:
            variables[name] = replace(variables[name], tunable=False)
    return replace(dae, variables=variables)


def _above(dae: Dae, parameters: Collection[str]) -> Iterator[str]:
    """Yield parameters and all those that their values are computed from."""
    pending, seen = list(parameters), set[str]()
    while pending:
        name = pending.pop()
        if name in seen or name not in dae.variables:
            continue
        seen.add(name)
        yield name
        binding = dae.variables[name].binding
        pending += names(binding) if binding is not None else ()
