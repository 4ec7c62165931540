"""Stepping a plant: against SciPy, against FMPy's own loop, in one run and in many."""

import resource
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from reference_runs import source
from scipy.integrate import solve_ivp

from fmus.package import cached_fmu
from fmus.plant import Plant, run_many
from fmus.sources import library_class
from foundation.errors import FmuError, InputError, UnitError, UnknownNameError


@pytest.fixture(scope="module")
def pendulum():
    return cached_fmu(library_class("Twinproof.Plants.Pendulum"))


TIME = np.arange(2001) * 1e-3
TAU = 0.3 * np.sin(7 * TIME)


def test_batch_equals_fmpy(pendulum):
    with Plant(pendulum, parameters={"theta_start": 0.4}) as plant:
        run = plant.run((TIME, {"tau": TAU}))
    table = np.array(list(zip(TIME, TAU, strict=True)), [("time", float), ("tau", float)])
    result = fmpy.simulate_fmu(
        str(pendulum),
        stop_time=2.0,
        output_interval=1e-3,
        step_size=1e-3,
        input=table,
        start_values={"theta_start": 0.4, "tau": TAU[0]},
        output=["theta", "omega"],
    )
    # FMPy sets the input of a step's start too, and joins samples by lines: held for the step.
    for name in ("theta", "omega"):
        assert run[name] == pytest.approx(result[name], abs=1e-9)


def test_single_steps_equal_the_batch(pendulum):
    with Plant(pendulum) as plant:
        batch = plant.run((TIME[:101], {"tau": TAU[:101]}))
        plant.reset()
        for k in range(100):
            plant.set({"tau": TAU[k]})
            assert plant.read()["theta"] == pytest.approx(batch["theta"][k], abs=1e-14)
            plant.step(1e-3)


def test_run_continues_where_it_was(pendulum):
    with Plant(pendulum) as plant:
        whole = plant.run((TIME, {"tau": TAU}))["theta"]
        plant.reset()
        plant.run((TIME[:1001], {"tau": TAU[:1001]}))
        assert plant.time == TIME[1000]
        rest = plant.run((TIME[1000:], {"tau": TAU[1000:]}))["theta"]
    assert np.array_equal(rest, whole[1000:])


def test_rewind_replays_exactly(pendulum):
    with Plant(pendulum, parameters={"theta_start": 0.4}) as plant:
        plant.run(stop=0.5, step=0.01)
        state = plant.save()
        first = plant.run(stop=1.0, step=0.01)["theta"]
        plant.rewind(state)
        assert plant.time == pytest.approx(0.5)
        assert np.array_equal(plant.run(stop=1.0, step=0.01)["theta"], first)
        plant.forget(state)


def test_units_are_converted_and_checked(pendulum):
    with Plant(pendulum, parameters={"theta_start": (90.0, "deg")}) as plant:
        assert plant.read()["theta"] == pytest.approx(np.pi / 2, rel=1e-15)
        plant.set({"tau": (100.0, "mN.m")})
        with pytest.raises(UnitError, match="tau"):
            plant.set({"tau": (1.0, "m")})
        milli = plant.run((TIME, {"tau": 1e3 * TAU}), units={"tau": "mN.m"})["theta"]
        plant.reset({"theta_start": np.pi / 2})
        assert plant.run((TIME, {"tau": TAU}))["theta"] == pytest.approx(milli, abs=1e-12)


def test_derivatives_match_finite_differences():
    fmu = cached_fmu(
        source(
            "model T input Real u(start=0.3); parameter Real k=2; Real x(start=1,fixed=true);"
            " output Real y; equation der(x) = -k*x + u; y = k*x^2 + sin(u); end T;"
        )
    )
    with Plant(fmu) as plant:
        matrix = plant.derivatives(["y"], ["u", "x"])
    assert matrix == pytest.approx(np.array([[np.cos(0.3), 4.0]]), abs=1e-12)


@pytest.mark.parametrize("workers", [1, 2])
def test_many_sets_equal_scipy(pendulum, workers):
    starts = np.linspace(0.1, 2.0, 20)
    time, result = run_many(
        pendulum, {"theta_start": starts}, stop=1.0, step=0.01, tolerance=1e-10, workers=workers
    )
    with Plant(pendulum) as plant:
        J, mgl, d = (plant.parameters[n].start for n in ("J", "mgl", "d"))
        columns = list(plant.outputs)
    assert result.shape == (20, 101, len(columns))
    for k in (0, 7, 19):
        run = solve_ivp(
            lambda t, x: [x[1], (-mgl * np.sin(x[0]) - d * x[1]) / J],
            (0, 1),
            [starts[k], 0.0],
            method="DOP853",
            rtol=1e-11,
            atol=1e-12,
            t_eval=time,
        )
        assert result[k, :, columns.index("theta")] == pytest.approx(run.y[0], abs=1e-7)


def test_many_report_the_set_that_failed():
    fmu = cached_fmu(
        source(
            "model T parameter Real a=1; Real x(start=1, fixed=true); output Real y;"
            " equation der(x) = a*x^2; y = x; end T;"
        )
    )
    with pytest.raises(FmuError, match=r"set 1 \(a = 5\)"):
        run_many(fmu, {"a": np.array([0.1, 5.0])}, stop=1.0, step=0.1)


def test_wrong_requests(pendulum):
    with Plant(pendulum) as plant:
        with pytest.raises(UnknownNameError, match="tau"):
            plant.set({"tua": 1.0})
        with pytest.raises(InputError, match="finite"):
            plant.set({"tau": float("nan")})
        with pytest.raises(InputError, match="forward"):
            plant.step(-1.0)
    with pytest.raises(UnknownNameError):
        Plant(pendulum, outputs=["nothing"])
    with pytest.raises(InputError, match="different numbers"):
        run_many(pendulum, {"J": np.ones(2), "d": np.ones(3)}, stop=1.0)
    with pytest.raises(FmuError, match="SHA-256"):
        Plant(pendulum, sha256="0" * 64)


@pytest.mark.skipif(sys.platform != "linux", reason="counts pages as Linux does")
def test_memory_stays_flat(pendulum):
    def pages():
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    with Plant(pendulum) as plant:

        def reset():
            plant.reset({"theta_start": 0.1})
            state = plant.save()
            plant.step(1e-3)
            plant.rewind(state)
            plant.forget(state)

        for _ in range(300):
            reset()
        plant.run(stop=plant.time + 200.0, step=1e-3)

        def growth():
            before = pages()
            for _ in range(2000):
                reset()
            plant.run(stop=plant.time + 200.0, step=1e-3)
            return pages() - before

        # A leak shows every time; what earlier tests have left behind, once.
        assert any(growth() < 2**20 for _ in range(3))
