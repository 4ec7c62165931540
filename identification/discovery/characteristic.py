"""An effect's own curve: what its Modelica class gives over the one variable that it depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from fmus.casadi_expressions import SX
from fmus.explicit import explicit
from fmus.frontend import load
from fmus.sources import ModelicaSource
from foundation.errors import UnsupportedModelError
from identification.discovery.effects import Effect
from identification.problem import Vector

_POINTS = 401

_HOST = """{text}
model CharacteristicHost
  {effect} effect;
  {declarations}
equation
  {equations}
end CharacteristicHost;
"""


@dataclass(frozen=True)
class Quantity:
    """A variable of an effect: its name in the class, in words, and its unit."""

    name: str
    words: str
    unit: str


_ROTATION = (Quantity("phi", "angle", "rad"), Quantity("w", "angular velocity", "rad/s"))
_TRANSLATION = (Quantity("s", "position", "m"), Quantity("v", "velocity", "m/s"))
# A signal's unit is that of its place.
_SIGNAL = (Quantity("u", "signal", ""),)

VARIABLES = {"rotational": _ROTATION, "translational": _TRANSLATION, "signal": _SIGNAL}
"""Kind of effect → what its force may depend on; the last is the usual one."""

FLOWS = {
    "rotational": Quantity("tau", "torque", "N.m"),
    "translational": Quantity("f", "force", "N"),
}
"""Kind of effect → what it exchanges with the machine."""


@dataclass(frozen=True)
class Characteristic:
    """An effect's curve.

    Attributes:
        variable: What it is drawn against.
        constant: It depends on no variable at all.
        x: (m,) the variable.
        y: (m,) torque or force that the machine spends on the effect; for a signal what the effect
            adds to it, y - u.
    """

    variable: Quantity
    constant: bool
    x: Vector
    y: Vector


def characteristic(
    effect: Effect,
    values: Mapping[str, float],
    low: float,
    high: float,
    *,
    base: ModelicaSource | None = None,
) -> Characteristic:
    """Evaluate an effect's Modelica class over a range of the variable that it depends on.

    A force of position and velocity is drawn against velocity, at position zero.

    Args:
        effect: The effect.
        values: Its parameters, by their names in the class; others keep their defaults.
        low, high: Range of the variable.
        base: The user's model, if the effect is defined in its text or its libraries.

    Raises:
        UnsupportedModelError: The effect has a memory (a lag, a delay), further inputs, or changes
            with time, so it is no curve.

    Example:
        >>> from identification.discovery.effects import find_effects
        >>> by_name = {e.class_name: e for e in find_effects()}
        >>> drag = by_name["Twinproof.Effects.Rotational.ViscousFriction"]
        >>> characteristic(drag, {"d": 2.0}, -1.0, 1.0).y[[0, -1]].tolist()
        [-2.0, 2.0]
    """
    law = _law(effect, base)
    x = np.linspace(low, high, _POINTS)
    given = {**law.defaults, **{f"effect.{name}": value for name, value in values.items()}}
    p = np.array([given[name] for name in law.parameter_names])
    y = np.asarray(law.function(x[None, :], p)).ravel()
    return Characteristic(law.variable, law.constant, x, y)


def variable_of(effect: Effect, base: ModelicaSource | None = None) -> Quantity:
    """Return the variable that an effect's curve is drawn against.

    Raises:
        UnsupportedModelError: The effect has a memory, so it is no curve.

    Example:
        >>> from identification.discovery.effects import find_effects
        >>> by_name = {e.class_name: e for e in find_effects()}
        >>> variable_of(by_name["Twinproof.Effects.Rotational.CubicSpring"]).words
        'angle'
    """
    return _law(effect, base).variable


@dataclass(frozen=True)
class _Law:
    """(variable, parameters) → what the effect gives."""

    variable: Quantity
    constant: bool
    function: ca.Function
    parameter_names: tuple[str, ...]
    defaults: Mapping[str, float]


@lru_cache(maxsize=64)
def _law(effect: Effect, base: ModelicaSource | None) -> _Law:
    if effect.companions:
        raise UnsupportedModelError(
            f"{effect.name} depends on {', '.join(effect.companions)} too: it is no curve over one "
            "variable",
            remedy="look at the error against time instead",
        )
    dae = load(_host(effect, base))
    model = explicit(dae)
    variables = VARIABLES[effect.kind]
    # The host moves at constant velocity: position and velocity are all the memory it needs.
    own = len(model.state_names) - (0 if effect.kind == "signal" else 1)
    if dae.delays or dae.when_equations or dae.reinits or own:
        raise UnsupportedModelError(
            f"{effect.name} has a memory: what it gives is no curve over one variable",
            remedy="look at the error against time instead",
        )
    if effect.kind == "signal":
        symbols, y = [model.u[0]], model.value("effect.y") - model.u[0]
    else:
        symbols = [model.x[0], model.u[0]]
        y = model.value(f"effect.flange.{FLOWS[effect.kind].name}")
    used = [k for k, symbol in enumerate(symbols) if ca.depends_on(y, symbol)]
    chosen = used[-1] if used else len(symbols) - 1
    others: list[SX] = [s for k, s in enumerate(symbols) if k != chosen]
    y = ca.substitute(y, ca.vertcat(*others), ca.SX.zeros(len(others))) if others else y
    if any(symbol.name() == "time" for symbol in ca.symvar(y)):
        raise UnsupportedModelError(
            f"{effect.name} changes with time: what it gives is no curve over one variable",
            remedy="look at the error against time instead",
        )
    function = ca.Function("law", [symbols[chosen], model.p], [y])
    return _Law(variables[chosen], not used, function, model.parameter_names, dae.parameter_values)


def _host(effect: Effect, base: ModelicaSource | None) -> ModelicaSource:
    if effect.kind == "signal":
        declarations = "input Real u; output Real y;"
        equations = "effect.u = u; y = effect.y;"
    else:
        position = VARIABLES[effect.kind][0].name
        point = f"Twinproof.Interfaces.{effect.kind.capitalize()}Point point;"
        declarations = f"input Real rate; Real position(start = 0, fixed = true); {point}"
        equations = (
            f"der(position) = rate; point.{position} = position; "
            "connect(effect.flange, point.flange);"
        )
    text = base.text if base is not None and base.defines else ""
    roots = base.roots if base is not None else ()
    whole = _HOST.format(
        text=text, effect=effect.class_name, declarations=declarations, equations=equations
    )
    name = "CharacteristicHost"
    return ModelicaSource(whole, name, f"{name}.mo", effect.class_name, roots)
