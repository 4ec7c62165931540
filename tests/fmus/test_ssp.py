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
            b"IntegerMappingTransformation",
            UnsupportedModelError,
            "Integer",
        ),
        (b"</ssd:System>", b"", FmuError, "malformed"),
        (
            b'version="1.0">\n<ssd:System ',
            b'version="3.0">\n<ssd:System ',
            FmuError,
            "version '3.0'",
        ),
        (
            b'type="application/x-fmu-sharedlibrary"',
            b'type="application/x-ssp-package"',
            UnsupportedModelError,
            "of the type application/x-ssp-package",
        ),
        (b" source=", b" elsewhere=", UnsupportedModelError, "without a source"),
        (
            b'<ssd:Connector name="r" kind="input"><ssc:Real/>',
            b'<ssd:Connector name="r" kind="input"><ssc:Real/><ssc:Float64>'
            b'<ssc:Dimension size="2"/></ssc:Float64>',
            UnsupportedModelError,
            "array connector 'r'",
        ),
        (
            b' startConnector="r"',
            b' startConnector="r" startIndices="1"',
            UnsupportedModelError,
            "array 'r'",
        ),
        (
            b"<ssd:Elements>",
            b'<ssd:Elements><ssd:SignalDictionaryReference name="d"/>',
            UnsupportedModelError,
            "SignalDictionaryReference",
        ),
        (b"<ssv:Real value", b"<ssv:String value", UnsupportedModelError, "String parameter 'T'"),
        (
            b'<ssv:Real value="0.5"',
            b'<ssv:Real value="0.5 1.0"',
            UnsupportedModelError,
            "array parameter 'T'",
        ),
        (b'endElement="b"', b'endElement="a"', FmuError, "two sources"),
    ],
)
def test_what_is_refused(ssp, tmp_path, old, new, kind, message):
    with pytest.raises(kind, match=message):
        read_ssp(changed(ssp, tmp_path, old, new))


NESTED = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
  xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
  version="2.0" name="nested">
<ssd:System name="outer">
  <ssd:Connectors>
    <ssd:Connector name="r" kind="input"><ssc:Float64 unit="deg"/></ssd:Connector>
    <ssd:Connector name="slow" kind="parameter"><ssc:Float64/></ssd:Connector>
    <ssd:Connector name="out" kind="output"><ssc:Float64 unit="deg"/></ssd:Connector>
  </ssd:Connectors>
  <ssd:ParameterBindings>
    <ssd:ParameterBinding source="resources/of%20all.ssv">
      <ssd:ParameterMapping source="resources/names.ssm"/>
    </ssd:ParameterBinding>
    <ssd:ParameterBinding prefix="in.">
      <ssd:ParameterValues><ssv:ParameterSet version="2.0" name="more"><ssv:Parameters>
        <ssv:Parameter name="b.T"><ssv:Float64 value="250" unit="ms"/></ssv:Parameter>
        <ssv:Parameter name="nothing"><ssv:Float64 value="9"/></ssv:Parameter>
      </ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues>
    </ssd:ParameterBinding>
  </ssd:ParameterBindings>
  <ssd:Elements>
    <ssd:System name="in">
      <ssd:Connectors>
        <ssd:Connector name="u" kind="input"><ssc:Float64/></ssd:Connector>
        <ssd:Connector name="y" kind="output"><ssc:Float64/></ssd:Connector>
        <ssd:Connector name="T" kind="parameter"><ssc:Float64/></ssd:Connector>
      </ssd:Connectors>
      <ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
        <ssv:ParameterSet version="2.0" name="low"><ssv:Parameters>
          <ssv:Parameter name="b.T"><ssv:Float64 value="77"/></ssv:Parameter>
        </ssv:Parameters></ssv:ParameterSet>
      </ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
      <ssd:Elements>
        <ssd:Component name="a" source="resources/lag.fmu"/>
        <ssd:Component name="b" source="resources/lag.fmu">
          <ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
            <ssv:ParameterSet version="2.0" name="lowest"><ssv:Parameters>
              <ssv:Parameter name="T"><ssv:Float64 value="88"/></ssv:Parameter>
            </ssv:Parameters></ssv:ParameterSet>
          </ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
        </ssd:Component>
      </ssd:Elements>
      <ssd:Connections>
        <ssd:Connection startConnector="u" endElement="a" endConnector="u">
          <ssc:LinearTransformation factor="2" offset="0.1"/></ssd:Connection>
        <ssd:Connection startElement="a" startConnector="y" endElement="b" endConnector="u"/>
        <ssd:Connection startElement="b" startConnector="y" endConnector="y"/>
        <ssd:Connection startConnector="T" endElement="a" endConnector="T"/>
      </ssd:Connections>
    </ssd:System>
  </ssd:Elements>
  <ssd:Connections>
    <ssd:Connection startConnector="r" endElement="in" endConnector="u">
      <ssc:LinearTransformation factor="3" offset="0.2"/></ssd:Connection>
    <ssd:Connection startElement="in" startConnector="y" endConnector="out"/>
    <ssd:Connection startConnector="slow" endElement="in" endConnector="T"/>
  </ssd:Connections>
</ssd:System>
<ssd:DefaultExperiment startTime="0" stopTime="1.5"/>
</ssd:SystemStructureDescription>
"""
VALUES = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
  version="2.0" name="all"><ssv:Parameters>
  <ssv:Parameter name="tau"><ssv:Real value="0.2"/></ssv:Parameter>
  <ssv:Parameter name="in.b.T"><ssv:Real value="99"/></ssv:Parameter>
</ssv:Parameters></ssv:ParameterSet>
"""
NAMES = """<?xml version="1.0" encoding="UTF-8"?>
<ssm:ParameterMapping xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="2.0">
  <ssm:MappingEntry source="tau" target="slow"><ssc:LinearTransformation factor="2" offset="0.1"/>
  </ssm:MappingEntry>
</ssm:ParameterMapping>
"""


@pytest.fixture
def nested(tmp_path):
    lag = cached_fmu(
        source(
            'model L parameter Real T(unit="s") = 1; input Real u(unit="rad");'
            ' output Real y(start=0, fixed=true, unit="rad");'
            " equation T * der(y) = u - y; end L;",
            "L",
        )
    )
    path = tmp_path / "nested.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", NESTED)
        archive.writestr("resources/of all.ssv", VALUES)
        archive.writestr("resources/names.ssm", NAMES)
        archive.write(lag, "resources/lag.fmu")
    return path


def test_nested_system_with_parameter_sets_and_mappings(nested):
    with read_ssp(nested) as opened:
        parts = {name: dict(part.parameters) for name, part in opened.system.components.items()}
        # Mapped and transformed on the way; the higher level and the later binding count.
        assert parts == {"in.a": {"T": 2 * 0.2 + 0.1}, "in.b": {"T": 0.25}}
        assert opened.defaults == {"start": 0.0, "stop": 1.5}
        assert (list(opened.system.inputs), list(opened.system.outputs)) == (["r"], ["out"])
    time = np.arange(0, 151) * 0.01
    run = simulate_ssp(nested, inputs=(time, {"r": np.full(151, 90.0)}), order=2)
    u = 2 * (3 * np.deg2rad(90) + 0.2) + 0.1
    a, b = 0.5, 0.25
    truth = u * (1 - (a * np.exp(-time / a) - b * np.exp(-time / b)) / (a - b))
    assert run["out"] == pytest.approx(np.rad2deg(truth), abs=0.3)


def test_nested_names_on_the_command_line(nested, tmp_path, monkeypatch, capsys):
    from twinproof.cli import main

    drive = tmp_path / "drive.csv"
    drive.write_text("time,r\n0,90\n1,90\n")
    out = tmp_path / "out.csv"
    words = ["--input", drive, "--param", "in.b.T=0.4", "--stop", "1", "--step", "0.1", "-o", out]
    monkeypatch.setattr("sys.argv", ["twinproof", "simulate", str(nested), *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)
    header, *rows = out.read_text().splitlines()
    assert header == "time,out"
    assert len(rows) == 11
    u = 2 * (3 * np.deg2rad(90) + 0.2) + 0.1
    end = u * (1 - (0.5 * np.exp(-1 / 0.5) - 0.4 * np.exp(-1 / 0.4)) / 0.1)
    assert float(rows[-1].split(",")[1]) == pytest.approx(np.rad2deg(end), rel=0.02)
    monkeypatch.setattr(
        "sys.argv",
        ["twinproof", "simulate", str(nested), "--param", "inn.b.T=1", "-o", str(out)],
    )
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "inn" in capsys.readouterr().err


def test_boolean_mapping_and_scaled_output(ssp, tmp_path):
    path = changed(
        ssp,
        tmp_path,
        b'<ssc:LinearTransformation factor="2.0" offset="0.5"/>',
        b'<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/>'
        b'<ssc:MapEntry source="false" target="true"/></ssc:BooleanMappingTransformation>',
    )
    with read_ssp(path) as opened:
        middle = opened.system.connections[1]
        assert (middle.factor, middle.offset) == (-1.0, 1.0)
    scaled = changed(
        ssp,
        tmp_path,
        b'endConnector="out"/>',
        b'endConnector="out"><ssc:LinearTransformation factor="10" offset="-1"/></ssd:Connection>',
    )
    inputs = (np.linspace(0, 1, 11), {"r": np.ones(11)})
    plain, changed_run = (simulate_ssp(p, inputs=inputs)["out"] for p in (ssp, scaled))
    assert changed_run == pytest.approx(10 * plain - 1)


def test_a_crash_inside_a_system_is_a_message(tmp_path):
    bad = foreign.hand_written(tmp_path)
    path = tmp_path / "bad.ssp"
    write_ssp(System({"a": Component(bad, {"misdeed": 1.0})}), path)
    with pytest.raises(FmuError, match="SIGSEGV"):
        simulate_ssp(path, stop=1.0, step=0.1)
