"""FMUs in the place of Modelica source: compared and fitted through FMI alone."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from fmus.black_box import black_box
from fmus.dae import ScalarType
from fmus.package import cached_fmu, export
from fmus.sources import library_class
from foundation.errors import FmuError, InputError, UnknownNameError, UnsupportedModelError
from twinproof import Model, compare, identify, read_recording

sys.path.insert(0, str(Path(__file__).parents[1] / "fmus"))
import foreign

PENDULUM = "Twinproof.Plants.Pendulum"
TRUE = {"J": 0.2, "mgl": 3.5, "d": 0.1}


@pytest.fixture(scope="module")
def swing(tmp_path_factory):
    """A pendulum driven by a held torque, by SciPy, with noise."""
    h, n = 0.01, 500
    time = np.arange(n) * h
    tau = 1.2 * (np.sin(1.9 * time) + 0.7 * np.sin(5.1 * time + 1))
    state, theta = np.array([0.3, 0.0]), np.zeros(n)
    for k in range(n):
        theta[k] = state[0]

        def rhs(_, x, u=tau[k]):
            return [x[1], (u - 3.5 * np.sin(x[0]) - 0.1 * x[1]) / 0.2]

        state = solve_ivp(rhs, (0, h), state, rtol=1e-9, atol=1e-11).y[:, -1]
    theta += 1e-3 * np.random.default_rng(5).standard_normal(n)
    path = tmp_path_factory.mktemp("swing") / "swing.csv"
    pd.DataFrame({"time": time, "tau": tau, "theta": theta}).to_csv(path, index=False)
    return path


def record(model, path):
    return read_recording(path, model)


@pytest.fixture(scope="module", params=["2", "3"])
def pendulum(request, tmp_path_factory):
    # Outside of the cache, it is foreign.
    path = tmp_path_factory.mktemp("fmu") / "pendulum.fmu"
    export(library_class(PENDULUM), path, fmi=request.param)
    return Model.of(str(path))


def test_it_compares_as_its_source_does(pendulum, swing):
    source = Model.of(PENDULUM)
    values = {"J": 0.21, "d": 0.05}
    for horizon in ("free", "1.0"):
        ours = compare(source, record(source, swing), parameters=values, horizon=horizon)
        there = compare(pendulum, record(pendulum, swing), parameters=values, horizon=horizon)
        a, b = (c.comparison.channels["theta"].rmse for c in (ours, there))
        assert b == pytest.approx(a, rel=1e-3)
        assert there.horizon == ours.horizon


def test_it_is_fitted_as_its_source_is(pendulum, swing):
    source = Model.of(PENDULUM)
    ours = identify(source, record(source, swing), method="output-error").estimate
    there = identify(pendulum, record(pendulum, swing)).estimate
    assert set(there.parameters) == set(TRUE)
    for name, parameter in there.parameters.items():
        assert parameter.value == pytest.approx(TRUE[name], abs=5 * parameter.sd)
        assert parameter.value == pytest.approx(ours.parameters[name].value, rel=1e-4)
        assert parameter.sd == pytest.approx(ours.parameters[name].sd, rel=0.02)
        assert parameter.unit == ours.parameters[name].unit


def test_what_needs_equations_says_so(pendulum, swing):
    data = record(pendulum, swing)
    for method in ("kalman", "output-filter", "differencing", "instrumental"):
        with pytest.raises(UnsupportedModelError, match="equations"):
            identify(pendulum, data, method=method)
    assert [place.name for place in pendulum.places] == ["tau", "theta", "omega"]


def lag(tmp_path_factory, maker):
    pytest.importorskip("pythonfmu")
    pytest.importorskip("pythonfmu3")
    folder = tmp_path_factory.mktemp("lag")
    makers = {
        "1": foreign.version_1,
        "1, Model Exchange": lambda f: foreign.version_1(f, co_simulation=False),
        "2": foreign.by_pythonfmu,
        "3": foreign.by_pythonfmu3,
    }
    return Model.of(str(makers[maker](folder)))


@pytest.mark.parametrize("maker", ["1", "1, Model Exchange", "2", "3"])
def test_a_parameter_of_a_foreign_fmu(maker, tmp_path_factory):
    """Whose state is hidden: it starts where the FMU says."""
    model = lag(tmp_path_factory, maker)
    time = np.arange(0, 300) * 0.02
    u = np.sign(np.sin(2 * time))
    y, rate = [1.0], 1.4
    for value in u[:-1]:
        share = 1 - np.exp(-0.02 * rate) if maker.startswith("1") else 0.02 * rate
        y.append(y[-1] + share * (value - y[-1]))
    noisy = np.array(y) + 1e-3 * np.random.default_rng(2).standard_normal(300)
    path = tmp_path_factory.mktemp("data") / "lag.csv"
    pd.DataFrame({"time": time, "u": u, "y": noisy}).to_csv(path, index=False)
    data = record(model, path)
    before = compare(model, data, horizon="free").comparison.channels["y"]
    assert before.rmse > 0.1
    true = compare(model, data, parameters={"rate": rate}, horizon="free").comparison
    assert true.channels["y"].rmse == pytest.approx(1e-3, rel=0.15)
    assert true.channels["y"].white_p > 0.001
    found = identify(model, data, free=["rate"]).estimate.parameters["rate"]
    assert abs(found.value - rate) < 5 * found.sd < 0.01
    with pytest.raises(InputError, match=r"no state of .* can be set"):
        compare(model, data, horizon=1)


def test_a_crash_while_comparing_is_a_message(tmp_path_factory, tmp_path):
    model = Model.of(str(foreign.hand_written(tmp_path_factory.mktemp("crash"))))
    time = np.arange(0, 100) * 0.01
    path = tmp_path / "data.csv"
    pd.DataFrame({"time": time, "u": np.sin(time), "y": np.cos(time)}).to_csv(path, index=False)
    with pytest.raises(FmuError, match="SIGSEGV"):
        compare(model, record(model, path), parameters={"misdeed": 1.0})
    with pytest.raises(UnknownNameError, match="misdede"):
        compare(model, record(model, path), parameters={"misdede": 1.0})


def test_black_box():
    box = black_box(cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"), fmi="3"))
    assert [v.name for v in box.inputs] == ["V"]
    assert box.start_parameters["theta_p_start"] == "theta_p"
    assert box.variables["X1"].unit
    assert all(v.type is ScalarType.REAL for v in box.parameters)
    assert not box.residuals


NONLINEAR = """model N input Real u; parameter Real k = 1; parameter Real c = 0.5;
  output Real x(start = 0.2, fixed = true); Real f(start = 0.1);
equation
  der(x) = u - f; f + c * f ^ 3 = k * x;
end N;"""
RELAY = """model R input Real u; parameter Real T = 1; parameter Real low = -0.5;
  output Real x(start = 0, fixed = true); Boolean on(start = true, fixed = true);
equation
  T * der(x) = u + (if on then 1 else -1) - x;
  when x > 0.5 then on = false; elsewhen x < low then on = true; end when;
end R;"""


def test_nonlinear_equations_are_fitted_through_the_models_fmu(tmp_path):
    (tmp_path / "n.mo").write_text(NONLINEAR)
    model = Model.of(str(tmp_path / "n.mo"))
    h, n = 0.02, 400
    time = np.arange(n) * h
    u = 1.5 * np.sin(1.3 * time) + np.sin(4.1 * time)
    x, state = np.zeros(n), np.array([0.4])
    for i in range(n):
        x[i] = state[0]

        def rhs(_, s, u=u[i]):
            f = np.roots([0.9, 0, 1, -1.7 * s[0]])
            return [u - float(f[np.argmin(np.abs(f.imag))].real)]

        state = solve_ivp(rhs, (0, h), state, rtol=1e-9, atol=1e-11).y[:, -1]
    noisy = x + 1e-3 * np.random.default_rng(3).standard_normal(n)
    pd.DataFrame({"time": time, "u": u, "x": noisy}).to_csv(tmp_path / "n.csv", index=False)
    found = identify(model, record(model, tmp_path / "n.csv")).estimate
    for name, value in {"k": 1.7, "c": 0.9}.items():
        parameter = found.parameters[name]
        assert parameter.identifiable
        assert parameter.value == pytest.approx(value, abs=5 * parameter.sd)
        assert parameter.sd < 0.03


def test_a_model_with_memory_is_compared_through_its_fmu(tmp_path):
    (tmp_path / "r.mo").write_text(RELAY)
    model = Model.of(str(tmp_path / "r.mo"))
    h, n = 0.01, 300
    time, x, on, state = np.arange(n) * h, np.zeros(n), True, 0.0
    for i in range(n):
        x[i] = state
        left = h
        while left > 0:
            goal = 1.0 if on else -1.0
            bound = 0.5 if on else -0.5
            arrives = np.log((state - goal) / (bound - goal))
            step = min(left, max(arrives, 0.0))
            state = goal + (state - goal) * np.exp(-step)
            if step < left:
                on = not on
            left -= step
    noisy = x + 1e-3 * np.random.default_rng(4).standard_normal(n)
    pd.DataFrame({"time": time, "u": 0.0, "x": noisy}).to_csv(tmp_path / "r.csv", index=False)
    result = compare(model, record(model, tmp_path / "r.csv"), horizon="free")
    assert result.comparison.channels["x"].rmse == pytest.approx(1e-3, rel=0.2)


BALL = """model A parameter Real c = 0.7; output Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(h) = v; der(v) = -9.81;
  when h < 0 then reinit(v, -c * pre(v)); end when;
end A;"""


@pytest.mark.parametrize("method", ["auto", "output-error"])
def test_a_model_with_jumps_is_fitted_through_its_fmu(method, tmp_path):
    (tmp_path / "a.mo").write_text(BALL)
    model = Model.of(str(tmp_path / "a.mo"))
    step, n = 0.005, 300
    height, h, v = np.zeros(n), 1.0, 0.0
    for i in range(n):
        height[i] = h
        falls = (v + np.sqrt(v * v + 2 * 9.81 * h)) / 9.81
        if falls > step:
            h, v = h + v * step - 4.905 * step**2, v - 9.81 * step
        else:
            rest, v = step - falls, 0.8 * (9.81 * falls - v)
            h, v = v * rest - 4.905 * rest**2, v - 9.81 * rest
    noisy = height + 1e-3 * np.random.default_rng(6).standard_normal(n)
    pd.DataFrame({"time": np.arange(n) * step, "h": noisy}).to_csv(tmp_path / "a.csv", index=False)
    found = identify(model, record(model, tmp_path / "a.csv"), method=method).estimate
    c = found.parameters["c"]
    assert c.value == pytest.approx(0.8, abs=max(5 * c.sd, 1e-3))
    assert c.sd < 0.01
