"""Closed loops predicted, against loops integrated by SciPy and a law written here."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmus.package import cached_fmu
from fmus.sources import library_class
from foundation.errors import ChannelError, DivergenceError, InputError, UnknownNameError
from hil.controllers import PID
from hil.prediction import predict_loop
from recordings import Channel, Recording

STEP, SAMPLES = 0.01, 400
TRUE = {"J": 0.185, "mgl": 3.61, "d": 0.006}
START = {"theta_start": 0.2, "omega_start": -0.1}
TIME = np.arange(SAMPLES) * STEP
REFERENCE = 0.3 * np.sin(2 * TIME)
P, INTEGRAL, D, N = 8.0, 3.0, 1.5, 50.0


@cache
def plant():
    return cached_fmu(library_class("Twinproof.Plants.Pendulum"))


def pid(**changes):
    keys = {
        "proportional": P,
        "integral": INTEGRAL,
        "derivative": D,
        "bandwidth": N,
        "period": STEP,
    }
    return PID(measured=("theta",), commanded=("tau",), **(keys | changes))


@cache
def machine(J=0.185, mgl=3.61, late=0):
    """Angle, rate and torque (n,) each; a command acts `late` samples after its sensors."""
    x, integral, smooth = np.array([0.2, -0.1]), 0.0, 0.0
    states, wanted = np.empty((SAMPLES, 2)), np.zeros(SAMPLES + 1)
    for k in range(SAMPLES):
        states[k] = x
        error = REFERENCE[k] - x[0]
        slope = N * (error - smooth)
        wanted[k + late] = P * error + INTEGRAL * integral + D * slope
        integral, smooth = integral + STEP * error, smooth + STEP * slope

        def rates(_, x, torque=wanted[k]):
            return [x[1], (torque - mgl * np.sin(x[0]) - 0.006 * x[1]) / J]

        x = solve_ivp(rates, (0, STEP), x, rtol=1e-10, atol=1e-12).y[:, -1]
    return {"theta": states[:, 0], "omega": states[:, 1], "tau": wanted[:SAMPLES]}


def record(columns, origin="run"):
    return Recording(TIME, {name: Channel(name, c) for name, c in columns.items()}, origin)


@pytest.mark.parametrize("late", [0, 1])
def test_the_true_model_predicts_outputs_and_control_input(late):
    found = predict_loop(
        *(plant(), pid(), record(machine(late=late)), {"theta": REFERENCE}),
        parameters=TRUE | START,
        at_once=not late,
    )
    assert set(found.rmse) == {"theta", "omega", "tau"}
    for name, column in machine(late=late).items():
        np.testing.assert_allclose(found.simulated[name], column, atol=2e-5, err_msg=name)


def test_a_wrong_model_errs_by_what_its_own_loop_differs():
    wrong = {"J": 0.25, "mgl": 3.0}
    found = predict_loop(
        *(plant(), pid(), record(machine()), {"theta": REFERENCE}),
        parameters=TRUE | START | wrong,
    )
    for name, column in machine(**wrong).items():
        expected = np.sqrt(np.mean((column - machine()[name]) ** 2))
        assert found.rmse[name] == pytest.approx(expected, rel=1e-3)
        assert found.rmse[name] > 1e-3


def test_the_moment_a_command_acts_matters():
    late = record(machine(late=1))
    references = {"theta": REFERENCE}
    right = predict_loop(plant(), pid(), late, references, parameters=TRUE | START, at_once=False)
    wrong = predict_loop(plant(), pid(), late, references, parameters=TRUE | START)
    assert wrong.rmse["tau"] > 100 * right.rmse["tau"]


def test_the_control_input_need_not_be_recorded():
    angle = record({"theta": machine()["theta"]})
    found = predict_loop(plant(), pid(), angle, {"theta": REFERENCE}, parameters=TRUE | START)
    assert list(found.rmse) == ["theta"]
    np.testing.assert_allclose(found.simulated["tau"], machine()["tau"], atol=2e-5)


def test_an_unstable_loop_is_said():
    with pytest.raises(DivergenceError, match="leaves all bounds after"):
        predict_loop(
            *(plant(), pid(proportional=-1e4), record(machine()), {"theta": REFERENCE}),
            parameters=TRUE,
        )


def test_mistakes_are_named():
    data = record(machine())
    with pytest.raises(InputError, match=r"reference of theta has shape \(3,\)"):
        predict_loop(plant(), pid(), data, {"theta": np.zeros(3)})
    with pytest.raises(UnknownNameError, match="'omega'"):
        predict_loop(plant(), pid(), data, {"omega": REFERENCE})
    with pytest.raises(InputError, match="period"):
        predict_loop(plant(), pid(period=0.015), data, {"theta": REFERENCE})
    with pytest.raises(ChannelError, match="neither an output nor a commanded input"):
        predict_loop(plant(), pid(), record({"other": TIME}), {"theta": REFERENCE})
