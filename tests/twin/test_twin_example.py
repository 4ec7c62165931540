"""The example and the guide: what they say can be done."""

import configparser
import re
import shutil
from pathlib import Path

import pytest

from twin.pipeline import Pipeline
from twin.settings import ServiceSettings, VerificationSettings, read_settings
from twin.store import ParameterSet
from twin.verification import Job, file_hash, verify

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "twin"
GUIDE = (ROOT / "docs" / "twin.md").read_text()


@pytest.fixture
def example(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "twin")
    return read_settings(tmp_path / "twin" / "arm.toml")


def test_the_example_can_be_followed_and_its_controller_passes(example):
    (twin,) = example.twins
    fit, v = twin.plant.fit, twin.verification
    set_ = ParameterSet(
        twin.name,
        0.0,
        file_hash(twin.plant.fmu),
        fit.names,
        fit.values,
        tuple(map(tuple, fit.covariance.tolist())),
    )
    assert Pipeline(twin, set_).newest is None
    job = Job(set_, twin.plant.model, twin.file(v.study), twin.file(v.controller), 10)
    evidence = verify(job, lambda: 0.0, workers=0)
    assert evidence.passed, evidence.detail["worst"]


def test_the_guide_names_every_key_of_service_and_verification():
    for line, kind in (
        ("[service]", ServiceSettings),
        ("[twin.verification]", VerificationSettings),
    ):
        row = next(r for r in GUIDE.splitlines() if r.startswith(f"| `{line}`"))
        named = set(re.findall(r"`(\w+)`", row)) | {"listen"}
        assert set(kind.__dataclass_fields__) <= named


def test_the_unit_serves_and_reloads():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read_string((EXAMPLE / "twinproof-twin@.service").read_text())
    assert unit["Service"]["ExecStart"].endswith("twinproof twin serve config.toml")
    assert "HUP" in unit["Service"]["ExecReload"]
    assert unit["Service"]["Restart"] == "always"
