"""The workbench's project folder, channel maps and curves."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.errors import FormatError, InputError
from recordings import read_map
from twinproof.workbench import curves, mapping
from twinproof.workbench.project import Project, Step


def test_a_project_is_what_was_chosen_after_it_is_opened_again(tmp_path: Path) -> None:
    first = Project(tmp_path)
    first.choose({"model": "Twinproof.Plants.Positioner", "recording": " emps "})
    first.accept(Step(("CoulombFriction@carriage,f_c=20",), "models/P_1.mo:P_1"))
    again = Project(tmp_path).choices
    assert (again.recording, again.present_model) == ("emps", "models/P_1.mo:P_1")
    assert (
        json.loads((tmp_path / "workbench.json").read_text())["schema"] == "twinproof/workbench/1"
    )
    assert (tmp_path / ".gitignore").read_text() == ".cache/\n"
    Project(tmp_path).undo()
    assert Project(tmp_path).choices.present_model == "Twinproof.Plants.Positioner"


def test_another_model_begins_without_steps(tmp_path: Path) -> None:
    project = Project(tmp_path)
    project.choose({"model": "A"})
    project.accept(Step(("E@p",), "models/A_1.mo:A_1"))
    project.choose({"recording": "emps"})
    assert project.choices.steps
    project.choose({"model": "B"})
    assert not project.choices.steps


@pytest.mark.parametrize("text", ["{", "[]", '{"steps": [{}]}', '{"steps": 3}'])
def test_a_damaged_project_says_where(tmp_path: Path, text: str) -> None:
    (tmp_path / "workbench.json").write_text(text)
    with pytest.raises(FormatError, match=r"workbench\.json"):
        _ = Project(tmp_path).choices


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("recordings", "../run.csv"),
        ("recordings", ".hidden.csv"),
        ("recordings", "a/b.csv"),
        ("recordings", "run.exe"),
        ("models", "run.csv"),
        ("results", "run.csv"),
        ("recordings", "run.csv\n"),
    ],
)
def test_uploads_of_other_names_are_refused(tmp_path: Path, folder: str, name: str) -> None:
    with pytest.raises(InputError):
        Project(tmp_path).upload_path(folder, name)


def test_results_are_out_of_date_once_their_question_is_another(tmp_path: Path) -> None:
    project = Project(tmp_path)
    project.choose({"model": "M", "recording": "emps"})
    project.write_result("compare", {"nrmse": 1.0}, "<p>")
    found = project.result("compare")
    assert found is not None
    assert found["made_with"] == project.question()
    mapping.change_tables(project.map_file, "q", {"unit": "mm"})
    assert found["made_with"] != project.question()


def test_saying_one_thing_of_a_channel_keeps_all_others(tmp_path: Path) -> None:
    path = tmp_path / "channels.toml"
    path.write_text('[channels.q]\nsource = "qm"\ndelay = 0.002\n[time]\nunit = "ms"\n')
    mapping.change_tables(path, "q", {"unit": "mm", "sd": "1e-4"})
    mapping.change_tables(path, "v", {"source": "speed"})
    found = read_map(path)
    q = found.channels["q"]
    assert (q.source, q.unit, q.sensor.sd, q.sensor.delay) == ("qm", "mm", 1e-4, 0.002)
    assert (found.channels["v"].source, found.time.unit) == ("speed", "ms")
    mapping.change_tables(path, "v", {"source": ""})
    assert set(read_map(path).channels) == {"q"}


@pytest.mark.parametrize("said", [{"sd": "thin"}, {"sd": "-1"}, {"factor": "0"}, {"kind": "x"}])
def test_a_wrong_word_leaves_the_map_as_it_was(tmp_path: Path, said: dict[str, str]) -> None:
    path = tmp_path / "channels.toml"
    path.write_text('[channels.q]\nsource = "qm"\n')
    with pytest.raises(InputError):
        mapping.change_tables(path, "q", said)
    assert path.read_text() == '[channels.q]\nsource = "qm"\n'


def test_columns_are_suggested_by_name_description_and_unit() -> None:
    variables = {
        "theta_p": ("rad", "Pitch of the body, zero upright"),
        "omega_p": ("rad/s", "Pitch rate"),
        "V": ("V", "Motor voltage"),
        "q": ("m", "Position of the carriage"),
    }
    columns = {"Pitch": "deg", "PitchRate": "deg/s", "MotorVoltage": None, "Position": "N.m"}
    assert mapping.suggest(variables, columns) == {
        "theta_p": "Pitch",
        "omega_p": "PitchRate",
        "V": "MotorVoltage",
    }


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.floats(-1e6, 1e6, width=32), min_size=20, max_size=300),
    points=st.integers(4, 40),
)
def test_thinned_curves_have_every_extreme(values: list[float], points: int) -> None:
    record = np.array(values)
    edges = np.linspace(0, len(record), points // 2 + 1).astype(int)[:-1]
    edges = np.unique(edges)
    thin = curves.extremes(record, edges)
    group = np.searchsorted(edges, np.arange(len(record)), side="right") - 1
    by_pandas = pd.Series(record).groupby(group).agg(["min", "max"]).to_numpy().ravel()
    np.testing.assert_array_equal(thin, by_pandas)


def test_a_ten_hour_record_is_looked_at_in_an_instant(tmp_path: Path) -> None:
    n = 36_000_00  # 10 h at 100 Hz
    t = np.arange(n) / 100
    y = np.sin(t)
    y[n // 3] = 7.0
    curves.save(tmp_path, t, {"y": y}, {})
    began = time.perf_counter()
    shown, (drawn,) = curves.view(tmp_path, -np.inf, np.inf, 3000)
    seconds = time.perf_counter() - began
    assert len(shown) == len(drawn) == 3000
    assert np.max(drawn) == 7.0
    assert seconds < 1.0
    close, (whole,) = curves.view(tmp_path, 1000.0, 1001.0, 3000)
    np.testing.assert_allclose(whole, np.sin(close), atol=1e-6)
    assert len(close) == 103
