"""What FMI asks for beside values: state, derivatives, tunables, instances, packaging, messages."""

import ctypes
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.simulation import instantiate_fmu
from fmpy.validation import validate_fmu
from numpy import cos, sin
from reference_runs import integrate, source

from fmus.archive import describe
from fmus.co_simulation import initialise
from fmus.compiler import compile_library
from fmus.frontend import load
from fmus.package import cached_fmu, export
from fmus.running import Fmu, model_fmu, simulate, simulate_model
from fmus.sources import library_class
from foundation.errors import FmuError, InputError, UnknownNameError
from modelica import LIBRARY

CLASSES = [
    ".".join(("Twinproof", folder, file.stem))
    for folder in ("Plants", "Examples")
    for file in sorted((LIBRARY / folder).glob("*.mo"))
    if file.stem != "package"
]


@pytest.mark.parametrize("name", CLASSES)
def test_every_plant_and_example_is_a_valid_fmu_and_runs(name):
    fmu = cached_fmu(library_class(name))
    assert validate_fmu(str(fmu)) == []
    runs = [simulate(fmu, stop=0.01, step=0.005, kind=k) for k in describe(fmu).kinds]
    assert len(runs) == 2
    for output, column in runs[0].columns.items():
        assert np.all(np.isfinite(column))
        assert runs[1][output] == pytest.approx(column, abs=1e-7)


# Everything that a state must hold: events, a discrete variable, a delay, an input.
EVENTFUL = """model T parameter Real k = 3; parameter Real e = 0.7; input Real u(start = 0);
  Real h(start = 1, fixed = true); Real v(start = 0, fixed = true);
  discrete Real n(start = 0, fixed = true); output Real y; output Real z;
equation der(h) = v; der(v) = -9.81 + u; y = delay(h * u, 0.05);
  z = k * h + n + y;
  when h < 0 then reinit(v, -e * pre(v)); n = pre(n) + 1; end when; end T;"""


@pytest.fixture(scope="module")
def eventful():
    return cached_fmu(source(EVENTFUL))


@pytest.fixture
def instance(eventful):
    """An initialised Co-Simulation instance and the references of its variables."""
    with Fmu(eventful) as fmu:
        md = read_model_description(str(eventful))
        slave, _ = fmu.instantiate()
        initialise(slave, md, {}, start=0.0, stop=None, tolerance=None)
        yield slave, {v.name: v.valueReference for v in md.modelVariables}
        slave.freeInstance()


def run_on(slave, references, begin, steps):
    rows = []
    for k in range(begin, begin + steps):
        slave.setReal([references["u"]], [float(np.sin(0.3 * k))])
        slave.doStep(0.01 * k, 0.01)
        rows.append(slave.getReal([references[n] for n in ("h", "v", "n", "y", "z")]))
    return rows


def test_state_restores_exactly(instance):
    slave, references = instance
    run_on(slave, references, 0, 80)
    state = slave.getFMUState()
    first = run_on(slave, references, 80, 120)
    slave.setFMUState(state)
    assert run_on(slave, references, 80, 120) == first
    slave.freeFMUState(state)


def test_serialised_state_restores_in_another_instance(eventful, instance):
    slave, references = instance
    run_on(slave, references, 0, 80)
    state = slave.getFMUState()
    kept = slave.serializeFMUState(state)
    expected = run_on(slave, references, 80, 120)
    slave.freeFMUState(state)
    with Fmu(eventful) as fmu:
        other, _ = fmu.instantiate()
        initialise(
            other, read_model_description(str(eventful)), {}, start=0.0, stop=None, tolerance=None
        )
        restored = other.deSerializeFMUstate(kept)
        other.setFMUState(restored)
        assert run_on(other, references, 80, 120) == expected
        other.freeFMUState(restored)
        with pytest.raises(Exception, match="failed"):
            other.deSerializeFMUstate(kept[:-8])
        other.freeInstance()


def test_reset_starts_anew(eventful, instance):
    slave, references = instance
    md = read_model_description(str(eventful))
    first = run_on(slave, references, 0, 50)
    slave.reset()
    initialise(slave, md, {}, start=0.0, stop=None, tolerance=None)
    assert run_on(slave, references, 0, 50) == first


def test_instances_do_not_share_anything(eventful):
    with Fmu(eventful) as fmu:
        alone = fmu.simulate(stop=1.0, step=0.01, outputs=["h", "z"], parameters={"e": 0.5})
        with ThreadPoolExecutor(4) as pool:
            runs = [
                pool.submit(
                    fmu.simulate, stop=1.0, step=0.01, outputs=["h", "z"], parameters={"e": e}
                )
                for e in (0.5, 0.9, 0.5, 0.7)
            ]
            together = [run.result() for run in runs]
    for which in (0, 2):
        assert np.array_equal(together[which]["z"], alone["z"])
    assert not np.array_equal(together[1]["h"], alone["h"])


def test_parameters_can_be_tuned_while_running(instance):
    slave, references = instance
    run_on(slave, references, 0, 10)
    h, z, n, y = (slave.getReal([references[name]])[0] for name in ("h", "z", "n", "y"))
    slave.setReal([references["k"]], [10.0])
    assert slave.getReal([references["h"]])[0] == h, "a parameter must not restart the states"
    assert slave.getReal([references["z"]])[0] == pytest.approx(10 * h + n + y, abs=1e-14)
    assert z == pytest.approx(3 * h + n + y, abs=1e-14)


def test_start_parameters_count_only_at_the_start():
    fmu = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
    md = read_model_description(str(fmu))
    references = {v.name: v.valueReference for v in md.modelVariables}
    with Fmu(fmu) as opened:
        slave, _ = opened.instantiate()
        initialise(slave, md, {"theta_start": 0.4}, start=0.0, stop=None, tolerance=None)
        assert slave.getReal([references["theta"]]) == [0.4]
        slave.doStep(0.0, 0.1)
        theta = slave.getReal([references["theta"]])
        slave.setReal([references["theta_start"]], [2.0])
        assert slave.getReal([references["theta"]]) == theta
        slave.freeInstance()


@pytest.mark.parametrize("name", ["Pendulum", "WheeledPendulum"])
def test_directional_derivatives_match_finite_differences(name):
    fmu = cached_fmu(library_class(f"Twinproof.Plants.{name}"))
    md = read_model_description(str(fmu))
    reference = {v.name: v.valueReference for v in md.modelVariables}
    with Fmu(fmu) as opened:
        slave, _ = opened.instantiate("ModelExchange")
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.newDiscreteStates()
        slave.enterContinuousTimeMode()
        n = len(md.derivatives)
        states = [d.variable.derivative.name for d in md.derivatives]
        x = (ctypes.c_double * n)(*np.linspace(0.3, 0.9, n))
        slave.setContinuousStates(x, n)
        unknowns = [d.variable.valueReference for d in md.derivatives]
        parameters = [v.name for v in md.modelVariables if v.causality == "parameter"]
        knowns = [*parameters, *(v.name for v in md.modelVariables if v.causality == "input")]
        for known in [*knowns, *states]:
            vr = [reference[known]]
            value = slave.getReal(vr)[0]
            exact = slave.getDirectionalDerivative(unknowns, vr, [1.0])

            def derivatives_at(shift, known=known, value=value, vr=vr):
                if known in states:
                    moved = (ctypes.c_double * n)(*x)
                    moved[states.index(known)] += shift
                    slave.setContinuousStates(moved, n)
                else:
                    slave.setReal(vr, [value + shift])
                return np.array(slave.getReal(unknowns))

            step = 1e-5 * max(abs(value), 1.0)
            difference = (derivatives_at(step) - derivatives_at(-step)) / (2 * step)
            derivatives_at(0.0)
            assert exact == pytest.approx(difference, rel=1e-6, abs=1e-8), known
        slave.freeInstance()


def test_declared_structure_is_what_the_equations_say():
    md = read_model_description(
        str(cached_fmu(library_class("Twinproof.Plants.Pendulum"))), validate_model_structure=True
    )
    needed = {
        unknown.variable.name: [v.name for v in unknown.dependencies] for unknown in md.derivatives
    }
    assert needed == {"der(theta)": ["omega"], "der(omega)": ["tau", "theta", "omega"]}
    outputs = {u.variable.name: [v.name for v in u.dependencies] for u in md.outputs}
    assert outputs == {"theta": ["theta"], "omega": ["omega"]}


def test_units_bounds_and_descriptions_arrive():
    md = read_model_description(str(cached_fmu(library_class("Twinproof.Plants.Positioner"))))
    mass = next(v for v in md.modelVariables if v.name == "M")
    assert (mass.unit, float(mass.start), float(mass.min), float(mass.nominal)) == (
        "kg", 95.1089, 1e-3, 100.0,
    )  # fmt: skip
    assert mass.description.startswith("Moving mass")
    force = next(u for u in md.unitDefinitions if u.name == "N.s/m")
    assert (force.baseUnit.kg, force.baseUnit.s) == (1, -1)


def test_aliases_are_in_the_fmu_with_their_signs():
    fmu = cached_fmu(
        source(
            "model T extends Twinproof.Plants.Pendulum(theta_start = 0.5);"
            " Twinproof.Effects.Rotational.ViscousFriction f(d = 0.1);"
            " equation connect(f.flange, joint.flange); end T;"
        )
    )
    run = simulate(
        fmu, stop=1.0, step=0.1,
        outputs=["theta", "f.phi", "joint.phi", "joint.tau", "f.flange.tau", "omega", "f.w"],
    )  # fmt: skip
    assert np.array_equal(run["f.phi"], run["theta"])
    assert np.array_equal(run["joint.phi"], run["theta"])
    assert np.array_equal(run["f.flange.tau"], -run["joint.tau"])
    assert run["f.flange.tau"] == pytest.approx(0.1 * run["omega"], abs=1e-15)
    assert run["f.w"] == pytest.approx(run["omega"], abs=1e-15)


def test_defaults_can_be_baked_in(tmp_path):
    plant = library_class("Twinproof.Plants.Pendulum")
    export(plant, tmp_path / "p.fmu", parameters={"mgl": 2.5, "theta_start": 0.2})
    info = {v.name: v.start for v in describe(tmp_path / "p.fmu").parameters}
    assert (info["mgl"], info["theta_start"]) == (2.5, 0.2)
    baked = simulate(tmp_path / "p.fmu", stop=1.0)
    given = simulate(cached_fmu(plant), stop=1.0, parameters={"mgl": 2.5, "theta_start": 0.2})
    assert np.array_equal(baked["theta"], given["theta"])
    plain = source("model T Real x(start = 1, fixed = true); equation der(x) = -x; end T;")
    export(plain, tmp_path / "x.fmu", parameters={"x": 3.0})
    run = simulate(tmp_path / "x.fmu", stop=1.0, outputs=["x"])
    assert run["x"] == pytest.approx(3 * np.exp(-run.time), abs=1e-7)
    with pytest.raises(UnknownNameError, match="did you mean mgl"):
        export(plant, tmp_path / "q.fmu", parameters={"mgI": 1.0})
    assert not (tmp_path / "q.fmu").exists()


def test_export_is_reproducible_and_whole(tmp_path):
    plant = library_class("Twinproof.Plants.Positioner")
    first = export(plant, tmp_path / "a.fmu")
    second = export(load(plant), tmp_path / "b.fmu")
    assert first.sha256 == second.sha256
    assert first.variables == len(read_model_description(str(first.fmu)).modelVariables)
    names = zipfile.ZipFile(first.fmu).namelist()
    assert "binaries/linux64/Positioner.so" in names
    assert {"sources/fmi2.c", "sources/model.h", "sources/fmi2Functions.h"} <= set(names)
    other = export(plant, tmp_path / "c.fmu", parameters={"M": 1.0})
    guids = [read_model_description(str(r.fmu)).guid for r in (first, other)]
    assert guids[0] != guids[1]
    assert list(tmp_path.glob(".*")) == []


def test_integer_and_boolean_parameters(tmp_path):
    text = (
        "model T parameter Integer n = 2; parameter Boolean on = true; parameter Real a = 2 * n;"
        " Real x(start = 1, fixed = true); equation der(x) = if on then -a * x else 0; end T;"
    )
    fmu = cached_fmu(source(text))
    assert validate_fmu(str(fmu)) == []
    run = simulate(fmu, stop=1.0, outputs=["x", "a"], parameters={"n": 1})
    assert run["x"] == pytest.approx(np.exp(-2 * run.time), abs=1e-7)
    assert set(run["a"]) == {2.0}
    # What decides which equations there are is not a parameter any more.
    with pytest.raises(InputError, match="'on' cannot be set"):
        simulate(fmu, stop=1.0, parameters={"on": False})


@pytest.mark.parametrize("kind", ["eventful", "plain"])
def test_sources_in_the_fmu_compile_without_a_warning(kind, eventful, tmp_path):
    plain = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
    with zipfile.ZipFile(eventful if kind == "eventful" else plain) as archive:
        archive.extractall(tmp_path)
    compile_library(
        [tmp_path / "sources" / "fmi2.c"],
        tmp_path / "checked.so",
        flags=["-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter", "-Wno-type-limits"],
    )


def test_names_that_clash_with_c_and_its_library_do_no_harm():
    fmu = cached_fmu(
        source(
            "model step parameter Real main = 2; parameter Real model_start = 1;"
            " Real y0(start = 1, fixed = true); output Real sin;"
            " equation der(y0) = -main * y0; sin = y0 + model_start; end step;",
            "step",
        )
    )
    assert validate_fmu(str(fmu)) == []
    run = simulate(fmu, stop=1.0)
    assert run["sin"] == pytest.approx(np.exp(-2 * run.time) + 1, abs=1e-7)


def test_binary_exports_only_the_standard(eventful):
    with Fmu(eventful) as fmu:
        md = read_model_description(str(eventful))
        slave = instantiate_fmu(fmu._folder.name, md, "CoSimulation")
        for name in ("model_derivatives", "solver_advance", "events_update", "fail"):
            assert not hasattr(slave.dll, name)
        assert hasattr(slave.dll, "fmi2DoStep")
        slave.freeInstance()


# Running: inputs, names, messages


def test_divergence_says_what_and_when():
    fmu = cached_fmu(
        source("model T Real x(start = 1, fixed = true); equation der(x) = x^2; end T;")
    )
    with pytest.raises(FmuError, match=r"state 'x'.* at time 1|no step is short enough.* time 1"):
        simulate(fmu, stop=2.0)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"parameters": {"jj": 1.0}}, UnknownNameError, "unknown variable 'jj'"),
        ({"outputs": ["thet"]}, UnknownNameError, "did you mean theta"),
        ({"parameters": {"theta": 1.0}}, InputError, "'theta' cannot be set"),
        ({"inputs": (np.arange(3.0), {"w": np.ones(3)})}, UnknownNameError, "unknown input 'w'"),
        ({"inputs": (np.zeros(3), {"tau": np.ones(3)})}, InputError, "do not increase"),
        ({"inputs": (np.arange(3.0), {"tau": np.ones(2)})}, InputError, "2 values for 3 times"),
        (
            {"inputs": (np.arange(3.0), {"tau": np.array([0, np.nan, 0])})},
            InputError,
            "not finite",
        ),
        ({"stop": -1.0}, InputError, "not after the start"),
        ({"stop": 1.0, "step": 2.0}, InputError, "step"),
    ],
)
def test_wrong_requests(settings, error, message):
    with pytest.raises(error, match=message):
        simulate_model("Twinproof.Plants.Pendulum", **settings)


def test_kind_that_is_not_there(tmp_path):
    fmu = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
    only = tmp_path / "only_cs.fmu"
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(only, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                begin, end = content.index(b"<ModelExchange"), content.index(b"</ModelExchange>")
                content = content[:begin] + content[end + len(b"</ModelExchange>") :]
            new.writestr(name, content)
    assert describe(only).kinds == ("CoSimulation",)
    with pytest.raises(FmuError, match="does not offer ModelExchange"):
        simulate(only, kind="ModelExchange")


def test_damaged_and_dangerous_files(tmp_path):
    with pytest.raises(FmuError, match="no such FMU"):
        describe(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("hello")
    with pytest.raises(FmuError, match="not a zip"):
        describe(tmp_path / "text.fmu")
    good = cached_fmu(library_class("Twinproof.Plants.Pendulum")).read_bytes()
    (tmp_path / "short.fmu").write_bytes(good[: len(good) // 2])
    with pytest.raises(FmuError):
        Fmu(tmp_path / "short.fmu")
    (tmp_path / "evil.fmu").write_bytes(good)
    with zipfile.ZipFile(tmp_path / "evil.fmu", "a") as archive:
        archive.writestr("../outside.txt", "x")
    with pytest.raises(FmuError, match="outside"):
        Fmu(tmp_path / "evil.fmu")
    assert not (tmp_path.parent / "outside.txt").exists()
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<oops")
    with pytest.raises(FmuError, match=r"modelDescription\.xml"):
        describe(tmp_path / "empty.fmu")


def test_no_binary_for_this_platform(tmp_path):
    good = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
    with zipfile.ZipFile(good) as old, zipfile.ZipFile(tmp_path / "w.fmu", "w") as new:
        for name in old.namelist():
            if not name.startswith("sources/"):
                new.writestr(name.replace("linux64", "win64"), old.read(name))
    with pytest.raises(FmuError, match="no binary"):
        Fmu(tmp_path / "w.fmu")


def test_description_of_any_fmu():
    found = describe(cached_fmu(library_class("Twinproof.Plants.Pendulum")))
    assert found.fmi == "2.0"
    assert found.kinds == ("CoSimulation", "ModelExchange")
    assert found.platforms == ("linux64",)
    assert [(v.name, v.unit) for v in found.inputs] == [("tau", "N.m")]
    assert [v.name for v in found.outputs] == ["theta", "omega"]
    assert found.states == ("theta", "omega")
    assert found.directional_derivatives
    assert found.saves_state


def test_every_word_for_a_model(tmp_path):
    text = "model Decay Real x(start = 1, fixed = true); equation der(x) = -x; end Decay;"
    (tmp_path / "m.mo").write_text(text)
    for word in (tmp_path / "m.mo", f"{tmp_path}/m.mo:Decay", model_fmu(tmp_path / "m.mo")):
        run = simulate_model(word, stop=1.0, outputs=["x"])
        assert run["x"] == pytest.approx(np.exp(-run.time), abs=1e-7)


def test_tolerance_is_honoured():
    fmu = cached_fmu(
        source(
            "model T Real q(start = 1, fixed = true); Real w(start = 0, fixed = true);"
            " equation der(q) = w; der(w) = -q; end T;"
        )
    )
    worst = [
        np.max(np.abs(run["q"] - cos(run.time)))
        for tolerance in (1e-3, 1e-6, 1e-11)
        for run in [simulate(fmu, stop=50.0, step=5.0, outputs=["q"], tolerance=tolerance)]
    ]
    assert worst[0] > 10 * worst[1] > 100 * worst[2]
    assert worst[2] < 1e-9


def test_inputs_finer_and_coarser_than_the_result():
    """Communication happens at every time of either, so the result depends on neither grid."""
    fmu = cached_fmu(library_class("Twinproof.Plants.Positioner"))
    t = np.linspace(0.0, 1.0, 41)
    u = sin(7 * t)
    expected = integrate(
        lambda _, x, u: [x[1], (35.1507 * u - 203.5034 * x[1]) / 95.1089],
        [0.0, 0.0],
        t,
        lambda s: u[np.searchsorted(t, s, side="right") - 1],
        np.array([0.0, 0.3, 0.6, 0.9]),
    )
    run = simulate(fmu, inputs=(t, {"vir": u}), step=0.3)
    assert run["q"] == pytest.approx(expected[:, 0], abs=1e-9)
    fine = simulate(fmu, inputs=(t, {"vir": u}), step=0.003)
    assert fine["q"][::100] == pytest.approx(expected[:, 0], abs=1e-9)
