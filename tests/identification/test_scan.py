"""The score test: what letting an effect in would gain, without letting it in."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import truth_records as truth
import user_models

from fmus.sources import ModelicaSource
from identification.discovery.extension import extend, parse_addition
from identification.discovery.scan import candidates, scan
from identification.discovery.transfer import transfer_problem, transfer_states
from identification.experiment import Experiment
from identification.gauss_newton import fit

PENDULUM = truth.library("Pendulum")


def hidden(extra, *, seed=1, sd=2e-3, n=3001, step=2e-3):
    """A swing with an extra torque `extra(angle, rate)` that the model lacks."""

    def rates(_, x, torque):
        total = torque + extra(x[0], x[1]) - 3.61 * np.sin(x[0]) - 0.006 * x[1]
        return [x[1], total / 0.185]

    torque = truth.swing(n, step)
    states = truth.held(rates, [0.4, -0.5], torque, step)
    clean = truth.problem(PENDULUM, torque, states[:, 0], step, names=("theta",))
    return truth.noisy(clean, [sd], seed)


@cache
def scanned(law, source=PENDULUM):
    laws = {
        "nothing": lambda q, w: 0.0,
        "drag": lambda q, w: -0.004 * w * abs(w),
        "spring": lambda q, w: -0.004 * q**3,
        "constant": lambda q, w: 0.02,
    }
    problem = replace(hidden(laws[law]))
    experiment = Experiment.of(problem)
    fitted = experiment.fit_stages()[-1]
    return experiment, fitted, scan(extend(source, []), experiment, fitted)


def refitted(label, experiment, base):
    """The actual fall of the cost, at the same weights, when the effect is let in."""
    model = extend(PENDULUM, [parse_addition(label, PENDULUM)])
    problem = transfer_problem(experiment.problem, model, base.values, extend(PENDULUM, []))
    larger = Experiment.of(problem)
    x0 = transfer_states(
        problem,
        larger.shooting,
        model,
        experiment.windows,
        experiment,
        extend(PENDULUM, []),
        base.x0,
    )
    found = fit(problem, larger.shooting, larger.windows, x0, problem.values, fixed_sd=base.sd)
    return base.at.cost - found.at.cost, found


@pytest.mark.parametrize(
    ("law", "label", "true"),
    [
        ("drag", "QuadraticDrag@joint", 0.004),
        ("spring", "CubicSpring@joint", 0.004),
        ("constant", "ConstantTorque@joint", 0.02),
    ],
)
def test_the_predicted_gain_is_what_a_refit_gains(law, label, true):
    experiment, base, found = scanned(law)
    scored = next(s for s in found.scored if s.addition.label == label)
    actual, after = refitted(label, experiment, base)
    assert scored.gain > 50
    assert scored.gain == pytest.approx(actual, rel=0.2)
    (predicted,) = scored.values.values()
    parameter = next(iter(scored.values)).removeprefix("plant.")
    assert predicted == pytest.approx(after.values[parameter], rel=0.1)
    assert predicted == pytest.approx(true, rel=0.3)


def test_the_hidden_law_is_among_the_first():
    for law, label in (("drag", "QuadraticDrag@joint"), ("spring", "CubicSpring@joint")):
        _, _, found = scanned(law)
        assert label in [s.addition.label for s in found.scored[:3]]


def test_gains_fall_and_are_never_negative():
    _, _, found = scanned("drag")
    gains = [s.gain for s in found.scored]
    assert gains == sorted(gains, reverse=True)
    assert gains[-1] >= 0


def test_nothing_hidden_gains_no_more_than_chance():
    """The gain of one parameter is chi-square with one degree of freedom; the best of 30 stays
    below 16 but once in 500."""
    _, base, found = scanned("nothing")
    scale = base.at.cost / base.at.counts[0]
    assert max(s.gain for s in found.scored) / scale < 16


def test_a_copy_of_what_the_model_has_gains_nothing():
    _, _, found = scanned("drag")
    by_label = {s.addition.label: s for s in found.scored}
    copy = by_label["ViscousFriction@joint"]
    assert copy.gain == 0
    assert set(copy.values.values()) == {0.0}
    # A gain at the input only rescales J, mgl and d.
    assert by_label["Gain@tau"].gain == 0


def test_candidates_are_all_effects_at_all_places_that_are_measured():
    found = {a.label for a in candidates(PENDULUM, ("theta",))}
    assert "CoulombFriction@joint" in found
    assert "Offset@tau" in found
    assert "Offset@theta" in found
    assert "Offset@omega" not in found
    assert not any(label.startswith("CoulombFriction@tau") for label in found)
    assert "Offset@omega" in {a.label for a in candidates(PENDULUM, ("theta", "omega"))}


def test_what_is_excluded_or_had_already_is_not_scored():
    experiment, base, _ = scanned("drag")
    model = extend(PENDULUM, [])
    found = scan(model, experiment, base, exclude=["QuadraticDrag@joint"])
    labels = {s.addition.label for s in found.scored}
    assert "QuadraticDrag@joint" not in labels
    assert "CubicSpring@joint" in labels


def test_a_sensors_lag_and_its_delay_are_scored():
    """What the filter remembers when a window starts is not free, so it explains no noise."""
    _, _, found = scanned("drag")
    gains = {s.addition.label: s.gain for s in found.scored}
    assert gains["FirstOrderLag@theta"] < 0.5 * max(gains.values())
    assert {"FirstOrderLag@tau", "Delay@tau"} <= set(gains)
    # To first order, a late sensor and a slow one are the same.
    assert {"FirstOrderLag@theta", "Delay@theta"} <= set(gains)
    assert gains["Delay@theta"] == pytest.approx(gains["FirstOrderLag@theta"], rel=0.02)


AWKWARD = """
model Latch "Changes its mind at events"
  extends Twinproof.Interfaces.RotationalEffect;
  parameter Real tau_l(unit = "N.m") = 0;
  discrete Real mode(start = 1);
equation
  when phi > 1 then
    mode = 2;
  end when;
  flange.tau = tau_l * mode;
end Latch;

model Echo "Friction that remembers"
  extends Twinproof.Interfaces.RotationalEffect;
  parameter Real tau_e(unit = "N.m") = 0;
equation
  flange.tau = tau_e * delay(phi, 0.05);
end Echo;

model Twice "Two parameters that act alike"
  extends Twinproof.Interfaces.RotationalEffect;
  parameter Real a(unit = "N.m") = 0;
  parameter Real b(unit = "N.m") = 0;
equation
  flange.tau = (a + b) * w * abs(w);
end Twice;
"""


def test_a_users_awkward_effects_do_not_spoil_the_scan(tmp_path):
    root = tmp_path / "Odd"
    root.mkdir()
    (root / "package.mo").write_text(f"within ;\npackage Odd\n{AWKWARD}\nend Odd;\n")
    source = ModelicaSource(
        PENDULUM.text, "Pendulum", "Pendulum.mo", PENDULUM.origin, (root,), defines=False
    )
    experiment, base, plain = scanned("drag")
    found = scan(extend(source, []), experiment, base)
    assert "events" in found.skipped["Latch@joint"]
    assert "delayed motion" in found.skipped["Echo@joint"]
    twice = next(s for s in found.scored if s.addition.label == "Twice@joint")
    drag = next(s for s in plain.scored if s.addition.label == "QuadraticDrag@joint")
    assert twice.gain == pytest.approx(drag.gain, rel=1e-3)


def test_a_users_own_effect_is_scored(tmp_path):
    source = truth.library_class("Twinproof.Plants.Pendulum", (user_models.library(tmp_path),))
    experiment, base, _ = scanned("drag")
    found = scan(extend(source, []), experiment, base)
    assert {"Cogging@joint", "Square@theta", "Square@tau"} <= {
        s.addition.label for s in found.scored
    }
