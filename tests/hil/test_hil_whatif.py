import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import stats

from fmus.package import cached_fmu
from fmus.sources import library_class
from foundation.errors import InputError
from hil import whatif
from hil.closed_loop import ClosedLoop, Signals
from hil.controllers import PID, FmuController, Incremental, StateFeedback
from hil.linear import linear_model
from hil.margins import delayed, margins
from hil.plants import Fit, read_fit
from hil.rig import run_scenario
from hil.scenario import scenario_of
from hil.settings import parse_toml
from hil.study import study_of
from hil.whatif import rate, replay, run_study
from twinproof.cli import command

EXAMPLES = Path(__file__).parents[2] / "examples" / "hil"
PLANT = "Twinproof.Plants.WheeledPendulum"
STUDY = f"""
[plant]
model = "{PLANT}"
[plant.sensors.theta_p]
sd = "0.5 deg"
[plants]
draws = 6
[plants.ranges]
theta_p_start = ["-5 deg", "5 deg"]
X5 = [4.0, 5.5]
[controllers.paper]
kind = "pid"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
proportional = -168.0
integral = -800.0
derivative = -8.8
[controllers.soft]
kind = "pid"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
proportional = -20.0
[references.slow.theta_p]
kind = "sines"
amplitudes = ["5 deg"]
frequencies = [1.0]
[disturbances.none]
[disturbances.noise.V]
kind = "noise"
sd = 0.5
bandwidth = 5.0
[[criteria]]
kind = "limit"
signal = "theta_p"
low = "-20 deg"
high = "20 deg"
[[criteria]]
kind = "rms"
signal = "theta_p"
most = "3 deg"
after = 0.5
[margins]
gain_db = 6.0
phase_deg = 30.0
disk = 0.5
[run]
duration = 1.0
seed = 7
"""


def study(text=STUDY, path=Path("study.toml")):
    return study_of(parse_toml(text, path))


def pid(**gains):
    defaults = {"proportional": -168.0, "integral": -800.0, "derivative": -8.8}
    return PID(measured=("theta_p",), commanded=("V",), period=1e-3, **{**defaults, **gains})


@pytest.fixture(scope="module")
def fmu():
    return cached_fmu(library_class(PLANT))


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "study.toml"
    return run_study(study(path=path), workers=0)


def test_offline_and_over_the_bus_are_the_same_loop(fmu, tmp_path):
    text = f"""
[plant]
model = "{PLANT}"
parameters = {{ theta_p_start = 0.05 }}
[controller]
kind = "pid"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
proportional = -168.0
integral = -800.0
derivative = -8.8
[references.theta_p]
kind = "sines"
amplitudes = [0.1]
frequencies = [1.0]
[run]
duration = 1.0
"""
    over_bus = run_scenario(scenario_of(parse_toml(text, tmp_path / "s.toml"))).trace
    n = 1000
    wave = {"theta_p": 0.1 * np.sin(np.arange(n) * 1e-3)}
    with ClosedLoop(fmu) as loop:
        offline = loop.run(pid(), {"theta_p_start": 0.05}, Signals(wave, {}, {}), 1e-3, n)
    # What differs is the resolution of the bus: 1e-4 rad and 1e-4 V.
    assert np.max(np.abs(offline["theta_p"] - over_bus.columns["theta_p"])) < 2e-4
    assert np.max(np.abs(offline["theta_p"])) > 0.05


def test_the_compiled_loop_does_what_the_interpreted_one_does(fmu):
    n = 3000
    time_ = np.arange(n) * 1e-3
    rng = np.random.default_rng(1)
    signals = Signals(
        {"theta_p": 0.1 * np.sin(time_)},
        {"V": 0.3 * np.sin(3 * time_)},
        {"theta_p": 1e-3 * rng.standard_normal(n)},
    )
    law = FmuController(
        measured=("theta_p",),
        commanded=("V",),
        period=1e-3,
        model=f"{EXAMPLES / 'PitchPID.mo'}:PitchPID",
    )
    with ClosedLoop(fmu) as loop:
        compiled = loop.run(law, {"theta_p_start": 0.05}, signals, 1e-3, n)
        loop.plant.reset({"theta_p_start": 0.05})
        law.start()
        interpreted = loop._interpreted(law, signals, 1e-3, n, 1)
        python = loop.run(pid(), {"theta_p_start": 0.05}, signals, 1e-3, n)
    law.close()
    for name, column in interpreted.items():
        np.testing.assert_allclose(compiled[name], column, atol=1e-9, err_msg=name)
    # The law of the example is continuous, the one in Python sampled: the same up to its filter.
    assert np.max(np.abs(python["theta_p"] - compiled["theta_p"])) < 5e-3


def closed_loop_is_stable(linear, law, delay):
    """Eigenvalues of plant and PID as one sampled system, written out."""
    A, B0, B1 = delayed(linear, law.period, delay)
    C = linear.C[[linear.outputs.index("theta_p")]]
    T, N = law.period, law.bandwidth
    n = len(A)
    # States: plant, last command, integral, smooth; u = -(P + D N) y - ... with e = -y.
    fast = law.proportional + law.derivative * N
    u = np.hstack([-fast * C, [[0.0, law.integral, -law.derivative * N]]])
    whole = np.zeros((n + 3, n + 3))
    whole[:n, :n] = A
    whole[:n, [n]] = B1
    whole[:n] += B0 @ u
    whole[[n]] = u
    whole[[n + 1]] = np.hstack([-T * C, [[0.0, 1.0, 0.0]]])
    whole[[n + 2]] = np.hstack([-N * T * C, [[0.0, 0.0, 1 - N * T]]])
    values = np.sort(np.abs(np.linalg.eigvals(whole)))
    # The wheel's angle is integrated and does not matter to the pitch: a pole at one.
    return values[-1] < 1 + 1e-7


@pytest.mark.parametrize("scale", [0.01, 0.03, 0.05, 0.2, 1.0, 5.0, 15.0, 18.0, 20.0, 40.0])
def test_stability_agrees_with_eigenvalues(fmu, scale):
    linear = linear_model(fmu)
    law = pid(proportional=-168 * scale, integral=-800 * scale, derivative=-8.8 * scale)
    assert margins(linear, law, 1e-3).is_stable == closed_loop_is_stable(linear, law, 1e-3)


def test_gain_and_phase_margins_are_where_stability_ends(fmu):
    linear = linear_model(fmu)
    found = margins(linear, pid(), 1e-3)
    assert found.is_stable

    def stable(gain):
        law = pid(proportional=-168 * gain, integral=-800 * gain, derivative=-8.8 * gain)
        return closed_loop_is_stable(linear, law, 1e-3)

    for inside, outside in ((0.99, 1.01),):
        up = stable(found.gain**inside), stable(found.gain**outside)
        down = stable(found.gain**-inside), stable(found.gain**-outside)
        assert (True, False) in (up, down)
        assert up[0]
        assert down[0]
    # The disk is inside of both: (1 + α/2)/(1 − α/2) and 2 atan(α/2).
    assert (1 + found.disk / 2) / (1 - found.disk / 2) <= found.gain + 1e-6
    assert 2 * np.arctan(found.disk / 2) <= found.phase + 1e-6


def test_margins_of_a_loop_that_can_be_done_by_hand():
    from hil.linear import Linear

    # x(k+1) = x(k) + T u, u = −k x: L = k T/(z − 1); gain margin 2/(k T), phase 90° − half a turn.
    T, k = 0.1, 4.0
    plant = Linear(
        *(np.array([[v]]) for v in (0.0, 1.0, 1.0, 0.0)),
        states=("x",),
        inputs=("u",),
        outputs=("x",),
    )
    law = StateFeedback(measured=("x",), commanded=("u",), period=T, gain=((-k,),))
    found = margins(plant, law, 0.0)
    assert found.gain == pytest.approx(2 / (k * T), rel=1e-3)
    crossover = 2 * np.arcsin(k * T / 2)
    assert found.phase == pytest.approx(np.pi / 2 - crossover / 2, rel=1e-3)
    z = np.exp(1j * np.linspace(1e-3, np.pi, 20_000))
    S = 1 / (1 + k * T / (z - 1))
    assert found.disk == pytest.approx(1 / np.max(np.abs(S - 0.5)), rel=1e-3)
    late = StateFeedback(measured=("x",), commanded=("u",), period=T, gain=((-25.0,),))
    assert not margins(plant, late, 0.0).is_stable


def test_a_study_counts_what_passed(result):
    assert len(result.runs) == 2 * 6 * 2
    paper, soft = result.rate("paper"), result.rate("soft")
    assert paper.passed == paper.runs == 12
    assert soft.passed < soft.runs
    assert result.rate().passed == paper.passed + soft.passed
    (pair,) = result.pairs()
    assert pair.only_first == soft.runs - soft.passed
    assert pair.only_second == 0
    assert pair.p == pytest.approx(2 * 0.5**pair.only_first)


def test_intervals_are_those_of_clopper_and_pearson():
    for passed, runs in ((0, 10), (3, 10), (90, 100), (100, 100)):
        found = rate([True] * passed + [False] * (runs - passed))
        low = stats.beta.ppf(0.025, passed, runs - passed + 1) if passed else 0.0
        high = stats.beta.ppf(0.975, passed + 1, runs - passed) if passed < runs else 1.0
        assert (found.low, found.high) == pytest.approx((low, high))


def test_every_controller_meets_the_same_plants(result):
    worlds = {}
    for run in result.runs:
        worlds.setdefault(run.case.world, []).append(dict(run.parameters))
    assert all(a == b for a, b in worlds.values())
    assert len({tuple(p[0].values()) for p in worlds.values()}) == 6


def test_the_worst_run_is_replayed_to_the_last_digit(result):
    worst = result.worst()[0]
    again, columns = replay(result.study, worst.case.number)
    assert again == worst
    assert len(columns["theta_p"]) > 10
    with pytest.raises(InputError, match="no run 99"):
        replay(result.study, 99)


def test_a_study_goes_on_where_it_was_killed(result, tmp_path):
    path = tmp_path / "r.jsonl"
    whole = result.study.path.with_suffix(".results.jsonl").read_bytes()
    lines = whole.splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:8]) + lines[8][: len(lines[8]) // 2])
    again = run_study(result.study, workers=0, results=path)
    assert again.resumed == 7
    assert [r.verdicts for r in again.runs] == [r.verdicts for r in result.runs]
    finished = run_study(result.study, workers=0, results=path)
    assert finished.resumed == len(result.runs)


def test_results_of_another_study_are_refused(result, tmp_path):
    other = study(STUDY.replace("seed = 7", "seed = 8"))
    path = result.study.path.with_suffix(".results.jsonl")
    with pytest.raises(InputError, match="another study"):
        run_study(other, workers=0, results=path)
    path = tmp_path / "r.jsonl"
    path.write_text("nonsense\n")
    with pytest.raises(InputError, match="damaged"):
        run_study(other, workers=0, results=path)


def test_draws_follow_the_fit():
    covariance = np.array([[4e-6, 3e-3], [3e-3, 4.0]])
    fit = Fit({"a": 1e-2, "b": 50.0, "c": 3.0}, ("a", "b"), covariance)
    rng = np.random.default_rng(1)
    drawn = [fit.draw(rng) for _ in range(4000)]
    table = np.array([[d["a"], d["b"]] for d in drawn])
    assert np.mean(table, 0) == pytest.approx([1e-2, 50.0], rel=2e-2)
    assert np.cov(table.T) == pytest.approx(covariance, rel=0.1)
    assert {d["c"] for d in drawn} == {3.0}


def test_the_fit_of_identify_is_read(tmp_path):
    path = tmp_path / "fit.json"
    parameters = {
        "X4": {"value": 0.9, "sd": 0.01, "unit": "", "identifiable": True},
        "X5": {"value": 4.7, "sd": 0.1, "unit": "", "identifiable": True},
        "X6": {"value": 0.7, "sd": None, "unit": "", "identifiable": False},
    }
    matrix = [[1e-4, 5e-4, None], [5e-4, 1e-2, None], [None, None, None]]
    whole = {
        "parameters": parameters,
        "covariance": {"names": ["X4", "X5", "X6"], "matrix": matrix},
    }
    path.write_text(json.dumps(whole))
    fit = read_fit(path, "here")
    assert fit.names == ("X4", "X5")
    assert fit.covariance.tolist() == [[1e-4, 5e-4], [5e-4, 1e-2]]
    text = STUDY.replace(f'model = "{PLANT}"', f'model = "{PLANT}"\nparameters_from = "fit.json"')
    text = text.replace("X5 = [4.0, 5.5]\n", "")
    read = study(text, tmp_path / "study.toml")
    first, second = read.parameters(0), read.parameters(1)
    assert (first["X4"], first["X6"]) == (0.9, 0.7)
    assert second["X4"] != 0.9
    assert second == read.parameters(1)
    path.write_text("{}")
    with pytest.raises(InputError, match="not what `twinproof identify"):
        study(text, tmp_path / "study.toml")


def test_effects_are_plants_of_their_own(tmp_path):
    text = STUDY.replace("draws = 6", 'draws = 1\neffects = ["CoulombFriction@wheel,tau_c=60"]')
    result = run_study(study(text, tmp_path / "s.toml"), workers=0)
    by = {(r.case.variant, r.case.controller, r.case.disturbance): r for r in result.runs}
    assert len(by) == 8
    plain, rubbing = (
        next(v.value for v in by[name, "paper", "none"].verdicts if v.kind == "rms")
        for name in ("none", "CoulombFriction@wheel,tau_c=60")
    )
    assert plain != rubbing


BAD = {
    "no criteria": (STUDY[: STUDY.index("[[criteria]]")] + "[run]\n", "nothing that must hold"),
    "no controllers": (
        STUDY[: STUDY.index("[controllers")] + STUDY[STUDY.index("[references") :],
        "no controller",
    ),
    "unknown key": (STUDY.replace("draws = 6", "darws = 6"), r"'darws'.*study\.toml:\d+.*draws"),
    "unknown parameter": (STUDY.replace("X5 =", "X9 ="), r"'X9'.*study\.toml:\d+"),
    "range upside down": (
        STUDY.replace("[4.0, 5.5]", "[5.5, 4.0]"),
        r"from 5\.5 to 4.*study\.toml",
    ),
    "criterion of a bus": (
        STUDY.replace(
            'kind = "rms"\nsignal = "theta_p"\nmost = "3 deg"', 'kind = "deadlines"\nmost = 1'
        ),
        "without a bus",
    ),
    "bad effect": (
        STUDY.replace("draws = 6", 'effects = ["Coulomb@wheeel"]'),
        r"study\.toml:\d+, plants\.effects",
    ),
    "process": (
        STUDY.replace(
            '[controllers.soft]\nkind = "pid"',
            '[controllers.x]\nkind = "process"\nbuilt_in = "balance"\n'
            '[controllers.soft]\nkind = "pid"',
        ),
        "no place in a study",
    ),
    "period": (STUDY.replace("[run]", '[run]\nstep = "0.7 ms"'), "multiple"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_study_that_makes_no_sense_is_refused(name, tmp_path):
    text, message = BAD[name]
    with pytest.raises(InputError, match=f"(?s){message}") as caught:
        run_study(study(text, tmp_path / "study.toml"), workers=0)
    assert caught.value.exit_status == 2
    assert caught.value.remedy


def test_command_writes_document_and_report(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    words = ["whatif", str(path), "--workers", "0", "--json", str(tmp_path / "r.json")]
    words += ["--report", str(tmp_path / "report")]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.exception is None
    assert done.return_value == 1
    found = json.loads((tmp_path / "r.json").read_text())
    assert found["schema"] == "twinproof/whatif/1"
    assert {"runs", "passed", "criteria", "worst"} <= found.keys()
    assert found["runs"] == 24
    number = found["worst"][0]["run"]
    html = (tmp_path / "report" / "report.html").read_text()
    assert "Clopper" in html
    out = tmp_path / "run.csv"
    words = ["whatif", str(path), "--replay", str(number), "-o", str(out)]
    assert CliRunner().invoke(command, words, standalone_mode=False).return_value == 1
    assert out.read_text().startswith("time,theta_w")


def test_no_scheduler(tmp_path):
    with pytest.raises(InputError, match=r"scheduler does not answer.*tcp://"):
        run_study(study(path=tmp_path / "s.toml"), scheduler="nowhere:1")


def test_a_study_of_an_fmu_travels_with_it(tmp_path):
    import pickle

    text = STUDY.replace("draws = 6", "draws = 2")
    start, stop = text.index("[controllers.soft]"), text.index("[references")
    law = f"""[controllers.fmu]
kind = "fmu"
model = "{EXAMPLES / "PitchPID.mo"}:PitchPID"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
"""
    read = study(text[:start] + law + text[stop:], tmp_path / "study.toml")
    parcel = pickle.loads(pickle.dumps(whatif._parcel(read)))
    unpacked = parcel.unpacked()
    assert unpacked.controllers["fmu"].values["model"].endswith(".fmu")
    assert unpacked.variants[0].fmu != read.variants[0].fmu
    result = run_study(read, workers=0)
    assert result.notes == ()
    assert result.rate("fmu").passed == result.rate("paper").passed == 4
    # The same law, continuous and sampled: margins agree to a few per cent.
    margin = {
        (r.case.controller, v.name): v.value
        for r in result.runs
        for v in r.verdicts
        if v.kind == "margin" and r.case.draw == 0
    }
    for name in ("gain margin", "phase margin", "disk margin"):
        assert margin["fmu", name] == pytest.approx(margin["paper", name], rel=0.1)


@pytest.mark.slow
def test_workers_of_dask_and_a_kill(result, tmp_path):
    """A study that is killed while two workers are at it goes on and ends like any other."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    words = [sys.executable, "-c", "from twinproof.cli import main; main()"]
    words += ["whatif", str(path)]
    first = subprocess.Popen(words, stdout=subprocess.DEVNULL, start_new_session=True)
    results = path.with_suffix(".results.jsonl")
    end = time.monotonic() + 120
    while time.monotonic() < end and first.poll() is None:
        if results.exists() and len(results.read_text().splitlines()) > 3:
            break
        time.sleep(0.02)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    again = run_study(study(path=path), workers=2) if results.exists() else None
    assert again is not None
    assert [r.verdicts for r in again.runs] == [r.verdicts for r in result.runs]


def test_transfer_functions_are_those_of_the_laws():
    """A sine through each law, against K(z)."""
    laws = [
        pid(),
        Incremental(
            measured=("a", "b"), commanded=("u",), period=0.01, gains=(-6, -5, 137, 20, 0.15)
        ),
        StateFeedback(measured=("a", "b"), commanded=("u",), period=0.01, gain=((1.0, -2.0),)),
    ]
    for law in laws:
        for channel in range(len(law.measured)):
            w = 0.3
            n = 6000
            law.start()
            u = np.empty(n)
            for k in range(n):
                y = [0.0] * len(law.measured)
                y[channel] = 1e-3 * np.cos(w * k)
                (u[k],) = law.step(k * law.period, y, [0.0] * len(y))
            k = np.arange(n // 2, n)
            basis = np.column_stack([np.cos(w * k), np.sin(w * k), np.ones(k.size)])
            a, b, _ = np.linalg.lstsq(basis, u[k], rcond=None)[0]
            expected = law.transfer(np.array([np.exp(1j * w)]))[0, 0, channel]
            assert complex(a, -b) / 1e-3 == pytest.approx(expected, rel=1e-3)
