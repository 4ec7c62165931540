"""Icons: what the annotation draws stands in the FMU as a picture."""

import io
import zipfile
from pathlib import Path

import fmpy
import matplotlib.image
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree
from reference_runs import source

from fmus.icon import icon_of, png
from fmus.package import export

MODEL = """model Block "With an icon"
  model Inner annotation (Icon(graphics={Line(points={{0,0},{1,1}})})); end Inner;
  Real x(start = 1, fixed = true);
equation
  der(x) = -x;
  annotation (Documentation(info="Icon(graphics={})"), Icon(
    coordinateSystem(preserveAspectRatio=false, extent={{-50,-50},{50,50}}),
    graphics={
      Rectangle(extent={{-50,-50},{0,50}}, lineColor={255,0,0}, fillColor={255,0,0},
        fillPattern=FillPattern.Solid),
      Ellipse(origin={25,25}, extent={{-20,-20},{20,20}}, lineColor={0,0,255},
        fillColor={0,0,255}, fillPattern=FillPattern.Solid, pattern=LinePattern.None),
      Polygon(points={{5,-45},{45,-45},{45,-5}}, fillColor={0,255,0},
        fillPattern=FillPattern.Solid),
      Line(points={{-50,0},{50,0}}, color={0,0,0}, thickness=1.5),
      Text(extent={{-40,-20},{0,20}}, textString="%name \\"1\\"", lineColor={255,255,255})}));
end Block;
"""


def at(picture, x, y):
    """Colour at a point of the icon's coordinates."""
    row, column = round((50 - y) / 100 * 127), round((x + 50) / 100 * 127)
    return tuple(np.round(picture[row, column], 2).tolist())


def test_the_picture():
    icon = icon_of(MODEL, "Block")
    assert [s.kind for s in icon.shapes] == ["Rectangle", "Ellipse", "Polygon", "Line", "Text"]
    picture = matplotlib.image.imread(io.BytesIO(png(icon, "Block")))
    assert picture.shape == (128, 128, 4)
    assert at(picture, -40, 40) == (1, 0, 0, 1)
    assert at(picture, 25, 25) == (0, 0, 1, 1)
    assert at(picture, 40, -40) == (0, 1, 0, 1)
    assert at(picture, 10, 10)[3] == 0
    assert png(icon, "Block") == png(icon, "Block")


@pytest.mark.parametrize(
    "text",
    [
        "model A Real x; end A;",
        "model A annotation (Icon(graphics={})); end A;",
        "model A annotation (Icon(graphics={Line(points=f(x + 1))})); end A;",
        "model A annotation (Icon(",
        "model A model B annotation (Icon(graphics={Line(points={{0,0},{1,1}})})); end B; end A;",
    ],
)
def test_no_icon(text):
    assert icon_of(text, "A") is None


@pytest.mark.parametrize(
    ("fmi", "place"), [("2", "model.png"), ("3", "terminalsAndIcons/icon.png")]
)
def test_the_fmu_has_it(fmi, place, tmp_path):
    fmu = tmp_path / "block.fmu"
    export(source(MODEL, "Block"), fmu, fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    with zipfile.ZipFile(fmu) as archive:
        assert archive.read(place).startswith(b"\x89PNG")
        if fmi == "3":
            root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
            etree.XMLSchema(file=str(schema)).assertValid(root)
            (system,) = root.iter("CoordinateSystem")
            assert (system.get("x1"), system.get("y2")) == ("-50.0", "50.0")
