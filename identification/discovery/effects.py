"""The effects there are: Modelica classes that extend one of the library's three effect bases.

Nothing about an effect is written in Python. A class found here, with its parameters, units and
ranges, comes from the Modelica sources alone; a user adds an effect by writing a class.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from fmus.dae import Dae, Variable
from fmus.frontend import load
from fmus.places import Place
from fmus.sources import ModelicaSource
from foundation.errors import UnknownNameError
from modelica import LIBRARY

_KINDS = {
    "RotationalEffect": "rotational",
    "TranslationalEffect": "translational",
    "SignalEffect": "signal",
}
_EMPIRICAL = ("RotationalEmpirical", "TranslationalEmpirical", "SignalEmpirical")
_TOKEN = re.compile(
    r"\b(end)\s+(\w+)\s*;|\b(partial\s+)?(package|model|block)\s+(\w+)\b(?!\s*=)"
    r"|\bextends\s+\.?([\w.]+)|\bRealInput\s+(\w+)"
    r"|\b__twinproof\s*\(\s*(search)\s*=\s*false"
)
_DESCRIPTION = re.compile(r'\s*"((?:[^"\\]|\\.)*)"')
_COMMENT_OR_STRING = re.compile(r'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)

_HOST = {
    "rotational": "Twinproof.Interfaces.RotationalPoint point; Real w; equation "
    "connect(effect.flange, point.flange); der(point.phi) = w; der(w) = point.tau;",
    "translational": "Twinproof.Interfaces.TranslationalPoint point; Real w; equation "
    "connect(effect.flange, point.flange); der(point.s) = w; der(w) = point.f;",
    # Naming the library makes the front end read it, which a user's package may need.
    "signal": "Twinproof.Interfaces.RealInput u; Twinproof.Interfaces.RealOutput y; equation "
    "effect.u = u; y = effect.y;",
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
        states: Number of states of its own.
        jumps: It changes discrete variables or states at events.
        unit: Of the signals that it is for; empty for any, and for effects on flanges.
        empirical: A curve drawn from data, which has no name in physics and is not searched for.
        companions: Further inputs: each gets the model's input of the same name.
        searched: False with `annotation(__twinproof(search = false))`: only added by name.
    """

    class_name: str
    kind: str
    description: str
    parameters: tuple[Variable, ...]
    defaults: tuple[float, ...]
    delays: bool = False
    states: int = 0
    jumps: bool = False
    unit: str = ""
    empirical: bool = False
    companions: tuple[str, ...] = ()
    searched: bool = True

    @property
    def name(self) -> str:
        """The class's own name, as users write it."""
        return self.class_name.rpartition(".")[2]

    @property
    def has_memory(self) -> bool:
        """Its output depends on more than the present input."""
        return self.delays or self.states > 0

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


def unit_at(parameter: Variable, place: Place) -> str:
    """Return the unit of an effect's parameter where the effect is.

    One that declares no unit has that of the signal it stands in, or what it says of that.

    Example:
        >>> from fmus.dae import Role
        >>> limit = Variable("inverse_limit", Role.PARAMETER, unit_in_series="1/signal")
        >>> [unit_at(limit, Place("u", "input", unit)) for unit in ("V", "rad/s")]
        ['1/V', '1/(rad/s)']
    """
    if parameter.unit or not parameter.unit_in_series:
        return parameter.unit or place.unit
    unit = place.unit
    if not parameter.unit_in_series.startswith("signal") and re.search(r"[./]", unit):
        unit = f"({unit})"
    return parameter.unit_in_series.replace("signal", unit)


def find_effects(source: ModelicaSource | None = None) -> tuple[Effect, ...]:
    """Return all effects of the bundled library, of `source`'s libraries and of its own text.

    A user's effect hides the library's of the same name and kind.

    Raises:
        ModelicaError: An effect's class does not compile; the message names file:line:column.

    Example:
        >>> [e.kind for e in find_effects() if e.name == "DeadZone"]
        ['signal']
    """
    roots = source.roots if source is not None else ()
    text = source.text if source is not None and source.defines else ""
    bundled = _classes_of_library(LIBRARY)
    others = [c for root in roots for c in _classes_of_library(root)]
    beside = list(_classes_in(text, ""))
    every = (*bundled, *others, *beside)
    found: dict[tuple[str, str], Effect] = {}
    for classes, where, defined_in in (
        (bundled, (), ""),
        (others, roots, ""),
        (beside, roots, text),
    ):
        for one in classes:
            base = None if one.partial else _base_of(one, every, _KINDS)
            if base is not None:
                kind = _KINDS[base]
                effect = replace(
                    _read(
                        one.name,
                        one.description,
                        kind,
                        where,
                        defined_in,
                        tuple(one.inputs),
                        one.written,
                    ),
                    searched=one.searched,
                    empirical=_base_of(one, every, _EMPIRICAL) is not None,
                )
                found[kind, effect.name] = effect
    return tuple(found.values())


def kind_at(place_kind: str) -> str:
    """Return the kind of effects that act at a kind of place.

    Example:
        >>> kind_at("input"), kind_at("rotational")
        ('signal', 'rotational')
    """
    return "signal" if place_kind in ("input", "output") else place_kind


def resolve(name: str, kind: str, effects: tuple[Effect, ...]) -> Effect:
    """Return the effect that a user's word means at a place of a given kind.

    Args:
        name: Bare (`CoulombFriction`) or full name.
        kind: `rotational`, `translational`, `input` or `output`.
        effects: Those there are.

    Raises:
        UnknownNameError: No such effect acts at this kind of place.
    """
    wanted = kind_at(kind)
    fitting = [e for e in effects if e.kind == wanted]
    for effect in fitting:
        if name in (effect.class_name, effect.name):
            return effect
    raise UnknownNameError(f"{wanted} effect", name, [e.name for e in fitting])


@dataclass
class _Class:
    """A class in a Modelica text: its full name, its one line, what it extends, its inputs.

    `searched` is False with `annotation(__twinproof(search = false))`; `written` is the file of a
    library that has it.
    """

    name: str
    description: str
    partial: bool
    bases: list[str]
    inputs: list[str]
    searched: bool = True
    written: ModelicaSource | None = None


def _classes_of_library(root: Path) -> tuple[_Class, ...]:
    found: list[_Class] = []
    for path in sorted(root.rglob("*.mo")):
        text = path.read_text(encoding="utf-8")
        within = re.search(r"\bwithin\s+([\w.]+)\s*;", text)
        prefix = within[1] + "." if within else ""
        for one in _classes_in(text, prefix):
            own = one.name.removeprefix(prefix)
            one.written = ModelicaSource(text, own, str(path), one.name)
            found.append(one)
    return tuple(found)


def _classes_in(text: str, prefix: str) -> Iterator[_Class]:
    plain = _COMMENT_OR_STRING.sub(lambda m: " " * len(m[0]), text)
    scopes: list[_Class] = []
    for token in _TOKEN.finditer(plain):
        end, ended, partial, _, begun, base, signal, unsearched = token.groups()
        if end:
            if scopes and scopes[-1].name.rpartition(".")[2] == ended:
                yield scopes.pop()
        elif begun:
            outer = f"{scopes[-1].name}." if scopes else prefix
            words = _DESCRIPTION.match(text, token.end())
            scopes.append(_Class(outer + begun, words[1] if words else "", bool(partial), [], []))
        elif base and scopes:
            scopes[-1].bases.append(base)
        elif signal and scopes:
            scopes[-1].inputs.append(signal)
        elif unsearched and scopes:
            scopes[-1].searched = False


def _base_of(one: _Class, classes: Sequence[_Class], wanted: Collection[str]) -> str | None:
    """Return which of the wanted base classes a class extends in the end."""
    others = [c for c in classes if c is not one]
    for base in one.bases:
        short = base.rpartition(".")[2]
        if short in wanted:
            return short
        for other in others:
            if f".{other.name}".endswith(f".{base}"):
                found = _base_of(other, others, wanted)
                if found is not None:
                    return found
    return None


@lru_cache(maxsize=512)
def _read(
    class_name: str,
    description: str,
    kind: str,
    roots: tuple[Path, ...],
    text: str,
    companions: tuple[str, ...],
    written: ModelicaSource | None,
) -> Effect:
    further = "".join(f"Twinproof.Interfaces.RealInput given_{name}; " for name in companions)
    given = "".join(f" effect.{name} = given_{name};" for name in companions)
    host = (
        f"model EffectHost\n  {class_name} effect;\n  {further}{_HOST[kind]}{given}\n"
        "end EffectHost;\n"
    )
    source = ModelicaSource(
        f"{text}\n{host}", "EffectHost", f"{class_name}.mo", class_name, roots, file=written
    )
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
        description,
        tuple(_unprefixed(v) for v in parameters),
        tuple(dae.parameter_values[v.name] for v in parameters),
        bool(dae.delays),
        len(dae.states) - (0 if kind == "signal" else 2),
        bool(dae.when_equations or dae.reinits),
        _unit(dae),
        companions=companions,
    )


def _unit(dae: Dae) -> str:
    signal = dae.aliases.get("effect.u")
    return signal.declared.unit if signal is not None else ""


def _unprefixed(variable: Variable) -> Variable:
    return replace(variable, name=variable.name.removeprefix("effect."))
