"""Discovery over several records at once: against SciPy's simulations and single records."""

from dataclasses import replace

import numpy as np
import pytest
import truth_records as truth

from identification.discovery.crossvalidation import crossvalidate
from identification.discovery.diagnosis import Outcome, diagnose
from identification.discovery.evidence import independent_of_all, refit
from identification.discovery.extension import extend
from identification.discovery.ladder import improve
from identification.discovery.scan import scan
from identification.experiment import Experiment
from identification.problem import Problem

PENDULUM = truth.library("Pendulum")
PLAIN = extend(PENDULUM, [])


def swing(step, seed, *, coulomb=0.05, seconds=6.0, sd=1e-3, size=1.0):
    """A pendulum with dry friction that the model does not have, its angle with noise."""
    t = np.arange(round(seconds / step)) * step
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, 3)
    waves = [np.sin(w * t + p) for w, p in zip((1.1, 2.3, 4.7), phases, strict=True)]
    torque = 1.2 * size * np.sum(waves, axis=0)
    states = truth.held(truth.pendulum_rates(coulomb=coulomb), [0.0, 0.0], torque, step)
    theta = states[:, :1] + sd * rng.standard_normal((len(t), 1))
    problem = truth.problem(PENDULUM, torque[:, None], theta, step, names=("theta",))
    return replace(problem, noise_sd=np.array([sd]))


def fitted(*problems):
    experiment = Experiment.together(problems)
    return experiment, experiment.fit_stages()[-1]


def scored(experiment, base):
    return {s.addition.label: s for s in scan(PLAIN, experiment, base).scored}


def test_scores_and_evidence_of_records_add_up():
    """With parameters held there is nothing that one record tells of another."""
    pair = [replace(swing(5e-3, 1), free=()), replace(swing(1e-2, 2, sd=2e-3), free=())]
    label = "CoulombFriction@joint"
    gains, information = [], []
    for problem in pair:
        alone = scored(*fitted(problem))[label]
        # The gain is score²/information, and its prediction score/information.
        gains.append(alone.gain)
        (size,) = alone.values.values()
        information.append(alone.gain / size**2)
    together = scored(*fitted(*pair))[label]
    score = sum(np.sqrt(g * i) for g, i in zip(gains, information, strict=True))
    assert together.gain == pytest.approx(score**2 / sum(information), rel=1e-6)
    (size,) = together.values.values()
    assert size == pytest.approx(score / sum(information), rel=1e-6)


def test_independent_samples_are_counted_record_by_record():
    experiment, base = fitted(swing(5e-3, 1, coulomb=0.0), swing(1e-2, 2, coulomb=0.0, sd=2e-3))
    first, second = independent_of_all(experiment, base)
    # Six initial states and the parameters have taken little of the white noise's memory away.
    assert first == pytest.approx(1200, rel=0.3)
    assert second == pytest.approx(600, rel=0.3)


def test_a_block_may_hold_no_window_of_a_short_record():
    long, short = swing(5e-3, 1), swing(5e-3, 2, seconds=0.5)
    experiment, base = fitted(long, short)
    found = refit(PLAIN, experiment, base, scored(experiment, base)["CoulombFriction@joint"])
    verdict = crossvalidate(
        experiment,
        base,
        found.experiment,
        found.fit,
        experiment.noise(),
        independent=found.independent,
    )
    assert verdict.accepted, verdict.reason
    assert verdict.before.shape == (2,)
    assert np.all(np.isfinite(verdict.after))


def test_a_hidden_friction_is_found_in_two_records_at_once():
    pair = [swing(5e-3, 1), swing(1e-2, 2, sd=2e-3)]
    experiment, base = fitted(*pair)
    found = diagnose(PLAIN, experiment, base)
    assert found.outcome is Outcome.EFFECT
    assert found.chosen.addition.label == "CoulombFriction@joint"
    assert found.chosen.addition.values["tau_c"] == pytest.approx(0.05, rel=0.05)
    alone = diagnose(PLAIN, *fitted(pair[0]))
    assert found.chosen.evidence > alone.chosen.evidence


def test_nothing_is_added_where_nothing_is_missing():
    experiment, base = fitted(swing(5e-3, 3, coulomb=0.0), swing(1e-2, 4, coulomb=0.0))
    found = diagnose(PLAIN, experiment, base)
    assert found.outcome is Outcome.COMPLETE
    assert found.chosen is None


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_a_small_steady_torque_shows_over_longer_windows(size):
    """Of a quarter of a second it explains 2 %, where the sensor's noise is not all known."""
    problems: list[Problem] = []
    for seed in (5, 6):
        problem = swing(5e-3, seed, coulomb=0.0, sd=2e-3, seconds=10.0)
        pushed = replace(problem, inputs=problem.inputs - size)  # the model is not told of it
        problems.append(replace(pushed, noise_sd=np.array([3e-4])))
    experiment, base = fitted(*problems)
    found = diagnose(PLAIN, experiment, base)
    if not size:
        assert found.chosen is None
        return
    assert found.chosen is not None
    labels = {found.chosen.addition.label, *(label for tie in found.ties for label in tie)}
    assert labels & {"ConstantTorque@joint", "Offset@tau"}
    # It is the longer windows that let it in.
    assert "removes" in found.checks[found.chosen.addition.label].reason


def test_the_ladder_compares_every_record():
    pair = [swing(5e-3, 1), swing(1e-2, 2, sd=2e-3)]
    found = improve(PENDULUM, pair, swing(5e-3, 9), max_effects=1)
    assert [a.label for a in found.added] == ["CoulombFriction@joint"]
    for step in found.steps:
        assert len(step.also) == 1
    before, after = (step.also[0].channels["theta"].rmse for step in found.steps)
    assert after < 0.5 * before
    assert after == pytest.approx(2e-3, rel=0.5)
