"""Co-simulation of several FMUs against the whole in one piece, by SciPy."""

import foreign
import numpy as np
import pytest
from reference_runs import source
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from fmus.master import Component, Connection, System
from fmus.package import cached_fmu
from fmus.stepping import Loop
from foundation.errors import FmuError, InputError, UnitError, UnknownNameError

K1, K2, KC, D = 9.0, 4.0, 2.5, 0.2


def oscillator():
    """Two masses, a spring between them: each FMU has one mass and takes the other's position."""
    half = """model {name} parameter Real k = {k}; parameter Real x_start = {x};
      input Real other(start = {o}); output Real x(start = x_start, fixed = true);
      Real v(start = 0, fixed = true);
      equation der(x) = v; der(v) = -k * x - 0.2 * v + 2.5 * (other - x); end {name};"""
    a = cached_fmu(source(half.format(name="A", k=K1, x=1.0, o=-0.5), "A"))
    b = cached_fmu(source(half.format(name="B", k=K2, x=-0.5, o=1.0), "B"))
    return System(
        {"a": Component(a), "b": Component(b)},
        [Connection("a.x", "b.other"), Connection("b.x", "a.other")],
    )


def whole(times):
    A = np.array([[0, 1, 0, 0], [-K1 - KC, -D, KC, 0], [0, 0, 0, 1], [KC, 0, -K2 - KC, -D]], float)
    return np.array([expm(A * t) @ [1.0, 0.0, -0.5, 0.0] for t in times])[:, [0, 2]]


@pytest.fixture(scope="module")
def two():
    return oscillator()


@pytest.mark.parametrize("method", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("order", [1, 2])
def test_converges_at_the_order_of_the_method(two, method, order):
    errors = []
    for step in (0.02, 0.01, 0.005, 0.0025):
        run = two.simulate(stop=4.0, step=step, method=method, order=order)
        error = np.column_stack([run["a.x"], run["b.x"]]) - whole(run.time)
        errors.append(np.max(np.abs(error)))
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert observed[-1] == pytest.approx(order, abs=0.15)
    assert errors[-1] < {1: 1e-2, 2: 1e-4}[order]


@pytest.mark.parametrize("method", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4, 1e-5])
def test_error_control_holds_the_tolerance(two, method, tolerance, monkeypatch):
    steps = []
    advance = Loop.advance
    monkeypatch.setattr(Loop, "advance", lambda *a: (steps.append(1), advance(*a)))
    run = two.simulate(stop=4.0, step=0.5, method=method, order=2, tolerance=tolerance)
    error = np.column_stack([run["a.x"], run["b.x"]]) - whole(run.time)
    assert np.max(np.abs(error)) < tolerance
    # And spends no more than a second-order method must: three steps for each, a few repeated.
    assert np.max(np.abs(error)) > 0.03 * tolerance
    assert len(steps) < 40 / np.sqrt(tolerance)


def test_controller_and_plant():
    plant = cached_fmu(
        source(
            'model P input Real V(unit="V"); output Real w(start=0, fixed=true, unit="rad/s");'
            " equation 0.1 * der(w) = -w + 20 * V; end P;",
            "P",
        )
    )
    controller = cached_fmu(
        source(
            'model C input Real r(unit="rad/s"); input Real w(unit="rad/s");'
            ' output Real V(unit="V"); Real i(start=0, fixed=true);'
            " equation der(i) = r - w; V = 0.05 * (r - w) + 0.4 * i; end C;",
            "C",
        )
    )
    loop = System(
        {"controller": Component(controller), "plant": Component(plant)},
        [
            Connection("controller.V", "plant.V"),
            Connection("plant.w", "controller.w"),
            Connection("r", "controller.r"),
            Connection("plant.w", "speed"),
        ],
        inputs=["r"],
        outputs=["speed"],
    )
    time = np.arange(0, 2001) * 1e-3
    reference = np.where(time < 1.0, 10.0, -5.0)
    run = loop.simulate(inputs=(time, {"r": reference}), order=2)
    assert list(run.columns) == ["speed"]

    def rhs(t, x):
        e = (10.0 if t < 1.0 else -5.0) - x[0]
        return [(-x[0] + 20 * (0.05 * e + 0.4 * x[1])) / 0.1, e]

    first = solve_ivp(rhs, (0, 1 - 1e-12), [0, 0], rtol=1e-10, atol=1e-12, dense_output=True)
    second = solve_ivp(rhs, (1, 2), first.y[:, -1], rtol=1e-10, atol=1e-12, dense_output=True)
    truth = np.where(time < 1.0, first.sol(time)[0], second.sol(time)[0])
    assert np.max(np.abs(run["speed"] - truth)) < 0.02
    # Held outputs, as a sampled controller has them, are first-order.
    plain = loop.simulate(inputs=(time, {"r": reference}))
    assert np.max(np.abs(plain["speed"] - truth)) > np.max(np.abs(run["speed"] - truth))


def loop_of(a, b):
    block = "model {n} input Real u; output Real y; equation y = {e}; end {n};"
    return System(
        {
            n: Component(cached_fmu(source(block.format(n=n.upper(), e=e), n.upper())))
            for n, e in (("a", a), ("b", b))
        },
        [Connection("a.y", "b.u"), Connection("b.y", "a.u")],
    )


def test_algebraic_loops_are_solved():
    run = loop_of("cos(u) + 0.3 * time", "0.9 * u + 0.1").simulate(stop=1.0, step=0.1)
    for t, y in zip(run.time, run["a.y"], strict=True):
        truth = brentq(lambda y, t=t: y - np.cos(0.9 * y + 0.1) - 0.3 * t, -3, 3, xtol=1e-14)
        assert y == pytest.approx(truth, abs=1e-9)


def test_a_loop_without_solution_is_an_error():
    with pytest.raises(FmuError, match="algebraic loop"):
        loop_of("u + 1", "u").simulate(stop=1.0, step=0.1)


def test_chains_need_no_particular_order():
    """Direct outputs pass through several units within one point in time."""
    gain = cached_fmu(
        source("model G input Real u; output Real y; equation y = 2 * u; end G;", "G")
    )
    names = ["c", "a", "b"]
    chain = System(
        {name: Component(gain) for name in names},
        [Connection("a.y", "b.u"), Connection("b.y", "c.u"), Connection("x", "a.u")],
        inputs=["x"],
    )
    run = chain.simulate(inputs=(np.array([0.0, 1, 2]), {"x": np.array([1.0, 5, -3])}))
    assert run["c.y"] == pytest.approx([8, 40, -24])


def test_mixed_versions_and_makers(tmp_path):
    pytest.importorskip("pythonfmu3")
    lag = foreign.by_pythonfmu3(tmp_path)
    block = cached_fmu(
        source(
            "model I input Real u; output Real y(start=0, fixed=true); equation der(y) = u; end I;",
            "I",
        )
    )
    mixed = System(
        {"lag": Component(lag), "integral": Component(block)},
        [Connection("lag.y", "integral.u"), Connection("integral.y", "lag.u", -1.0, 0.0)],
    )
    run = mixed.simulate(stop=1.0, step=0.01)
    lag_y, integral = [1.0], [0.0]
    for _ in range(100):
        lag_y.append(lag_y[-1] + 0.01 * 2 * (-integral[-1] - lag_y[-1]))
        integral.append(integral[-1] + 0.01 * lag_y[-2])
    assert run["lag.y"] == pytest.approx(np.array(lag_y), abs=1e-9)
    with pytest.raises(InputError, match="save their state"):
        mixed.simulate(stop=1.0, step=0.01, tolerance=1e-3)


def test_units_convert_at_connections():
    degrees = cached_fmu(source('model U output Real y(unit="deg"); equation y = 180; end U;', "U"))
    radians = cached_fmu(
        source('model W input Real u(unit="rad"); output Real y; equation y = u; end W;', "W")
    )
    volts = cached_fmu(
        source('model X input Real u(unit="V"); output Real y; equation y = u; end X;', "X")
    )

    def system(target):
        return System({"a": Component(degrees), "b": Component(target)}, [Connection("a.y", "b.u")])

    assert system(radians).simulate(stop=1.0, step=1.0)["b.y"] == pytest.approx(np.pi)
    with pytest.raises(UnitError, match=r"a\.y → b\.u"):
        system(volts).simulate(stop=1.0)


def test_wrong_systems(two):
    for connections, kind, message in (
        ([Connection("a.x", "b.nothing")], UnknownNameError, "nothing"),
        ([Connection("a.nothing", "b.other")], UnknownNameError, "nothing"),
        ([Connection("a.x", "b.other"), Connection("b.x", "b.other")], InputError, "two sources"),
    ):
        with pytest.raises(kind, match=message):
            System(two.components, connections).simulate(stop=1.0)
    with pytest.raises(UnknownNameError, match="component"):
        two.simulate(stop=1.0, parameters={"c.k": 1.0})
    with pytest.raises(InputError, match="order"):
        two.simulate(stop=1.0, order=3)
