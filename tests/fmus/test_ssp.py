"""Systems as SSP files: written, read back, run; FMPy's reader and simulator agree."""

import zipfile

import foreign
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd
from reference_runs import source

from fmus.master import Component, Connection, System
from fmus.master.ssp import read_ssp, simulate_ssp, write_ssp
from fmus.package import cached_fmu
from foundation.errors import FmuError, UnsupportedModelError


@pytest.fixture(scope="module")
def system():
    lag = cached_fmu(
        source(
            "model L parameter Real T = 1; input Real u; output Real y(start=0, fixed=true);"
            " equation T * der(y) = u - y; end L;",
            "L",
        )
    )
    return System(
        {"a": Component(lag, {"T": 0.5}), "b": Component(lag)},
        [
            Connection("r", "a.u"),
            Connection("a.y", "b.u", 2.0, 0.5),
            Connection("b.y", "out"),
        ],
        inputs=["r"],
        outputs=["out"],
        name="cascade",
    )


@pytest.fixture
def ssp(system, tmp_path):
    path = tmp_path / "cascade.ssp"
    write_ssp(system, path, stop=2.0)
    return path


def test_round_trip(system, ssp):
    time = np.arange(0, 201) * 0.01
    inputs = (time, {"r": np.ones(201)})
    direct = system.simulate(inputs=inputs)
    run = simulate_ssp(ssp, inputs=inputs)
    assert list(run.columns) == ["out"]
    assert np.array_equal(run["out"], direct["out"])
    with read_ssp(ssp) as opened:
        assert opened.defaults == {"stop": 2.0}
        assert list(opened.system.connections) == list(system.connections)
        assert opened.system.components["a"].parameters == {"T": 0.5}


def test_fmpy_reads_what_we_write(ssp):
    # With its schema: the file is valid.
    description = read_ssd(str(ssp), validate=True)
    assert [e.name for e in description.system.elements] == ["a", "b"]
    assert len(description.system.connections) == 3


def changed(ssp, tmp_path, old, new):
    path = tmp_path / "changed.ssp"
    with zipfile.ZipFile(ssp) as given, zipfile.ZipFile(path, "w") as written:
        for entry in given.namelist():
            content = given.read(entry)
            if entry.endswith(".ssd"):
                assert old in content
                content = content.replace(old, new)
            written.writestr(entry, content)
    return path


@pytest.mark.parametrize(
    ("old", "new", "kind", "message"),
    [
        (b"resources/a.fmu", b"../a.fmu", UnsupportedModelError, "outside"),
        (b"resources/a.fmu", b"http://x/a.fmu", UnsupportedModelError, "outside"),
        (b"resources/a.fmu", b"resources/z.fmu", FmuError, "has no"),
        (b'factor="2.0"', b'factor="two"', FmuError, "no number"),
        (
            b"LinearTransformation",
            b"BooleanMappingTransformation",
            UnsupportedModelError,
            "Mapping",
        ),
        (b"</ssd:System>", b"", FmuError, "malformed"),
    ],
)
def test_what_is_refused(ssp, tmp_path, old, new, kind, message):
    with pytest.raises(kind, match=message):
        read_ssp(changed(ssp, tmp_path, old, new))


def test_a_crash_inside_a_system_is_a_message(tmp_path):
    bad = foreign.hand_written(tmp_path)
    path = tmp_path / "bad.ssp"
    write_ssp(System({"a": Component(bad, {"misdeed": 1.0})}), path)
    with pytest.raises(FmuError, match="SIGSEGV"):
        simulate_ssp(path, stop=1.0, step=0.1)
