import threading

import can
import numpy as np
import pytest
from fault_scenarios import SCENARIOS, UPRIGHT, scenario

from foundation.errors import InputError, UnknownNameError
from hil.faults import FAULTS, Delay, Drop, Duplicate, Reorder, Stuck
from hil.rig import run_scenario


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults")
    cache = {}

    def result(kind):
        if kind not in cache:
            cache[kind] = run_scenario(scenario(SCENARIOS[kind], folder / f"{kind}.toml"))
        return cache[kind]

    return result


def verdicts(result):
    return {v.kind: v.passed for v in result.verdicts}


def test_every_class_of_fault_has_a_scenario():
    assert set(SCENARIOS) == set(FAULTS)


@pytest.mark.parametrize(
    "kind",
    [
        *("drop", "delay", "duplicate", "reorder", "corrupt", "bus-off"),
        *("late-controller", "dead-controller", "supply-sag", "parameter-change"),
    ],
)
def test_reaction_is_the_expected_one(results, kind):
    result = results(kind)
    assert result.passed, [v for v in result.verdicts if not v.passed]
    assert result.faults[0][1] > 0


def test_lost_frames_are_counted_one_by_one(results):
    result = results("drop")
    assert 650 < result.faults[0][1] < 950
    # The last ones of a run have no successor that would show them missing; runs of 15 look like 0.
    assert abs(result.plant.lost - result.faults[0][1]) <= 3


def test_doubled_frames_are_counted_and_used_once(results):
    result = results("duplicate")
    both = result.plant.repeated + result.controller.repeated
    assert result.faults[0][1] - 3 <= both <= result.faults[0][1]


def test_swapped_frames_are_seen_on_both_ends(results):
    result = results("reorder")
    assert result.plant.wrong_sequence > 100
    assert result.controller.wrong_sequence > 100


def test_damaged_frames_are_never_believed(results):
    result = results("corrupt")
    both = result.plant.wrong_checksum + result.controller.wrong_checksum
    assert abs(both - result.faults[0][1]) <= 3
    good = np.abs(result.trace.columns["command.V"])
    assert np.max(good) < 60  # a turned high bit would be hundreds of volts


def test_bus_off_is_noticed_within_the_timeout_and_left(results):
    result = results("bus-off")
    assert len(result.safe) == 1
    start, stop = result.safe[0]
    assert 2.02 <= start <= 2.022
    assert 2.05 <= stop <= 2.053
    safe = result.trace.safe
    assert np.all(result.trace.columns["V"][safe] == 0)


def test_late_frames_are_counted(results):
    assert results("late-controller").plant.late >= 1
    assert results("delay").controller.late >= 1
    assert results("duplicate").plant.late == results("duplicate").controller.late == 0


def test_a_dead_controller_leaves_the_plant_safe_for_good(results):
    result = results("dead-controller")
    assert result.safe[-1][1] == np.inf
    assert abs(result.trace.columns["theta_p"][-1]) > 0.5  # and nobody keeps it upright


def test_what_no_checksum_can_see_shows_in_the_motion(results):
    for kind in ("stuck", "motor-failure"):
        found = verdicts(results(kind))
        assert found == {"limit": False, "safe-state": True}, kind
    assert verdicts(results("bias")) == {"rms": False, "limit": True}
    error = results("bias").trace
    late = error.time > 2.5
    away = error.columns["theta_p"] - error.columns["reference.theta_p"]
    assert np.degrees(np.mean(away[late])) == pytest.approx(-3.0, abs=0.3)


@pytest.mark.parametrize("kind", ["drop", "corrupt", "delay"])
def test_virtual_time_is_deterministic(results, kind, tmp_path):
    again = run_scenario(scenario(SCENARIOS[kind], tmp_path / "again.toml"))
    first = results(kind)
    for name, column in first.trace.columns.items():
        np.testing.assert_array_equal(column, again.trace.columns[name], err_msg=name)
    assert first.plant == again.plant
    assert first.recording.read_bytes()[200:] == again.recording.read_bytes()[200:]


def test_a_changed_parameter_is_that_of_a_plant_which_has_it(tmp_path):
    """From 1 s on as a plant that was always so, from the state of 1 s; not before."""
    text = SCENARIOS["parameter-change"]
    changed = run_scenario(scenario(text, tmp_path / "changed.toml")).trace
    never = run_scenario(scenario(UPRIGHT, tmp_path / "never.toml")).trace
    pitch, usual = changed.columns["theta_p"], never.columns["theta_p"]
    before = changed.time <= 1.0
    np.testing.assert_array_equal(pitch[before], usual[before])
    assert np.max(np.abs(pitch - usual)[~before]) > 1e-3
    # The wheels' friction X6 is what the voltage must overcome: more of it wants more voltage.
    last, there = changed.time > 3.5, (changed.time > 1.2) & (changed.time < 2.0)
    more = changed.columns["V"] - never.columns["V"]
    assert np.sqrt(np.mean(more[there] ** 2)) > 20 * np.sqrt(np.mean(more[last] ** 2))


@pytest.mark.parametrize(
    ("line", "said"), [('parameter = "Y6"', "did you mean"), ('parameter = "V"', "there are")]
)
def test_a_parameter_that_the_plant_does_not_have(line, said, tmp_path):
    text = SCENARIOS["parameter-change"].replace('parameter = "X6"', line)
    with pytest.raises(UnknownNameError, match=said):
        scenario(text, tmp_path / "unknown.toml")


def test_a_run_can_be_ended_early(tmp_path):
    class Ended(threading.Event):
        def is_set(self):
            asked.append(None)
            return len(asked) > 500

    asked = []
    result = run_scenario(scenario(UPRIGHT, tmp_path / "ended.toml"), stop=Ended())
    assert result.trace.count == 500
    assert not result.passed
    assert result.recording.exists()


def test_without_a_fault_nothing_is_counted(tmp_path):
    result = run_scenario(scenario(UPRIGHT, tmp_path / "none.toml"))
    assert result.passed
    assert result.plant.dropped == result.controller.dropped == 0
    assert result.safe == ()


def frame(k):
    return can.Message(arbitration_id=k, is_extended_id=False, data=bytes([k]))


def test_faults_keep_to_their_span_and_probability():
    fault = Drop(start=1.0, stop=2.0)
    kept = [k for k in range(30) if fault.deliver(frame(1), k / 10)]
    assert kept == [*range(10), *range(20, 30)]
    often = Drop(probability=0.25, seed=5)
    n = sum(not often.deliver(frame(1), 0.0) for _ in range(4000))
    assert 900 < n < 1100
    assert often.happened == n
    often.reset()
    assert sum(not often.deliver(frame(1), 0.0) for _ in range(4000)) == n


def test_what_frame_faults_deliver():
    assert [t for t, _ in Delay(by=0.5).deliver(frame(1), 1.0)] == [1.5]
    assert len(Duplicate().deliver(frame(1), 1.0)) == 2
    swap = Reorder(probability=1.0)
    out = [
        [f.data[0] for _, f in swap.deliver(can.Message(arbitration_id=1, data=[k]), 0.0)]
        for k in range(4)
    ]
    assert out == [[], [1, 0], [], [3, 2]]
    stuck = Stuck(signal="x", start=1.0, stop=2.0)
    assert [stuck.value(v, v) for v in (0.5, 1.5, 1.8, 2.5)] == [0.5, 0.5, 0.5, 2.5]


def test_a_fault_that_makes_no_sense():
    with pytest.raises(InputError):
        Drop(start=2.0, stop=1.0)
    with pytest.raises(InputError):
        Drop(probability=2.0)
