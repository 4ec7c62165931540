"""`twin replay` as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import asammdf
import numpy as np
import pytest
from click.testing import CliRunner
from pendulum_bus import START, TRUE, frames, motion, settings

from foundation.errors import FormatError, InputError, UnknownNameError
from twin.ingest import FrameRecorder, convert
from twinproof.cli import command

CONFIG = """
[[twin]]
name = "arm"
rate = 100
stale = "0.3 s"
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {sd = 0.01}
omega = {sd = 0.03}
[twin.estimator]
disturbances = {tau = 0.02}
[twin.drift]
diagnose = 0.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    settings(tmp_path)
    (tmp_path / "line.toml").write_text(CONFIG)
    recorder = FrameRecorder(tmp_path / "log")
    recorder.write(frames(motion(25, 9, lambda t: {"mgl": 1.15 * TRUE["mgl"]} if t > 15 else {})))
    recorder.close()
    return tmp_path


def _run(*words: str) -> str:
    result = CliRunner().invoke(command, ["twin", "replay", *words], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.stdout


def test_its_document_has_the_keys_that_scripts_rely_on(folder: Path) -> None:
    found = json.loads(_run(str(folder / "line.toml"), str(folder / "log"), "--json", "-"))
    assert found["schema"] == "twinproof/twin-replay/1"
    assert {"state", "parameters", "drift", "events"} <= set(found)
    assert found["state"] == "drifted"
    assert set(found["parameters"]) == set(TRUE)
    assert found["parameters"]["mgl"]["verified"] == TRUE["mgl"]
    assert found["drift"]["parameter"] == "mgl"
    drift = next(e for e in found["events"] if e["kind"] == "drift")
    assert START + 15 < drift["time"] < START + 20
    assert found["counts"]["received"] == 5000


def test_people_get_tables(folder: Path) -> None:
    shown = _run(str(folder / "line.toml"), str(folder / "log"))
    assert "mgl" in shown
    assert "drift" in shown


def test_a_bus_log_in_mf4_says_the_same(folder: Path) -> None:
    (log,) = (folder / "log").glob("*.log")
    convert(log, folder / "run.mf4")
    config = str(folder / "line.toml")
    one = json.loads(_run(config, str(folder / "log"), "--json", "-"))
    other = json.loads(_run(config, str(folder / "run.mf4"), "--json", "-"))
    assert other["counts"] == one["counts"]
    assert other["drift"]["parameter"] == "mgl"
    assert other["span"] == pytest.approx(one["span"], abs=1e-3)
    for name, found in one["parameters"].items():
        assert other["parameters"][name]["value"] == pytest.approx(found["value"], rel=1e-3)


def test_signals_in_mf4_are_no_bus_log(folder: Path) -> None:
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(np.zeros(3), np.arange(3.0), name="tau")])
        file.save(folder / "signals.mf4")
    with pytest.raises(FormatError, match=r"no CAN frame.*replay a bus log"):
        _run(str(folder / "line.toml"), str(folder / "signals.mf4"))


@pytest.mark.parametrize(
    ("words", "error", "said"),
    [
        (["line.toml", "fit.json"], FormatError, "fit.json"),
        (["line.toml", "log", "--twin", "leg"], UnknownNameError, "arm"),
        (["none.toml", "log"], InputError, "none.toml"),
        (["line.toml", "."], InputError, "no recording"),
    ],
)
def test_mistakes_are_named(
    folder: Path, words: list[str], error: type[Exception], said: str
) -> None:
    (folder / "none").mkdir()
    paths = [str(folder / words[0]), str(folder / words[1]), *words[2:]]
    with pytest.raises(error, match=said):
        _run(*paths)


def test_sensors_of_unknown_noise_and_buses_without_the_signals_are_named(folder: Path) -> None:
    config = folder / "line.toml"
    config.write_text(CONFIG.replace("omega = {sd = 0.03}", ""))
    with pytest.raises(InputError, match=r"noise of 'omega'.*\[twin\.plant\.sensors\.omega\]"):
        _run(str(config), str(folder / "log"))
    config.write_text(CONFIG + '[twin.bus]\ndbc = "other.dbc"\n')
    (folder / "other.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 5 M: 8 A\n SG_ x : 0|8@1+ (1,0) [0|0] "" A\n'
    )
    with pytest.raises(InputError, match="no bus carries tau"):
        _run(str(config), str(folder / "log"))
