"""Calibration on counts that the Modelica sensors make of known motions, and on printed tables."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.plant import Plant
from fmus.running import model_fmu, simulate_model
from fmus.sources import ModelicaSource
from foundation.errors import ExcitationError, InputError
from identification.calibration import (
    Track,
    affine_gain,
    counts_per_turn,
    dead_zone,
    find_track,
    fit_scale,
    rest_shift,
    sweeps_of,
    unwrap,
    zero_from_balance,
    zero_from_swing,
)

DEGREE = np.pi / 180
SETUPS = {
    "setup 1": Track(1024, low=-306, high_up=717, high_down=640),
    "setup 2": Track(1091, low=-322, high_up=701, high_down=701),
}
# Voltages of Table B.2.
DRIVE = [40, -40, 50, -50, 60, -60, 70, -70]
VOLTS_1 = [2.10, -2.20, 2.90, -3.00, 3.75, -3.80, 4.50, -4.60]
VOLTS_2 = [2.59, -2.60, 3.35, -3.35, 4.14, -4.15, 4.82, -4.86]


def sensed(phi, track, step=0.01):
    """Counts of the Modelica potentiometer at the samples; the angle is a line between them."""
    fine = np.arange((len(phi) - 1) * 20 + 1) * step / 20
    smooth = np.interp(fine, np.arange(len(phi)) * step, phi)
    found = simulate_model(
        "Twinproof.Sensors.Potentiometer",
        inputs=(fine, {"phi": smooth}),
        parameters={
            "N": track.counts_per_turn,
            "low": track.low,
            "high_up": track.high_up,
            "high_down": track.high_down,
            "T": 1e-4,
            "x_start": float(phi[0]) - 1e-6 * float(np.sign(phi[1] - phi[0])),
        },
        outputs=["counts"],
    )
    return found["counts"][::20]


@pytest.fixture(scope="module")
def turned():
    """Slow turns, one and a half each way, 0.3 counts a sample."""
    up = np.arange(0, 3 * np.pi, 0.3 * 2 * np.pi / 1024)
    return np.concatenate([up, up[::-1]])


@pytest.mark.parametrize("name", SETUPS)
def test_a_track_is_found_as_tabled(name, turned):
    """Tables A.4 and A.5."""
    track = SETUPS[name]
    found = find_track(sensed(turned, track), track.counts_per_turn)
    assert found.low == track.low
    assert found.high_up == pytest.approx(track.high_up, abs=1)
    assert found.high_down == pytest.approx(track.high_down, abs=1)


@pytest.mark.parametrize("name", SETUPS)
def test_swings_through_the_blind_zone_come_out_whole(name):
    track = SETUPS[name]
    t = np.arange(0, 12, 0.01)
    # Swings that grow from the bottom into whole turns, and turn round inside the zone too.
    phi = 0.7 * t * np.sin(3 * t) + 0.02
    found = unwrap(sensed(phi, track), track)
    half_a_count = np.pi / track.counts_per_turn
    assert np.abs(found.angle - phi)[~found.blind].max() < 1.001 * half_a_count
    assert found.blind.any()
    assert found.blind.mean() < 0.15
    # A straight line over the zone: at most its width off, and mostly much less.
    assert np.abs(found.angle - phi).max() < max(track.blind_up, track.blind_down)


@given(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=60), st.sampled_from(sorted(SETUPS)))
def test_seen_angles_are_exact_for_any_walk(steps, name):
    """Against the definition of the sensor, written here again."""
    track = SETUPS[name]
    turn = track.counts_per_turn
    true = np.concatenate([[0.0], np.cumsum(steps) * turn / (2 * np.pi)])
    inside = (true - track.low) % turn + track.low
    upwards = np.append(True, np.diff(true) >= 0)
    above = inside > np.where(upwards, track.high_up, track.high_down)
    counts = np.round(np.where(above, np.where(upwards, track.high_up, track.low), inside))
    found = unwrap(counts, track)
    error = found.angle * turn / (2 * np.pi) - true
    wholes = np.round(error[~found.blind] / turn)
    assert np.all(np.abs(error[~found.blind] - wholes * turn) <= 0.5 + 1e-6)
    # Steps are below half a turn less the blind zone, so that no turn is lost.
    widest = turn - min(track.high_up, track.high_down) + track.low
    if np.max(np.abs(np.diff(true))) < turn / 2 - widest:
        assert np.all(wholes == 0)


def test_what_a_track_cannot_be():
    with pytest.raises(InputError, match="low < high"):
        Track(1024, low=-306, high_up=800, high_down=640)
    with pytest.raises(InputError, match="sample 1"):
        unwrap([0, 900], SETUPS["setup 1"])
    with pytest.raises(ExcitationError, match="blind"):
        unwrap([717, 717, -306], SETUPS["setup 1"])
    with pytest.raises(ExcitationError, match="on the way down"):
        find_track([0, 500, 717, -306, 0], 1024)


def test_quarter_turns_of_table_a3():
    """Five movements to 90 and to -90 degrees: 256 counts a quarter, 275 on setup 2."""
    degrees = np.repeat([90.0, -90.0], 5)
    for readings, quarter, turn in (
        ([257, 255, 260, 257, 257, -255, -258, -256, -255, -255], 256.5, 1024),
        ([274, 274, 275, 274, 274, -279, -277, -276, -275, -275], 275.3, 1091),
    ):
        scale = fit_scale(degrees, readings)
        assert 90 * scale.slope.value == pytest.approx(quarter, abs=0.05)
        assert abs(360 * scale.slope.value - turn) < 12
        assert np.allclose(scale.position([90 * scale.slope.value + scale.zero.value]), [90.0])
        # The standard deviations are those of NumPy's own fit.
        _, covariance = np.polyfit(degrees, readings, 1, cov=True)
        sd = np.sqrt(np.diag(covariance))
        assert (scale.slope.sd, scale.zero.sd) == pytest.approx(tuple(sd), rel=1e-9)


def test_encoder_counts_per_turn():
    """Table 3.1, and the same experiment on the Modelica encoder."""
    for sweeps, printed in (
        ([52254, 52242, 52170, 52548, 52288, 52482], 52330),
        ([52512, 52616, 52566, 52502, 52542, 52294], 52505),
    ):
        found = counts_per_turn(sweeps, 8)
        assert 8 * found.value == pytest.approx(printed, abs=1)
        assert found.sd == pytest.approx(np.std(sweeps, ddof=1) / 8 / np.sqrt(6))
    t = np.arange(0, 30, 0.01)
    turns = np.interp(t, [0, 5, 15, 25, 30], [0, 4, -4, 4, 0])
    run = simulate_model(
        "Twinproof.Sensors.Encoder",
        inputs=(t, {"phi": 2 * np.pi * turns}),
        parameters={"N": 6541.0, "phi_0": 0.3},
        outputs=["counts"],
    )
    sweeps = sweeps_of(run["counts"])
    assert len(sweeps) == 2
    assert counts_per_turn(sweeps, 8).value == pytest.approx(6541, abs=0.2)


def test_affine_amplifier_of_table_b2():
    """V = 0.080 (|u| - 14) on setup 1, 0.074 (|u| - 5) on setup 2; the report's means beside."""
    for volts, gain, threshold, mean in (
        (VOLTS_1, 0.080, 14, 0.0602),
        (VOLTS_2, 0.074, 5, 0.0680),
    ):
        found = affine_gain(DRIVE, volts)
        slope, constant = np.polyfit(np.abs(DRIVE), np.abs(volts), 1)
        assert found.gain.value == pytest.approx(slope)
        assert found.threshold.value == pytest.approx(-constant / slope)
        assert found.gain.value == pytest.approx(gain, rel=0.02)
        assert found.threshold.value == pytest.approx(threshold, abs=1)
        assert found.mean_ratio == pytest.approx(mean, abs=1e-3)
        assert np.allclose(found.voltage(DRIVE), volts, atol=3 * found.residual_sd)
        assert found.voltage([5.0, -3.0])[1] == 0


def test_affine_gain_agrees_with_the_modelica_dead_zone():
    u = np.array([25.0, -30.0, 40.0, -55.0, 70.0])
    time = np.arange(5.0)
    run = simulate_model(
        ModelicaSource(
            'model Q Twinproof.Interfaces.RealInput c(unit = "1");'
            ' Twinproof.Interfaces.RealOutput y(unit = "1");'
            " Twinproof.Effects.Signal.DeadZone z(w = 13.7);"
            " equation z.u = c; y = 0.08 * z.y; end Q;",
            "Q",
            "Q.mo",
            "Q.mo:Q",
        ),
        inputs=(time, {"c": u}),
    )
    found = affine_gain(u, run["y"])
    assert (found.gain.value, found.threshold.value) == pytest.approx((0.08, 13.7))
    assert np.allclose(found.voltage(u), run["y"])


RIG = ModelicaSource(
    """model Rig
  extends Twinproof.Plants.FurutaPendulum(w_0 = 2e-3);
  Twinproof.Interfaces.RealOutput counts(unit = "1");
  Twinproof.Effects.Rotational.StribeckFriction rest(w_s = 0.1, w_0 = 2e-3);
  Twinproof.Sensors.Encoder encoder;
equation
  connect(rest.flange, arm.flange);
  encoder.phi = alpha;
  counts = encoder.counts;
end Rig;""",
    "Rig",
    "Rig.mo",
    "Rig.mo:Rig",
)


@pytest.mark.parametrize("returns", [False, True], ids=["type A", "type B"])
def test_dead_zone_of_a_motor_with_stiction(returns):
    """Section 3.3 on the Modelica plant: steps of 2 counts, 1 s each, until the arm moves."""
    sizes = np.arange(36.0, 60.0, 2.0)
    ramp = np.ravel(np.column_stack([sizes, 0 * sizes])) if returns else sizes
    u = np.repeat(np.concatenate([[0.0], ramp, [0.0], -ramp, [0.0]]), 100)
    motor = 0.0706 * 0.0618 / 0.9
    run = simulate_model(
        RIG,
        inputs=(np.arange(u.size) * 0.01, {"u": u}),
        # Somebody holds the rod, whose swings would help the arm to break away.
        parameters={"rest.tau_s": 45 * motor - 0.0351, "C1": 5e-3},
        outputs=["counts"],
    )
    # 5 degrees in a second: the smoothed friction creeps.
    found = dead_zone(u, run["counts"], least=5 * 18.17)
    assert found.each.size == 2
    assert 44 <= found.forwards.value <= 48
    assert -48 <= found.backwards.value <= -44


def test_a_dead_zone_that_cannot_be_found_says_why():
    u = np.repeat([1.0, 2.0, 3.0], 10)
    still, moving = np.zeros(30), np.arange(30.0)
    with pytest.raises(ExcitationError, match="larger commands"):
        dead_zone(u, still, least=1)
    with pytest.raises(ExcitationError, match="smaller commands"):
        dead_zone(u, moving, least=1)
    with pytest.raises(ExcitationError, match="no ramp"):
        dead_zone(np.zeros(30), moving, least=1)


WEIGHT = 0.0276 * 9.81 * 0.145
ROD = ModelicaSource(
    """model Rod
  extends Twinproof.Plants.Pendulum(J = 0.79e-3, mgl = 0.03926, d = 1e-4);
  Twinproof.Effects.Rotational.CoulombFriction dry(w_0 = 5e-4);
equation
  connect(dry.flange, joint.flange);
end Rod;""",
    "Rod",
    "Rod.mo",
    "Rod.mo:Rod",
)


def test_friction_at_rest_hides_the_zero_and_a_swing_shows_it():
    """0.7 degrees, as on the report's page on balancing; counts of 0.35 degrees."""
    friction = WEIGHT * np.sin(0.7 * DEGREE)
    assert rest_shift(friction, WEIGHT) == pytest.approx(0.7 * DEGREE)
    t = np.arange(0, 12, 0.01)
    count = 2 * np.pi / 1024
    resting, zeros = [], []
    for start in (40.0, 52.0, -47.0, 61.0):
        run = simulate_model(
            ROD,
            inputs=(t, {"tau": 0 * t}),
            parameters={"dry.tau_c": friction, "theta_start": start * DEGREE},
            outputs=["theta"],
        )
        shift = 0.011  # of the sensor
        read = np.round((run["theta"] + shift) / count) * count
        resting.append(abs(read[-1] - shift))
        found = zero_from_swing(read, resolution=count)
        zeros.append((found.value - shift) / found.sd)
        assert abs(found.value - shift) < 0.2 * DEGREE
    assert max(resting) > 0.4 * DEGREE, "the rest position is wrong"
    assert np.abs(zeros).max() < 3.5


def test_balancing_shows_the_zero_of_upright():
    """A controller whose zero is 0.7 degrees off: its arm wanders, the mean tilt tells."""
    bias, gains = 0.7 * DEGREE, np.array([-6.0, -5.0, 137.0, 20.0])
    tilts, arm, u = [], [], 0.0
    start = {"beta_start": np.pi + 0.03}
    with Plant(model_fmu("Twinproof.Plants.FurutaPendulum"), parameters=start) as plant:
        before = None
        for _ in range(2000):
            seen = plant.read()
            state = np.array([seen["alpha"], seen["beta"] - np.pi + bias])
            rates = (state - (state if before is None else before)) / 0.01
            before = state
            x = np.array([state[0], rates[0], state[1], rates[1]])
            u = float(np.clip(0.84 * u - gains @ x, -127, 127))
            plant.set({"u": u})
            plant.step(0.01)
            tilts.append(state[1])
            arm.append(state[0])
    found = zero_from_balance(np.array(tilts)[500:])
    assert abs(found.value - bias) < 0.05 * DEGREE
    assert abs(np.mean(arm[500:])) > 5 * DEGREE


def test_what_cannot_be_calibrated_is_said():
    for call in (
        lambda: fit_scale([90.0, 90.0, 90.0], [1.0, 2.0, 3.0]),
        lambda: fit_scale([0.0, 1.0, 2.0, 3.0], [5.0, -5.0, 5.0, -5.0]),
        lambda: affine_gain([50, 50, 50], [3.0, 3.1, 3.0]),
        lambda: zero_from_swing(np.linspace(0, 1, 100), resolution=0.01),
        lambda: zero_from_balance(np.zeros(20)),
    ):
        with pytest.raises(ExcitationError) as caught:
            call()
        assert caught.value.remedy
    for call in (
        lambda: fit_scale([0.0, 1.0], [0.0]),
        lambda: counts_per_turn([1.0], 0),
        lambda: rest_shift(1.0, 0.5),
        lambda: zero_from_swing([1.0, np.nan], resolution=1.0),
    ):
        with pytest.raises(InputError):
            call()
