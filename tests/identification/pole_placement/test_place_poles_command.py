"""`place-poles` as users and scripts meet it."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from foundation.errors import TwinproofError
from twinproof.cli.poles import place_poles

A = np.array([[1.0, 0.1], [0.3, 0.95]])
B = np.array([[0.0], [0.1]])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    rng, x, rows = np.random.default_rng(1), np.zeros(2), []
    for k in range(300):
        measured = x + 1e-3 * rng.standard_normal(2)
        u = np.array([[-20.0, -8.0]]) @ measured + rng.standard_normal(1)
        rows.append([0.02 * k, *measured, u[0], 1.0])
        x = A @ x + B @ u
    path = tmp_path_factory.mktemp("poles") / "run.csv"
    names = ["time", "x1", "x2", "u1", "spare"]
    pd.DataFrame(rows, columns=names).to_csv(path, index=False)
    return path


def invoke(*words):
    return CliRunner().invoke(place_poles, [str(w) for w in words])


def test_document(recorded):
    result = invoke(recorded, "--poles", "0.8±0.1j", "--json", "-")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["schema"] == "twinproof/place-poles/1"
    assert {"A", "B", "F", "poles", "warnings"} <= set(found)
    assert found["states"] == ["x1", "x2"]
    assert found["inputs"] == ["u1"]
    assert found["method"] == "auto"
    assert found["sample_time"] == pytest.approx(0.02)
    np.testing.assert_allclose(found["A"], A, atol=0.02)
    np.testing.assert_allclose(found["poles"], [[0.8, 0.1], [0.8, -0.1]], atol=1e-6)
    reached = np.linalg.eigvals(A + B @ np.array(found["F"]))
    assert np.max(np.abs(np.sort_complex(reached) - [0.8 - 0.1j, 0.8 + 0.1j])) < 0.03
    assert np.array(found["A_sd"]).shape == (2, 2)
    assert all(0 < sd < 0.1 for sd in found["poles_sd"])


def test_tables_and_choices(recorded, tmp_path):
    target = tmp_path / "out.json"
    words = ("--states", "x2,x1", "--inputs", "u1", "--method", "two-step", "--prefilter", "4")
    result = invoke(recorded, "--poles", "0.8,0.7", *words, "--json", target)
    assert result.exit_code == 0, result.output
    assert "u = F x + v" in result.output
    assert re.search(r"x2 +│.*±", result.output)
    found = json.loads(target.read_text())
    assert found["states"] == ["x2", "x1"]
    np.testing.assert_allclose(found["A"], A[::-1, ::-1], atol=0.02)


def test_a_negative_pole_is_no_option(recorded):
    assert invoke(recorded, "--poles", "-0.1,0.7", "--method", "two-step").exit_code == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--poles", "0.5"), "1 poles for 2 states"),
        (("--poles", "-3,-4"), "unit circle"),
        (("--poles", "0.5,0.6", "--method", "two_step"), "unknown method 'two_step'"),
        (("--poles", "0.5,0.6", "--prefilter", "0"), "prefilter of order 0"),
        (("--poles", "0.5,0.6", "--prefilter", "5000", "--method", "two-step"), "too few"),
        (("--poles", "0.5,0.6", "--states", "x1,x9"), "no channel 'x9'"),
        (("--poles", "0.5,0.6", "--states", "x1,x1"), "named twice"),
        (("--poles", "0.5,0.6", "--inputs", "spare"), "'spare' never changes"),
        (("--poles", "0.5,0.6", "--inputs", "x1"), "both a state and an input"),
        (("--poles", "0.5,0.6", "--excitation", "u1,u1"), "2 excitations for 1 inputs"),
    ],
)
def test_mistakes_are_explained(recorded, words, message):
    result = invoke(recorded, *words)
    assert isinstance(result.exception, TwinproofError)
    assert result.exception.exit_status == 2
    assert message in str(result.exception)
    assert result.exception.remedy


def test_no_state_columns(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,q,u\n0,1,2\n1,2,3\n2,1,1\n")
    result = invoke(path, "--poles", "0.5")
    assert "no channel is named x*" in str(result.exception)
    assert "--states" in str(result.exception)
