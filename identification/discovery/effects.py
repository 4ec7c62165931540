"""The effects there are: Modelica classes that extend one of the library's three effect bases.

Nothing about an effect is written in Python. A class found here, with its parameters, units and
ranges, comes from the Modelica sources alone; a user adds an effect by writing a class.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from fmus.dae import Variable
from fmus.frontend import load
from fmus.sources import ModelicaSource
from foundation.errors import UnknownNameError
from modelica import LIBRARY

_KINDS = {
    "RotationalEffect": "rotational",
    "TranslationalEffect": "translational",
    "SignalEffect": "signal",
}
_EXTENDS = re.compile(r"\bextends\s+(?:[\w.]+\.)?(\w+Effect)\b")
_CLASS = re.compile(r"\b(?:model|block)\s+(\w+)\b(?!\s*=)")
_COMMENT_OR_STRING = re.compile(r'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)

_HOST = {
    "rotational": "Twinproof.Interfaces.RotationalPoint point; Real w; equation "
    "connect(effect.flange, point.flange); der(point.phi) = w; der(w) = point.tau;",
    "translational": "Twinproof.Interfaces.TranslationalPoint point; Real w; equation "
    "connect(effect.flange, point.flange); der(point.s) = w; der(w) = point.f;",
    "signal": "input Real u; output Real y; equation effect.u = u; y = effect.y;",
}


@dataclass(frozen=True)
class Effect:
    """One effect class.

    Attributes:
        class_name: Full Modelica name.
        kind: `rotational`, `translational` or `signal`.
        description: The class's one line.
        parameters: Its tunable parameters.
        defaults: Their values, at which the effect is absent.
        delays: It has a memory of its input (`delay`).
    """

    class_name: str
    kind: str
    description: str
    parameters: tuple[Variable, ...]
    defaults: tuple[float, ...]
    delays: bool = False

    @property
    def name(self) -> str:
        """The class's own name, as users write it."""
        return self.class_name.rpartition(".")[2]

    @property
    def main_parameters(self) -> tuple[str, ...]:
        """Parameters at whose default, zero, the effect is absent."""
        return tuple(
            p.name
            for p, value in zip(self.parameters, self.defaults, strict=True)
            if value == 0.0 and not p.known
        )

    @property
    def shape_parameters(self) -> tuple[str, ...]:
        """Fitted parameters that give the effect its shape but cannot make it absent."""
        return tuple(
            p.name
            for p, value in zip(self.parameters, self.defaults, strict=True)
            if value != 0.0 and not p.known
        )


def find_effects(source: ModelicaSource | None = None) -> tuple[Effect, ...]:
    """Return all effects of the bundled library, of `source`'s libraries and of its own text.

    Raises:
        ModelicaError: An effect's class does not compile; the message names file:line:column.

    Example:
        >>> [e.kind for e in find_effects() if e.name == "DeadZone"]
        ['signal']
    """
    roots = source.roots if source is not None else ()
    found = {
        **_in_library(LIBRARY, ()),
        **{name: e for root in roots for name, e in _in_library(root, roots).items()},
    }
    if source is not None and source.defines:
        for name, kind in _in_text(source.text, ""):
            found[name] = _read(name, kind, roots, source.text)
    return tuple(found.values())


def resolve(name: str, kind: str, effects: tuple[Effect, ...]) -> Effect:
    """Return the effect that a user's word means at a place of a given kind.

    Args:
        name: Bare (`CoulombFriction`) or full name.
        kind: `rotational`, `translational`, `input` or `output`.
        effects: Those there are.

    Raises:
        UnknownNameError: No such effect acts at this kind of place.
    """
    wanted = "signal" if kind in ("input", "output") else kind
    fitting = [e for e in effects if e.kind == wanted]
    for effect in fitting:
        if name in (effect.class_name, effect.name):
            return effect
    raise UnknownNameError(f"{wanted} effect", name, [e.name for e in fitting])


@lru_cache(maxsize=32)
def _in_library(root: Path, roots: tuple[Path, ...]) -> dict[str, Effect]:
    found: dict[str, Effect] = {}
    for path in sorted(root.rglob("*.mo")):
        text = path.read_text(encoding="utf-8")
        within = re.search(r"\bwithin\s+([\w.]+)\s*;", text)
        for name, kind in _in_text(text, within[1] + "." if within else ""):
            found[name] = _read(name, kind, roots, "")
    return found


def _in_text(text: str, prefix: str) -> Iterator[tuple[str, str]]:
    """Yield (full class name, kind) of every class in a text that extends an effect base."""
    plain = _COMMENT_OR_STRING.sub(lambda m: " " * len(m[0]), text)
    scopes: list[str] = []
    pattern = re.compile(
        r"\b(end)\s+(\w+)\s*;|\b(?:partial\s+)?(package|model|block)\s+(\w+)\b(?!\s*=)"
        r"|\bextends\s+(?:[\w.]+\.)?(\w+)"
    )
    for token in pattern.finditer(plain):
        if token[1]:
            if scopes and scopes[-1] == token[2]:
                scopes.pop()
        elif token[3]:
            scopes.append(token[4])
        elif token[5] in _KINDS and scopes:
            yield prefix + ".".join(scopes), _KINDS[token[5]]


@lru_cache(maxsize=512)
def _read(class_name: str, kind: str, roots: tuple[Path, ...], text: str) -> Effect:
    host = f"model EffectHost\n  {class_name} effect;\n  {_HOST[kind]}\nend EffectHost;\n"
    source = ModelicaSource(text + host, "EffectHost", f"{class_name}.mo", class_name, roots)
    dae = load(source)
    parameters = tuple(
        v
        for v in dae.parameters
        if v.name.startswith("effect.")
        and v.tunable
        and v.name not in dae.dependent_parameters
        # A filter's start is an initial state, estimated as such.
        and v.name not in dae.start_parameters
    )
    return Effect(
        class_name,
        kind,
        _description(class_name, text, roots),
        tuple(_unprefixed(v) for v in parameters),
        tuple(dae.parameter_values[v.name] for v in parameters),
        bool(dae.delays),
    )


def _unprefixed(variable: Variable) -> Variable:
    return replace(variable, name=variable.name.removeprefix("effect."))


def _description(class_name: str, text: str, roots: tuple[Path, ...]) -> str:
    short = class_name.rpartition(".")[2]
    pattern = re.compile(rf'\b(?:model|block)\s+{short}\s+"((?:[^"\\]|\\.)*)"')
    texts = (
        [text]
        if text
        else [
            path.read_text(encoding="utf-8")
            for root in (LIBRARY, *roots)
            for path in root.rglob(f"{short}.mo")
            if class_name.endswith(".".join([*path.relative_to(root).parts[:-1], short]))
        ]
    )
    for candidate in texts:
        found = pattern.search(candidate)
        if found:
            return found[1]
    return ""
