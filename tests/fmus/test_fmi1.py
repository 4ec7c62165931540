"""FMI 1.0: FMUs written by hand in C run, are checked, co-simulate and are guarded."""

import foreign
import numpy as np
import pytest

from fmus.archive import describe
from fmus.checking import check_fmu
from fmus.guarded import open_plant
from fmus.master import Component, Connection, System
from fmus.running import simulate
from foundation.errors import FmuError, InputError


@pytest.fixture(scope="module", params=["CoSimulation", "ModelExchange"])
def fmu(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("one")
    return foreign.version_1(folder, co_simulation=request.param == "CoSimulation")


@pytest.fixture(scope="module")
def slave(tmp_path_factory):
    return foreign.version_1(tmp_path_factory.mktemp("slave"))


def held(times, inputs, rate, start=1.0):
    values = [start]
    for u, h in zip(inputs[:-1], np.diff(times), strict=True):
        values.append(u + (values[-1] - u) * np.exp(-rate * h))
    return np.array(values)


def test_description(slave):
    shown = describe(slave)
    assert (shown.fmi, shown.kinds) == ("1.0", ("CoSimulation",))
    assert [v.name for v in shown.inputs] == ["u"]
    assert [v.name for v in shown.parameters] == ["rate"]
    assert {"y", "steps"} == {v.name for v in shown.outputs}


@pytest.mark.parametrize("guarded", [True, False])
def test_values(fmu, guarded):
    times = np.linspace(0.0, 2.0, 101)
    u = np.where(times < 1.0, 3.0, -1.0)
    run = simulate(
        fmu, inputs=(times, {"u": u}), parameters={"rate": 5.0}, outputs=["y"], guarded=guarded
    )
    assert run["y"] == pytest.approx(held(times, u, 5.0), abs=1e-6)


def test_integers_and_further_outputs(slave):
    run = simulate(slave, stop=1.0, step=0.25, outputs=["steps", "slope"])
    assert run["steps"].tolist() == [0, 1, 2, 3, 4]
    assert run["slope"] == pytest.approx(-2 * np.exp(-2 * run.time), abs=1e-12)


def test_plant(slave):
    with open_plant(slave, parameters={"rate": 1.0}) as plant:
        plant.set({"u": 2.0})
        plant.step(0.5)
        assert plant.read()["y"] == pytest.approx(2 - np.exp(-0.5))
        plant.reset({"rate": 3.0})
        run = plant.run(stop=1.0, step=0.1)
        assert run["y"] == pytest.approx(np.exp(-3 * run.time))
        with pytest.raises(InputError, match="state"):
            plant.save()


def test_checks_pass(fmu):
    lines = check_fmu(fmu)
    assert [line.name for line in lines if not line.ok] == []
    assert {"rules of the standard", "repeats itself"} <= {line.name for line in lines}


def test_in_a_system_with_another_version(slave, tmp_path):
    other = foreign.hand_written(tmp_path)
    system = System(
        {"one": Component(slave), "two": Component(other)},
        [Connection("one.y", "two.u"), Connection("two.y", "one.u")],
    )
    run = system.simulate(stop=1.0, step=0.1)
    y, x = 1.0, 0.0
    for k in range(10):
        y, x = x + (y - x) * np.exp(-2 * 0.1), x + 0.1 * (y - x)
        assert (run["one.y"][k + 1], run["two.y"][k + 1]) == pytest.approx((y, x), abs=1e-12)


def test_refusals_are_messages(fmu):
    with pytest.raises(FmuError, match=r"failed|refuse"):
        simulate(fmu, parameters={"rate": -1.0}, stop=1.0, step=0.1)
