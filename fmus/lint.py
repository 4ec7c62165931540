"""Mistakes that the front end swallows: found in the user's text and the flat model together.

Only the user's own text is looked at, never that of a library.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

from fmus.dae import Connector, Dae, Role
from fmus.expressions import names
from fmus.modelica_text import (
    class_spans,
    connects,
    extends_clauses,
    find_declaration,
    parenthesis_depth,
    without_comments_and_strings,
)
from fmus.sources import ModelicaSource
from foundation.errors import ModelicaError, UnknownNameError

_REDECLARE_WITH_MODIFIER = re.compile(
    r"\bredeclare\s+(?:model|block|package)\s+\w+\s*=\s*[\w.]+\s*\("
)
_STREAM = re.compile(r"\bstream\s+[A-Za-z]")
_ATTRIBUTES = frozenset(
    ("start", "fixed", "min", "max", "nominal", "unit", "displayUnit", "quantity", "stateSelect")
)
_EFFECT = re.compile(r"\bEffects\.")


def check_text(source: ModelicaSource) -> None:
    """Refuse text whose meaning the front end is known to lose.

    Raises:
        ModelicaError: `extends A(redeclare model B = C(k=4))`: the modifier is lost; connectors
            with `stream` variables.
    """
    text = without_comments_and_strings(source.text)
    stream = _STREAM.search(text)
    if stream is not None:
        raise ModelicaError(
            f"{_place(source, stream.start())}: stream connectors cannot be translated",
            remedy="write the mixing equations out",
        )
    for found in _REDECLARE_WITH_MODIFIER.finditer(text):
        if parenthesis_depth(text, found.start()) > 0:
            raise ModelicaError(
                f"{_place(source, found.start())}: the modifier of this redeclare would be lost",
                remedy="write `redeclare B a(k=4)` for the component, or redeclare in the class "
                "body",
            )


def check_model(source: ModelicaSource, dae: Dae, known: Collection[str]) -> None:
    """Refuse models in which something that the author wrote has no effect.

    Args:
        source: The user's text.
        dae: The flat model with its aliases.
        known: Names of all flat variables, also of those kinds that `dae` does not hold.

    Raises:
        ModelicaError: A modifier of an extends-clause names nothing; a connection joins flanges of
            different kinds; a component with flanges, or an effect in series, is connected to
            nothing.
    """
    text = without_comments_and_strings(source.text)
    chain = _chain(source, text)
    _check_modifiers(source, text, chain, known)
    _check_connections(source, text, chain, dae)
    _check_isolated(source, text, chain, dae)


def _chain(source: ModelicaSource, text: str) -> dict[str, tuple[int, int]]:
    """Return the classes of the text whose contents are the model's own: it, and its bases."""
    spans = {name: (begin, end) for name, begin, end in class_spans(text)}
    bases = extends_clauses(text)
    chain: dict[str, tuple[int, int]] = {}
    pending = [source.class_name]
    while pending:
        name = pending.pop()
        if name in chain or name not in spans:
            continue
        chain[name] = spans[name]
        for clause in bases:
            if clause.inside == name:
                pending += [full for full in spans if _means(clause.base, full)]
    return chain


def _means(written: str, full: str) -> bool:
    """Whether a class name as written may mean a class of the same text."""
    return full == written or full.endswith(f".{written}")


def _place(source: ModelicaSource, offset: int) -> str:
    line = source.text.count("\n", 0, offset) + 1
    column = offset - source.text.rfind("\n", 0, offset)
    return f"{source.file_name}:{line}:{column}"


def _check_modifiers(
    source: ModelicaSource, text: str, chain: Collection[str], known: Collection[str]
) -> None:
    modifiers = [(c, m) for c in extends_clauses(text) if c.inside in chain for m in c.modifiers]
    if not modifiers:
        return
    # Everything that has a name: variables, and the components around them.
    named = {name[:end] for name in known for end in _ends(name)}
    for clause, modifier in modifiers:
        owner, _, last = modifier.name.rpartition(".")
        is_attribute = owner in known and last in _ATTRIBUTES
        if modifier.name in named or is_attribute or _is_class_of(text, last):
            continue
        if owner and owner not in named:
            continue  # reported for its owner
        beside = {n.removeprefix(f"{owner}.") for n in named if n.rpartition(".")[0] == owner}
        raise ModelicaError(
            f"{_place(source, modifier.offset)}: {clause.base} has nothing called "
            f"'{modifier.name}', so this modifier would be lost",
            remedy=UnknownNameError("name", last, sorted(beside or _ATTRIBUTES)).remedy,
        )


def _ends(name: str) -> Iterable[int]:
    return (*(i for i, letter in enumerate(name) if letter == "."), len(name))


def _is_class_of(text: str, name: str) -> bool:
    """A modifier may also be for a replaceable class or a type of the same text."""
    return (
        re.search(rf"\b(?:model|block|package|type|class)\s+{re.escape(name)}\b", text) is not None
    )


def _check_connections(source: ModelicaSource, text: str, chain: Collection[str], dae: Dae) -> None:
    by_path = {connector.path: connector for connector in dae.connectors}
    for equation in connects(text):
        if equation.inside not in chain:
            continue
        a, b = (by_path.get(end) for end in equation.ends)
        if a is not None and b is not None and _members(a) != _members(b):
            raise ModelicaError(
                f"{_place(source, equation.offset)}: '{equation.ends[0]}' and '{equation.ends[1]}' "
                "are connectors of different kinds, so this connection would be lost",
                remedy=f"connect '{equation.ends[0]}' to {_alternatives(a, dae.connectors)}",
            )
        if (a is None) != (b is None):
            flange, other = (0, 1) if a is not None else (1, 0)
            raise ModelicaError(
                f"{_place(source, equation.offset)}: '{equation.ends[flange]}' is a flange and "
                f"'{equation.ends[other]}' is not, so this connection would be lost",
                remedy="connect flanges to flanges and signals to signals",
            )


def _members(connector: Connector) -> tuple[str, str]:
    return (
        connector.potential.removeprefix(f"{connector.path}."),
        connector.flow.removeprefix(f"{connector.path}."),
    )


def _alternatives(connector: Connector, there: Iterable[Connector]) -> str:
    component = connector.path.partition(".")[0]
    alike = [
        f"'{c.path}'"
        for c in there
        if _members(c) == _members(connector) and c.path.partition(".")[0] != component
    ]
    return " or ".join(alike[:3]) or "a flange of its own kind"


def _check_isolated(
    source: ModelicaSource, text: str, chain: dict[str, tuple[int, int]], dae: Dae
) -> None:
    states = {v.name.partition(".")[0] for v in dae.with_role(Role.STATE)}
    neighbours = _neighbours(dae)
    for component in dict.fromkeys(c.path.partition(".")[0] for c in dae.connectors):
        flanges = [c for c in dae.connectors if c.path.startswith(f"{component}.")]
        if any(c.connected for c in flanges) or neighbours.get(component):
            continue
        if not flanges or states <= {component}:
            continue
        declared = _declared(text, component, chain)
        if declared is not None:
            raise ModelicaError(
                f"{_place(source, declared.start('name'))}: nothing is connected to "
                f"'{flanges[0].path}', so '{component}' does nothing",
                remedy=f"write connect({flanges[0].path}, …) to a flange of the model",
            )
    for component in {v.name.partition(".")[0] for v in dae.variables.values() if "." in v.name}:
        declared = _declared(text, component, chain)
        if declared is None or not _EFFECT.search(declared["type"]):
            continue
        if f"{component}.y" in dae.variables and not neighbours.get(component, set()) - {"u"}:
            raise ModelicaError(
                f"{_place(source, declared.start('name'))}: nothing is connected to "
                f"'{component}.y', so '{component}' does nothing",
                remedy=f"write connect({component}.y, …) to what the effect shall act on",
            )


def _neighbours(dae: Dae) -> dict[str, set[str]]:
    """Component → its own variables that equations share with the rest of the model."""
    shared: dict[str, set[str]] = {}
    parameters = {v.name for v in dae.parameters}
    for residual in (*dae.residuals, *(w.residual for w in dae.when_equations)):
        used = names(residual) - parameters
        components = {name.partition(".")[0] if "." in name else "" for name in used}
        if len(components) > 1:
            for name in used:
                component, dot, rest = name.partition(".")
                if dot:
                    shared.setdefault(component, set()).add(rest)
    return shared


def _declared(text: str, component: str, chain: dict[str, tuple[int, int]]) -> re.Match[str] | None:
    found = (find_declaration(text, component, span) for span in chain.values())
    return next((match for match in found if match), None)
