import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from fault_scenarios import BASE, UPRIGHT, scenario

from foundation.errors import BusError, ComputationError, InputError, TwinproofError
from hil.bus import bundled_dbc
from hil.clock import RealClock
from hil.criteria import (
    CRITERIA,
    Evidence,
    Limit,
    MissedFrames,
    Overshoot,
    Rms,
    SafeState,
    Saturation,
    Settling,
)
from hil.real_time import Histogram, real_time
from hil.rig import run_scenario
from hil.scenario import read_scenario
from recordings import load
from twinproof.cli import command

EXAMPLES = Path(__file__).parents[2] / "examples" / "hil"


def short(text, tmp_path):
    base = BASE.replace("duration = 4.0", "duration = 0.2")
    path = tmp_path / "s.toml"
    path.write_text(base + text)
    return path


def test_the_pid_of_the_paper_follows_its_reference(tmp_path):
    result = run_scenario(read_scenario(EXAMPLES / "balance.toml"), recording=tmp_path / "a.blf")
    assert result.passed
    trace = result.trace
    # 0.5 degrees of noise through P + N D are 9 V.
    assert 5 < np.std(trace.columns["V"]) < 20
    assert trace.count == 10_000
    assert result.plant.sent == 3 * result.plant.received + 3


def test_the_recording_goes_back_into_identification(tmp_path):
    result = run_scenario(
        scenario("", tmp_path / "x.toml"),
        recording=tmp_path / "run.blf",
    )
    run = load(
        tmp_path / "run.blf",
        dbc=bundled_dbc("WheeledPendulum"),
        variables={"theta_w": "rad", "theta_p": "rad", "omega_p": "rad/s", "V": "V"},
        inputs=["V"],
    )
    trace = result.trace
    first = np.searchsorted(trace.time, 0.5)
    k = np.searchsorted(run.time - run.time[0], trace.time[first] - trace.time[1] / 2)
    n = 3000
    shown = trace.columns["measured.theta_p"][first : first + n]
    offsets = [np.max(np.abs(run["theta_p"].values[k + d : k + d + n] - shown)) for d in (-1, 0, 1)]
    assert min(offsets) < 1e-4
    d = int(np.argmin(offsets)) - 1
    V = trace.columns["command.V"][first : first + n]
    assert np.max(np.abs(run["V"].values[k + d : k + d + n] - V)) < 1e-3


@pytest.mark.parametrize("suffix", [".csv", ".mf4", ".asc", ".log", ".trc"])
def test_every_kind_of_recording_reads_back(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    result = run_scenario(read_scenario(short("", tmp_path)), recording=path)
    is_frames = suffix not in (".csv", ".mf4")
    run = load(
        path,
        dbc=bundled_dbc("WheeledPendulum") if is_frames else None,
        variables={"theta_p": "rad", "V": "V"},
    )
    assert run["theta_p"].values[-50:] == pytest.approx(
        result.trace.columns["measured.theta_p"][-50:], abs=2e-4
    )


def test_run_command_writes_everything(tmp_path):
    path = short(UPRIGHT, tmp_path)
    words = ["hil", "run", str(path), "--json", str(tmp_path / "r.json")]
    words += ["--junit", str(tmp_path / "r.xml"), "--report", str(tmp_path / "report")]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.exception is None
    assert done.return_value == 0
    document = json.loads((tmp_path / "r.json").read_text())
    assert document["schema"] == "twinproof/hil-run/1"
    assert {"verdict", "cycles", "missed", "jitter_us", "faults", "criteria"} <= document.keys()
    assert document["verdict"] == "pass"
    assert document["cycles"] == 200
    suite = ET.parse(tmp_path / "r.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("failures")) == ("1", "0")
    html = (tmp_path / "report" / "report.html").read_text()
    assert "theta_p" in html
    assert "http" not in html.replace("http://www.w3.org", "")


def test_a_criterion_that_fails_is_exit_status_1(tmp_path):
    path = short('[[criteria]]\nkind = "limit"\nsignal = "V"\nhigh = -1.0\n', tmp_path)
    junit = tmp_path / "r.xml"
    words = ["hil", "run", str(path), "--junit", str(junit)]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.return_value == 1
    assert ET.parse(junit).getroot()[0].get("failures") == "1"


BAD = {
    "bus absent": (
        '[bus]\ninterface = "slcan"\nchannel = "/dev/nowhere"\n',
        r"cannot be opened.*nowhere.*plug in",
    ),
    "unknown interface": (
        '[bus]\ninterface = "telepathy"\n',
        r"cannot be used.*telepathy.*use one of",
    ),
    "DBC absent": ('[bus]\ndbc = "nowhere.dbc"\n', r"cannot be read.*nowhere\.dbc.*bus\.dbc"),
    "DBC without the signals": (
        '[bus]\ndbc = "other.dbc"\n',
        r"unknown signal 'theta_w'.*other\.dbc.*bus, signals|unknown signal 'theta_w'.*other\.dbc",
    ),
    "wrong unit in the DBC": ('[bus]\ndbc = "unit.dbc"\n', r"'kg'.*'rad'.*Sensors1.*theta_p"),
    "wrong rate": ('[bus]\ndbc = "rate.dbc"\n', r"every 0\.3 ms|every 3 ms"),
    "wrong unit of a value": (
        '[[criteria]]\nkind = "limit"\nsignal = "theta_p"\nhigh = "3 kg"\n',
        r"'kg' cannot be converted to 'rad'.*s\.toml:\d+, criteria\.1\.high",
    ),
    "unknown key": ("[bus]\nintreface = 1\n", r"unknown key 'intreface'.*s\.toml:\d+.*interface"),
    "unknown table": ("[fautls]\n", r"unknown key 'fautls'.*faults"),
    "unknown fault": ('[[faults]]\nkind = "dorp"\n', r"unknown kind 'dorp'.*faults\.1.*drop"),
    "fault on nothing": (
        '[[faults]]\nkind = "stuck"\nsignal = "thetta_p"\n',
        r"unknown signal 'thetta_p'.*did you mean theta_p",
    ),
    "criterion without signal": (
        '[[criteria]]\nkind = "limit"\nsignal = "thetta"\nhigh = 1.0\n',
        r"unknown signal 'thetta'.*s\.toml:\d+",
    ),
    "criterion without reference": (
        '[[criteria]]\nkind = "settling"\nsignal = "theta_w"\nband = 0.1\nwithin = 1.0\n',
        r"'theta_w' has no reference.*s\.toml:\d+.*references\.theta_w",
    ),
    "criterion after the end": (
        '[[criteria]]\nkind = "rms"\nsignal = "theta_p"\nmost = 1.0\nafter = 9.0\n',
        r"a criterion from 9 s to 0\.2 s.*s\.toml:\d+",
    ),
    "criterion without number": (
        '[[criteria]]\nkind = "missed-frames"\nmost = "few"\n',
        r"'few' is no int.*criteria\.1\.most",
    ),
    "safe value of nothing": ("[bus.safe]\nU = 0.0\n", r"unknown input 'U'.*s\.toml:\d+.*V"),
    "another process on a virtual bus": (None, r"cannot be reached over the bus 'virtual'"),
    "not TOML": ("[bus\n", r"not TOML.*s\.toml:\d+"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_exit_status_2_with_place_and_remedy(name, tmp_path):
    text, message = BAD[name]
    dbc = bundled_dbc("WheeledPendulum").read_text()
    (tmp_path / "other.dbc").write_text(bundled_dbc("Positioner").read_text())
    (tmp_path / "unit.dbc").write_text(
        dbc.replace(
            'SG_ theta_p : 40|24@1- (0.0001,0) [-838.8607|838.8607] "rad"',
            'SG_ theta_p : 40|24@1- (0.0001,0) [-838.8607|838.8607] "kg"',
        )
    )
    (tmp_path / "rate.dbc").write_text(
        dbc.replace('BA_ "GenMsgCycleTime" BO_ 273 1;', 'BA_ "GenMsgCycleTime" BO_ 273 3;')
    )
    path = short(text or "", tmp_path)
    if text is None:
        whole = path.read_text()
        start, stop = whole.index("[controller]"), whole.index("[references")
        path.write_text(
            whole[:start] + '[controller]\nkind = "process"\nbuilt_in = "balance"\n' + whole[stop:]
        )
    if name == "wrong rate":
        path.write_text(path.read_text().replace("[run]", '[run]\nstep = "2 ms"'))
    with pytest.raises(InputError, match=f"(?s){message}") as caught:
        run_scenario(read_scenario(path))
    assert caught.value.exit_status == 2
    assert caught.value.remedy
    assert caught.value.where
    assert not list(tmp_path.glob("*.blf"))


def external(tmp_path, controller, run=""):
    text = BASE.replace("duration = 4.0", f'duration = 0.5\nclock = "real"\n{run}')
    start, stop = text.index("[controller]"), text.index("[references")
    path = tmp_path / "s.toml"
    path.write_text(
        text[:start] + f'[bus]\ninterface = "slcan"\n[controller]\n{controller}\n' + text[stop:]
    )
    return read_scenario(path)


def test_the_controller_in_c_balances_from_another_process(tmp_path):
    controller = 'kind = "process"\nbuilt_in = "balance"'
    # A machine with other work to do: late cycles move the later ones.
    result = run_scenario(external(tmp_path, controller, 'silence = 20.0\noverrun = "slip"\n'))
    assert result.trace.count == 500
    assert np.max(np.abs(result.trace.columns["theta_p"])) < 0.2
    assert np.ptp(result.trace.columns["command.V"]) > 0.1
    assert result.plant.wrong_checksum == result.plant.unknown == 0
    assert result.loop.jitter.count == 500
    assert result.loop.latency.count > 5
    assert result.loop.latency.percentile(50) < 0.5


def test_a_controller_that_is_silent_leaves_its_recording(tmp_path):
    program = 'kind = "process"\ncommand = ["{python}", "-c", "import time; time.sleep(60)"]'
    with pytest.raises(BusError, match=r"silent.*0 frames came.*recording up to then is") as caught:
        run_scenario(external(tmp_path, program, "silence = 0.2\n"))
    assert caught.value.exit_status == 2
    assert (tmp_path / "s.blf").stat().st_size > 1000


def test_a_controller_that_cannot_start(tmp_path):
    with pytest.raises(BusError, match="does not start"):
        run_scenario(external(tmp_path, 'kind = "process"\ncommand = ["nowhere-to-be-found"]'))


def test_a_controller_that_diverges_leaves_its_recording(tmp_path):
    text = BASE.replace("proportional = -168.0", "proportional = 1e308")
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(TwinproofError, match="recording up to then is"):
        run_scenario(read_scenario(path))
    assert (tmp_path / "s.blf").is_file()


def test_stop_at_a_missed_deadline(tmp_path):
    controller = 'kind = "process"\nbuilt_in = "balance"'
    late = external(tmp_path, controller, 'step = "20 us"\noverrun = "stop"\nsilence = 20.0\n')
    late.messages.sensors[0].message.cycle_time = None
    with pytest.raises(ComputationError, match="deadline at"):
        run_scenario(late)


def test_real_clock_keeps_absolute_deadlines():
    clock = RealClock(spin=1e-3)
    woken = []
    for k in range(1, 21):
        clock.wait_until(k * 2e-3)
        woken.append(clock.now() - k * 2e-3)
    assert min(woken) >= 0
    assert np.median(woken) < 2e-3


def test_real_time_is_undone():
    import gc

    assert gc.isenabled()
    with real_time(cpu=100_000) as notes:
        assert not gc.isenabled()
    assert gc.isenabled()
    assert "processor" in notes[0]


def test_histogram_agrees_with_numpy():
    times = np.abs(np.random.default_rng(1).normal(0, 40e-6, 5000))
    found = Histogram()
    for t in times:
        found.add(float(t))
    for p in (1, 50, 99, 100):
        assert found.percentile(p) == pytest.approx(np.percentile(times, p), abs=1.5e-6)
    assert found.longest == times.max()


def evidence(values, reference=None, **more):
    time = np.arange(len(values)) * 0.1
    columns = {"x": np.array(values, float), "command.u": np.array(values, float)}
    if reference is not None:
        columns["reference.x"] = np.full(len(values), float(reference))
    safe = np.array(more.pop("safe", [False] * len(values)))
    return Evidence(time, columns, safe, 0.1 * len(values), 0.1, **more)


@pytest.mark.parametrize(
    ("criterion", "values", "passed", "value"),
    [
        (Settling(signal="x", band=0.2, within=0.3), [0, 2, 0.9, 1, 1.1, 1], True, 0.2),
        (Settling(signal="x", band=0.2, within=0.1), [0, 2, 0.9, 1, 1.1, 1], False, 0.2),
        (Settling(signal="x", band=0.2, within=0.3), [0, 1, 1, 1, 1, 3], False, np.inf),
        (Overshoot(signal="x", most=0.5), [0, 0.5, 1.4, 1], True, 0.4),
        (Overshoot(signal="x", most=0.3), [2, 0.5, 1.4, 1], False, 0.5),
        (Rms(signal="x", most=1.0), [0, 2, 0, 2], True, 1.0),
        (Rms(signal="x", most=0.5, target=0.0), [0, 1, 0, 1], False, np.sqrt(0.5)),
        (Limit(signal="x", low=-1, high=3), [0, 2, -0.5], True, -0.5),
        (Limit(signal="x", high=1), [0, 2, -0.5], False, 2),
        (Saturation(signal="u", at=2, most=0.5), [2, -2, 0, 0], True, 0.5),
        (
            Settling(signal="x", band=0.1, within=0, target=np.pi, wraps=True),
            [-np.pi, 3 * np.pi],
            True,
            0,
        ),
    ],
)
def test_criteria_on_hand_made_runs(criterion, values, passed, value):
    verdict = criterion.judge(evidence(values, reference=1.0))
    assert verdict.passed is passed
    assert verdict.value == pytest.approx(value)


def test_a_run_that_ended_early_meets_nothing():
    cut = Evidence(np.arange(3) * 0.1, {"x": np.zeros(3)}, np.full(3, False), 1.0, 0.1)
    for criterion in (
        Rms(signal="x", most=1, target=0),
        Limit(signal="x", high=1),
        Settling(signal="x", band=1, within=1, target=0),
        SafeState(),
    ):
        assert not criterion.judge(cut).passed


def test_safe_state_in_time_and_back():
    run = evidence([0] * 10, safe=[False] * 3 + [True] * 4 + [False] * 3)
    assert SafeState(after=0.2, within=0.15).judge(run).passed
    assert not SafeState(after=0.2, within=0.05).judge(run).passed
    assert SafeState(after=0.2, until=0.6, within=0.15, back=0.1).judge(run).passed
    assert not SafeState(after=0.2, until=0.45, within=0.15, back=0.1).judge(run).passed
    assert not SafeState().judge(run).passed
    assert MissedFrames(most=2).judge(evidence([0], dropped=2)).passed
    assert not MissedFrames(most=2).judge(evidence([0], dropped=3)).passed
    assert len(CRITERIA) == 8


def test_python_of_this_process_can_be_the_controller(tmp_path):
    script = tmp_path / "law.py"
    script.write_text(
        "import sys, can\n"
        "from hil.bus import *\n"
        "from hil.bus.slcan import SlcanBus\n"
        "db = read_dbc(bundled_dbc('WheeledPendulum'))\n"
        "sensors = layouts(db, [Port('theta_p', 'rad'), Port('omega_p', 'rad/s')])\n"
        "out = Packer(layouts(db, [Port('V', 'V')])[0])\n"
        "unpacker = Unpacker(sensors)\n"
        "y = {}\n"
        "with SlcanBus(sys.argv[1]) as bus:\n"
        "    while True:\n"
        "        reading = unpacker.unpack(bus.recv(30.0))\n"
        "        y.update(reading.values if reading else {})\n"
        "        if reading and 'omega_p' in reading.values and 'theta_p' in y:\n"
        "            bus.send(out.pack({'V': 170 * y['theta_p'] + 9 * y['omega_p']}), 1.0)\n"
    )
    command = f'kind = "process"\ncommand = ["{sys.executable}", "{script}", "{{channel}}"]'
    result = run_scenario(external(tmp_path, command, 'silence = 30.0\noverrun = "slip"\n'))
    assert np.max(np.abs(result.trace.columns["theta_p"])) < 0.3
