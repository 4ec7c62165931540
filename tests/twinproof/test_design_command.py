"""`twinproof design` as users and their scripts meet it."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from twinproof.cli import main

MODEL = "Twinproof.Plants.Pendulum"


@pytest.fixture
def run(monkeypatch, capsys):
    def invoke(*words):
        monkeypatch.setattr(sys, "argv", ["twinproof", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return stopped.value.code or 0, out, err

    return invoke


def test_a_plan_is_written_and_judged_alike_when_read_back(run, tmp_path):
    path = tmp_path / "input.csv"
    code, out, _ = run(
        *("design", MODEL, "--amplitude", "1.5", "--band", "0.2,4", "--duration", "4"),
        *("--step", "0.002", "--limit", "theta=-1:1", "--sd", "theta=1e-3", "--json", "-"),
        *("-o", path),
    )
    assert code == 0
    plan = json.loads(out)
    assert plan["schema"] == "twinproof/design/1"
    assert set(plan["parameters"]) == {"J", "mgl", "d"}
    assert plan["peaks"]["theta"][1] <= 1
    assert plan["unseen"] == []
    frame = pd.read_csv(path)
    assert list(frame.columns) == ["time", "tau", "theta"]
    assert np.max(np.abs(frame["tau"])) <= 1.5
    sensor = tmp_path / "map.toml"
    sensor.write_text("[channels.theta]\nsd = 1e-3\n")
    code, out, _ = run("design", MODEL, path, "--map", sensor, "--json", "-")
    assert code == 0
    judged = json.loads(out)
    assert "family" not in judged
    for name, row in plan["parameters"].items():
        # The record is judged in windows of 1 s with an unknown state each.
        assert row["sd"] * 0.99 < judged["parameters"][name]["sd"] < 20 * row["sd"]


def test_mistakes_cost_one_line(run):
    code, _, err = run("design", MODEL)
    assert (code, err.count("\n")) == (2, 1)
    assert "--amplitude" in err
    for words in (
        ("--amplitude", "big"),
        ("--amplitude", "1", "--band", "3"),
        ("--amplitude", "1", "--limit", "theta=up"),
        ("--amplitude", "1", "--sd", "q=1"),
    ):
        code, _, err = run("design", MODEL, *words)
        assert code == 2, words
        assert err.startswith("twinproof: ")
