"""C text to libraries: what is cached, what fails how."""

import ctypes
import stat
import struct
import sys
import zipfile
from importlib.util import find_spec

import pytest

from fmus import compiler
from fmus.base_units import BASE_UNITS, base_unit
from fmus.compiler import (
    Compiler,
    compile_library,
    find_compiler,
    find_target,
    shared_library,
)
from fmus.package import cached_fmu, export
from fmus.sources import library_class
from foundation.errors import CompilerError, InputError, ModelicaError
from foundation.units import factor_and_offset


def test_library_is_made_once_for_each_text():
    first = shared_library("double f(double x) { return x + 1; }")
    stamp = first.stat().st_mtime_ns
    assert shared_library("double f(double x) { return x + 1; }") == first
    assert first.stat().st_mtime_ns == stamp
    other = shared_library("double f(double x) { return x + 2; }")
    assert other != first
    assert shared_library("double f(double x) { return x + 1; }", optimise="-O1") != first
    for path, expected in ((first, 2.0), (other, 3.0)):
        function = ctypes.CDLL(str(path)).f
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
        assert function(1.0) == expected


def test_names_of_the_c_library_stay_inside():
    """A function called like one of the C library must call itself, not the other."""
    path = shared_library(
        "double step(double x) { return 5 * x; } double twice(double x) { return 2 * step(x); }"
    )
    function = ctypes.CDLL(str(path)).twice
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    assert function(1.0) == 10.0


def test_refused_code_leaves_nothing(tmp_path):
    source = tmp_path / "bad.c"
    source.write_text("int f( {")
    with pytest.raises(CompilerError, match="refused"):
        compile_library([source], tmp_path / "out" / "bad.so")
    assert list((tmp_path / "out").iterdir()) == []


def test_unknown_target():
    with pytest.raises(InputError, match="linux64"):
        find_target("amiga")


@pytest.fixture
def fresh_search():
    find_compiler.cache_clear()
    yield
    find_compiler.cache_clear()


def test_no_compiler_says_what_to_install(monkeypatch, fresh_search):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(compiler, "find_spec", lambda name: None)
    with pytest.raises(CompilerError, match=r"twinproof\[compiler\]"):
        find_compiler()


def test_pypi_compiler_is_the_last_resort(monkeypatch, fresh_search):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(compiler, "find_spec", lambda name: object())
    monkeypatch.setattr(compiler, "_version", lambda command: "clang 20")
    assert find_compiler() == Compiler((sys.executable, "-m", "ziglang", "cc"), "clang 20")


def test_chosen_compiler_comes_first(monkeypatch, fresh_search):
    monkeypatch.setenv("CC", "my-cc -m64")
    monkeypatch.setattr(compiler, "_version", lambda command: "1")
    assert find_compiler().command == ("my-cc", "-m64")


@pytest.mark.parametrize(
    "unit",
    ["N.m", "N.m/V", "V.s2/rad", "kg.m2", "rad/s2", "N.s/m", "Ohm", "mm/s", "1/s", "N.m/(rad/s)"],
)
def test_base_units_agree_with_pint(unit):
    """FMI counts rad as a base unit, pint as a number."""
    found = base_unit(unit)
    if unit == "N.m/(rad/s)":
        assert found is None, "two strokes are not in Modelica's grammar"
        return
    text = ".".join(f"{name}{power}" for name, power in found.exponents.items() if name != "rad")
    assert set(found.exponents) <= set(BASE_UNITS)
    assert factor_and_offset(unit, text or "1")[0] == pytest.approx(found.factor)


def test_unknown_units_have_no_base():
    assert base_unit("count") is None
    assert base_unit("furlong/s") is None


# Other platforms, other compilers

PENDULUM = library_class("Twinproof.Plants.Pendulum")


def machine_of(binary):
    """Return format and processor of a library, from its header as the formats define it."""
    if binary[:4] == b"\x7fELF":
        return "elf", struct.unpack_from("<H", binary, 18)[0]
    if binary[:2] == b"MZ":
        header = struct.unpack_from("<I", binary, 0x3C)[0]
        assert binary[header : header + 4] == b"PE\0\0"
        return "pe", struct.unpack_from("<H", binary, header + 4)[0]
    if binary[:4] == b"\xcf\xfa\xed\xfe":
        return "mach-o", struct.unpack_from("<I", binary, 4)[0]
    magic, count = struct.unpack_from(">II", binary)
    assert magic == 0xCAFEBABE
    slices = [struct.unpack_from(">IIII", binary, 8 + 20 * k) for k in range(count)]
    return "fat", *(machine_of(binary[at : at + size])[1] for _, _, at, size in slices)


X86_64 = {"elf": 62, "pe": 0x8664, "mach-o": 0x01000007}
ARM64_MACH_O = 0x0100000C
BINARIES = {
    ("linux64", "2"): {"linux64/Pendulum.so": ("elf", X86_64["elf"])},
    ("linux64", "3"): {"x86_64-linux/Pendulum.so": ("elf", X86_64["elf"])},
    ("win64", "2"): {"win64/Pendulum.dll": ("pe", X86_64["pe"])},
    ("win64", "3"): {"x86_64-windows/Pendulum.dll": ("pe", X86_64["pe"])},
    ("darwin64", "2"): {"darwin64/Pendulum.dylib": ("fat", X86_64["mach-o"], ARM64_MACH_O)},
    ("darwin64", "3"): {
        "x86_64-darwin/Pendulum.dylib": ("mach-o", X86_64["mach-o"]),
        "aarch64-darwin/Pendulum.dylib": ("mach-o", ARM64_MACH_O),
    },
}


@pytest.mark.parametrize(("target", "fmi"), BINARIES)
def test_binaries_are_of_the_format_of_the_target(target, fmi, tmp_path):
    if target != compiler.NATIVE and find_spec("ziglang") is None:
        pytest.skip("the compiler from PyPI is not installed")
    result = export(PENDULUM, tmp_path / "p.fmu", target=target, fmi=fmi)
    with zipfile.ZipFile(result.fmu) as archive:
        names = [name for name in archive.namelist() if name.startswith("binaries/")]
        found = {name.removeprefix("binaries/"): archive.read(name) for name in names}
    assert {name: machine_of(binary) for name, binary in found.items()} == BINARIES[target, fmi]
    assert all(f"fmi{fmi}DoStep".encode() in binary for binary in found.values())
    assert result.fmu.stat().st_size <= 100_000


def test_other_platforms_need_the_compiler_from_pypi(monkeypatch, tmp_path):
    monkeypatch.setattr(compiler, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"twinproof\[compiler\]"):
        export(PENDULUM, tmp_path / "p.fmu", target="win64")
    assert list(tmp_path.iterdir()) == []


def test_unknown_version_and_compiler(tmp_path):
    with pytest.raises(InputError, match="FMI version '4'"):
        export(PENDULUM, tmp_path / "p.fmu", fmi="4")
    with pytest.raises(InputError, match="no compiler 'gfortran'"):
        export(PENDULUM, tmp_path / "p.fmu", compiler="gfortran")


def stand_in_for_omc(folder, monkeypatch, body):
    """Put a shell script on the path where omc would be."""
    script = folder / "omc"
    script.write_text(f"#!/bin/sh\n{body}\n")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder), prepend=":")


def test_omc_is_asked_for_when_absent(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="omc on the PATH"):
        export(PENDULUM, tmp_path / "p.fmu", compiler="omc")


def test_omc_writes_the_fmu(monkeypatch, tmp_path):
    made = cached_fmu(PENDULUM)
    kept = tmp_path / "script"
    stand_in_for_omc(tmp_path, monkeypatch, f"cp $1 {kept}; cp {made} Pendulum.fmu")
    result = export(PENDULUM, tmp_path / "p.fmu", compiler="omc", fmi="3")
    assert result.fmu.read_bytes() == made.read_bytes()
    assert result.variables > 0
    asked = kept.read_text()
    assert 'buildModelFMU(Pendulum, version="3.0", fmuType="me_cs"' in asked
    assert 'Twinproof/package.mo");' in asked
    with pytest.raises(InputError, match="this machine only"):
        export(PENDULUM, tmp_path / "p.fmu", compiler="omc", target="darwin64")
    with pytest.raises(InputError, match="no parameter values"):
        export(PENDULUM, tmp_path / "p.fmu", compiler="omc", parameters={"J": 1.0})


def test_what_omc_says_is_passed_on(monkeypatch, tmp_path):
    stand_in_for_omc(tmp_path, monkeypatch, "echo 'Error: Variable zz not found in scope T.'")
    with pytest.raises(ModelicaError, match="zz not found"):
        export(PENDULUM, tmp_path / "p.fmu", compiler="omc")
    assert not (tmp_path / "p.fmu").exists()
