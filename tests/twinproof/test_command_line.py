"""The command line as users and their scripts meet it: keys, exit statuses, messages."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from twinproof.cli import main

MODEL = "Twinproof.Plants.Pendulum"
DEMO = Path(__file__).parents[2] / "twinproof" / "demo_data"

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    def invoke(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["twinproof", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        code = stopped.value.code
        return (code if isinstance(code, int) else 0), out, err

    return invoke


def swing(path: Path, *, seed: int, coulomb: float = 0.0, duration: float = 8.0) -> Path:
    """Write a CSV of a torque-driven pendulum, independently simulated."""
    rng = np.random.default_rng(seed)
    h, n = 0.005, round(duration / 0.005)
    inertia, mgl, d = 0.2, 3.5, 0.1
    amplitude, rate = 1.2, rng.uniform(1.5, 2.5)
    time = np.arange(n) * h
    tau = amplitude * (np.sin(rate * time) + 0.7 * np.sin(2.7 * rate * time + 1))
    theta, state = np.zeros(n), np.array([0.3, 0.0])
    for k in range(n):
        theta[k] = state[0]

        def rhs(_: float, x: np.ndarray, u: float = float(tau[k])) -> list[float]:
            friction = coulomb * np.tanh(x[1] / 0.02)
            return [x[1], (u - mgl * np.sin(x[0]) - d * x[1] - friction) / inertia]

        state = solve_ivp(rhs, (0, h), state, rtol=1e-8, atol=1e-10).y[:, -1]
    noisy = theta + 1e-3 * rng.standard_normal(n)
    pd.DataFrame({"time": time, "tau": tau, "theta": noisy, "spare": 1.0}).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return swing(tmp_path_factory.mktemp("data") / "swing.csv", seed=1, coulomb=0.15)


@pytest.fixture(scope="module")
def unseen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return swing(tmp_path_factory.mktemp("data") / "unseen.csv", seed=2, coulomb=0.15)


def keys(text: str) -> set[str]:
    document = json.loads(text)
    assert re.fullmatch(r"twinproof/[a-z-]+/1", document["schema"])
    return set(document)


def test_help_of_every_command_has_an_example(run: Run) -> None:
    status, out, _ = run("--help")
    assert status == 0
    commands = re.findall(r"^  ([a-z-]+)  ", out.split("Commands:")[1], re.MULTILINE)
    assert len(commands) >= 12
    for name in commands:
        status, out, _ = run(name, "--help")
        assert status == 0
        assert "Example:" in out or "Commands:" in out, name


def test_places_and_effects(run: Run) -> None:
    status, out, _ = run("places", MODEL, "--json", "-")
    assert status == 0
    places = {p["name"]: p for p in json.loads(out)["places"]}
    assert set(places) == {"joint", "tau", "theta", "omega"}
    assert places["joint"]["unit"] == "N.m"
    status, out, _ = run("effects", "--json", "-")
    names = {e["name"] for e in json.loads(out)["effects"]}
    assert {"CoulombFriction", "DeadZone", "QuadraticDrag", "ConstantForce"} <= names


def test_export_check_simulate(run: Run, tmp_path: Path) -> None:
    fmu = tmp_path / "p.fmu"
    status, out, _ = run("export", MODEL, "-o", fmu, "--json", "-")
    assert status == 0
    assert {"fmu", "fmi", "sha256", "variables", "seconds"} <= keys(out)
    status, out, _ = run("check", fmu, "--json", "-")
    assert status == 0
    checks = json.loads(out)["checks"]
    assert len(checks) >= 5
    assert all(c["ok"] for c in checks)
    csv = tmp_path / "out.csv"
    status, out, _ = run(
        *("simulate", fmu, "--param", "theta_start=0.1", "--param", "d=0", "--param", "J=1"),
        *("--param", "mgl=4", "--stop", "3.1415926", "--step", "0.01", "-o", csv, "--json", "-"),
    )
    assert status == 0
    assert json.loads(out)["rows"] == len(pd.read_csv(csv))
    # A small swing with ω = 2 rad/s is back after π seconds.
    assert pd.read_csv(csv)["theta"].iloc[-1] == pytest.approx(0.1, abs=1e-3)


def test_a_broken_fmu_fails_the_check(run: Run, tmp_path: Path) -> None:
    import zipfile

    run("export", MODEL, "-o", tmp_path / "p.fmu")
    with (
        zipfile.ZipFile(tmp_path / "p.fmu") as old,
        zipfile.ZipFile(tmp_path / "broken.fmu", "w") as new,
    ):
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'causality="output"', b'causality="local"')
            new.writestr(name, content)
    status, _, _ = run("check", tmp_path / "broken.fmu")
    assert status == 1


def test_people_see_units(run: Run, recorded: Path) -> None:
    status, out, _ = run("compare", MODEL, recorded)
    assert status == 0
    theta = next(line for line in out.splitlines() if "theta" in line)
    assert re.match(r"│ theta\s+│ +[\d.]+ m?rad │ +[\d.]+ % │ +−?[\d.]+ m?rad │", theta), theta
    _, failing = out.split("where it fails")
    assert re.search(r"│ [\d.]+ to [\d.]+ s │ theta .*tau −?[\d.]+ to −?[\d.]+ m?N·m", failing)
    status, out, _ = run("diagnose", MODEL, recorded)
    assert status == 0
    assert "evidence [nats]" in out
    assert "effect: CoulombFriction at joint is missing from Pendulum" in out


def test_compare(run: Run, recorded: Path) -> None:
    status, out, _ = run("compare", MODEL, recorded, "--json", "-")
    assert status == 0
    document = json.loads(out)
    assert {"channels", "worst", "horizon"} <= set(document)
    assert set(document["channels"]["theta"]) >= {"rmse", "nrmse", "bias", "white_p"}
    assert {"from", "to", "channel", "where"} <= set(document["worst"][0])
    assert any("spare" in note for note in document["notes"])


def test_identify(run: Run, recorded: Path) -> None:
    status, out, _ = run("identify", MODEL, recorded, "--json", "-")
    assert status == 0
    document = json.loads(out)
    assert {"parameters", "method", "condition_number", "channels", "warnings"} <= set(document)
    mgl = document["parameters"]["mgl"]
    assert set(mgl) == {"value", "sd", "unit", "identifiable"}
    assert mgl["value"] == pytest.approx(3.5, rel=0.05)


def test_the_whole_journey(run: Run, recorded: Path, unseen: Path, tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    json_file = tmp_path / "result.json"
    status, out, _ = run(
        "improve", MODEL, recorded, "--holdout", unseen, "-o", out_dir, "--json", json_file
    )
    assert status == 0
    assert "CoulombFriction@joint" in out
    assert re.search(r"coulombFriction_joint.tau_c │ 0\.1\d+ ± 0\.0\d+ +│ N·m", out), out
    assert "CoulombFriction at joint is missing from Pendulum" in out
    document = json.loads(json_file.read_text())
    assert {
        "verdict",
        "added",
        "ladder",
        "noise_floor",
        "ties",
        "horizon",
    } <= set(document)
    assert document["added"][0]["effect"] == "CoulombFriction"
    assert document["added"][0]["place"] == "joint"
    assert document["added"][0]["parameters"]["tau_c"] == pytest.approx(0.15, rel=0.1)
    first, last = document["ladder"][0], document["ladder"][-1]
    assert last["holdout"]["nrmse"] < 0.5 * first["holdout"]["nrmse"]
    for step in document["ladder"]:
        assert Path(step["model"]).is_file()
        assert Path(step["fmu"]).is_file()
    assert (out_dir / "report.html").is_file()
    assert len((out_dir / "ladder.csv").read_text().splitlines()) == 1 + len(document["ladder"])
    assert "improve" in (out_dir / "repeat.sh").read_text()
    # The written model is a MODEL like any other, and its defaults are the fitted values.
    name = Path(last["model"]).stem
    status, out, _ = run("compare", f"{last['model']}:{name}", unseen, "--json", "-")
    assert status == 0
    assert json.loads(out)["channels"]["theta"]["nrmse"] < 0.1


def test_extend_writes_what_loads(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "Better.mo"
    status, out, _ = run(
        *("extend", MODEL, "--add", "CoulombFriction@joint,tau_c=0.2"),
        *("--add", "DeadZone@tau,w=0.1", "-o", path, "--json", "-"),
    )
    assert status == 0
    assert {"model", "diff"} <= keys(out)
    status, out, _ = run("places", f"{path}:Better", "--json", "-")
    assert status == 0
    assert {"tau", "theta", "omega"} <= {p["name"] for p in json.loads(out)["places"]}


@pytest.mark.parametrize("command", ["compare", "diagnose"])
def test_report_option(run: Run, command: str, recorded: Path, tmp_path: Path) -> None:
    status, _, _ = run(command, MODEL, recorded, "--report", tmp_path)
    assert status == 0
    assert "<html" in (tmp_path / "report.html").read_text()


def test_can_log_with_dbc(run: Run) -> None:
    status, out, _ = run(
        *("compare", "Twinproof.Plants.WheeledPendulum", DEMO / "balancing.blf"),
        *("--map", DEMO / "channels.toml", "--dbc", DEMO / "wheeled_pendulum.dbc", "--json", "-"),
    )
    assert status == 0
    assert json.loads(out)["horizon"] == 1.0


def csv(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def rows(*lines: str) -> str:
    return "\n".join(["time,tau,theta", *lines]) + "\n"


GOOD = [f"{k / 100},{k % 7},{k % 5}" for k in range(40)]


def bad_inputs(folder: Path) -> dict[str, tuple[list[object], str]]:
    """Name → (command's words, pattern of the message)."""
    good = csv(folder / "good.csv", rows(*GOOD))
    nan = csv(folder / "nan.csv", rows(*GOOD[:5], "0.05,nan,1", *GOOD[6:]))
    back = csv(folder / "back.csv", rows(*GOOD[:5], "0.01,1,1", *GOOD[6:]))
    no_time = csv(folder / "no_time.csv", "t,tau,theta\n0,1,1\n")
    text = csv(folder / "text.csv", rows(*GOOD[:5], "0.05,fast,1", *GOOD[6:]))
    empty = csv(folder / "empty.csv", "")
    short = csv(folder / "short.csv", rows(*GOOD[:5]))
    no_input = csv(
        folder / "no_input.csv", "time,theta\n" + "".join(f"{k / 100},{k}\n" for k in range(40))
    )
    unknown_source = csv(folder / "source.toml", '[channels.theta]\nsource = "thetta"\n')
    bad_unit = csv(folder / "unit.toml", '[channels.theta]\nsource = "theta"\nunit = "kg"\n')
    bad_key = csv(folder / "key.toml", '[channels.theta]\nsorce = "theta"\n')
    empty_log = csv(folder / "empty.log", "")
    cut_log = csv(folder / "cut.log", "(0.001) can0 101#0011\n(0.002) can0 10")
    other_dbc = csv(
        folder / "other.dbc",
        'VERSION ""\nBU_: A\nBO_ 291 Other: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n',
    )
    broken_dbc = csv(folder / "broken.dbc", "this is not a DBC")
    syntax = csv(folder / "Syntax.mo", "model Syntax\n  Real x\nequation\n  x = 1;\nend Syntax;\n")
    unbalanced = csv(
        folder / "Unbalanced.mo",
        "model Unbalanced\n  Real x;\n  Real y;\nequation\n  x = 1;\nend Unbalanced;\n",
    )
    modifier = csv(
        folder / "Modifier.mo",
        "model Modifier\n  extends Twinproof.Plants.Pendulum(JJ = 2);\nend Modifier;\n",
    )
    return {
        "unknown class": (["compare", "Twinproof.Plants.Pendulun", good], r"Pendulum"),
        "no such file": (["compare", MODEL, folder / "none.csv"], r"none\.csv"),
        "unknown data set": (["compare", MODEL, "empss"], r"emps"),
        "NaN": (["compare", MODEL, nan], r"tau.*(row|line|time)"),
        "time runs back": (["compare", MODEL, back], r"(row|line).*"),
        "no time": (["compare", MODEL, no_time], r"time"),
        "text in a column": (["compare", MODEL, text], r"fast"),
        "empty file": (["compare", MODEL, empty], r"empty"),
        "too short": (["compare", MODEL, short], r"5 samples"),
        "input not recorded": (["compare", MODEL, no_input], r"tau"),
        "unknown column": (["compare", MODEL, good, "--map", unknown_source], r"thetta.*theta"),
        "unit mismatch": (["compare", MODEL, good, "--map", bad_unit], r"kg.*rad"),
        "unknown key": (["compare", MODEL, good, "--map", bad_key], r"sorce.*source"),
        "no map": (["compare", MODEL, good, "--map", folder / "none.toml"], r"none\.toml"),
        "empty log": (["compare", MODEL, empty_log, "--dbc", other_dbc], r"empty|no frame"),
        "cut log": (["compare", MODEL, cut_log, "--dbc", other_dbc], r"cut\.log"),
        "log without DBC": (["compare", MODEL, DEMO / "balancing.blf"], r"dbc|DBC"),
        "DBC of another bus": (
            ["compare", MODEL, DEMO / "balancing.blf", "--dbc", other_dbc],
            r"(?i)0x123|id",
        ),
        "broken DBC": (
            ["compare", MODEL, DEMO / "balancing.blf", "--dbc", broken_dbc],
            r"broken\.dbc",
        ),
        "syntax error": (["places", f"{syntax}:Syntax"], r"Syntax\.mo:\d+:\d+"),
        "unbalanced": (["places", f"{unbalanced}:Unbalanced"], r"Unbalanced\.mo:\d+:\d+"),
        "lost modifier": (["places", f"{modifier}:Modifier"], r"Modifier\.mo:2:\d+.*JJ"),
        "no such model file": (["places", "none.mo:X"], r"none\.mo"),
        "unknown parameter": (["compare", MODEL, good, "--param", "Q=1"], r"Q"),
        "malformed parameter": (["compare", MODEL, good, "--param", "J"], r"NAME=NUMBER"),
        "unknown free": (["identify", MODEL, good, "--free", "JJ"], r"JJ.*J"),
        "unknown method": (["identify", MODEL, good, "--method", "outputerror"], r"output-error"),
        "bad horizon": (["compare", MODEL, good, "--horizon", "long"], r"long"),
        "unknown effect": (
            ["extend", MODEL, "--add", "CoulombFrictoin@joint", "-o", folder / "x.mo"],
            r"CoulombFriction",
        ),
        "unknown place": (
            ["extend", MODEL, "--add", "CoulombFriction@joints", "-o", folder / "x.mo"],
            r"joint",
        ),
        "unknown parameter of an effect": (
            ["extend", MODEL, "--add", "CoulombFriction@joint,tau=1", "-o", folder / "x.mo"],
            r"tau_c",
        ),
        "hold-out is the fitted record": (
            ["improve", MODEL, good, "--holdout", good, "-o", folder / "out"],
            r"hold-out",
        ),
        "FMU where equations are needed": (
            ["export", "a.fmu", "-o", "b.fmu"],
            r"Modelica",
        ),
        "missing FMU": (["check", folder / "none.fmu"], r"none\.fmu"),
        "not an FMU": (["check", good], r"good\.csv"),
        "unknown target": (
            ["export", MODEL, "-o", folder / "x.fmu", "--target", "beos"],
            r"linux64",
        ),
        "unknown command": (["compar"], r"compare"),
    }


CASES = sorted(bad_inputs(Path(__import__("tempfile").mkdtemp())))


@pytest.mark.parametrize("case", CASES)
def test_bad_input(run: Run, case: str, tmp_path: Path) -> None:
    words, pattern = bad_inputs(tmp_path)[case]
    before = {p.name for p in tmp_path.iterdir()}
    status, out, err = run(*words)
    assert status == 2, f"{case}: {out}{err}"
    said = err.replace("\n", " ")
    assert re.search(pattern, said), said
    # Nothing half-written is left.
    assert {p.name for p in tmp_path.iterdir()} == before


def test_parameter_without_effect_is_a_warning(run: Run, tmp_path: Path) -> None:
    model = tmp_path / "Idle.mo"
    model.write_text(
        "model Idle\n  extends Twinproof.Plants.Pendulum;\n"
        '  parameter Real idle(unit = "1") = 2 "Does nothing";\nend Idle;\n'
    )
    data = swing(tmp_path / "swing.csv", seed=3)
    status, out, err = run("identify", f"{model}:Idle", data, "--json", "-")
    assert status == 0
    document = json.loads(out)
    assert document["parameters"]["idle"]["identifiable"] is False
    assert any("idle" in w for w in document["warnings"])
    assert "idle" in err


def test_inseparable_parameters_are_a_warning(run: Run, tmp_path: Path) -> None:
    model = tmp_path / "Twice.mo"
    model.write_text(
        "model Twice\n  extends Twinproof.Plants.Pendulum;\n"
        "  Twinproof.Effects.Rotational.ViscousFriction more;\n"
        "equation\n  connect(more.flange, joint.flange);\nend Twice;\n"
    )
    data = swing(tmp_path / "swing.csv", seed=3)
    status, out, _ = run("identify", f"{model}:Twice", data, "--json", "-")
    assert status == 0
    warnings = " ".join(json.loads(out)["warnings"])
    assert "d" in warnings
    assert "more.d" in warnings


def test_output_folder_that_cannot_be_made(run: Run, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    status, _, err = run("export", MODEL, "-o", blocked / "x.fmu")
    assert status == 2
    assert "file" in err


def test_demo_data_is_shipped() -> None:
    assert shutil.which("true")  # the fixture folder exists on any machine
    assert {p.name for p in DEMO.iterdir()} >= {
        "balancing.blf",
        "held_out.blf",
        "channels.toml",
        "wheeled_pendulum.dbc",
    }
