"""Where a step may have been a wrong one, the climb is tried again from there."""

from functools import cache

import pytest
import truth_records as truth

from foundation.progress import Spoken
from identification.discovery.climb import climb
from identification.discovery.diagnosis import Outcome
from identification.discovery.extension import extend
from identification.experiment import Experiment

STEP = 2e-3
COULOMB, DRAG, STRIBECK = (
    f"{law}@joint" for law in ("CoulombFriction", "QuadraticDrag", "StribeckFriction")
)


@cache
def climbed(max_effects):
    """A pendulum with dry friction and drag at its joint, which look like one Stribeck curve."""
    torque = 0.5 * truth.swing(5001, STEP)
    states = truth.held(truth.pendulum_rates(coulomb=0.1, drag=0.02), [0.4, -0.5], torque, STEP)
    clean = truth.problem(truth.library("Pendulum"), torque, states, STEP, names=("theta", "omega"))
    record = truth.noisy(clean, [1e-3, 1e-2], 1)
    said: list[str] = []
    experiment, fit = Experiment.of(record).followed(record.values)
    model = extend(truth.library("Pendulum"), [])
    rungs = climb(model, experiment, fit, max_effects=max_effects, progress=Spoken(said.append))
    return rungs, said


def test_two_laws_at_one_joint_are_not_taken_for_one():
    rungs, _ = climbed(3)
    assert {a.label for a in rungs[-1].model.additions} == {COULOMB, DRAG}
    last = rungs[-1]
    found = {
        a.effect.name: last.fit.values[last.model.parameter_of(a, a.effect.main_parameters[0])]
        for a in last.model.additions
    }
    assert found["CoulombFriction"] == pytest.approx(0.1, rel=0.03)
    assert found["QuadraticDrag"] == pytest.approx(0.02, rel=0.1)
    assert last.diagnosis.outcome is Outcome.COMPLETE


def test_the_way_was_a_detour():
    """Or the test above says nothing: the curve with more parameters does explain more alone."""
    rungs, said = climbed(3)
    assert rungs[0].diagnosis.ranking[0].label == STRIBECK
    assert rungs[0].diagnosis.chosen.addition.label == COULOMB
    assert f"trying {COULOMB} instead of {STRIBECK}" in said
    assert rungs[1].added.label == COULOMB
    assert rungs[1].verdict.accepted
    assert rungs[1].verdict.reason.endswith(f"better than {STRIBECK}")


def test_a_detour_takes_no_more_effects_than_it_may():
    rungs, _ = climbed(1)
    assert len(rungs[-1].model.additions) == 1
    # Of the two laws alone the curve is the better one.
    assert rungs[-1].added.label == STRIBECK
