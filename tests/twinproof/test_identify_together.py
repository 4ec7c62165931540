"""`identify --also --prior` as users and their scripts meet it."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from twinproof.cli import main

MODEL = "Twinproof.Plants.Pendulum"
INERTIA, MGL, DAMPING = 0.2, 3.5, 0.1


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


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Three files of one pendulum, let go from other angles."""
    folder, time = tmp_path_factory.mktemp("data"), np.arange(800) * 0.005
    paths = []
    for k, angle in enumerate((0.4, -0.9, 1.3)):

        def rates(_, x):
            return [x[1], (0.1 - MGL * np.sin(x[0]) - DAMPING * x[1]) / INERTIA]

        span = (0.0, float(time[-1]))
        theta = solve_ivp(rates, span, [angle, 0], t_eval=time, rtol=1e-9, atol=1e-11).y[0]
        theta = theta + 1e-3 * np.random.default_rng(k).standard_normal(len(time))
        table = pd.DataFrame({"time": time, "tau": 0.1, "theta": theta})
        paths.append(folder / f"swing_{k}.csv")
        table.to_csv(paths[-1], index=False)
    return paths


def test_keys_stay_and_records_join(run, records):
    first, second, third = records
    status, out, _ = run("identify", MODEL, first, "--json", "-")
    assert status == 0
    alone = json.loads(out)
    command = ["identify", MODEL, first, "--also", second, "--also", third]
    status, out, _ = run(*command, "--json", "-")
    assert status == 0
    together = json.loads(out)
    assert set(together) == set(alone)
    assert together["method"] == "output-error"
    assert set(together["records"][0]) == {"data", "samples", "channels", "nrmse", "horizon"}
    assert len({record["horizon"] for record in together["records"]}) == 1
    for record, path in zip(together["records"], records, strict=True):
        assert path.name in record["data"]
        assert record["samples"] == 800
        assert record["channels"]["theta"]["rmse"] == pytest.approx(1e-3, rel=0.2)
    assert together["channels"] == together["records"][0]["channels"]
    assert [record["channels"] for record in alone["records"]] == [alone["channels"]]
    for name, value in {"J": INERTIA, "mgl": MGL, "d": DAMPING}.items():
        found = together["parameters"][name]
        assert abs(found["value"] - value) < 4 * found["sd"] < 0.2 * value, name


@pytest.mark.parametrize("word", ["mgl=3.4±1e-5", "mgl=3.4,1e-5"])
def test_a_prior_holds_what_it_is_sure_of(run, records, word):
    status, out, err = run("identify", MODEL, records[0], "--prior", word, "--json", "-")
    assert status == 0
    mgl = json.loads(out)["parameters"]["mgl"]
    assert mgl["value"] == pytest.approx(3.4, abs=1e-3)
    assert mgl["sd"] == pytest.approx(1e-5, rel=0.1)
    assert "mgl is known from its prior" in err


def test_tables_and_report_name_every_record(run, records, tmp_path):
    status, out, _ = run(
        *("identify", MODEL, records[0], "--also", records[1], "--report", tmp_path)
    )
    assert status == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for path in records[:2]:
        assert path.name in out
    assert records[1].name in page.replace("\u200b", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--prior", "mgl=3.4"], "mgl=3.4±0.5|VALUE±SD"),
        (["--prior", "mgl=3.4±0"], "standard deviation above 0"),
        (["--prior", "mgk=3.4±1"], "did you mean mgl"),
        (["--prior", "mgl=3±1", "--prior", "mgl=4±1"], "two priors of mgl"),
        (["--prior", "mgl=3±1", "--method", "kalman"], "--method output-error"),
        (["--also", "SECOND", "--method", "output-filter"], "--method output-error"),
        (["--also", "FIRST"], "given twice"),
        (["--also", "absent.csv"], "absent.csv"),
    ],
)
def test_mistakes_are_answered_in_one_line(run, records, words, said):
    files = {"FIRST": records[0], "SECOND": records[1]}
    status, out, err = run("identify", MODEL, records[0], *(files.get(w, w) for w in words))
    assert status == 2
    assert out == ""
    assert any(part in err for part in said.split("|")), err
    assert len(err.strip().splitlines()) == 1


def test_diagnose_and_improve_take_several_records(run, records, tmp_path):
    first, second, third = records
    command = ("diagnose", MODEL, first, "--also", second, "--json", "-")
    status, out, _ = run(*command)
    assert status == 0
    found = json.loads(out)
    assert found["verdict"] == "complete"
    assert [r["samples"] for r in found["records"]] == [800, 800]
    assert found["channels"] == found["records"][0]["channels"]
    # Gravity's share of the damping is all that a model without damping lacks.
    held = ("--free", "J,mgl", "--param", "d=0", "--max-effects", 1, "-o", tmp_path)
    command = ("improve", MODEL, first, "--also", second, "--holdout", third, *held, "--json", "-")
    status, out, _ = run(*command)
    assert status == 0
    found = json.loads(out)
    assert [a["effect"] for a in found["added"]] == ["ViscousFriction"]
    assert second.name in found["also"][0]
    errors = [step["also"][0]["channels"]["theta"]["rmse"] for step in found["ladder"]]
    assert errors[1] == pytest.approx(1e-3, rel=0.2)
    assert errors[0] > 10 * errors[1]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert second.name in page.replace("\u200b", "")


@pytest.mark.parametrize(
    "extra", [["--also", "FIRST"], ["--also", "SECOND", "--holdout", "SECOND"]]
)
def test_a_record_is_fitted_once_and_not_judged_by(run, records, tmp_path, extra):
    files = {"FIRST": records[0], "SECOND": records[1]}
    words = [files.get(w, w) for w in extra]
    holdout = [] if "--holdout" in extra else ["--holdout", records[2]]
    status, out, err = run("improve", MODEL, records[0], *words, *holdout, "-o", tmp_path / "no")
    assert status == 2
    assert out == ""
    assert "given twice" in err or "hold-out" in err
    assert not (tmp_path / "no").exists()


def test_verified_parameters_are_asked_whether_they_moved(run, records, tmp_path):
    verified = tmp_path / "verified.json"
    status, _, _ = run("identify", MODEL, records[0], "--json", verified)
    assert status == 0
    status, out, _ = run("diagnose", MODEL, records[1], "--verified", verified, "--json", "-")
    assert status == 0
    drifted = json.loads(out)["drifted"]
    assert drifted["verdict"] == "nothing"
    assert {name for one in drifted["moved"] for name in one["parameters"]} == {"J", "mgl", "d"}


@pytest.mark.parametrize("text", ["{", "{}", '{"parameters": 3}', None])
def test_what_is_no_document_of_identify_is_refused(run, records, tmp_path, text):
    path = tmp_path / "verified.json"
    if text is not None:
        path.write_text(text)
    status, out, err = run("diagnose", MODEL, records[0], "--verified", path)
    assert status == 2
    assert out == ""
    assert "identify" in err
    assert len(err.strip().splitlines()) == 1
