"""The workbench's server: bad requests leave nothing, and strangers are refused."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.twinproof.workbench.conftest import START, Running


def ask(
    workbench: Running,
    method: str,
    path: str,
    body: bytes | None = None,
    headers: Mapping[str, str] | None = None,
) -> tuple[int, Any]:
    request = urllib.request.Request(
        workbench.url + path, data=body, method=method, headers=dict(headers or {})
    )
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            content = answer.read()
            status = answer.status
    except urllib.error.HTTPError as error:
        content, status = error.read(), error.code
        error.close()
    try:
        return status, json.loads(content)
    except ValueError:
        return status, content


def change(workbench: Running, **fields: str) -> tuple[int, Any]:
    return ask(workbench, "PATCH", "api/state", json.dumps(fields).encode())


@pytest.fixture(autouse=True)
def _a_new_project(workbench: Running) -> None:
    """Empty the project of the tests before."""
    settled(workbench)
    workbench.clear()


def settled(workbench: Running) -> Any:
    """Wait until nothing runs; return the state."""
    for _ in range(600):
        status, state = ask(workbench, "GET", "api/state")
        assert status == 200, state
        running = state["job"] is not None and state["job"]["status"] == "running"
        if not running and not state["looking"]:
            return state
        time.sleep(0.1)
    raise AssertionError("the task does not end")


def test_strangers_are_refused(workbench: Running) -> None:
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        status, said = ask(workbench, "GET", "api/state", headers=headers)
        assert status == 403, said
    status, _ = ask(workbench, "POST", "api/demo", b"", {"Origin": "http://evil.example"})
    assert status == 403
    assert not (workbench.folder / "recordings").exists()


def test_only_results_can_be_downloaded(workbench: Running) -> None:
    (workbench.folder / "secret.mo").write_text("x")
    for path in ("files/workbench.json", "files/../secret.mo", "files/%2e%2e/secret.mo"):
        assert ask(workbench, "GET", path)[0] == 404
    (workbench.folder / "models").mkdir()
    (workbench.folder / "models" / "A.mo").write_text("model A end A;")
    assert ask(workbench, "GET", "files/models/A.mo") == (200, b"model A end A;")


def test_uploads_are_whole_or_absent(workbench: Running) -> None:
    assert ask(workbench, "PUT", "upload/recordings/my%20run.csv", b"time,q\n0,1\n1,2\n") == (
        200,
        {"word": "recordings/my run.csv"},
    )
    for name, body in (("run.exe", b"x"), ("empty.csv", b""), ("%2e%2e%2fx.csv", b"x")):
        status, said = ask(workbench, "PUT", f"upload/recordings/{name}", body)
        assert (status, bool(said["what"]), bool(said["remedy"])) == (422, True, True)
    assert [p.name for p in (workbench.folder / "recordings").iterdir()] == ["my run.csv"]


@pytest.mark.parametrize(
    ("field", "word", "said"),
    [
        ("model", "Twinproof.Plants.Positoner", "Positioner"),
        ("model", "nothing.fmu", "nothing.fmu"),
        ("model", "3 apples", "neither a file nor a Modelica class"),
        ("recording", "nothing.csv", "no such file"),
        ("recording", "recordings/bad.csv", ""),
        ("recording", "recordings/bad.mf4", ""),
        ("recording", "recordings/bad.parquet", ""),
        ("recording", "recordings/bad.mat", ""),
        ("recording", "recordings/bad.blf", ""),
        ("holdout", "emp", "emps"),
        ("dbc", "nothing.dbc", "nothing.dbc"),
        ("also", "nothing.csv", "no such file"),
        ("also", "recordings/other.csv, recordings/run.csv", "run.csv is given twice"),
        ("also", "recordings/short.csv", "vir in recordings/short.csv"),
        ("libraries", "nowhere", "no such folder"),
        ("libraries", "recordings", "no Modelica package"),
        ("libraries", "lab/Lab", "the folder that it is in"),
        ("horizon", "soon", "auto, free"),
        ("horizon", "-1", "auto, free"),
    ],
)
def test_a_wrong_word_is_told_at_its_field(
    workbench: Running, field: str, word: str, said: str
) -> None:
    folder = workbench.folder / "recordings"
    folder.mkdir()
    rows = "".join(f"{k},0,{k}\n" for k in range(30))
    (folder / "run.csv").write_text("time,vir,q\n" + rows)
    (folder / "other.csv").write_text("time,vir,q\n" + rows.replace("9", "8"))
    (folder / "short.csv").write_text("time,volts,q\n" + rows)
    (workbench.folder / "lab" / "Lab").mkdir(parents=True)
    (workbench.folder / "lab" / "Lab" / "package.mo").write_text("package Lab end Lab;")
    if word.startswith("recordings/bad."):
        (workbench.folder / word).write_bytes(b"\x00\xffnot what the name says\n")
    change(workbench, model="Twinproof.Plants.Positioner", recording="recordings/run.csv")
    settled(workbench)
    assert change(workbench, **{field: word})[0] == 200
    state = settled(workbench)
    error = state["look"]["errors"][field]
    assert said in f"{error['what']} {error['where']} {error['remedy']}"
    assert error["what"]
    # What was typed is kept.
    assert state["choices"][field] == word


def test_a_wrong_unit_is_told_at_its_channel(workbench: Running) -> None:
    (workbench.folder / "recordings").mkdir()
    text = "time,vir,q\n" + "".join(f"{k},0,{k}\n" for k in range(30))
    (workbench.folder / "recordings" / "run.csv").write_text(text)
    change(workbench, model="Twinproof.Plants.Positioner", recording="recordings/run.csv")

    def row() -> Any:
        found = settled(workbench)["look"]["recording"]["rows"]
        return next(r for r in found if r["name"] == "q")

    for said, expected in (
        ({"unit": "kg"}, "cannot be converted"),
        ({"unit": "smoot"}, "not known"),
        ({"unit": "mm", "source": "qq"}, "no column 'qq'"),
    ):
        ask(workbench, "PATCH", "api/channels/q", json.dumps(said).encode())
        assert expected in row()["error"]
    ask(workbench, "PATCH", "api/channels/q", b'{"source": "q", "unit": "mm"}')
    good = row()
    assert good["error"] == ""
    assert good["preview"]["most"] == pytest.approx(0.029)
    status, said = ask(workbench, "PATCH", "api/channels/q", b'{"sd": "thin"}')
    assert (status, "no number" in said["what"]) == (422, True)


def test_a_task_without_its_input_names_the_field(workbench: Running) -> None:
    for task, field in (("compare", "model"), ("export", "model")):
        ask(workbench, "POST", "api/jobs", json.dumps({"task": task}).encode())
        job = settled(workbench)["job"]
        assert (job["status"], job["error"]["field"]) == ("failed", field)
    change(workbench, model="Twinproof.Plants.Positioner", recording="emps", horizon="soon")
    status, _ = ask(workbench, "POST", "api/jobs", b'{"task": "improve"}')
    assert status == 200
    job = settled(workbench)["job"]
    assert (job["status"], job["error"]["field"]) == ("failed", "holdout")
    assert ask(workbench, "POST", "api/jobs", b'{"task": "rm"}')[0] == 422
    assert ask(workbench, "POST", "api/steps", b"")[0] == 422
    assert ask(workbench, "PATCH", "api/state", b"[]")[0] == 422
    assert change(workbench, nonsense="x")[0] == 422


def test_a_task_is_seen_running_while_a_look_waits_for_it(workbench: Running) -> None:
    assert ask(workbench, "POST", "api/demo", b"")[0] == 200
    settled(workbench)
    assert ask(workbench, "POST", "api/jobs", b'{"task": "diagnose"}')[0] == 200
    _, state = change(workbench, max_effects="1")
    assert (state["job"]["task"], state["job"]["status"]) == ("diagnose", "running")
    ask(workbench, "DELETE", "api/jobs")
    assert settled(workbench)["choices"]["max_effects"] == "1"


def test_a_taken_port_is_said_in_one_line(workbench: Running, tmp_path: Path) -> None:
    port = workbench.url.rstrip("/").rpartition(":")[2]
    again = subprocess.run(
        [sys.executable, "-c", START, "workbench", str(tmp_path / "b"), "--port", port],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert again.returncode == 2
    assert f"port {port} cannot be used" in again.stderr
    assert again.stderr.count("\n") == 1
