"""The next experiment, against candidates whose difference is known."""

import numpy as np
import pytest
import truth_records as truth

from identification.discovery.evidence import refit
from identification.discovery.extension import extend, parse_addition
from identification.discovery.next_experiment import propose
from identification.discovery.scan import Scored
from identification.experiment import Experiment


def tied(labels, given):
    source = truth.library("Pendulum")
    model = extend(source, [])
    experiment = Experiment.of(given)
    base = experiment.fit_stages(given.values)[-1]
    found = []
    for label in labels:
        addition = parse_addition(label, source)
        values = dict.fromkeys(addition.effect.main_parameters, 0.02)
        found.append(refit(model, experiment, base, Scored(addition, 1.0, values)))
    return found


@pytest.fixture(scope="module")
def given():
    return truth.noisy(truth.pendulum_problem(4.0, coulomb=0.1), [2e-3], 1)


def test_one_law_in_two_places_is_not_told_apart(given):
    found = propose(tied(["Offset@tau", "ConstantTorque@joint"], given))
    assert found.nats < 1.0
    assert "one law in two places" in found.text
    assert found.inputs is None


def test_two_frictions_are_told_apart_within_the_limits(given):
    limits = {"tau": (-1.0, 1.0)}
    found = propose(
        tied(["CoulombFriction@joint", "HystereticDamping@joint"], given), limits=limits
    )
    assert found.nats > 10
    assert f"{found.nats:.0f} nats" in found.text
    if found.inputs is not None:
        assert np.max(np.abs(found.inputs)) <= 1.0 + 1e-9
    else:
        assert np.max(np.abs(found.scale * given.inputs)) <= 1.0 + 1e-9
