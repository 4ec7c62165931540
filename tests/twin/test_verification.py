"""Verification: the deployed controller in a what-if study of the plant as it is now."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scripted import CONTROLLER
from scripted import STUDY as SHORT

from foundation.errors import InputError, UnknownNameError
from hil.plants import plant_of
from hil.settings import parse_toml
from hil.study import read_study
from hil.whatif import run_study
from twin.store.documents import ParameterSet
from twin.verification import Job, controller_hash, file_hash, study_for, study_hash, verify

MODEL = "Twinproof.Plants.Pendulum"
# Long enough for a controller to bring the plant out of bounds.
STUDY = SHORT.replace("duration = 0.5", "duration = 1.0")


@pytest.fixture(scope="module")
def fmu():
    return plant_of(parse_toml(f'model = "{MODEL}"')).fmu


@pytest.fixture
def job(tmp_path, fmu):
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "pid.toml").write_text(CONTROLLER)
    values = {"J": 0.5, "mgl": 2.0, "d": 0.1}
    covariance = ((1e-4, 5e-4), (5e-4, 1e-2))
    parameters = ParameterSet("robot", 4.0, file_hash(fmu), ("J", "mgl"), values, covariance)
    return Job(parameters, MODEL, tmp_path / "study.toml", tmp_path / "pid.toml", 12)


def test_a_controller_that_holds_passes(job):
    found = verify(job, lambda: 77.0, workers=0)
    assert found.passed
    assert found.time == 77.0
    assert (found.detail["runs"], found.detail["passed"]) == (12, 12)
    assert found.parameters == job.parameters.id
    assert found.controller == controller_hash(job.controller)
    # What the plants were drawn from is what the gate will compare with.
    np.testing.assert_allclose(found.covariance, [[4e-4, 2e-3], [2e-3, 4e-2]])
    json.dumps(found.document(), allow_nan=False)


def test_one_that_does_not_is_refused_with_its_worst_runs(job):
    job.controller.write_text(CONTROLLER.replace("= 5.0", "= -50.0"))
    found = verify(job, lambda: 0.0, workers=0)
    assert not found.passed
    assert found.detail["passed"] == 0
    worst = found.detail["worst"]
    assert worst[0]["failed"][0]["name"] == "stays in bounds"
    assert set(worst[0]["parameters"]) >= {"J", "mgl"}
    json.dumps(found.document(), allow_nan=False)


def test_plants_are_drawn_from_the_widened_covariance(job):
    study = study_for(replace(job, draws=2000))
    drawn = [study.parameters(k) for k in range(1, 2000)]
    assert study.parameters(0) == dict(job.parameters.values)
    found = np.cov(np.array([[p["J"], p["mgl"]] for p in drawn]).T)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), [2e-2, 2e-1], rtol=0.06)
    assert {p["d"] for p in drawn} == {0.1}


def test_the_study_runs_as_the_what_if_command_would_run_it(job, tmp_path):
    fit = {
        "parameters": {
            "J": {"value": 0.5, "sd": 0.02},
            "mgl": {"value": 2.0, "sd": 0.2},
            "d": {"value": 0.1, "sd": None},
        },
        "covariance": {"names": ["J", "mgl"], "matrix": [[4e-4, 2e-3], [2e-3, 4e-2]]},
    }
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    text = STUDY.replace(f'model = "{MODEL}"', f'model = "{MODEL}"\nparameters_from = "fit.json"')
    controller = STUDY[STUDY.index("kind") : STUDY.index("[references")]
    text = text.replace(controller, CONTROLLER) + "\n[plants]\ndraws = 12\n"
    (tmp_path / "plain.toml").write_text(text)
    plain = run_study(read_study(tmp_path / "plain.toml"), workers=0)
    study = study_for(job)
    ours = run_study(study, workers=0, results=tmp_path / "ours.jsonl")
    for a, b in zip(plain.runs, ours.runs, strict=True):
        assert a.parameters == pytest.approx(b.parameters, rel=1e-12)
        assert [v.value for v in a.verdicts] == pytest.approx([v.value for v in b.verdicts])


def test_hashes_tell_what_was_verified(job, tmp_path):
    before = controller_hash(job.controller)
    assert before == file_hash(job.controller)
    job.controller.write_text(job.controller.read_text() + "# another\n")
    assert controller_hash(job.controller) != before
    # A controller that is a model changes with the model, too.
    (tmp_path / "law.mo").write_text("model Law end Law;")
    job.controller.write_text('kind = "fmu"\nmodel = "law.mo:Law"\n')
    named = controller_hash(job.controller)
    (tmp_path / "law.mo").write_text("model Law Real x = 1; end Law;")
    assert controller_hash(job.controller) != named
    study = study_hash(job.study, 12, 2.0)
    assert study_hash(job.study, 13, 2.0) != study
    assert study_hash(job.study, 12, 3.0) != study
    job.study.write_text(STUDY + "\n# changed\n")
    assert study_hash(job.study, 12, 2.0) != study


def test_another_model_or_parameter_is_not_verified_by_mistake(job):
    with pytest.raises(InputError, match="model has changed"):
        verify(replace(job, parameters=replace(job.parameters, model="x")), lambda: 0.0, workers=0)
    foreign = replace(job.parameters, names=(), covariance=(), values={"K": 1.0})
    with pytest.raises(UnknownNameError, match="'K'"):
        verify(replace(job, parameters=foreign), lambda: 0.0, workers=0)
    with pytest.raises(InputError, match="cannot be read"):
        verify(replace(job, controller=job.controller.with_name("no.toml")), lambda: 0.0, workers=0)
