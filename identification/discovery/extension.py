"""A model with effects added, written as a Modelica author would write it.

Effects on flanges: a class that `extends` the model, one component, one `connect` each. Effects in
series with an input or output: a class that contains the model as `plant` and stands in its place:
the same parameters, inputs and outputs under the same names. With both, the class extended is
nested as `Plant`, so that no connection reaches two levels down.
"""

from __future__ import annotations

import difflib
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from fmus.dae import Dae, ScalarType, Variable
from fmus.expressions import Literal
from fmus.frontend import load
from fmus.in_series import model_of
from fmus.places import Place, places
from fmus.sources import ModelicaSource
from foundation.errors import InputError, UnknownNameError
from identification.discovery.effects import Effect, find_effects, resolve
from identification.priors import NO_PRIORS, Prior

_WIDTH = 92
_SHORT = 40
_WRAPPED = "plant."
# The first of these that nothing in sight is called names the class nested in a wrapper.
_NESTED = ("Plant", "Machine", "InnerModel")


@dataclass(frozen=True)
class Addition:
    """An effect at a place.

    Attributes:
        effect: What.
        place: Where.
        values: Its parameters, where they differ from the defaults.
        starts: Values of what gives its initial state, for an effect with a memory.
        number: Which one it is of its kind here, counting those that the model had before.
        priors: What is known, by the user's names of parameters, where a record need not tell what
            is new from what was there before.
    """

    effect: Effect
    place: Place
    values: Mapping[str, float] = field(default_factory=dict[str, float])
    starts: Mapping[str, float] = field(default_factory=dict[str, float])
    number: int = 1
    priors: Mapping[str, Prior] = field(default_factory=lambda: NO_PRIORS)

    @property
    def instance(self) -> str:
        """Name of the component in the written class."""
        effect = self.effect.name
        number = "" if self.number == 1 else f"_{self.number}"
        return f"{effect[0].lower()}{effect[1:]}_{self.place.name.replace('.', '_')}{number}"

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
        return model_of(self.source)

    @cached_property
    def wrapped(self) -> bool:
        """The user's model is a component of this one, not its base class."""
        return _wrapped(self.additions)

    @property
    def priors(self) -> Mapping[str, Prior]:
        """What the additions know of parameters beforehand, by flat names."""
        return {
            self.flat_name(name): prior
            for addition in self.additions
            for name, prior in addition.priors.items()
        }

    def user_name(self, name: str) -> str:
        """Return a variable's name as the user knows it, whatever wrapper was built around it."""
        return name.removeprefix(_WRAPPED) if self.wrapped else name

    def flat_name(self, name: str) -> str:
        """Return the name here of a variable that the user's model or an addition has."""
        if not self.wrapped:
            return name
        for addition in self.additions:
            if name.startswith(f"{addition.instance}."):
                return self.parameter_of(addition, name.removeprefix(f"{addition.instance}."))
        # What the wrapper does not declare anew is reached through its component.
        return name if name in self.dae.variables else f"{_WRAPPED}{name}"

    def parameter_of(self, addition: Addition, parameter: str) -> str:
        """Return the flat name of an added effect's parameter."""
        inside = self.wrapped and addition.effect.kind != "signal"
        prefix = _WRAPPED if inside and addition.place.inherited_connect else ""
        return f"{prefix}{addition.instance}.{parameter}"


def addition_at(source: ModelicaSource, effect: Effect, place: Place) -> Addition:
    """Return an effect at a place of a model, told apart from one that the model already has."""
    dae = load(source)
    names = [n for n in (*dae.variables, *dae.aliases, *dae.constant_values) if "." in n]
    components = {name.partition(".")[0] for name in names}
    addition = Addition(effect, place)
    while addition.instance in components:
        addition = replace(addition, number=addition.number + 1)
    return addition


def parse_addition(text: str, source: ModelicaSource) -> Addition:
    """Read `EFFECT@PLACE[,P=V]…`.

    Raises:
        UnknownNameError: No such place, effect or parameter.
        InputError: No place is named, or a value is not a finite number.
    """
    head, *settings = text.split(",")
    effect_name, at, place_name = head.partition("@")
    if not at:
        raise InputError(
            f"'{head}' names no place", where=f"--add {text}", remedy="write EFFECT@PLACE"
        )
    there = places(source)
    by_name = {name: p for p in there for name in (p.name, *p.also)}
    if place_name not in by_name:
        raise UnknownNameError("place", place_name, by_name, where=f"--add {text}")
    place = by_name[place_name]
    effect = resolve(effect_name, place.kind, find_effects(source))
    inputs = [p.name for p in there if p.kind == "input" and p.name != place.name]
    for name in effect.companions:
        if name not in inputs:
            raise UnknownNameError("input", name, inputs, where=f"--add {text}")
    values: dict[str, float] = {}
    known = [p.name for p in effect.parameters]
    for setting in settings:
        name, _, number = setting.partition("=")
        if name not in known:
            raise UnknownNameError("parameter", name, known, where=effect.class_name)
        try:
            values[name] = float(number)
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise InputError(
                f"'{number}' is no value for {name}",
                where=f"--add {text}",
                remedy=f"write a number, as in {name}=0.4",
            )
    return replace(addition_at(source, effect, place), values=values)


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
        values: New defaults of the user's own parameters, by the names that they have in `base`;
            `<state>.start` for the start of a state.
        name: Class name; by default the model's with the number of additions appended.

    Raises:
        ModelicaError: What was written does not compile (a fault in the user's effect).
    """
    values = dict(values or {})
    name = name or f"{base.short_name}_{len(additions)}"
    if not additions and (not values or base.fmu is not None):
        return ExtendedModel(base, (), values, name if values else base.short_name, base, base.text)
    write = _write_wrapper if _wrapped(additions) else _write_extension
    # An FMU's own values are not written in Modelica: its parameters are not there.
    text = write(base, tuple(additions), values if base.fmu is None else {}, name)
    whole = f"{base.text.rstrip()}\n\n{text}" if base.defines else text
    source = ModelicaSource(whole, name, f"{name}.mo", name, base.roots, fmu=base.fmu)
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


def _wrapped(additions: Sequence[Addition]) -> bool:
    return any(a.effect.kind == "signal" or not a.place.inherited_connect for a in additions)


def _number(value: float) -> str:
    return f"{value:.9g}"


def _modifiers(values: Mapping[str, float]) -> str:
    """Return `(a = 1, b = 2)`, broken into lines as a person would."""
    if not values:
        return ""
    return _in_parentheses(_settings(values))


def _settings(values: Mapping[str, float]) -> list[str]:
    """Return `a = 1`, and `load(J = 2)` for the name `load.J`."""
    direct: list[str] = []
    nested: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        component, dot, rest = name.partition(".")
        if dot:
            nested.setdefault(component, {})[rest] = value
        else:
            direct.append(f"{name} = {_number(value)}")
    inner = [f"{name}({', '.join(_settings(part))})" for name, part in nested.items()]
    return [*direct, *inner]


def _in_parentheses(words: Iterable[str]) -> str:
    lines = textwrap.wrap(", ".join(words), _WIDTH, break_on_hyphens=False)
    # A single short line stays where it is.
    start = "" if len(lines) == 1 and len(lines[0]) < _SHORT else "\n    "
    return "(" + start + "\n    ".join(lines) + ")"


def _component(addition: Addition) -> str:
    modifiers = _modifiers({**addition.values, **addition.starts})
    return (
        f"  {addition.effect.class_name} {addition.instance}{modifiers}\n"
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
        lines += _companions(additions)
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
        if v.tunable
        and v.type is ScalarType.REAL
        and v.name not in dae.dependent_parameters
        and "." not in v.name
    ]
    declared = {v.name for v in parameters}
    deeper = {name: value for name, value in values.items() if name not in declared}
    lines = [f'model {name} "{base.short_name} with {", ".join(a.label for a in additions)}"\n']
    plant_class = base.base_class
    if inside:
        plant_class = _nested_name(base, inside)
        nested = _write_extension(base, inside, {}, plant_class)
        lines += ["  " + line + "\n" for line in nested.rstrip("\n").split("\n")]
    lines += [
        _declare_parameter(v, values.get(v.name, dae.parameter_values[v.name])) for v in parameters
    ]
    handed = [*(f"{v.name} = {v.name}" for v in parameters), *_settings(deeper)]
    same = _in_parentheses(handed) if handed else ""
    lines.append(f"  {plant_class} plant{same};\n")
    lines += [_component(a) for a in (*bare, *series)]
    lines += [_declare_signal("RealInput", v) for v in dae.inputs]
    lines += [_declare_signal("RealOutput", v) for v in dae.outputs]
    lines.append("equation\n")
    lines += [f"  connect({a.instance}.flange, plant.{a.place.connector});\n" for a in bare]
    lines += _companions((*bare, *series))
    for v in dae.inputs:
        blocks = chain(series, v.name)
        stations = [v.name, *(f"{a.instance}" for a in blocks), f"plant.{v.name}"]
        lines += _connect_chain(stations)
    for v in dae.outputs:
        blocks = chain(series, v.name)
        stations = [f"plant.{v.name}", *(f"{a.instance}" for a in blocks), v.name]
        lines += _connect_chain(stations)
    lines.append(f"end {name};\n")
    return "".join(lines)


def _nested_name(base: ModelicaSource, additions: Sequence[Addition]) -> str:
    used = (base.base_class, *(a.effect.class_name for a in additions))
    taken = {name.partition(".")[0] for name in used}
    return next(name for name in _NESTED if name not in taken)


def chain(additions: Sequence[Addition], place: str) -> list[Addition]:
    """Return what is in series with an input or output, in the order in which a signal meets it."""
    here = [a for a in additions if a.place.name == place]

    def turn(addition: Addition) -> int:
        # A delay needs the bare input as operand, and the finished output.
        if addition.effect.delays:
            return 0 if addition.place.kind == "input" else 3
        # A limit leaves a curve behind it nothing of what it cuts off.
        return 1 if addition.effect.empirical else 2

    return sorted(here, key=turn)


def _connect_chain(stations: Sequence[str]) -> list[str]:
    blocks = stations[1:-1]
    ends = [stations[0], *(part for b in blocks for part in (f"{b}.u", f"{b}.y")), stations[-1]]
    # Equations, not connections: a user's plant may declare its signals as plain Reals.
    return [f"  {to} = {frm};\n" for frm, to in zip(ends[::2], ends[1::2], strict=True)]


def _companions(additions: Sequence[Addition]) -> list[str]:
    """Return the equations that give effects the model's inputs that they ask for by name."""
    return [f"  {a.instance}.{name} = {name};\n" for a in additions for name in a.effect.companions]


def _declare_parameter(v: Variable, value: float) -> str:
    attributes = [f'unit = "{v.unit}"'] if v.unit else []
    for word, value_of in (("min", v.minimum), ("max", v.maximum), ("nominal", v.nominal)):
        if isinstance(value_of, Literal):
            attributes.append(f"{word} = {_number(float(value_of.value))}")
    head = f"  parameter Real {v.name}{'(' + ', '.join(attributes) + ')' if attributes else ''}"
    known = " annotation(__twinproof(known = true))" if v.known else ""
    description = f'\n    "{v.description}"' if v.description else ""
    return f"{head} = {_number(value)}{description}{known};\n"


def _declare_signal(kind: str, v: Variable) -> str:
    unit = f'(unit = "{v.unit}")' if v.unit else ""
    description = f' "{v.description}"' if v.description else ""
    return f"  Twinproof.Interfaces.{kind} {v.name}{unit}{description};\n"
