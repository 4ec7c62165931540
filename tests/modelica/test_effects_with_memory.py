"""Effects with states of their own, or that change with time, against SciPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, solve_ivp
from test_effects import KINDS, WITH_MEMORY, of_kind, run

from fmus.explicit import explicit
from fmus.frontend import load as load_dae
from fmus.sources import ModelicaSource

Array = np.ndarray


@dataclass(frozen=True)
class Law:
    """States `s` of an effect at position, speed and time, and what the machine spends on it."""

    parameters: dict[str, float]
    rates: Callable[[dict[str, float], Any, Any, Any], list[Any]]
    effort: Callable[[dict[str, float], Any, Any, Any], Any]
    states: int = 1


LAWS = {
    "WarmUpFriction": Law(
        {"d_w": 0.9, "T_w": 6.0},
        lambda p, w, s, t: [],
        lambda p, w, s, t: p["d_w"] * w * np.exp(-t / p["T_w"]),
        0,
    ),
}
every_law = pytest.mark.parametrize("name", LAWS)
every_kind = pytest.mark.parametrize("kind", KINDS)


def test_there_is_a_law_for_every_effect_with_memory() -> None:
    assert set(LAWS) == WITH_MEMORY


def names(kind: str, law: Law, **more: float) -> dict[str, float]:
    parameters = {**law.parameters, **more}
    renamed = {"f_n": parameters.pop("f_n")} if "f_n" in parameters else {}
    return {f"e.{k}": v for k, v in {**of_kind(kind, parameters), **renamed}.items()}


@every_kind
@every_law
def test_absent_at_its_defaults(kind: str, name: str) -> None:
    _, effort = run(kind, name, 3.0)
    assert np.all(effort == 0.0)


@every_kind
@every_law
def test_body_moves_as_scipy_says(kind: str, name: str) -> None:
    law = LAWS[name]
    found, effort = run(kind, name, 3.0, names(kind, law))

    def motion(t: float, x: Array) -> list[Any]:
        spent = law.effort(law.parameters, x[1], x[2:], t)
        own = law.rates(law.parameters, x[1], x[2:], t)
        return [x[1], (2 * np.sin(3 * t) - spent) / 0.5, *own]

    start = [0.3, -1.0, *np.zeros(law.states)]
    time = found["time"]
    # Short steps, so that the corners of the laws are met closely.
    truth = solve_ivp(motion, (0, 3), start, "DOP853", time, rtol=1e-10, atol=1e-12, max_step=2e-3)
    np.testing.assert_allclose(found["q"], truth.y[0], atol=2e-6)
    np.testing.assert_allclose(found["w"], truth.y[1], atol=2e-6)
    expected = [
        law.effort(law.parameters, x[1], x[2:], t) for t, x in zip(time, truth.y.T, strict=True)
    ]
    np.testing.assert_allclose(effort, expected, atol=1e-4)
    assert np.ptp(np.sign(truth.y[1])) == 2, "the test has to visit both directions"


@every_kind
@every_law
def test_takes_energy_out_over_a_motion(kind: str, name: str) -> None:
    """Whatever it stores in between, an effect that began empty never gives more than it took."""
    found, effort = run(kind, name, 4.0, names(kind, LAWS[name]), 2001)
    taken = cumulative_simpson(effort * found["w"], x=found["time"], initial=0)
    assert np.min(taken) >= -1e-6
    assert taken[-1] > 0.05


# Sensitivities at the absent default --------------------------------------------------------


@every_kind
@every_law
def test_its_slope_at_zero_is_finite_and_tells_something(kind: str, name: str) -> None:
    """The score test looks at the derivative by the main parameter where the effect is absent."""
    main = next(iter(LAWS[name].parameters))
    main = of_kind(kind, {main: 0.0}).popitem()[0]
    point, position, effort = (
        ("RotationalPoint", "phi", "tau")
        if kind == "Rotational"
        else ("TranslationalPoint", "s", "f")
    )
    text = (
        f"model T Twinproof.Interfaces.{point} p; Real w(start = 0, fixed = true);"
        f" Real q(start = 0, fixed = true); Twinproof.Effects.{kind}.{name} e; equation"
        f" connect(e.flange, p.flange); der(q) = w; p.{position} = q; der(w) = p.{effort}; end T;"
    )
    model = explicit(load_dae(ModelicaSource(text, "T", "t.mo", "T", ())))
    row = model.state_names.index("w")
    slope = ca.Function(
        "slope",
        [model.time, model.x, model.p],
        [ca.jacobian(model.derivatives[row], model.p)[model.parameter_names.index(f"e.{main}")]],
    )
    values = [model.dae.parameter_values[n] for n in model.parameter_names]
    rng = np.random.default_rng(1)
    found = [float(slope(1.0, rng.normal(size=len(model.state_names)), values)) for _ in range(5)]
    at_rest = float(slope(0.0, np.zeros(len(model.state_names)), values))
    assert np.all(np.isfinite([*found, at_rest]))
    assert min(np.abs(found)) > 1e-3
