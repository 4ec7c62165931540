"""Signals at their own times, and the recordings that are made of them."""

import pickle

import numpy as np
import pytest

from foundation.errors import ChannelError, TimeError
from recordings import Kind, Recording, Samples, Sensor, Signals, load, load_signals


def samples(name, time, values=None, **facts):
    time = np.asarray(time, float)
    return Samples(name, time, np.asarray(time if values is None else values, float), "m", **facts)


def signals(*parts, **facts):
    return Signals({part.name: part for part in parts}, "bench", **facts)


FINE = np.arange(101) * 0.01


def test_shared_stamps_keep_every_number_and_there_is_no_second_copy():
    run = signals(samples("a", FINE), samples("b", FINE, -FINE)).recording()
    assert np.array_equal(run["b"].values, -FINE)
    assert (run.raw, run.notes) == (None, ())
    assert Signals.of(run)["a"].values is run["a"].values


def test_asynchronous_signals_stay_available_and_can_be_put_on_any_step():
    fast, slow = samples("a", FINE, np.sin(FINE)), samples("b", [0.005, 0.5, 0.995])
    run = signals(fast, slow).recording()
    assert run.time.tolist() == FINE[1:100].tolist()
    assert run.raw["b"].time.tolist() == [0.005, 0.5, 0.995]
    again = run.raw.recording(step=0.1)
    np.testing.assert_allclose(np.diff(again.time), 0.1)
    np.testing.assert_allclose(again["b"].values, again.time, atol=1e-12)
    assert any("low-passed at 4 Hz to steps of 0.1 s: a" in note for note in again.notes)
    assert pickle.loads(pickle.dumps(run)).raw["b"].values.tolist() == [0.005, 0.5, 0.995]


def test_commands_hold_and_states_never_mix():
    command = samples("u", [0.0, 0.105, 0.5], [0, 1, 0], kind=Kind.COMMAND)
    gear = samples("gear", [0.0, 0.105, 0.9], [1, 2, 3], kind=Kind.STATE)
    run = signals(samples("x", FINE), command, gear).recording()
    assert set(run["u"].values) == {0.0, 1.0}
    assert run.time[np.argmax(run["u"].values)] == pytest.approx(0.11)
    assert run["gear"].values[[0, 10, 11, 89, 90]].tolist() == [1, 1, 2, 2, 3]
    # What holds goes on beyond its last sample: the measured signal says how long the record is.
    assert run.time[-1] == 1.0
    assert run.notes == ("held to the times of 'x': u, gear",)


def test_a_command_that_stopped_long_ago_is_said():
    command = samples("u", [0.0, 0.01, 0.02], kind=Kind.COMMAND)
    run = signals(samples("x", FINE), command).recording()
    assert any("'u' ends at 0.02 s and is held for 0.98 s more" in note for note in run.notes)


def test_delays_are_taken_off_once():
    true = np.sin(3 * FINE)
    late = samples("q", FINE, np.sin(3 * (FINE - 0.02)), sensor=Sensor(1e-3, None, 0.02))
    run = signals(samples("u", FINE, true), late).recording()
    np.testing.assert_allclose(run["q"].values, np.sin(3 * run.time), atol=2e-5)
    assert run["q"].sensor == Sensor(1e-3, None, 0.0)
    assert run.raw["q"].sensor.delay == 0.02
    assert "'q' is read 0.02 s earlier: its sensor's delay" in run.notes
    assert run.time[0] == 0.0
    assert run.time[-1] == pytest.approx(0.98)


def test_one_delay_for_all_moves_the_clock_only():
    sensor = Sensor(delay=0.005)
    run = signals(*(samples(n, FINE, FINE, sensor=sensor) for n in "ab")).recording()
    assert np.array_equal(run["a"].values, FINE)
    np.testing.assert_allclose(run.time, FINE - 0.005, atol=1e-15)


def test_averaging_makes_noise_smaller_and_says_how_much():
    rng = np.random.default_rng(0)
    time = np.arange(50_000) * 0.001
    noisy = samples("q", time, rng.normal(0, 0.2, time.size), sensor=Sensor(sd=0.2))
    run = signals(noisy, step=0.05).recording()
    assert run["q"].sensor.sd == pytest.approx(np.std(run["q"].values), rel=0.06)
    assert run["q"].sensor.sd < 0.05


def test_gaps_are_said_and_parts_are_cut_there():
    time = np.concatenate([FINE, FINE + 3])
    run = signals(samples("x", time), samples("y", [0.0, 1.0, 4.0])).recording()
    parts = run.parts()
    assert [len(part) for part in parts] == [101, 101]
    assert parts[1].time[0] == 3.0
    assert parts[0].raw["y"].time.tolist() == [0.0, 1.0]
    with pytest.raises(TimeError, match=r"gap of 2 s .*Recording\.parts"):
        run.uniform()
    assert parts[1].uniform().duration == pytest.approx(1.0)


def test_parts_of_a_recording_keep_their_raw_signals():
    run = signals(samples("a", FINE), samples("b", FINE[::10])).recording()
    part = run.between(0.25, 0.55)
    assert part.raw["b"].time.tolist() == pytest.approx([0.2, 0.3, 0.4, 0.5, 0.6])
    assert list(run.select(["b"]).raw.samples) == ["b"]
    assert run.replace_values({"a": np.zeros(101)}).raw is None


@pytest.mark.parametrize("step", [None, 0.1])
def test_no_common_span(step):
    with pytest.raises(TimeError, match=r"'b' starts at 2 s, 'a' ends at 1 s"):
        signals(samples("a", FINE), samples("b", FINE + 2)).recording(step=step)
    with pytest.raises(ChannelError, match="'b' has fewer than two values"):
        signals(samples("a", FINE), samples("b", [0.5])).recording(step=step)
    with pytest.raises(ChannelError, match="did you mean a"):
        signals(samples("a", FINE))["aa"]


DBC = """VERSION ""
BU_: X
BO_ 256 Fast: 2 X
 SG_ q : 0|16@1- (0.01,0) [0|0] "rad" X
BO_ 257 Slow: 2 X
 SG_ u : 0|16@1- (0.01,0) [0|0] "V" X
"""


@pytest.fixture
def log(tmp_path):
    rows = [(k * 0.001, 256, k) for k in range(1001)] + [(k * 0.1, 257, 100 * k) for k in range(11)]
    path, dbc, mapping = tmp_path / "run.log", tmp_path / "bus.dbc", tmp_path / "map.toml"
    path.write_text(
        "".join(
            f"({t:.6f}) can0 {i:03X}#{v.to_bytes(2, 'little').hex()}\n" for t, i, v in sorted(rows)
        )
    )
    dbc.write_text(DBC)

    def read(text="", loader=load, **options):
        mapping.write_text(text)
        options.setdefault("variables", {"q": "rad", "u": "V"})
        return loader(path, dbc=dbc, channel_map=mapping, **options)

    return read


def test_inputs_are_commands_and_the_map_is_stronger(log):
    line = log()
    step = log(inputs=["u"])
    assert line["u"].values[50] == pytest.approx(0.5)
    assert step["u"].values[50] == 0
    assert step["u"].values[-1] == 10
    assert (step["u"].kind, step["q"].kind) == (Kind.COMMAND, Kind.MEASURED)
    measured = log('[channels.u]\nkind = "measured"', inputs=["u"])
    assert np.array_equal(measured["u"].values, line["u"].values)


def test_the_step_of_a_log_is_that_of_its_grid(log):
    run = log("[time]\nstep = 0.02", inputs=["u"])
    assert len(run) == 51
    assert run.uniform() is run
    np.testing.assert_allclose(run["q"].values, run.time * 10, atol=1e-3)
    assert len(run.raw["q"]) == 1001


def test_a_span_is_read_alone(log):
    run = log(span=(0.2, 0.4))
    assert run.time[[0, -1]].tolist() == [0.2, 0.4]
    assert len(log(span=(0.2, 0.4), loader=load_signals)["q"]) == 201
    with pytest.raises(ChannelError, match="fewer than two values"):
        log(span=(5.0, 6.0))


def test_a_span_of_a_table(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,q\n" + "".join(f"{k / 10},{k}\n" for k in range(50)))
    run = load(path, span=(1.0, 2.0))
    assert run["q"].values.tolist() == list(range(10, 21))


def test_factor_and_offset_come_after_the_unit(log):
    run = log('[channels.q]\nfactor = -2\noffset = 1\nunit = "mrad"')
    np.testing.assert_allclose(run["q"].values, 1 - 2e-5 * np.arange(1001), rtol=1e-12)
    assert run["q"].sensor.resolution == pytest.approx(2e-5)


def test_software_stamps_go_back_to_their_beat(tmp_path):
    rng = np.random.default_rng(3)
    true = np.arange(2000) * 0.01
    late = np.maximum.accumulate(true + rng.exponential(1e-3, true.size))
    path, dbc, mapping = tmp_path / "run.log", tmp_path / "bus.dbc", tmp_path / "map.toml"
    path.write_text(
        "".join(f"({t:.6f}) can0 100#{k.to_bytes(2, 'little').hex()}\n" for k, t in enumerate(late))
    )
    dbc.write_text(DBC)
    mapping.write_text('[time]\nclock = "software"')
    run = load(path, dbc=dbc, channel_map=mapping)
    assert np.ptp(run.time - true) < 2e-4
    assert run.uniform() is run
    assert any("'q' put on an even beat of 0.0" in note for note in run.notes)
    assert isinstance(run, Recording)
