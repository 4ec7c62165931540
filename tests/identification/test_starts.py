"""Where a candidate is refitted from: shapes and limits that this record has, not the library's."""

from functools import cache

import numpy as np
import pytest
import truth_records as truth

from foundation.errors import UnsupportedModelError
from identification.discovery.evidence import refit
from identification.discovery.extension import extend, parse_addition
from identification.discovery.scan import Scored, scan
from identification.discovery.starts import starts
from identification.discovery.transfer import transfer_all_states, transfer_problems
from identification.experiment import Experiment

PENDULUM = truth.library("Pendulum")
POSITIONER = truth.library("Positioner")
STEP = 2e-3
TORQUE = truth.swing(4001, STEP)


@cache
def swung(size, *, bumper=np.inf, limit=np.inf):
    """A pendulum with bumpers that it touches seldom, or whose motor's torque is limited."""
    torque = size * TORQUE

    def rates(_, x, u):
        beyond = np.sign(x[0]) * max(abs(x[0]) - bumper, 0.0)
        push = np.clip(u, -limit, limit) - 3.61 * np.sin(x[0]) - 0.006 * x[1] - 5 * beyond
        return [x[1], push / 0.185]

    states = truth.held(rates, [0.4 * size, 0.0], torque, STEP)
    clean = truth.problem(PENDULUM, torque, states[:, 0], STEP, names=("theta",))
    experiment = Experiment.of(truth.noisy(clean, [2e-3 * size], 1))
    return experiment, experiment.fit_stages()[-1], np.abs(states[:, 0])


def found_by(label, experiment, fit, source=PENDULUM):
    scored = scan(extend(source, []), experiment, fit).scored
    candidate = next(s for s in scored if s.addition.label == label)
    return candidate, refit(extend(source, []), experiment, fit, candidate)


@pytest.mark.parametrize("size", [0.1, 0.4])
@pytest.mark.parametrize("share", [0.7, 0.9])
def test_a_bumper_is_found_where_it_begins(size, share):
    """The library's stands at 0.3 rad, which the smaller swing never reaches."""
    largest = float(np.max(swung(size)[2]))
    experiment, fit, _ = swung(size, bumper=share * largest)
    _, found = found_by("EndStop@joint", experiment, fit)
    assert found.addition.values["phi_e"] == pytest.approx(share * largest, rel=0.02)
    assert found.addition.values["k_e"] == pytest.approx(5.0, rel=0.1)


@pytest.mark.parametrize("size", [0.01, 0.4])
@pytest.mark.parametrize("share", [0.95, 0.7])
def test_a_limit_is_found_however_small_its_signal(size, share):
    """The score test cannot see it: nothing changes until it acts."""
    limit = share * size * float(np.max(np.abs(TORQUE)))
    experiment, fit, _ = swung(size, limit=limit)
    scored, found = found_by("Saturation@tau", experiment, fit)
    assert scored.blind
    assert 1 / found.addition.values["inverse_limit"] == pytest.approx(limit, rel=0.01)


def test_what_cannot_act_in_a_record_is_said_so():
    """Strokes of 2 mm never reach a stop: the closest that there may be is at 5 mm."""
    volts = 0.2 * np.sin(20 * np.arange(2001) * STEP)
    states = truth.held(truth.positioner_rates(), [0.0, 0.0], volts, STEP)
    assert np.max(np.abs(states[:, 0])) < 4e-3
    clean = truth.problem(POSITIONER, volts, states[:, 0], STEP, names=("q",))
    experiment = Experiment.of(truth.noisy(clean, [1e-6], 1))
    with pytest.raises(UnsupportedModelError, match="EndStop@carriage would do nothing"):
        found_by("EndStop@carriage", experiment, experiment.fit_stages()[-1], POSITIONER)


def test_what_always_acts_but_promises_nothing_is_tried_in_many_sizes():
    """A lag has no size at which it begins; the score test may point to a negative one."""
    experiment, fit, _ = swung(0.4)
    lag = parse_addition("FirstOrderLag@tau", PENDULUM)
    model, plain = extend(PENDULUM, [lag]), extend(PENDULUM, [])
    problems = transfer_problems(experiment, model, fit.values, plain)
    larger = Experiment.together(problems).lasting(experiment.window)
    x0 = transfer_all_states(larger, model, experiment, plain, fit.x0)
    found = starts(larger, model, Scored(lag, 0.0, {"T": 0.0}), x0)
    sizes = [value for start in found for value in start.values()]
    assert min(sizes) < 0.02 < max(sizes)
    assert max(sizes) / min(sizes) > 100


TOPPLING = """
model Toppling "A rod on its end, ten times quicker to fall than a window is long"
  parameter Real a(unit = "rad/(s2.N.m)", min = 0) = 10 "Of the motor";
  parameter Real c(unit = "1/s2", min = 0) = 100 "Of gravity";
  input Real u(unit = "N.m");
  output Real theta(unit = "rad", start = 0, fixed = true);
  output Real omega(unit = "rad/s", start = 0, fixed = true);
  Twinproof.Interfaces.RotationalPoint rod;
equation
  der(theta) = omega;
  rod.phi = theta;
  der(omega) = c * theta + a * (u + rod.tau);
end Toppling;
"""


def test_a_torque_on_what_topples_is_no_other_initial_tilt():
    """Beside a free initial state a thousand-millionth of its information is left, well seen."""
    n, step, pushed = 4001, 2e-3, 0.05
    t = np.arange(n) * step
    # Unit steps of the exact discrete system, in closed loop, so that nothing runs away.
    lam, gain = 10.0, 10.0
    cosh, sinh = np.cosh(lam * step), np.sinh(lam * step)
    transition = np.array([[cosh, sinh / lam], [lam * sinh, cosh]])
    forced = gain * np.array([(cosh - 1) / lam**2, sinh / lam])
    x, states, commands = np.zeros(2), np.empty((n, 2)), np.empty(n)
    for k in range(n):
        wanted = 0.05 * np.sin(5 * t[k]) + 0.03 * np.sin(13 * t[k] + 1)
        commands[k] = -40.0 * (x[0] - wanted) - 2.0 * x[1]
        states[k] = x
        x = transition @ x + forced * (commands[k] + pushed)
    assert np.max(np.abs(states[:, 0])) < 0.3
    source = truth.own(TOPPLING, "Toppling")
    clean = truth.problem(source, commands, states, step, names=("theta", "omega"))
    experiment = Experiment.of(truth.noisy(clean, [1e-4, 1e-3], 1))
    fit = experiment.fit_stages()[-1]
    scored, found = found_by("ConstantTorque@rod", experiment, fit, source)
    assert scored.gain > 50
    assert found.addition.values["tau_0"] == pytest.approx(pushed, rel=0.05)
    assert "tau_0" not in " ".join(found.fit.held)
