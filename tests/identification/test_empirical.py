"""A force without a name is drawn as a curve, proposed, and can be added like any other effect."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

import twinproof
from fmus.frontend import load
from fmus.sources import library_class
from identification.discovery.characteristic import characteristic
from identification.discovery.effects import find_effects
from identification.discovery.empirical import propose
from identification.discovery.extension import extend
from identification.discovery.scan import candidates
from identification.experiment import Experiment
from identification.problem import match

J, D, STIFFNESS = 0.2, 0.05, 3.0


def curve(speed: float) -> float:
    """A resistance with a peak at one speed, as no law of the library has it."""
    return 0.8 * speed / (1 + (speed / 0.9) ** 4)


def record(law: bool, seed: int) -> twinproof.Recording:
    h, n = 5e-3, 4001
    time = np.arange(n) * h
    rng = np.random.default_rng(seed)
    omega, phase = rng.uniform(1.5, 9, 7), rng.uniform(0, 6, 7)
    torque = 0.3 * np.sum(np.sin(omega[:, None] * time + phase[:, None]), axis=0)

    def rates(t: float, x: np.ndarray) -> list[float]:
        tau = torque[min(int(t / h + 1e-9), n - 1)] - (curve(x[1]) if law else 0.0)
        return [x[1], (tau - STIFFNESS * np.sin(x[0]) - D * x[1]) / J]

    x = np.zeros((n, 2))
    for k in range(n - 1):
        run = solve_ivp(rates, (time[k], time[k] + h * (1 - 1e-9)), x[k], rtol=1e-8, atol=1e-10)
        x[k + 1] = run.y[:, -1]
    angle = x[:, 0] + 1e-3 * rng.standard_normal(n)
    speed = x[:, 1] + 1e-2 * rng.standard_normal(n)
    sensors = [twinproof.Sensor(sd, None, 0.0) for sd in (None, 1e-3, 1e-2)]
    return twinproof.Recording(
        time,
        {
            "tau": twinproof.Channel("tau", torque, "N.m", sensors[0]),
            "theta": twinproof.Channel("theta", angle, "rad", sensors[1]),
            "omega": twinproof.Channel("omega", speed, "rad/s", sensors[2]),
        },
        "truth",
        (),
    )


def proposal(law: bool, seed: int):
    source = library_class("Twinproof.Plants.Pendulum")
    problem = match(load(source), record(law, seed))
    experiment = Experiment.of(problem)
    fit = experiment.fit_stages()[-1]
    return propose(extend(source, []), experiment, fit)


def test_empirical_effects_are_there_but_not_searched_for():
    assert {e.name for e in find_effects() if e.empirical} == {
        "EmpiricalOverSpeed",
        "EmpiricalOverAngle",
        "EmpiricalOverPosition",
        "EmpiricalOverSignal",
    }


def test_a_force_in_no_library_is_drawn_over_speed_and_can_be_added():
    found = proposal(law=True, seed=1)
    assert found is not None
    assert (found.refit.addition.label, found.over) == (
        "EmpiricalOverSpeed@joint",
        "angular velocity",
    )
    assert found.verdict.removed > 0.8
    addition = found.refit.addition
    drawn = characteristic(addition.effect, addition.values, -3.0, 3.0)
    # Viscous friction is the model's own: the curve is known up to a straight line.
    truth = np.array([curve(x) for x in drawn.x])
    line = np.polynomial.Polynomial.fit(drawn.x, truth - drawn.y, 1)
    assert np.std(truth - drawn.y - line(drawn.x)) < 0.25 * np.std(truth)
    written = twinproof.extend(
        twinproof.Model.of("Twinproof.Plants.Pendulum"), [found.addition]
    ).source.text
    assert "Twinproof.Effects.Rotational.EmpiricalOverSpeed" in written


def test_nothing_is_drawn_where_nothing_is_missing():
    assert proposal(law=False, seed=2) is None


def test_the_search_never_tries_a_curve_without_a_name():
    source = library_class("Twinproof.Plants.Pendulum")
    assert not any(a.effect.empirical for a in candidates(source, ["theta", "omega"]))
