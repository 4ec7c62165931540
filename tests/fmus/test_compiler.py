"""C text to libraries: what is cached, what fails how."""

import ctypes
import sys

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
from foundation.errors import CompilerError, InputError
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
