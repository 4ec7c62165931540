"""What is different in FMI 3: event mode, adjoints, indicators, terminals, build description."""

import ctypes
import shutil
import subprocess
import sys
import zipfile

import fmpy
import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.model_description import read_build_description
from fmpy.validation import validate_fmu
from lxml import etree
from reference_runs import source

from fmus.compiler import compile_library
from fmus.package import cached_fmu
from fmus.sources import library_class

EVENTFUL = """model T "Ball" parameter Real k = 3; parameter Real e = 0.7; input Real u(start = 0);
  parameter Real h0 = 1; parameter Integer n0 = 2; parameter Real slope = 2 * k;
  Real h(start = h0, fixed = true, unit = "m"); Real v(start = 0, fixed = true, unit = "m/s");
  discrete Real n(start = 0, fixed = true); output Real y; output Real z; Real same = h;
equation der(h) = v; der(v) = -9.81 + u; y = delay(h * u, 0.05);
  z = k * h + n + y + n0;
  when h < 0 then reinit(v, -e * pre(v)); n = pre(n) + 1; end when; end T;"""


@pytest.fixture(scope="module")
def eventful():
    return cached_fmu(source(EVENTFUL), fmi="3")


@pytest.fixture
def open_instance(eventful, tmp_path):
    """Make an instance: of Co-Simulation or Model Exchange, with its references by name."""
    md = read_model_description(str(eventful))
    folder = extract(str(eventful), str(tmp_path / "fmu"))
    opened = []

    def make(kind, path=None, **settings):
        description = md if path is None else read_model_description(str(path))
        where = folder if path is None else extract(str(path), str(tmp_path / "other"))
        instance = kind(
            guid=description.guid,
            unzipDirectory=where,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="i",
        )
        instance.instantiate(**settings)
        opened.append(instance)
        return instance, {v.name: v.valueReference for v in description.modelVariables}

    yield make
    for instance in opened:
        instance.freeInstance()


def started(instance):
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    return instance


def run_on(slave, vr, begin, steps):
    rows = []
    for k in range(begin, begin + steps):
        slave.setFloat64([vr["u"]], [float(np.sin(0.3 * k))])
        slave.doStep(0.01 * k, 0.01)
        rows.append(slave.getFloat64([vr[name] for name in ("h", "v", "n", "y", "z")]))
    return rows


def test_description_is_valid_and_complete(eventful):
    assert validate_fmu(str(eventful)) == []
    md = read_model_description(str(eventful))
    assert md.fmiVersion == "3.0"
    by_name = {v.name: v for v in md.modelVariables}
    assert by_name["n0"].type == "Int32"
    assert by_name["same"].alias is not None
    assert by_name["h"].unit == "m"
    assert by_name["der(h)"].derivative.name == "h"
    assert [u.variable.name for u in md.eventIndicators] == ["_eventIndicators[1]"]
    assert {u.variable.name for u in md.initialUnknowns} >= {"h", "der(h)", "y", "z", "slope"}
    with zipfile.ZipFile(eventful) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
    assert [e.get("name") for e in root.iter("Float64") if e.get("reinit") == "true"] == ["v"]
    assert md.modelExchange.needsCompletedIntegratorStep, "the delay needs it"
    for kind in ("ModelExchange", "CoSimulation"):
        for ability in ("providesDirectionalDerivatives", "providesAdjointDerivatives"):
            assert root.find(kind).get(ability) == "true"
    assert md.coSimulation.hasEventMode


def test_no_empty_elements(eventful):
    plain = source("model T output Real y; equation y = sin(time); end T;")
    for path in (eventful, cached_fmu(plain, fmi="3")):
        assert validate_fmu(str(path)) == []
        with zipfile.ZipFile(path) as archive:
            root = etree.fromstring(archive.read("modelDescription.xml"))
        assert [e.tag for e in root.iter() if not len(e) and not e.attrib] == []


def test_state_restores_and_serialises(open_instance):
    slave, vr = open_instance(FMU3Slave)
    started(slave)
    run_on(slave, vr, 0, 80)
    state = slave.getFMUState()
    expected = run_on(slave, vr, 80, 120)
    slave.setFMUState(state)
    assert run_on(slave, vr, 80, 120) == expected
    kept = slave.serializeFMUState(state)
    slave.freeFMUState(state)
    other, _ = open_instance(FMU3Slave)
    started(other)
    restored = other.deserializeFMUState(kept)
    other.setFMUState(restored)
    assert run_on(other, vr, 80, 120) == expected
    other.freeFMUState(restored)
    slave.reset()
    started(slave)
    run_on(slave, vr, 0, 80)
    assert run_on(slave, vr, 80, 120) == expected


def test_step_returns_early_at_an_event(open_instance):
    """The ball lands at sqrt(2/g): the importer is told, handles the event, and goes on."""
    slave, vr = open_instance(FMU3Slave, eventModeUsed=True, earlyReturnAllowed=True)
    started(slave)
    slave.updateDiscreteStates()
    slave.enterStepMode()
    event, _, early, time = slave.doStep(0.0, 1.0)
    assert (event, early) == (True, True)
    assert time == pytest.approx(np.sqrt(2 / 9.81), abs=1e-7)
    assert slave.getFloat64([vr["n"]]) == [0.0]
    slave.enterEventMode()
    speed = slave.getFloat64([vr["v"]])[0]
    _, _, _, jumped, _, _ = slave.updateDiscreteStates()
    assert jumped
    assert slave.getFloat64([vr["n"], vr["v"]]) == [1.0, pytest.approx(-0.7 * speed)]
    slave.enterStepMode()
    event, _, _, soon = slave.doStep(time, 1.0 - time)
    assert event, "the ball leaves the floor: h < 0 no longer holds"
    assert 0 < soon - time < 1e-6
    slave.enterEventMode()
    slave.updateDiscreteStates()
    slave.enterStepMode()
    assert slave.doStep(soon, 0.9 - soon) == (False, False, False, 0.9)
    assert slave.getFloat64([vr["n"]]) == [1.0]


def test_event_mode_gives_the_same_run(eventful):
    runs = [
        simulate_fmu(str(eventful), stop_time=2.0, output_interval=0.1, output=["h", "n"], **how)
        for how in ({}, {"use_event_mode": True, "early_return_allowed": True})
    ]
    at = [np.searchsorted(run["time"], np.arange(1, 20) * 0.1 - 1e-9) for run in runs]
    for name in ("h", "n"):
        assert runs[0][name][at[0]] == pytest.approx(runs[1][name][at[1]], abs=1e-7)


def test_adjoint_and_directional_derivatives_are_one_jacobian(open_instance):
    model, vr = open_instance(FMU3Model)
    started(model)
    model.updateDiscreteStates()
    model.enterContinuousTimeMode()
    unknowns = [vr[n] for n in ("der(h)", "der(v)", "z", "slope", "_eventIndicators[1]")]
    knowns = [vr[n] for n in ("h", "v", "u", "k", "e")]
    columns = [model.getDirectionalDerivative(unknowns, [known], [1.0]) for known in knowns]
    jacobian = np.array(columns).T
    expected = [  # columns: h, v, u, k, e; h is 1 at the start
        [0, 1, 0, 0, 0],
        [0, 0, 1, 0, 0],
        [3, 0, 0, 1, 0],
        [0, 0, 0, 2, 0],
        [-1, 0, 0, 0, 0],
    ]
    assert jacobian == pytest.approx(np.array(expected, float), abs=1e-14)
    rows = [
        model.getAdjointDerivative(unknowns, knowns, [float(i == k) for k in range(5)])
        for i in range(5)
    ]
    assert np.array(rows) == pytest.approx(jacobian, abs=1e-14)


START = """model T parameter Real q0 = 2; parameter Real k = 4; parameter Real u = 3;
  Real x(start = q0 ^ 2, fixed = true); Real y(start = 1); output Real z;
initial equation y ^ 3 = k * x;
equation der(x) = u - k * x; der(y) = -y; z = x * y; end T;"""


@pytest.mark.parametrize("kind", [FMU3Model, FMU3Slave])
def test_derivatives_through_start_values_and_initial_equations(kind, open_instance):
    """x = q0², y = (k x)^(1/3) at the start: their derivatives are those of the closed form."""
    instance, vr = open_instance(kind, cached_fmu(source(START), fmi="3"))
    instance.enterInitializationMode()
    unknowns = [vr[n] for n in ("x", "y", "z", "der(x)")]
    by_q0 = instance.getDirectionalDerivative(unknowns, [vr["q0"]], [1.0])
    by_k = instance.getDirectionalDerivative(unknowns, [vr["k"]], [1.0])
    y = 16 ** (1 / 3)
    dy_dq0, dy_dk = 16 / (3 * y**2), 4 / (3 * y**2)
    assert by_q0 == pytest.approx([4, dy_dq0, 4 * y + 4 * dy_dq0, -16], rel=1e-12)
    assert by_k == pytest.approx([0, dy_dk, 4 * dy_dk, -4], rel=1e-12, abs=1e-14)
    instance.exitInitializationMode()
    if kind is FMU3Slave:
        assert instance.getDirectionalDerivative(unknowns, [vr["q0"]], [1.0]) == [0, 0, 0, 0]


def test_flanges_are_terminals():
    fmu = cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"), fmi="3")
    schema = etree.XMLSchema(file=f"{fmpy.__path__[0]}/schema/fmi3/fmi3TerminalsAndIcons.xsd")
    with zipfile.ZipFile(fmu) as archive:
        root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    assert schema.validate(root), schema.error_log
    known = {v.name for v in read_model_description(str(fmu)).modelVariables}
    found = {
        t.get("name"): [(m.get("memberName"), m.get("variableKind")) for m in t]
        for t in root.iter("Terminal")
    }
    assert found == {
        place: [("phi", "signal"), ("tau", "inflow")] for place in ("wheel.flange", "body.flange")
    }
    assert {m.get("variableName") for m in root.iter("TerminalMemberVariable")} <= known


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_sources_build_as_described(fmi, tmp_path):
    fmu = cached_fmu(source(EVENTFUL), fmi=fmi)
    (configuration,) = read_build_description(str(fmu))
    assert configuration.modelIdentifier == "T"
    (files,) = configuration.sourceFileSets
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(tmp_path)
    compile_library(
        [tmp_path / "sources" / name for name in files.sourceFiles],
        tmp_path / "built.so",
        flags=["-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter", "-Wno-type-limits"],
    )
    library = ctypes.CDLL(str(tmp_path / "built.so"))
    get_version = getattr(library, f"fmi{fmi}GetVersion")
    get_version.restype = ctypes.c_char_p
    assert get_version() == f"{fmi}.0".encode()


# Nothing is allocated while an instance steps

COUNTER = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stddef.h>
static long count;
long allocations(void) { return count; }
extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);
void *malloc(size_t n) { count++; return __libc_malloc(n); }
void *calloc(size_t n, size_t size) { count++; return __libc_calloc(n, size); }
void *realloc(void *p, size_t n) { count++; return __libc_realloc(p, n); }
"""
DRIVER = r"""
#include <dlfcn.h>
#include <stdio.h>
#include "fmi3Functions.h"
extern long allocations(void);
int main(int n, char **arguments)
{
    void *fmu = dlopen(arguments[1], RTLD_NOW);
    if (n != 3 || fmu == NULL)
        return 1;
#define LOAD(name) fmi3##name##TYPE *name = (fmi3##name##TYPE *)dlsym(fmu, "fmi3" #name)
    LOAD(InstantiateCoSimulation);
    LOAD(EnterInitializationMode);
    LOAD(ExitInitializationMode);
    LOAD(DoStep);
    LOAD(GetFloat64);
    LOAD(FreeInstance);
    fmi3Instance a = InstantiateCoSimulation("a", arguments[2], "", 0, 0, 0, 0, NULL, 0, NULL,
                                             NULL, NULL);
    if (a == NULL)
        return 2;
    EnterInitializationMode(a, 0, 0, 0, 0, 0);
    ExitInitializationMode(a);
    const long created = allocations();
    for (int k = 0; k < 10000; k++) {
        fmi3Boolean event, terminate, early;
        fmi3Float64 last, value;
        const fmi3ValueReference time = 0;
        if (DoStep(a, k * 1e-4, 1e-4, 1, &event, &terminate, &early, &last) != fmi3OK
            || GetFloat64(a, &time, 1, &value, 1) != fmi3OK)
            return 3;
    }
    printf("%ld %ld\n", created, allocations() - created);
    FreeInstance(a);
    return 0;
}
"""


@pytest.mark.skipif(sys.platform != "linux", reason="counts calls of the GNU C library")
def test_nothing_is_allocated_while_stepping(eventful, tmp_path):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no cc")
    with zipfile.ZipFile(eventful) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "counter.c").write_text(COUNTER)
    (tmp_path / "driver.c").write_text(DRIVER)
    subprocess.run(
        [compiler, "-rdynamic", "-o", tmp_path / "driver", tmp_path / "driver.c",
         tmp_path / "counter.c", f"-I{tmp_path / 'sources'}", "-ldl"],
        check=True,
    )  # fmt: skip
    token = read_model_description(str(eventful)).guid
    library = tmp_path / "binaries" / "x86_64-linux" / "T.so"
    done = subprocess.run(
        [tmp_path / "driver", library, token], capture_output=True, text=True, check=True
    )
    created, while_stepping = map(int, done.stdout.split())
    assert created > 0, "the counter counts"
    assert while_stepping == 0
