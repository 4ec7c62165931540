"""Libraries from a path, written like the Modelica Standard Library; and which files count."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from fmus.frontend import load
from fmus.package import export
from fmus.places import places
from fmus.running import simulate, simulate_model
from fmus.sources import ModelicaSource, find_source, library_class
from foundation.errors import ModelicaError, UnknownNameError

LIBRARIES = Path(__file__).parent / "libraries"
DRIVE, SERVO = "Workshop.Examples.Drive", "Workshop.Examples.Servo"


def solved(rhs, start, times):
    run = solve_ivp(
        rhs, (times[0], times[-1]), start, "DOP853", t_eval=times, rtol=1e-11, atol=1e-13
    )
    return run.y


def servo(times, *, integral=True, speed=3.0):
    def rhs(_, x):
        error = speed - x[0]
        torque = 2.0 * (error + (x[1] if integral else 0.0))
        return [(torque - 0.2 * np.tanh(x[0] / 0.05)) / 0.5, error / 0.3]

    return solved(rhs, [0.0, 0.0], times)[0]


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_drive_train_with_gear_and_support(fmi, tmp_path):
    fmu = tmp_path / "drive.fmu"
    export(library_class(DRIVE, (LIBRARIES,)), fmu, fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    run = simulate(fmu, stop=1.0, step=0.01, outputs=["inertia1.phi", "inertia3.w"])

    def rhs(t, x):
        q, w, phi, v = x
        shaft = 1e4 * (phi - q) + 40 * (v - w)
        driven = 10 * 10 * np.sin(2 * np.pi * 5 * t) + shaft - 10 * w
        return [w, driven / (100 * 1.0 + 2.0), v, -shaft / 2.0]

    truth = solved(rhs, [0.0, 0.2, 0.01, 0.0], run.time)
    assert run["inertia1.phi"] == pytest.approx(10 * truth[0], abs=1e-6)
    assert run["inertia3.w"] == pytest.approx(truth[3], abs=1e-6)


def test_replaceable_law_enumerations_and_conditional_blocks():
    time = np.linspace(0.0, 2.0, 201)
    run = simulate_model(SERVO, roots=(LIBRARIES,), inputs=(time, {"w_ref": np.full(201, 3.0)}))
    assert run["w"] == pytest.approx(servo(time), abs=1e-6)


def test_a_users_class_extends_a_librarys(tmp_path):
    text = f"model Mine extends {SERVO}(controllerType = Workshop.Blocks.Types.SimpleController.P);"
    (tmp_path / "mine.mo").write_text(text + " end Mine;")
    time = np.linspace(0.0, 2.0, 201)
    run = simulate_model(
        str(tmp_path / "mine.mo"),
        roots=(LIBRARIES,),
        inputs=(time, {"w_ref": np.full(201, 3.0)}),
    )
    assert run["w"] == pytest.approx(servo(time, integral=False), abs=1e-6)


def test_units_and_what_cannot_be_set():
    dae = load(library_class(SERVO, (LIBRARIES,)))
    assert {v.name: v.unit for v in dae.outputs} == {"w": "rad/s", "tau": "N.m"}
    assert dae.variables["axis.phi"].display_unit == "deg"
    # They decide which components there are.
    for name in ("controllerType", "controller.initType", "bearing.useSupport"):
        assert not dae.variables[name].tunable, name
    assert dae.variables["axis.J"].tunable


def test_its_flanges_are_places():
    found = places(library_class(SERVO, (LIBRARIES,)))
    assert [place.name for place in found] == ["torque.flange", "w_ref", "w", "tau"]
    assert "axis.flange_b" in found[0].also


def test_unknown_classes_name_their_neighbours():
    with pytest.raises(UnknownNameError, match=r"did you mean Workshop\.Examples\.Servo"):
        load(library_class("Workshop.Examples.Serwo", (LIBRARIES,)))


# Which files count


@pytest.fixture
def package(tmp_path):
    shutil.copytree(LIBRARIES / "Workshop", tmp_path / "Workshop")
    return tmp_path / "Workshop"


@pytest.mark.parametrize("word", ["", ":Servo", ":Workshop.Examples.Servo"])
def test_a_file_beside_package_mo_belongs_to_the_package(package, word):
    source = find_source(f"{package}/Examples/Servo.mo{word}")
    assert source.base_class == SERVO
    assert "axis.phi" in load(source).variables


def test_classes_of_package_mo(package):
    assert "y" in load(find_source(f"{package}/Blocks/package.mo:Blocks.Sine")).variables
    assert "w" in load(find_source(f"{package}/package.mo:{SERVO}")).variables


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("model Bad end Bad;", r"no within-clause .*package Workshop\.Examples.*begin it with"),
        ("within Workshop; model Bad end Bad;", r"has within Workshop; but .*Workshop\.Examples"),
        ("within Workshop.Examples;\nmodel Bad Real x\nend Bad;", r"Bad\.mo:2:16: unexpected"),
        (
            "within Workshop.Examples;\nmodel Bad\n  extends Servo(kk = 3);\nend Bad;",
            r"Bad\.mo:3:17: Servo has nothing called 'kk'",
        ),
        (
            "within Workshop.Examples;\nmodel Bad Boolean b; Real x; equation b = x;\nend Bad;",
            r"Bad\.mo:2:\d+: type mismatch",
        ),
    ],
)
def test_mistakes_in_a_file_of_a_package(package, text, message):
    (package / "Examples" / "Bad.mo").write_text(text)
    with pytest.raises(ModelicaError, match=message):
        load(find_source(f"{package}/Examples/Bad.mo"))


def test_a_library_that_does_not_parse_names_the_file(package):
    (package / "Components" / "Fixed.mo").write_text(
        "within Workshop.Components;\nmodel Fixed real"
    )
    with pytest.raises(ModelicaError, match=r"Fixed\.mo:2:\d+: unexpected"):
        load(library_class(SERVO, (package.parent,)))


def test_other_files_of_a_plain_folder_are_not_read(tmp_path, monkeypatch):
    (tmp_path / "A.mo").write_text("model A Real x(start=1); equation der(x) = -B.c * x; end A;")
    (tmp_path / "B.mo").write_text("package B constant Real c = 5; end B;")
    (tmp_path / "Broken.mo").write_text("model Broken")
    with pytest.raises(ModelicaError, match=r"A\.mo:1:\d+: .*'B\.c'"):
        load(find_source(str(tmp_path / "A.mo")))
    (tmp_path / "C.mo").write_text("model C Real x(start=1); equation der(x) = -x; end C;")
    monkeypatch.chdir(tmp_path)
    assert list(load(find_source("C.mo")).variables) == ["x"]
    # Even a name that exists is text only.
    text = "model C Real z(start=1); equation der(z) = -z; end C;"
    assert list(load(ModelicaSource(text, "C", "C.mo", "C.mo")).variables) == ["z"]


def test_a_within_clause_needs_its_package(tmp_path):
    (tmp_path / "W.mo").write_text("within P; model W Real x; equation der(x) = 1; end W;")
    with pytest.raises(ModelicaError, match=r"W\.mo:1:1.*beside the package\.mo of P"):
        find_source(str(tmp_path / "W.mo"))
