"""What was added earlier is tested again, and goes when it is not missed."""

import pytest
import truth_records as truth

from identification.discovery.extension import extend
from identification.discovery.scan import candidates
from identification.discovery.superfluous import without_superfluous
from identification.discovery.transfer import transfer_problem
from identification.experiment import Experiment
from identification.prediction import noise_estimate

PLAIN = extend(truth.library("Pendulum"), [])
CANDIDATES = {a.label: a for a in candidates(PLAIN.base, ("theta", "omega"))}
COULOMB, DRAG = "CoulombFriction@joint", "QuadraticDrag@joint"


def slimmed(order):
    """Of a pendulum that has dry friction, and no drag."""
    record = truth.noisy(truth.pendulum_problem(10.0, 2e-3, coulomb=0.05), [2e-3], 1)
    model = extend(PLAIN.base, [CANDIDATES[label] for label in order])
    problem = transfer_problem(record, model, record.values, PLAIN)
    experiment = Experiment.of(problem)
    fit = experiment.fit_stages()[-1]
    found = without_superfluous(model, experiment, fit, noise_estimate(problem))
    return found, model


def test_what_explains_nothing_beside_the_newest_goes():
    found, _ = slimmed([DRAG, COULOMB])
    assert [a.label for a in found.removed] == [DRAG]
    assert [a.label for a in found.model.additions] == [COULOMB]
    friction = found.model.parameter_of(found.model.additions[0], "tau_c")
    assert found.fit.values[friction] == pytest.approx(0.05, rel=0.02)
    assert all("quadraticDrag" not in name for name in found.fit.values)


def test_what_is_needed_stays():
    found, model = slimmed([COULOMB, DRAG])
    assert found.removed == ()
    assert found.model is model
