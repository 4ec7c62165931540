"""`demo --live`: how it is told and broken off; the whole of it is in tests/twin/test_story."""

import json
import os
import signal
import subprocess
import sys

import pytest
from click.testing import CliRunner

from foundation.errors import ComputationError, InputError
from twin.audit import Entry
from twinproof.cli import command
from twinproof.cli.demo import told_document
from twinproof.story import StoryFiles, Telling, Told, tell_live

EFFECT = {"effect": "CoulombFriction@joint"}
PASSED = {"passed": True, "runs": 20, "runs_passed": 20, "evidence": "e" * 64, "effect": None}
REFUSED = {"passed": False, "runs": 20, "runs_passed": 3, "evidence": "e" * 64, "effect": None}
NAMED = {
    "verdict": "effect",
    "name": "CoulombFriction@joint",
    "parameters": {"tau_c": 0.3},
    "evidence": 96.0,
}
DRIFT = {"parameter": "d", "statistic": -9.1, "threshold": 5.8, "named": False}


def entry(time, kind, **detail):
    return Entry(1, float(time), float(time), "arm", kind, json.dumps(detail))


def gate(time, allowed):
    return entry(time, "gate", allowed=allowed, because="so it is")


def until_named():
    return [
        entry(0, "verification", **PASSED),
        gate(5, allowed=True),
        entry(20, "drift", **DRIFT),
        gate(20, allowed=False),
        entry(32, "diagnosis", **NAMED),
    ]


def test_a_story_that_ends_well():
    telling = Telling()
    lines = [telling.take(e) for e in until_named()]
    assert "20 of 20 runs" in lines[0]
    assert "9.1 standard deviations of 5.8" in lines[2]
    assert "CoulombFriction@joint (tau_c = 0.3)" in lines[4]
    assert telling.awaited == "the controller is judged on the improved model"
    telling.take(entry(35, "verification", **PASSED | EFFECT))
    assert telling.ending == ""
    telling.take(gate(40, allowed=True))
    assert (telling.ending, telling.awaited) == ("opened", "")
    assert list(telling.chapters.values()) == [5.0, 20.0, 20.0, 32.0, 35.0, 40.0]


def test_a_story_that_ends_with_a_refusal():
    telling = Telling()
    for e in until_named():
        telling.take(e)
    assert "REFUSED: 3 of 20" in telling.take(entry(35, "verification", **REFUSED | EFFECT))
    assert telling.ending == "refused"


def test_what_is_not_the_story_does_not_end_it():
    telling = Telling()
    # A gate that opens after a verification on the old model, without the effect.
    for e in until_named()[:-1]:
        telling.take(e)
    telling.take(entry(33, "verification", **PASSED))
    telling.take(gate(38, allowed=True))
    assert telling.ending == ""
    assert telling.awaited == "the effect is named"
    telling.take(until_named()[-1])
    telling.take(entry(41, "verification", **REFUSED))
    assert telling.ending == ""


def test_its_document():
    telling = Telling()
    entries = tuple(until_named())
    for e in entries:
        telling.take(e)
    found = told_document(Told(telling, entries, 1.0, 50.0), "somewhere")
    assert found["schema"] == "twinproof/demo-live/1"
    assert found["chapters"][0] == {"chapter": "the gate is open", "seconds": 4.0}
    assert [e["kind"] for e in found["events"]][1:3] == ["gate", "drift"]


def test_a_folder_of_somebody_else_is_left_alone(tmp_path):
    story = StoryFiles.bundled()
    (tmp_path / "config.toml").write_text("[service]\n")
    found = CliRunner().invoke(command, ["demo", "--live", "-o", str(tmp_path)])
    assert isinstance(found.exception, InputError)
    assert "choose another folder" in str(found.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["config.toml"]
    (tmp_path / "config.toml").unlink()
    story.write(tmp_path)
    (tmp_path / "twin.db").write_text("of the last story")
    story.write(tmp_path)
    assert not (tmp_path / "twin.db").exists()


def test_a_story_that_does_not_come_to_its_end(tmp_path):
    said = []
    with pytest.raises(ComputationError, match="still waits for 'the gate is open'"):
        tell_live(tmp_path, lambda *words: said.append(words), patience=0.2)
    assert "watch it: http://127.0.0.1:" in said[0][1]
    # What had happened by then can be looked at: the arm's recording and the service's log.
    assert (tmp_path / "bus.log").stat().st_size > 0
    assert '"stopped"' in (tmp_path / "service.log").read_text()


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_it_runs_and_ends_in_order_at_ctrl_c(tmp_path):
    # A run in the background of a script ignores Ctrl-C, and so would what it starts.
    heeding = (
        "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "runpy.run_module('twinproof', run_name='__main__', alter_sys=True)"
    )
    words = (sys.executable, "-c", heeding, "demo", "--live", "-o", str(tmp_path / "live"))
    # A group of its own: the signal reaches its processes as a terminal's would.
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        told = []
        for line in process.stdout:
            told.append(line)
            if "the gate is CLOSED" in line:
                break
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert errors.rstrip().endswith("twinproof: stopped")
    audit = ["twin", "audit", str(tmp_path / "live" / "config.toml"), "--json", "-"]
    found = json.loads(CliRunner().invoke(command, audit).stdout)
    assert found["intact"] is True
    assert found["events"] > len(told) - 1
