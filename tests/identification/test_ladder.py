"""The whole journey: what is added, what it brings, and that the hold-out stays unseen."""

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pymoca.parser
import pytest
import truth_records as truth
import user_models

import twinproof
from fmus.frontend import load
from identification.discovery.diagnosis import Outcome
from identification.discovery.ladder import improve
from identification.problem import match
from identification.shooting import Shooting
from recordings import load as load_recording
from twinproof import documents

DEMO = Path(twinproof.__file__).parent / "demo_data"
STEP = 2e-3


def swings(duration, *, coulomb=0.05, seed=1, faster=1.0, **options):
    n = round(duration / STEP) + 1
    torque = truth.swing(n, STEP * faster)
    states = truth.held(truth.pendulum_rates(coulomb=coulomb), [0.4, -0.5], torque, STEP)
    clean = truth.problem(
        truth.library("Pendulum"), torque, states[:, 0], STEP, names=("theta",), **options
    )
    return truth.noisy(clean, [2e-3], seed)


@cache
def improved():
    return improve(truth.library("Pendulum"), swings(8.0), swings(6.0, seed=2, faster=1.2))


def test_the_hidden_effect_is_the_only_one_added():
    found = improved()
    assert [a.label for a in found.added] == ["CoulombFriction@joint"]
    assert found.added[0].values["tau_c"] == pytest.approx(0.05, rel=0.02)
    assert found.outcome is Outcome.COMPLETE
    assert [s.number for s in found.steps] == [0, 1]
    assert found.steps[0].added is None
    assert found.steps[1].verdict.accepted
    assert not found.steps[1].contradicted


def test_errors_fall_to_the_noise_on_both_records():
    first, last = improved().steps
    for side in ("train", "holdout"):
        before, after = (getattr(s, side).channels["theta"].rmse for s in (first, last))
        assert after < before
    assert last.train.channels["theta"].rmse < 1.2 * improved().noise_floor["theta"]
    assert improved().sensor_noise == {"theta": 2e-3}
    for name, value in truth.PENDULUM.items():
        assert last.fit.values[name] == pytest.approx(value, rel=0.02 if name != "d" else 0.5)


def same(one, other):
    assert [s.model.source.text for s in one.steps] == [s.model.source.text for s in other.steps]
    for a, b in zip(one.steps, other.steps, strict=True):
        assert a.fit.values == b.fit.values
        np.testing.assert_array_equal(a.fit.covariance, b.fit.covariance)
        assert a.train.channels == b.train.channels
        assert a.diagnosis.ranking == b.diagnosis.ranking
    assert one.outcome is other.outcome
    assert one.horizon == other.horizon
    assert one.noise_floor == other.noise_floor


def test_the_hold_out_takes_no_part_in_choosing():
    """Replaced by garbage, or left out: the same steps, the same numbers, another score."""
    good = swings(6.0, seed=2, faster=1.2)
    rng = np.random.default_rng(0)
    garbage = replace(
        good,
        inputs=rng.normal(size=good.inputs.shape),
        outputs=100 * rng.normal(size=good.outputs.shape),
    )
    with_garbage = improve(truth.library("Pendulum"), swings(8.0), garbage)
    same(improved(), with_garbage)
    scores = [r.steps[-1].holdout.channels["theta"].rmse for r in (improved(), with_garbage)]
    assert scores[1] > 100 * scores[0]
    alone = improve(truth.library("Pendulum"), swings(8.0))
    same(improved(), alone)
    assert all(s.holdout is None for s in alone.steps)


def test_no_effect_is_added_beyond_the_limit():
    found = improve(truth.library("Pendulum"), swings(8.0), max_effects=0)
    assert len(found.steps) == 1
    assert found.added == ()
    assert found.outcome is Outcome.EFFECT
    assert found.steps[0].diagnosis.chosen.addition.label == "CoulombFriction@joint"


def test_what_the_user_holds_stays_and_is_in_what_is_written():
    problem = swings(4.0, free=("J", "mgl"), values={"d": 0.0061})
    found = improve(truth.library("Pendulum"), problem, max_effects=1)
    for step in found.steps:
        dae = step.model.dae
        assert "d" not in step.fit.free
        assert dae.parameter_values["d"] == 0.0061
    assert [a.label for a in found.added] == ["CoulombFriction@joint"]


def free_run(step, problem):
    """Simulate a step's text with nothing but its own defaults, over the whole record."""
    dae = load(step.model.source)
    shooting = Shooting(dae, problem.output_names, ())
    p = shooting.parameter_vector(dae.parameter_values)
    starts = {v.name: dae.number(v.start, 0.0) for v in dae.states}
    x0 = np.array([starts[name] for name in shooting.state_names])
    h = problem.sample_time
    inputs = shooting.inputs_with_delays(problem.inputs, h, p)
    return shooting.run(x0, inputs, p, h).outputs


def test_what_is_written_simulates_as_it_was_scored():
    problem = swings(8.0)
    assert improved().horizon is None
    for step in improved().steps:
        assert pymoca.parser.parse(step.model.source.text) is not None
        simulated = free_run(step, problem)
        np.testing.assert_allclose(simulated, step.train.prediction.simulated, atol=1e-6)


@cache
def bench():
    """A composed model of the user's with a hidden drag and a hidden offset of its sensor."""
    n = 4001
    current = 4 * truth.swing(n, STEP)

    def rates(_, x, i):
        return [x[1], (0.5 * i - 0.3 * x[1] * abs(x[1])) / 0.25]

    states = truth.held(rates, [0.7, 0.0], current, STEP)
    source = truth.own(user_models.BENCH, "Bench")
    clean = truth.problem(
        source,
        current,
        states[:, 0],
        STEP,
        names=("angle",),
        wrong=1.2,
        free=("load.J",),
        values={"motor.k": 0.4},
    )
    return source, truth.noisy(clean, [2e-3], 3)


@cache
def improved_bench():
    source, problem = bench()
    return improve(source, problem, max_effects=2)


def test_a_composed_model_of_the_users_is_improved_under_his_own_names():
    """The torque constant is held at 0.4 instead of 0.5: inertia and drag follow in proportion."""
    found = improved_bench()
    # Both ends of the shaft are one place, called after the first.
    assert [a.label for a in found.added] == ["QuadraticDrag@motor.flange_a"]
    assert found.added[0].values["c"] == pytest.approx(0.3 * 0.8, rel=0.02)
    assert found.steps[-1].fit.values["load.J"] == pytest.approx(0.25 * 0.8, rel=0.02)
    last = found.steps[-1]
    names = [last.model.user_name(name) for name in last.fit.free]
    assert "load.J" in names
    assert not any(name.startswith("plant.") for name in names)
    assert "motor.k" not in names
    assert last.model.dae.parameter_values[last.model.flat_name("motor.k")] == 0.4
    _, problem = bench()
    simulated = free_run(last, problem)
    np.testing.assert_allclose(simulated, last.train.prediction.simulated, atol=1e-5)


def test_json_names_are_the_users_own_behind_a_wrapper():
    """A block in series wraps the plant; its parameters keep their names."""
    n = 4001
    torque = truth.swing(n, STEP)
    applied = np.sign(torque) * np.maximum(np.abs(torque) - 0.25, 0)
    states = truth.held(truth.pendulum_rates(), [0.4, -0.5], applied, STEP)
    clean = truth.problem(truth.library("Pendulum"), torque, states[:, 0], STEP, names=("theta",))
    problem = truth.noisy(clean, [2e-3], 1)
    found = improve(truth.library("Pendulum"), problem)
    assert [a.label for a in found.added] == ["DeadZone@tau"]
    assert found.steps[-1].model.wrapped
    result = twinproof.Improved(problem, None, found)
    files = {s.number: ("m.mo", "m.fmu") for s in found.steps}
    document = documents.improved(result, files)
    last = document["ladder"][-1]
    assert set(last["parameters"]) == {"J", "mgl", "d", "deadZone_tau.w"}
    assert set(last["train"]["channels"]) == {"theta"}
    assert document["added"] == [
        {"effect": "DeadZone", "place": "tau", "parameters": pytest.approx({"w": 0.25}, rel=0.02)}
    ]
    where = {name for failure in found.steps[-1].train.worst for name in failure.where}
    assert where <= {"tau", "theta", "omega"}


@cache
def demo():
    source = truth.library("WheeledPendulum")
    dae = load(source)
    units = {v.name: v.unit for v in (*dae.inputs, *dae.outputs)}
    records = [
        match(
            dae,
            load_recording(
                DEMO / name,
                variables=units,
                channel_map=DEMO / "channels.toml",
                dbc=DEMO / "wheeled_pendulum.dbc",
                inputs=[v.name for v in dae.inputs],
            ),
        )
        for name in ("balancing.blf", "held_out.blf")
    ]
    return improve(source, *records)


@pytest.mark.slow
def test_the_demos_hidden_effect_is_named_first_and_is_all():
    found = demo()
    assert [a.label for a in found.added] == ["CoulombFriction@wheel"]
    assert found.added[0].values["tau_c"] == pytest.approx(25, rel=0.01)
    assert found.outcome is Outcome.COMPLETE
    assert found.horizon == 1.0
    assert found.steps[0].diagnosis.ranking[0].label == "CoulombFriction@wheel"
    assert not any(s.contradicted for s in found.steps)


@pytest.mark.slow
def test_the_demos_held_out_error_ends_at_the_noise():
    found = demo()
    first, last = found.steps[0].holdout, found.steps[-1].holdout
    for name, channel in last.channels.items():
        assert channel.rmse <= 1.2 * found.noise_floor[name], name
        assert channel.rmse < first.channels[name].rmse
    for name in ("theta_p", "omega_p"):
        assert last.channels[name].rmse <= 1.2 * np.radians(0.5)
    for name, value in truth.X.items():
        assert found.steps[-1].fit.values[name] == pytest.approx(value, rel=0.02), name


@cache
def emps():
    source = truth.library("Positioner")
    dae = load(source)
    units = {v.name: v.unit for v in (*dae.inputs, *dae.outputs)}
    records = [
        match(dae, load_recording(n, variables=units, inputs=["vir"]))
        for n in ("emps", "emps-pulses")
    ]
    return improve(source, *records)


@pytest.mark.slow
@pytest.mark.skipif(
    "TWINPROOF_DATA" not in os.environ,
    reason="measured data: TWINPROOF_DATA names the folder that has them",
)
def test_emps_comes_down_from_centimetres_to_millimetres():
    """The benchmark's free simulation over 24.8 s, fitted and unseen."""
    found = emps()
    labels = [a.label for a in found.added]
    assert labels[0] == "CoulombFriction@carriage"
    assert found.horizon is None
    first, last = found.steps[0], found.steps[-1]
    assert first.train.channels["q"].rmse > 70e-3
    assert first.holdout.channels["q"].rmse > 70e-3
    assert last.train.channels["q"].rmse <= 3e-3
    assert last.holdout.channels["q"].rmse <= 4.5e-3
    assert not any(s.contradicted for s in found.steps)
