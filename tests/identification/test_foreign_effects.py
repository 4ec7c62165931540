"""What a foreign FMU lacks: effects in series with its inputs and outputs.

The FMU is written by hand in C (tests/fmus/foreign1.c): y' = rate·(u - y), of which no state can be
set. The truth is computed here.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus.black_box import black_box
from fmus.in_series import around, model_of
from fmus.master.ssp import read_ssp
from fmus.package import cached_fmu, export
from fmus.sources import library_class
from foundation.errors import InputError, UnsupportedModelError
from identification.discovery.diagnosis import Outcome
from identification.discovery.extension import extend, parse_addition
from identification.experiment import Experiment, simulator_of
from identification.gauss_newton import fit_together
from identification.problem import match
from recordings import Channel, Recording
from recordings.recording import Sensor
from twinproof import Model, diagnose, improve
from twinproof import extend as api_extend
from twinproof.results import write_extended, write_improvement

sys.path.insert(0, str(Path(__file__).parents[1] / "fmus"))
import foreign

H, RATE, NOISE = 0.02, 1.6, 5e-3


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return foreign.version_1(tmp_path_factory.mktemp("foreign"))


def command(seed, n=900):
    time = np.arange(n) * H
    steps = 0.4 * np.repeat(np.random.default_rng(seed).standard_normal(n // 25), 25)
    return 1.5 * np.sin(1.1 * time) + 0.8 * np.sign(np.sin(0.37 * time + 0.4)) + steps


def machine(u):
    """What the machine answers to a command that is held for a sample: exact."""
    y = np.ones_like(u)
    share = 1 - np.exp(-H * RATE)
    for k in range(len(u) - 1):
        y[k + 1] = y[k] + share * (u[k] - y[k])
    return y


def recorded(u, y, seed):
    noisy = y + NOISE * np.random.default_rng(seed).standard_normal(len(y))
    return Recording(
        np.arange(len(u)) * H, {"u": Channel("u", u), "y": Channel("y", noisy)}, f"seed {seed}"
    )


def soft_dead_zone(u):
    """Without the corners of the library's."""
    return u - 0.3 * np.tanh(u / 0.3)


def test_a_dead_zone_is_named_added_and_runs_as_a_system(fmu, tmp_path):
    u, other = command(1), command(2)
    found = improve(
        Model.of(str(fmu)),
        recorded(u, machine(soft_dead_zone(u)), 1),
        recorded(other, machine(soft_dead_zone(other)), 2),
        free=["rate"],
        max_effects=1,
    )
    steps = found.improvement.steps
    assert [a.label for a in found.improvement.added] == ["DeadZone@u"]
    assert steps[1].verdict.accepted
    assert not steps[1].contradicted
    assert steps[1].fit.values["rate"] == pytest.approx(RATE, rel=0.02)
    assert steps[1].holdout.nrmse < 0.2 * steps[0].holdout.nrmse
    with pytest.raises(UnsupportedModelError, match="system"):
        _ = found.model
    files = write_improvement(found, tmp_path / "out", command="…", progress=lambda _: None)
    assert not list((tmp_path / "out").glob("*.mo"))
    # The system of the last step is what was scored.
    with read_ssp(Path(files[1][0])) as ssp:
        run = ssp.system.simulate(inputs=(np.arange(len(other)) * H, {"u": other}), step=H)
    scored = steps[1].holdout.prediction.simulated[:, 0]
    assert run["y"] == pytest.approx(scored, abs=2e-6)


def test_a_bias_is_the_sensors(fmu):
    u = command(3)
    found = diagnose(Model.of(str(fmu)), recorded(u, machine(u) + 0.05, 3), free=["rate"]).diagnosis
    assert found.outcome is Outcome.SENSOR
    assert found.ranking[0].label == "Offset@y"
    value, sd, _ = found.ranking[0].parameters["b"]
    assert abs(value - 0.05) < 5 * sd < 0.01


def test_nothing_is_missing(fmu):
    u = command(4)
    found = diagnose(Model.of(str(fmu)), recorded(u, machine(u), 4), free=["rate"]).diagnosis
    assert found.outcome is Outcome.COMPLETE
    assert found.chosen is None


def test_what_no_effect_explains_has_no_name(fmu):
    """With a sensor whose noise is known, a filter would be asked, which needs equations."""
    u = command(7, 600)
    hum = 0.2 * np.sin(9 * H * np.arange(len(u)))
    record = recorded(u, machine(u) + hum, 7)
    known = replace(record.channels["y"], sensor=Sensor(sd=NOISE))
    record = replace(record, channels={**record.channels, "y": known})
    found = diagnose(Model.of(str(fmu)), record, free=["rate"]).diagnosis
    assert found.outcome is Outcome.UNKNOWN_SHAPE
    assert found.chosen is None


ADDED = (
    "DeadZone@tau,w=0.2",
    "Gain@tau,k=0.1",
    "FirstOrderLag@theta,T=0.05",
    "Offset@theta,b=0.02",
    "Delay@theta,T=0.03",
)


def test_an_fmu_with_blocks_answers_as_the_same_model_in_modelica(tmp_path):
    """Outputs and sensitivities, of a plant of which both are at hand."""
    plant = library_class("Twinproof.Plants.Pendulum")
    path = tmp_path / "pendulum.fmu"
    export(plant, path)
    time = np.arange(150) * 0.01
    tau = 1.2 * np.sin(4 * time) + 0.5
    still = np.zeros_like(time)
    record = Recording(time, {"tau": Channel("tau", tau), "theta": Channel("theta", still)})
    answers = []
    for source in (plant, around(path)):
        additions = [parse_addition(text, source) for text in ADDED]
        bigger = extend(source, additions)
        free = ["J", "d", "deadZone_tau.w", "gain_tau.k", "firstOrderLag_theta.T"]
        problem = match(bigger.dae, record, free=free)
        problem = replace(problem, following=("firstOrderLag_theta.x",))
        shooting = simulator_of(problem)
        start = {"theta": 0.3, "plant.theta": 0.3, "omega": -0.5, "plant.omega": -0.5}
        x0 = np.array([start.get(name, 0.0) for name in shooting.state_names])
        p = shooting.parameter_vector(problem.values)
        inputs = shooting.inputs_with_delays(problem.inputs, 0.01, p)
        run = shooting.run(x0, inputs, p, 0.01, sensitivities=True)
        order = [bigger.user_name(name) for name in shooting.state_names]
        columns = [order.index("theta"), order.index("omega"), *range(len(x0), len(x0) + 5)]
        answers.append((run.outputs, run.sensitivities[:, :, columns]))
    (y, dy), (y_fmu, dy_fmu) = answers
    # What the delayed sensor shows of the time before is guessed in two ways.
    assert y_fmu == pytest.approx(y, abs=1e-3)
    assert y_fmu[3:] == pytest.approx(y[3:], abs=1e-4)
    scale = np.max(np.abs(dy), axis=(0, 1))
    assert np.all(np.max(np.abs(dy_fmu - dy), axis=(0, 1)) < 0.01 * scale)


def test_what_is_left_out_does_not_count(fmu):
    u = command(5)
    y = machine(u)
    spoilt = y.copy()
    spoilt[300:500] = 7.0
    record = recorded(u, spoilt, 5)
    problem = match(model_of(around(fmu)), record, free=["rate"])
    experiment = Experiment.of(problem)
    counted = np.ones(len(u), dtype=bool)
    counted[300:500] = False
    part = replace(experiment.parts()[0], counted=counted)
    found = fit_together([part], experiment.guess(part.windows), problem.values)
    assert found.values["rate"] == pytest.approx(RATE, rel=0.01)
    assert found.at.rms[0] == pytest.approx(NOISE, rel=0.1)
    assert np.max(np.abs(found.at.residuals[0][300:500])) > 5


def test_extend_writes_a_system(fmu, tmp_path):
    extended = api_extend(Model.of(str(fmu)), ["Saturation@u,inverse_limit=1", "Offset@y,b=0.5"])
    with pytest.raises(InputError, match=r"\.ssp"):
        write_extended(extended, tmp_path / "new.mo")
    path = tmp_path / "new.ssp"
    assert write_extended(extended, path) == str(path)
    time = np.arange(400) * H
    with read_ssp(path) as ssp:
        run = ssp.system.simulate(inputs=(time, {"u": np.full(400, 9.0)}), step=H)
    # It settles where the limit and the offset say.
    assert run["y"][-1] == pytest.approx(1.5, abs=1e-3)


def test_names_that_modelica_does_not_allow(tmp_path):
    description = foreign.DESCRIPTION.replace('name="u"', 'name="u[1]"')
    path = foreign.hand_written(tmp_path, description)
    with pytest.raises(UnsupportedModelError, match=r"'u\[1\]'"):
        _ = Model.of(str(path)).extensible


def test_the_text_around_an_fmu_keeps_units_and_words():
    fmu = cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"))
    model, box = model_of(around(fmu)), black_box(fmu)
    for mine, theirs in zip(
        (*model.inputs, *model.outputs), (*box.inputs, *box.outputs), strict=True
    ):
        assert (mine.name, mine.unit) == (theirs.name, theirs.unit)
