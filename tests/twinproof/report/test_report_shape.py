"""The shape of a missing force against laws that SciPy simulated, and curves against formulas."""

import doctest

import numpy as np
import pytest
from swinging_pendulum import COULOMB, NOISE, WIDTH, swing

from fmus.frontend import load
from fmus.sources import library_class
from foundation.errors import UnsupportedModelError
from identification.discovery import characteristic as characteristic_module
from identification.discovery import shape as shape_module
from identification.discovery.characteristic import characteristic, variable_of
from identification.discovery.effects import find_effects
from identification.discovery.extension import extend, parse_addition
from identification.discovery.shape import missing_force
from identification.experiment import Experiment
from identification.problem import match

PENDULUM = library_class("Twinproof.Plants.Pendulum")
SD = np.array(list(NOISE.values()))
EFFECTS = {e.class_name.removeprefix("Twinproof.Effects."): e for e in find_effects()}


@pytest.mark.parametrize("module", [characteristic_module, shape_module])
def test_examples_in_docstrings(module):
    assert doctest.testmod(module).failed == 0


@pytest.mark.parametrize(
    ("name", "values", "law"),
    [
        ("Rotational.CoulombFriction", {"tau_c": 2.0}, lambda w: 2 * np.tanh(w / 0.05)),
        ("Rotational.QuadraticDrag", {"c": 0.7}, lambda w: 0.7 * w * np.abs(w)),
        ("Rotational.CubicSpring", {"k3": 4.0}, lambda phi: 4 * phi**3),
        ("Translational.ConstantForce", {"f_0": 3.0}, lambda v: -3 + 0 * v),
        ("Signal.DeadZone", {"w": 0.3}, lambda u: -np.clip(u, -0.3, 0.3)),
        ("Signal.Gain", {"k": 0.1}, lambda u: 0.1 * u),
    ],
)
def test_characteristics_are_those_of_the_classes(name, values, law):
    curve = characteristic(EFFECTS[name], values, -2.0, 2.0)
    assert np.allclose(curve.y, law(curve.x), atol=1e-12)


def test_what_a_force_depends_on_is_read_from_its_class():
    assert variable_of(EFFECTS["Rotational.LinearSpring"]).unit == "rad"
    assert variable_of(EFFECTS["Translational.ViscousFriction"]).unit == "m/s"
    assert characteristic(EFFECTS["Rotational.ConstantTorque"], {}, 0.0, 1.0).constant


@pytest.mark.parametrize("name", ["Signal.Delay", "Signal.FirstOrderLag"])
def test_an_effect_with_a_memory_has_no_curve(name):
    with pytest.raises(UnsupportedModelError, match="has a memory"):
        characteristic(EFFECTS[name], {}, -1.0, 1.0)


def shape_of(label: str, coulomb: float, *, fitted: bool = True):
    """Add an effect to the pendulum, fit it (or keep the true parameters), and take its shape."""
    model = extend(PENDULUM, [parse_addition(label, PENDULUM)])
    experiment = Experiment.of(match(model.dae, swing(6.0, 1, coulomb)))
    values = experiment.fit_stages()[-1].values if fitted else experiment.problem.values
    return missing_force(model, experiment, values, SD, model.additions[0])


def test_missing_force_recovers_a_coulomb_law():
    found = shape_of("CoulombFriction@joint,tau_c=0.1", COULOMB)
    truth = COULOMB * np.tanh(found.centres / WIDTH)
    assert found.unit == "N.m"
    assert len(found.centres) >= 5
    assert np.min(found.centres) < -1 < 1 < np.max(found.centres)
    assert np.all(np.abs(found.law - truth) < 3 * found.spread)
    assert np.all(found.spread < 0.1 * COULOMB)
    # The windows' own standard deviations are honest: their errors are of that size.
    pull = (found.y - COULOMB * np.tanh(found.x / WIDTH)) / found.sd
    assert 0.5 < np.sqrt(np.mean(pull**2)) < 2.0


@pytest.mark.parametrize("effect", ["ViscousFriction", "QuadraticDrag", "ConstantTorque"])
def test_missing_force_shows_the_law_whatever_the_candidate(effect):
    """The parameters are true, so what is missing is dry friction and nothing else."""
    found = shape_of(f"{effect}@joint", COULOMB, fitted=False)
    assert np.all(np.abs(found.law - COULOMB * np.sign(found.centres)) < 4 * found.spread)


def test_no_force_is_missing_where_none_is():
    found = shape_of("CoulombFriction@joint,tau_c=0.1", 0.0)
    assert np.median(np.abs(found.y)) < 3 * np.median(found.sd)


def test_shape_of_a_sensors_effect_is_refused():
    model = extend(PENDULUM, [parse_addition("Gain@theta", PENDULUM)])
    experiment = Experiment.of(match(load(model.source), swing(2.0, 1)))
    with pytest.raises(UnsupportedModelError, match="acts on a sensor"):
        missing_force(model, experiment, experiment.problem.values, SD, model.additions[0])


def test_shape_of_an_effect_in_series_with_an_input():
    """A drive that gives 20 % more torque than it was asked for: what it adds is a line."""
    model = extend(PENDULUM, [parse_addition("Gain@tau", PENDULUM)])
    recording = swing(6.0, 1, 0.0)
    weaker = recording.replace_values({"tau": recording["tau"].values / 1.2})
    experiment = Experiment.of(match(model.dae, weaker))
    found = missing_force(
        model, experiment, experiment.problem.values, SD, model.additions[0], window=0.1
    )
    assert found.unit == "N.m"
    assert found.curve.variable.name == "u"
    slope, offset = np.polyfit(found.x, found.y, 1, w=1 / found.sd)
    assert abs(slope - 0.2) < 0.02
    assert abs(offset) < 0.01
