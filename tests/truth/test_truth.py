"""The truth simulator and the bundled logs, against SciPy, NumPy, the print and cantools."""

import tomllib
from math import degrees, pi, tanh
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from examples import make_demo_recording as truth

DEMO_DATA = Path(__file__).parents[2] / "twinproof" / "demo_data"
DBC = DEMO_DATA / "wheeled_pendulum.dbc"

# The paper's Table 1, typed anew so that a slip in the simulator shows.
X = (0.0436, 0.0178, 0.1149, 0.8719, 4.6701, 0.7268, 0.7256)
ALPHA = 165.418


def accelerations(theta_p, omega_w, omega_p, volts, tau_w=0.0, tau_b=0.0):
    """Equations (19) and (20) as the 2 by 2 linear system M a = r that they are."""
    x1, x2, x3, x4, x5, x6, x7 = X
    c, s = np.cos(theta_p), np.sin(theta_p)
    mass = np.array([[x1 + x2, x3 * c - x2], [-(x3 * c - x2), -(x4 + x2)]])
    right = np.array(
        [
            volts + tau_w / ALPHA + x3 * omega_p**2 * s - x6 * omega_w + x7 * omega_p,
            volts - tau_b / ALPHA - x5 * s - x6 * omega_w + x7 * omega_p,
        ]
    )
    return np.linalg.solve(mass, right)


LAWS = {
    "none": ({}, lambda x: (0.0, 0.0)),
    "coulomb_wheel": ({"coulomb_wheel": 25.0}, lambda x: (-25.0 * tanh(x[2] / 0.05), 0.0)),
    "coulomb_body": ({"coulomb_body": 9.0}, lambda x: (0.0, -9.0 * tanh(x[3] / 0.05))),
    "quadratic_drag_wheel": (
        {"quadratic_drag_wheel": 4.0},
        lambda x: (-4.0 * x[2] * abs(x[2]), 0.0),
    ),
    "viscous and constant": (
        {"viscous_wheel": 5.0, "constant_torque_wheel": 8.0, "viscous_body": 2.0},
        lambda x: (8.0 - 5.0 * x[2], -2.0 * x[3]),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_open_loop_agrees_with_dop853(name):
    """One second under voltages held for 1 ms each; both integrate the same held input."""
    sizes, law = LAWS[name]
    torques = truth.sum_of([truth.TORQUE_EFFECTS[k](v) for k, v in sizes.items()])
    volts = 3.0 * np.sin(2 * pi * 2.0 * np.arange(1000) * 1e-3) - 1.0
    start = np.array([0.1, 0.05, 0.5, -0.2])

    mine = tuple(start.tolist())
    theirs = start
    worst = 0.0
    for v in volts.tolist():
        for _ in range(truth.SUBSTEPS):
            mine = truth.advance(mine, v, torques, truth.STEP / truth.SUBSTEPS)

        def rates(_, x, v=v):
            return [x[2], x[3], *accelerations(x[1], x[2], x[3], v, *law(x))]

        solution = solve_ivp(rates, (0, 1e-3), theirs, method="DOP853", rtol=1e-12, atol=1e-13)
        theirs = solution.y[:, -1]
        worst = max(worst, float(np.max(np.abs(theirs - mine))))
    assert np.ptp(theirs - start) > 0.1, "the plant hardly moved: the comparison says nothing"
    assert worst < 1e-7


def test_eigenvalues_upright_are_the_printed_ones():
    step = 1e-6
    nothing = truth.sum_of([])
    jacobian = np.empty((4, 4))
    for i in range(4):
        high, low = np.zeros(4), np.zeros(4)
        high[i], low[i] = step, -step
        jacobian[:, i] = (
            np.array(truth.derivative(tuple(high.tolist()), 0.0, nothing))
            - np.array(truth.derivative(tuple(low.tolist()), 0.0, nothing))
        ) / (2 * step)
    found = np.sort(np.linalg.eigvals(jacobian).real)
    np.testing.assert_allclose(found, [-18.5, -1.95, 0.0, 2.08], rtol=3e-3, atol=1e-6)


def test_a_standing_pendulum_falls_to_the_side_it_leans_to():
    x = (0.0, 0.01, 0.0, 0.0)
    for _ in range(500):
        x = truth.advance(x, 0.0, truth.sum_of([]), 1e-3)
    assert x[1] > 0.015


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("coulomb_wheel", 25.0),
        ("coulomb_body", 25.0),
        ("stribeck_wheel", 15.0),
        ("viscous_wheel", 5.0),
        ("viscous_body", 5.0),
        ("quadratic_drag_wheel", 2.0),
        ("constant_torque_wheel", 10.0),
        ("constant_torque_body", 10.0),
        ("cubic_spring_body", 500.0),
        ("input_dead_zone", 0.3),
        ("input_gain", 0.1),
        ("input_offset", 0.1),
        ("pitch_bias", 0.02),
    ],
)
def test_every_effect_is_felt_and_the_loop_stays_upright(name, size):
    plain = truth.simulate(duration=3.0)
    with_effect = truth.simulate({name: size}, duration=3.0)
    assert degrees(np.abs(with_effect.state[:, 1]).max()) < 30
    assert np.abs(with_effect.state[:, 0] - plain.state[:, 0]).max() > 100 * truth.COUNT


def test_effect_cases_are_complete():
    tried = {
        case[0]
        for mark in test_every_effect_is_felt_and_the_loop_stays_upright.pytestmark
        for case in mark.args[1]
    }
    assert tried == set(truth.EFFECTS)


def test_an_effect_of_size_zero_is_absent():
    plain = truth.simulate(duration=0.5)
    zero = truth.simulate(dict.fromkeys(truth.EFFECTS, 0.0), duration=0.5)
    np.testing.assert_array_equal(zero.state, plain.state)


def test_unknown_effect_is_refused_by_name():
    with pytest.raises(KeyError, match="coulomb_whel"):
        truth.simulate({"coulomb_whel": 1.0})


def test_nothing_hidden_follows_the_reference_for_the_whole_record():
    run = truth.simulate()
    assert run.time[-1] == pytest.approx(20.0)
    tracking = run.reference - run.state[:, 1]
    assert degrees(float(np.sqrt(np.mean(tracking[1000:] ** 2)))) < 2.0
    assert degrees(float(np.abs(run.state[:, 1]).max())) < 30


def test_noise_and_resolution_are_what_the_paper_says():
    run = truth.simulate(seed=5)
    wheel = run.channels["theta_w"] - run.state[:, 0]
    assert np.abs(wheel).max() <= truth.COUNT / 2 * (1 + 1e-9)
    # sd of n samples is known to 1 / sqrt(2 n) = 0.5 %: four of these.
    for channel, column in (("theta_p", 1), ("omega_p", 3)):
        error = np.degrees(run.channels[channel] - run.state[:, column])
        assert float(error.std()) == pytest.approx(0.5, rel=0.02)
        assert abs(float(error.mean())) < 4 * 0.5 / np.sqrt(error.size)


def test_the_logged_voltage_is_the_applied_voltage():
    """Replaying the log's integers over the plant gives the true states back, bit for bit."""
    run = truth.simulate(truth.HIDDEN, duration=1.0, seed=3)
    torques = truth.TORQUE_EFFECTS["coulomb_wheel"](25.0)
    x = (0.0, 0.0, 0.0, 0.0)
    for k, counts in enumerate(run.counts["V"].tolist()):
        assert x == tuple(run.state[k].tolist())
        for _ in range(truth.SUBSTEPS):
            x = truth.advance(x, counts * 1e-3, torques, truth.STEP / truth.SUBSTEPS)


def test_ideal_sensors_give_the_truth():
    run = truth.simulate(duration=0.5, ideal_sensors=True)
    np.testing.assert_array_equal(run.channels["theta_w"], run.state[:, 0])
    np.testing.assert_array_equal(run.channels["theta_p"], run.state[:, 1])
    np.testing.assert_array_equal(run.channels["omega_p"], run.state[:, 3])


def decoded(log: Path) -> dict[str, tuple[list[float], list[int], list[float]]]:
    """Times, raw integers and scaled values of each signal in a log."""
    database = cantools.database.load_file(DBC)
    columns: dict[str, tuple[list[float], list[int], list[float]]] = {}
    with can.BLFReader(log) as reader:
        for frame in reader:
            raw = database.decode_message(frame.arbitration_id, frame.data, scaling=False)
            scaled = database.decode_message(frame.arbitration_id, frame.data)
            for name, value in raw.items():
                times, integers, values = columns.setdefault(name, ([], [], []))
                times.append(frame.timestamp)
                integers.append(value)
                values.append(scaled[name])
    return columns


@pytest.mark.parametrize(
    ("log", "make"),
    [("balancing.blf", truth.fitted_run), ("held_out.blf", truth.held_out_run)],
)
def test_bundled_log_is_what_the_script_makes(log, make):
    run = make()
    columns = decoded(DEMO_DATA / log)
    to_si = {"theta_w": 1.0, "theta_p": pi / 180, "omega_p": pi / 180, "V": 1.0}
    for message, signals in truth.SIGNALS.items():
        for signal, channel in signals.items():
            times, integers, values = columns[signal]
            np.testing.assert_array_equal(integers, run.counts[channel])
            np.testing.assert_allclose(
                np.array(values) * to_si[channel], run.channels[channel], rtol=1e-12, atol=1e-15
            )
            np.testing.assert_allclose(times, run.time, rtol=0, atol=1e-9)
        counter = columns[f"{message}Counter"][1]
        np.testing.assert_array_equal(counter, np.arange(run.time.size) % 256)
    assert len(columns) == 7
    assert (DEMO_DATA / log).stat().st_size < 1_000_000


def test_writing_a_log_twice_gives_the_same_bytes(tmp_path):
    run = truth.simulate(truth.HIDDEN, duration=0.2)
    for name in ("a.blf", "b.blf"):
        truth.write_log(run, DBC, tmp_path / name)
    assert (tmp_path / "a.blf").read_bytes() == (tmp_path / "b.blf").read_bytes()


def test_the_two_bundled_runs_differ_in_reference_and_noise():
    fitted, other = truth.fitted_run(), truth.held_out_run()
    assert np.corrcoef(fitted.reference, other.reference)[0, 1] < 0.7
    noise = [run.channels["omega_p"] - run.state[:, 3] for run in (fitted, other)]
    assert abs(np.corrcoef(*noise)[0, 1]) < 0.05


def test_channel_map_agrees_with_dbc_and_simulator():
    channels = tomllib.loads((DEMO_DATA / "channels.toml").read_text())["channels"]
    assert set(channels) == {"theta_w", "theta_p", "omega_p", "V"}
    database = cantools.database.load_file(DBC)
    for message, signals in truth.SIGNALS.items():
        for signal, channel in signals.items():
            assert channels[channel]["source"] == signal
            found = database.get_message_by_name(message).get_signal_by_name(signal)
            assert channels[channel]["unit"] == found.unit
            to_si = pi / 180 if found.unit.startswith("deg") else 1.0
            assert channels[channel]["resolution"] == pytest.approx(found.scale * to_si, rel=1e-12)
    assert channels["theta_w"]["resolution"] == pytest.approx(truth.COUNT, rel=1e-12)
    for channel in ("theta_p", "omega_p"):
        assert channels[channel]["sd"] == pytest.approx(truth.PITCH_NOISE, rel=1e-12)
