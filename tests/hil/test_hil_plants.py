from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import cont2discrete

from fmus.package import cached_fmu
from fmus.sources import library_class
from foundation.errors import ComputationError, InputError, UnsupportedModelError
from hil.controllers import (
    CONTROLLERS,
    PID,
    Incremental,
    OnLine,
    StateFeedback,
    SwingUp,
    optimal_gain,
)
from hil.linear import linear_model
from hil.rig import run_scenario
from hil.scenario import read_scenario
from hil.settings import parse_toml
from hil.study import study_of
from hil.whatif import run_study

EXAMPLES = Path(__file__).parents[2] / "examples" / "hil"


def fmu(plant):
    return cached_fmu(library_class(f"Twinproof.Plants.{plant}"))


@pytest.mark.parametrize(
    "name",
    [
        *("robot_2d", "robot_2d_unknown", "robot_3d", "positioner"),
        pytest.param("furuta_over_can", marks=pytest.mark.slow),
    ],
)
def test_plant_in_the_loop(name, tmp_path):
    result = run_scenario(
        read_scenario(EXAMPLES / f"{name}.toml"), recording=tmp_path / f"{name}.blf"
    )
    assert result.verdicts
    assert result.passed, result.verdicts
    assert result.plant.dropped == 0


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda p: p.stem)
def test_every_example_can_be_read(path):
    text = path.read_text()
    read = study_of if "[controllers." in text else None
    if read is None:
        assert read_scenario(path).criteria
    else:
        assert study_of(parse_toml(text, path)).cases()


def test_furuta_swings_up_and_balances(tmp_path):
    text = (EXAMPLES / "furuta.toml").read_text().replace("draws = 100", "draws = 12")
    (tmp_path / "FurutaWithStiction.mo").write_text(
        (EXAMPLES / "FurutaWithStiction.mo").read_text()
    )
    result = run_study(study_of(parse_toml(text, tmp_path / "furuta.toml")), workers=0)
    assert result.rate().passed >= 11


def test_stiction_of_the_example_is_45_counts():
    text = (EXAMPLES / "FurutaWithStiction.mo").read_text()
    tau_s, w_s, w_0 = (
        float(text.split(f"{name} = ")[1].split(",")[0].split(")")[0])
        for name in ("tau_s", "w_s", "w_0")
    )
    w = np.linspace(0, 1, 100_000)
    torque = tau_s * np.exp(-((w / w_s) ** 2)) * np.tanh(w / w_0) + 0.0351 * np.tanh(15 * w)
    counts = np.max(torque) / (0.0706 * 0.0618 / 0.9)
    assert counts == pytest.approx(45, abs=0.2)


def test_printed_model_and_poles_of_the_furuta_pendulum():
    """(5.7), the open-loop poles below (5.13) and the closed-loop ones of figure 5.9."""
    linear = linear_model(fmu("FurutaPendulum"), point={"beta": np.pi}, parameters={"K_f": 0.0})
    A, B = linear.in_outputs(["alpha", "omega_alpha", "beta", "omega_beta"]).sampled(0.01)
    printed = [
        [1, 0.0097, 0.0004, 0],
        [0, 0.94, 0.08, 0.0002],
        [0, -0.0002, 1.003, 0.01],
        [0, -0.045, 0.553, 1.001],
    ]
    assert pytest.approx(np.array(printed), abs=5e-3) == A
    assert B[:, 0] == pytest.approx([0.0001, 0.013, 0, 0.01], abs=3e-4)
    whole = np.block([[A, B], [np.zeros((1, 4)), np.ones((1, 1))]])
    open_loop = np.sort(np.linalg.eigvals(whole).real)
    assert open_loop == pytest.approx([0.9183, 0.9520, 1, 1, 1.0746], abs=5e-4)
    law = Incremental(
        measured=("alpha", "beta"),
        commanded=("u",),
        period=0.01,
        gains=(-6.0, -5.0, 137.0, 20.0, 0.15),
    )
    K = np.array([law.gains])
    closed = np.linalg.eigvals(whole - np.vstack([B, [[1.0]]]) @ K)
    for pole in (0.8731 + 0.3352j, 0.9372, 0.9868 + 0.0172j):
        assert np.min(np.abs(closed - pole)) < 5e-4
    # Setup 2 is another motor, amplifier and inertia: not repeated here.


def test_printed_gain_of_the_robot():
    """(2.10); the print is rounded, the corrected figures are those of the reference notes."""
    law = StateFeedback(
        measured=("theta_b", "theta_m", "omega_b", "omega_m"),
        commanded=("u",),
        period=0.01,
        poles=("0.8", "0.9", "0.9+0.05j", "0.9-0.05j"),
    )
    law.design(linear_model(fmu("BalancingRobot2D")))
    assert law.F[0] == pytest.approx([32.258, 1.763, 4.3125, 0.5216], rel=1e-3)
    assert law.F[0] == pytest.approx([32.2761, 1.7605, 4.3148, 0.5209], rel=2e-3)


def test_printed_gain_and_poles_of_the_robot_that_turns():
    """(3.33), (3.35): F1 is LQ with Q = diag(10, 50, 0, 0), R = 1 on a model with J/1.1, h = 0.1 s;
    on the true one the loop has other poles."""
    linear = linear_model(fmu("BalancingRobot3D")).in_outputs(
        ["theta_w", "theta_b", "omega_w", "omega_b"]
    )
    more = np.diag([1.0, 1.0, 1.1, 1.1])
    A, B = replace(linear, A=more @ linear.A, B=more @ linear.B).sampled(0.1)
    F = optimal_gain(A, B[:, :1], np.diag([10.0, 50, 0, 0]), np.eye(1))
    assert F[0] == pytest.approx([1.5216, 124.181, 2.3915, 18.3089], rel=2e-2)
    placed = np.sort(np.linalg.eigvals(A + B[:, :1] @ F).real)
    assert placed == pytest.approx([6.0355e-5, 0.5253, 0.5745, 0.7630], abs=5e-3)
    A, B = linear.sampled(0.1)
    found = np.linalg.eigvals(A + B[:, :1] @ F)
    for pole in (0.0655, 0.2826, 0.7669 + 0.102j):
        assert np.min(np.abs(found - pole)) < 5e-3, np.sort_complex(found)


def test_sampled_models_agree_with_scipy():
    linear = linear_model(fmu("WheeledPendulum"))
    A, B = linear.sampled(0.01)
    expected = cont2discrete((linear.A, linear.B, linear.C, linear.D), 0.01)
    assert pytest.approx(expected[0], abs=1e-12) == A
    assert pytest.approx(expected[1], abs=1e-12) == B


def test_optimal_gain_solves_the_riccati_equation():
    A, B = linear_model(fmu("BalancingRobot2D")).sampled(0.01)
    Q, R = np.diag([1.0, 2, 3, 4]), np.eye(1)
    F = optimal_gain(A, B, Q, R)
    P = solve_discrete_are(A, B, Q, R)
    closed = A + B @ F
    assert pytest.approx(Q + F.T @ R @ F + closed.T @ P @ closed, rel=1e-6) == P
    assert np.max(np.abs(np.linalg.eigvals(closed))) < 1
    with pytest.raises(ComputationError):
        optimal_gain(np.diag([1.2, 0.5]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))


def test_pitch_can_be_controlled_without_the_wheel_angle():
    linear = linear_model(fmu("WheeledPendulum"))
    assert linear.in_outputs(["theta_p", "omega_w", "omega_p"]).A.shape == (3, 3)
    with pytest.raises(UnsupportedModelError, match="measure all states"):
        linear.in_outputs(["theta_p", "omega_p"])


LAWS = [
    PID(
        measured=("a",),
        commanded=("u",),
        period=0.01,
        proportional=2.0,
        integral=1.0,
        derivative=0.1,
        limit=1.0,
    ),
    StateFeedback(
        measured=("a", "b"), commanded=("u",), period=0.01, gain=((1.0, 2.0),), limit=1.0
    ),
    Incremental(
        measured=("a", "b"), commanded=("u",), period=0.01, gains=(1, 2, 3, 4, 0.5), limit=1.0
    ),
    SwingUp(measured=("a", "b"), commanded=("u",), period=0.01, limit=1.0),
    OnLine(measured=("a", "b"), commanded=("u",), period=0.01, poles=("0.5", "0.6"), limit=1.0),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.kind)
def test_every_law_starts_anew_keeps_its_limit_and_repeats_itself(law):
    rng = np.random.default_rng(1)
    y = 10 * rng.standard_normal((200, len(law.measured)))
    runs = []
    for _ in range(2):
        law.start()
        runs.append(
            [law.step(k * law.period, list(row), [0.0] * len(row)) for k, row in enumerate(y)]
        )
    assert runs[0] == runs[1]
    table = np.array(runs[0])
    assert table.shape == (200, 1)
    assert np.max(np.abs(table)) <= 1.0


def test_every_law_is_in_the_conformance_test():
    assert {law.kind for law in LAWS} == set(CONTROLLERS) - {"fmu"}


@pytest.mark.parametrize(
    "make",
    [
        lambda: PID(measured=("a", "b"), commanded=("u",), period=0.1, proportional=1.0),
        lambda: PID(measured=("a",), commanded=("u",), period=0.1, proportional=1.0),
        lambda: PID(measured=("a",), commanded=("u",), period=-1.0, proportional=1.0),
        lambda: StateFeedback(measured=("a",), commanded=("u",), period=0.1),
        lambda: StateFeedback(measured=("a",), commanded=("u",), period=0.1, gain=((1.0, 2.0),)),
        lambda: Incremental(measured=("a",), commanded=("u",), period=0.1, gains=(1.0,)),
        lambda: SwingUp(measured=("a",), commanded=("u",), period=0.1),
        lambda: SwingUp(measured=("a", "b"), commanded=("u",), period=0.1, zone=(2.0, 1.0)),
        lambda: OnLine(measured=("a",), commanded=("u",), period=0.1, poles=("0.5",), form="x"),
    ],
)
def test_laws_that_make_no_sense(make):
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.remedy


def test_pid_against_its_formula():
    law = PID(
        measured=("a",),
        commanded=("u",),
        period=1e-3,
        proportional=3.0,
        integral=2.0,
        derivative=0.5,
        bandwidth=50.0,
    )
    rng = np.random.default_rng(2)
    error = rng.standard_normal(400)
    law.start()
    found = [law.step(0.0, [-e], [0.0])[0] for e in error]
    from scipy.signal import lfilter

    integral = lfilter([0, 1e-3], [1, -1], error)
    slope = lfilter([50.0, -50.0], [1, -(1 - 50 * 1e-3)], error)
    assert found == pytest.approx(3 * error + 2 * integral + 0.5 * slope, abs=1e-9)


def test_switching_in_at_10_and_out_at_20_degrees():
    law = SwingUp(measured=("a", "b"), commanded=("u",), period=0.01)
    law.start()
    modes = []
    for tilt in (40, 21, 11, 9, 15, 19, 21, 15, 11, 9):
        law.step(10.0, [0.0, np.pi + np.radians(tilt)], [0.0, 0.0])
        modes.append(law.mode)
    assert modes == [*["swing"] * 3, *["balance"] * 3, *["swing"] * 3, "balance"]
