"""A model with effects added, written as a Modelica author would write it.

Effects on flanges: a class that `extends` the model, one component, one `connect` each. Effects in
series with an input or output: a class that contains the model as `plant` and stands in its place:
the same parameters, inputs and outputs under the same names. With both, the class extended is
nested as `Plant`, so that no connection reaches two levels down.
"""

from __future__ import annotations

import difflib
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from fmus.dae import Dae, Variable
from fmus.expressions import Literal
from fmus.frontend import load
from fmus.places import Place, places
from fmus.sources import ModelicaSource
from foundation.errors import UnknownNameError
from identification.discovery.effects import Effect, find_effects, resolve

_WIDTH = 92
_SHORT = 40
# A delay needs its bare input as operand; the other effects follow in the order they were added.
_FIRST_IN_CHAIN = ("Delay",)


@dataclass(frozen=True)
class Addition:
    """An effect at a place.

    Attributes:
        effect: What.
        place: Where.
        values: Its parameters, where they differ from the defaults.
    """

    effect: Effect
    place: Place
    values: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def instance(self) -> str:
        """Name of the component in the written class."""
        effect = self.effect.name
        return f"{effect[0].lower()}{effect[1:]}_{self.place.name.replace('.', '_')}"

    @property
    def label(self) -> str:
        """`EFFECT@PLACE`, as on the command line."""
        return f"{self.effect.name}@{self.place.name}"


@dataclass(frozen=True)
class ExtendedModel:
    """A model and what has been added to it.

    Attributes:
        base: Source of the user's own model.
        additions: In the order added.
        values: Values of the user's own parameters, where they differ from the declared ones.
        name: Class name of the extended model.
        source: Its Modelica source; the base's where nothing was added or changed.
    """

    base: ModelicaSource
    additions: tuple[Addition, ...]
    values: Mapping[str, float]
    name: str
    source: ModelicaSource
    class_text: str

    @property
    def dae(self) -> Dae:
        """The flat model."""
        return load(self.source)

    def user_name(self, name: str) -> str:
        """Return a variable's name as the user knows it, whatever wrapper was built around it."""
        return name.removeprefix("plant.")

    def parameter_of(self, addition: Addition, parameter: str) -> str:
        """Return the flat name of an added effect's parameter."""
        nested = _wrapped(self.additions, self.base) and addition.effect.kind != "signal"
        inside = nested and addition.place.inherited_connect
        return f"{'plant.' if inside else ''}{addition.instance}.{parameter}"


def parse_addition(text: str, source: ModelicaSource) -> Addition:
    """Read `EFFECT@PLACE[,P=V]…`.

    Raises:
        UnknownNameError: No such place, effect or parameter.
    """
    head, *settings = text.split(",")
    effect_name, _, place_name = head.partition("@")
    there = places(source)
    by_name = {name: p for p in there for name in (p.name, *p.also)}
    if place_name not in by_name:
        raise UnknownNameError("place", place_name, by_name, where=f"--add {text}")
    place = by_name[place_name]
    effect = resolve(effect_name, place.kind, find_effects(source))
    values: dict[str, float] = {}
    known = [p.name for p in effect.parameters]
    for setting in settings:
        name, _, number = setting.partition("=")
        if name not in known:
            raise UnknownNameError("parameter", name, known, where=effect.class_name)
        try:
            values[name] = float(number)
        except ValueError:
            raise UnknownNameError(
                "number", number, ["write it as 0.4"], where=f"--add {text}"
            ) from None
    return Addition(effect, place, values)


def extend(
    base: ModelicaSource,
    additions: Sequence[Addition],
    *,
    values: Mapping[str, float] | None = None,
    name: str | None = None,
) -> ExtendedModel:
    """Write the class that has the additions.

    Args:
        base: The user's model.
        additions: Effects with their places and values.
        values: New defaults of the user's own parameters (and starts).
        name: Class name; by default the model's with the number of additions appended.

    Raises:
        ModelicaError: What was written does not compile (a fault in the user's effect).
    """
    values = dict(values or {})
    name = name or f"{base.short_name}_{len(additions)}"
    if not additions and not values:
        return ExtendedModel(base, (), {}, base.short_name, base, base.text)
    write = _write_wrapper if _wrapped(additions, base) else _write_extension
    text = write(base, tuple(additions), values, name)
    whole = f"{base.text.rstrip()}\n\n{text}" if base.defines else text
    source = ModelicaSource(whole, name, f"{name}.mo", name, base.roots)
    return ExtendedModel(base, tuple(additions), values, name, source, text)


def text_diff(before: ExtendedModel | ModelicaSource, after: ExtendedModel) -> str:
    """Return the unified diff between two models' Modelica texts."""
    old = before.text if isinstance(before, ModelicaSource) else before.source.text
    old_name = before.file_name if isinstance(before, ModelicaSource) else f"{before.name}.mo"
    return "".join(
        difflib.unified_diff(
            old.splitlines(keepends=True),
            after.source.text.splitlines(keepends=True),
            old_name,
            f"{after.name}.mo",
        )
    )


def _wrapped(additions: Sequence[Addition], base: ModelicaSource) -> bool:
    del base
    return any(a.effect.kind == "signal" or not a.place.inherited_connect for a in additions)


def _number(value: float) -> str:
    return f"{value:.9g}"


def _modifiers(values: Mapping[str, float]) -> str:
    """Return `(a = 1, b = 2)`, broken into lines as a person would."""
    if not values:
        return ""
    return _in_parentheses(f"{name} = {_number(value)}" for name, value in values.items())


def _in_parentheses(words: Iterable[str]) -> str:
    lines = textwrap.wrap(", ".join(words), _WIDTH, break_on_hyphens=False)
    # A single short line stays where it is.
    start = "" if len(lines) == 1 and len(lines[0]) < _SHORT else "\n    "
    return "(" + start + "\n    ".join(lines) + ")"


def _component(addition: Addition) -> str:
    return (
        f"  {addition.effect.class_name} {addition.instance}{_modifiers(addition.values)}\n"
        f'    "{addition.effect.description}";\n'
    )


def _write_extension(
    base: ModelicaSource, additions: tuple[Addition, ...], values: Mapping[str, float], name: str
) -> str:
    what = ", ".join(a.label for a in additions)
    title = f'"{base.short_name} with {what}"' if additions else f'"{base.short_name}, fitted"'
    lines = [
        f"model {name} {title}\n",
        f"  extends {base.base_class}{_modifiers(values)};\n",
    ]
    lines += [_component(a) for a in additions]
    if additions:
        lines.append("equation\n")
        lines += [f"  connect({a.instance}.flange, {a.place.connector});\n" for a in additions]
    lines.append(f"end {name};\n")
    return "".join(lines)


def _write_wrapper(
    base: ModelicaSource, additions: tuple[Addition, ...], values: Mapping[str, float], name: str
) -> str:
    dae = load(base)
    inside = tuple(a for a in additions if a.effect.kind != "signal" and a.place.inherited_connect)
    bare = tuple(
        a for a in additions if a.effect.kind != "signal" and not a.place.inherited_connect
    )
    series = tuple(a for a in additions if a.effect.kind == "signal")
    parameters = [
        v
        for v in dae.parameters
        if v.tunable and v.name not in dae.dependent_parameters and "." not in v.name
    ]
    lines = [f'model {name} "{base.short_name} with {", ".join(a.label for a in additions)}"\n']
    plant_class = base.base_class
    if inside:
        plant_class = "Plant"
        nested = _write_extension(base, inside, {}, "Plant")
        lines += ["  " + line + "\n" for line in nested.rstrip("\n").split("\n")]
    lines += [
        _declare_parameter(v, values.get(v.name, dae.parameter_values[v.name])) for v in parameters
    ]
    same = _in_parentheses(f"{v.name} = {v.name}" for v in parameters) if parameters else ""
    lines.append(f"  {plant_class} plant{same};\n")
    lines += [_component(a) for a in (*bare, *series)]
    lines += [_declare_signal("RealInput", v) for v in dae.inputs]
    lines += [_declare_signal("RealOutput", v) for v in dae.outputs]
    lines.append("equation\n")
    lines += [f"  connect({a.instance}.flange, plant.{a.place.connector});\n" for a in bare]
    for v in dae.inputs:
        chain = _chain(series, v.name)
        stations = [v.name, *(f"{a.instance}" for a in chain), f"plant.{v.name}"]
        lines += _connect_chain(stations)
    for v in dae.outputs:
        chain = _chain(series, v.name)
        stations = [f"plant.{v.name}", *(f"{a.instance}" for a in chain), v.name]
        lines += _connect_chain(stations)
    lines.append(f"end {name};\n")
    return "".join(lines)


def _chain(series: tuple[Addition, ...], place: str) -> list[Addition]:
    here = [a for a in series if a.place.name == place]
    return sorted(here, key=lambda a: a.effect.name not in _FIRST_IN_CHAIN)


def _connect_chain(stations: Sequence[str]) -> list[str]:
    blocks = stations[1:-1]
    ends = [stations[0], *(part for b in blocks for part in (f"{b}.u", f"{b}.y")), stations[-1]]
    # Equations, not connections: a user's plant may declare its signals as plain Reals.
    return [f"  {to} = {frm};\n" for frm, to in zip(ends[::2], ends[1::2], strict=True)]


def _declare_parameter(v: Variable, value: float) -> str:
    attributes = [f'unit = "{v.unit}"'] if v.unit else []
    for word, bound in (("min", v.minimum), ("max", v.maximum)):
        if isinstance(bound, Literal):
            attributes.append(f"{word} = {_number(float(bound.value))}")
    head = f"  parameter Real {v.name}{'(' + ', '.join(attributes) + ')' if attributes else ''}"
    known = " annotation(__twinproof(known = true))" if v.known else ""
    description = f'\n    "{v.description}"' if v.description else ""
    return f"{head} = {_number(value)}{description}{known};\n"


def _declare_signal(kind: str, v: Variable) -> str:
    unit = f'(unit = "{v.unit}")' if v.unit else ""
    description = f' "{v.description}"' if v.description else ""
    return f"  Twinproof.Interfaces.{kind} {v.name}{unit}{description};\n"
