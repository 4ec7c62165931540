"""`twinproof twin …`, against a service that is really served."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import can
import pytest
from click.testing import CliRunner
from pendulum_bus import frames, motion
from scripted import CONTROLLER, STUDY, drift, scripted_service, settle

from foundation.errors import InputError
from hil.bus.bridge import bridged_terminals
from hil.bus.interface import BusSettings, open_bus
from hil.settings import read_toml
from twin.api import make_app, served
from twin.ingest.buses import BusSource
from twin.settings import settings_of
from twin.store import Store
from twin.tokens import Tokens, read_tokens
from twinproof.cli import command


def run(*words, **env):
    return CliRunner().invoke(command, [str(w) for w in words], standalone_mode=False, env=env)


def answer(result):
    return json.loads(result.stdout)


@pytest.fixture
def site(tmp_path):
    with scripted_service(tmp_path) as service:
        settle(service)
        with served(make_app(service, Tokens())) as server:
            yield service, server.url, server


def gate(site, controller="pid.toml", name="robot", **env):
    service, base, _ = site
    file = service.settings.path.parent / controller
    words = ("twin", "gate", "--controller", file, "--twin", name, "--url", base, "--json", "-")
    return run(*words, **env)


def test_the_gate_s_exit_status_is_its_answer(site):
    service, _, server = site
    found = gate(site)
    assert found.return_value == 0
    assert answer(found)["schema"] == "twinproof/twin-gate/1"
    assert answer(found)["allowed"] is True
    assert answer(found)["evidence"] == service.monitor("robot").decide().evidence
    other = gate(site, "study.toml")
    assert other.return_value == 1
    assert "another controller" in answer(other)["because"]
    assert isinstance(gate(site, name="nobody").exception, InputError)
    assert isinstance(gate(site, "missing.toml").exception, InputError)
    service.monitor("robot").feed([drift(service.clock.now)])
    assert gate(site).return_value == 1
    server.end()
    time.sleep(0.3)
    silent = gate(site)
    assert silent.return_value == 1
    assert "does not answer" in answer(silent)["because"]


def test_the_gate_is_closed_if_something_else_answers(tmp_path, site):
    from http.server import BaseHTTPRequestHandler, HTTPServer
    from threading import Thread

    class Other(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b'["allowed", true]')

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Other) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}"
        controller = site[0].settings.path.parent / "pid.toml"
        words = ("twin", "gate", "--controller", controller, "--twin", "robot", "--url", url)
        assert run(*words).return_value == 1
        server.shutdown()


def test_status_in_brief_and_in_full(site):
    _, base, _ = site
    brief = run("twin", "status", "--url", base)
    assert "robot" in brief.stdout
    assert "open" in brief.stdout
    full = answer(run("twin", "status", "--twin", "robot", "--url", base, "--json", "-"))
    assert full["state"] == "verified"
    assert full["parameters"]["J"]["value"] == 0.5
    assert full["drift"]["J"]["threshold"] == 5.0
    assert full["events"][0]["kind"] == "gate"


def test_a_token_is_shown_where_one_is_needed(tmp_path):
    made = run("twin", "token", "eyes", "--file", tmp_path / "tokens.toml")
    secret = made.stdout.strip()
    with scripted_service(tmp_path) as service:
        settle(service)
        app = make_app(service, read_tokens(tmp_path / "tokens.toml"))
        with served(app) as server:
            url = server.url
            refused = run("twin", "status", "--url", url)
            assert "show a token" in str(refused.exception)
            assert run("twin", "status", "--url", url, TWINPROOF_TOKEN=secret).return_value == 0
            (tmp_path / "secret").write_text(secret + "\n")
            words = ("twin", "status", "--url", url, "--token-file", tmp_path / "secret")
            assert run(*words).return_value == 0


def test_audit_backup_and_restore(tmp_path):
    service = scripted_service(tmp_path)
    settle(service)
    config = service.settings.path
    service.close()
    found = run("twin", "audit", config, "--json", "-")
    assert found.return_value == 0
    whole = answer(found)
    assert whole["intact"]
    assert whole["events"] == 7
    assert "backup.gz" in run("twin", "backup", config, "-o", tmp_path / "backup.gz").stdout
    with Store.open("sqlite:///twin.db", Path("audit.key"), tmp_path) as store:
        store.append([drift(1.0)], time.time)
        with store.engine.begin() as connection:
            connection.exec_driver_sql("UPDATE events SET kind = 'gate' WHERE kind = 'promoted'")
    broken = run("twin", "audit", config, "--json", "-")
    assert broken.return_value == 1
    assert "entry 5" in answer(broken)["because"]
    assert "not empty" in str(run("twin", "restore", config, tmp_path / "backup.gz").exception)
    for file in tmp_path.glob("twin.db*"):
        file.unlink()
    assert run("twin", "restore", config, tmp_path / "backup.gz").return_value == 0
    again = answer(run("twin", "audit", config, "--json", "-"))
    # What came after the backup is gone, and that is in the log.
    assert again == {**whole, "events": whole["events"] + 1}
    with Store.open("sqlite:///twin.db", Path("audit.key"), tmp_path) as store:
        assert "restored from backup.gz" in store.events(limit=1)[0].detail


LIVE = """
[service]
listen = "127.0.0.1:{port}"
[[twin]]
name = "arm"
rate = 100.0
[twin.plant]
model = "Twinproof.Plants.Pendulum"
parameters_from = "fit.json"
[twin.plant.sensors]
theta = {{sd = 0.05}}  # what a busy machine adds to stamps is noise too
omega = {{sd = 0.2}}
[twin.bus]
interface = "{interface}"
channel = "{channel}"
[twin.estimator]
disturbances = {{tau = 0.1}}
[twin.drift]
diagnose = 0.0
false_alarms_per_hour = 1e-9
[twin.verification]
study = "study.toml"
controller = "pid.toml"
draws = 4
settle = 1.0
"""
FIT = '{"parameters": {"J": {"value": 0.185, "sd": 0.01}, "mgl": {"value": 3.61, "sd": 0.1},'
FIT += ' "d": {"value": 0.05, "sd": 0.01}}}'


MAIN = "from twinproof.cli import main; main()"


def live_config(folder, interface, channel, port=0):
    (folder / "study.toml").write_text(STUDY)
    (folder / "pid.toml").write_text(CONTROLLER)
    (folder / "fit.json").write_text(FIT)
    path = folder / "config.toml"
    path.write_text(LIVE.format(interface=interface, channel=channel, port=port))
    return path


def messages(rows):
    whole = frames(rows)
    return [
        can.Message(
            arbitration_id=int(whole.identifier[k]),
            is_extended_id=False,
            data=bytes(whole.payload[k][: whole.length[k]]),
        )
        for k in range(len(whole))
    ]


def test_a_bus_that_is_gone_is_said_and_opened_again(tmp_path):
    settings = settings_of(read_toml(live_config(tmp_path, "virtual", "arm-source")))
    with BusSource(settings, settings.twins[0]) as source:
        assert source.faults() == {}
        with can.Bus("arm-source", interface="virtual") as bus:
            for message in messages(motion(1.0, seed=1))[:40]:
                bus.send(message)
            end = time.monotonic() + 5
            got = 0
            while got < 40 and time.monotonic() < end:
                got += len(source.read())
            assert got == 40
            assert source.counts() == {"received": 40, "dropped": 0, "unrecorded": 0}
            ((path, size),) = source.recorded()
            assert path.read_bytes().count(b"\n") == 40
            assert size == path.stat().st_size
            line = source._lines[0]
            line._receiver.error = can.CanOperationError("it was unplugged")
            line._tried = time.monotonic()
            assert source.faults() == {"bus arm-source": "it was unplugged"}
            assert len(source.read()) == 0
            line._tried = 0.0
            assert source.faults() == {}
            bus.send(messages(motion(0.1, seed=1))[0])
            end = time.monotonic() + 5
            while not len(source.read()) and time.monotonic() < end:
                time.sleep(0.01)
            assert source.counts()["received"] == 41


def test_a_disk_that_is_full_loses_recordings_but_not_the_twin(tmp_path, monkeypatch):
    settings = settings_of(read_toml(live_config(tmp_path, "virtual", "arm-disk")))
    (tmp_path / "recordings").write_text("a file where a folder should be")
    with (
        BusSource(settings, settings.twins[0]) as source,
        can.Bus("arm-disk", interface="virtual") as bus,
    ):

        def pass_one():
            bus.send(messages(motion(0.1, seed=1))[0])
            end = time.monotonic() + 5
            while time.monotonic() < end:
                if len(source.read()):
                    return
            raise AssertionError

        pass_one()
        assert "not recorded" in source.faults()["recordings"]
        assert source.counts()["unrecorded"] == 1
        (tmp_path / "recordings").unlink()
        pass_one()
        assert source.faults() == {}


@pytest.mark.skipif(os.name == "nt", reason="needs terminals")
def test_the_service_as_a_process_follows_a_plant_verifies_it_and_ends_in_order(tmp_path):
    with bridged_terminals() as (ours, theirs):
        config = live_config(tmp_path, "slcan", theirs)
        process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "from twinproof.cli import main; main()",
                "twin",
                "serve",
                config,
            ],
            stderr=subprocess.PIPE,
            text=True,
        )
        lines = []
        try:
            url = ""
            while not url:
                lines.append(json.loads(process.stderr.readline()))
                if lines[-1]["message"] == "listening":
                    url = f"http://{lines[-1]['address']}"
            _drive(ours, url, tmp_path)
            full = answer(run("twin", "status", "--twin", "arm", "--url", url, "--json", "-"))
            assert full["counts"]["received"] > 500
            assert full["counts"]["dropped"] == 0
            assert abs(full["parameters"]["J"]["value"] - 0.185) < 0.05
        finally:
            process.send_signal(signal.SIGTERM)
            rest = process.communicate(timeout=30)[1]
        assert process.returncode == 0, rest
        assert json.loads(rest.splitlines()[-1])["message"] == "stopped"
    found = answer(run("twin", "audit", config, "--json", "-"))
    assert found["intact"]
    with Store.open("sqlite:///twin.db", Path("audit.key"), tmp_path) as store:
        kinds = [e.kind for e in store.all_events()]
    assert kinds[0] == "started"
    assert kinds[-1] == "stopped"
    assert "promoted" in kinds


def _drive(channel, url, folder):
    """Send a plant's frames in real time until the gate opens."""
    rows = motion(40.0, seed=3)
    packed = messages(rows)
    each = len(packed) // len(rows)
    opened = threading.Event()

    def send():
        with open_bus(BusSettings("slcan", channel)) as bus:
            began = time.monotonic()
            for k in range(len(rows)):
                for message in packed[each * k : each * (k + 1)]:
                    bus.send(message)
                if opened.wait(max(0.0, began + 0.01 * (k + 1) - time.monotonic())):
                    return

    sender = threading.Thread(target=send)
    sender.start()
    last = None
    while sender.is_alive():
        time.sleep(0.5)
        words = ("--controller", folder / "pid.toml", "--twin", "arm", "--url", url)
        last = run("twin", "gate", *words, "--json", "-")
        if last.return_value == 0:
            opened.set()
            break
    sender.join()
    assert opened.is_set(), answer(last)
