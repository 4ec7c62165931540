"""Folders given with --modelica-path: what is wrong with one is said with place and remedy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fmus.sources import check_libraries, library_class
from foundation.errors import ModelicaError, TwinproofError
from identification.discovery.effects import find_effects
from twinproof import Model

PACKAGE = "within ;\npackage Lab\nend Lab;\n"
EFFECT = """within Lab;
model Guide "A cable guide"
  extends Twinproof.Interfaces.RotationalEffect;
  parameter Real k_g(unit = "N.m/rad3", min = 0, nominal = 1) = 0 "Stiffness";
equation
  flange.tau = k_g * phi^3;
end Guide;
"""
GOOD = {"lab/Lab/package.mo": PACKAGE, "lab/Lab/Guide.mo": EFFECT}


def lay(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "lab"


def test_a_whole_library_is_taken_whatever_stands_beside_it(tmp_path: Path) -> None:
    lab = lay(
        tmp_path,
        {
            **GOOD,
            "lab/Lab/package.order": "Guide\n",
            "lab/Lab/Kinds/package.mo": "within Lab;\npackage Kinds\nend Kinds;\n",
            "lab/Lab/Kinds/Angle.mo": 'within Lab.Kinds;\ntype Angle = Real(unit = "rad");\n',
            "lab/Lab/Resources/model.c": "int x;\n",
            "lab/models/Loose.mo": "model Anything\nend Anything;\n",
        },
    )
    assert check_libraries([lab]) == (lab,)
    names = {e.name for e in find_effects(library_class("Twinproof.Plants.Pendulum", (lab,)))}
    assert "Guide" in names


@pytest.mark.parametrize(
    ("files", "folder", "what", "where", "remedy"),
    [
        (GOOD, "gone", "no such folder", "gone", "give the folder"),
        (GOOD, "lab/Lab/Guide.mo", "no such folder", "Guide.mo", "give the folder"),
        (GOOD, "lab/Lab", "is a package itself", "lab/Lab", "give the folder that it is in: "),
        ({"lab/notes.txt": ""}, "lab", "no Modelica package", "lab", "which has a package.mo"),
        (
            {"lab/Lab/Guide.mo": EFFECT},
            "lab",
            "the package Lab has no package.mo",
            "lab/Lab/Guide.mo",
            "within ; package Lab end Lab;",
        ),
        (
            {"lab/Other/package.mo": PACKAGE, "lab/Other/Guide.mo": EFFECT},
            "lab",
            "defines Lab, where Modelica looks for Other",
            "lab/Other/package.mo:2",
            "rename the folder to Lab",
        ),
        (
            {**GOOD, "lab/Lab/Guide.mo": EFFECT.replace("within Lab", "within Lib")},
            "lab",
            "says `within Lib;` but stands in the package Lab",
            "lab/Lab/Guide.mo:1:1",
            "begin it with `within Lab;`",
        ),
        (
            {**GOOD, "lab/Lab/Guide.mo": EFFECT.replace("Guide", "Chain")},
            "lab",
            "defines Chain, where Modelica looks for Guide",
            "lab/Lab/Guide.mo:2",
            "rename the file to Chain.mo",
        ),
        (
            {**GOOD, "lab/Lab/Sub/Deep.mo": "within Lab.Sub;\nmodel Deep\nend Deep;\n"},
            "lab",
            "the package Lab.Sub has no package.mo",
            "lab/Lab/Sub/Deep.mo",
            "package Sub end Sub;",
        ),
    ],
)
def test_a_library_that_is_not_whole_is_refused(
    tmp_path: Path, files: dict[str, str], folder: str, what: str, where: str, remedy: str
) -> None:
    lay(tmp_path, files)
    with pytest.raises(TwinproofError) as found:
        Model.of("Twinproof.Plants.Pendulum", [tmp_path / folder])
    assert what in found.value.what
    assert where in found.value.where
    assert remedy in found.value.remedy


@pytest.mark.parametrize(
    ("good", "bad", "place"),
    [("phi^3;", "phi^^3;", ":6:26: "), ("phi^3;", "phy^3;", ":6:22: ")],
    ids=["does not parse", "unknown name"],
)
def test_an_effect_that_does_not_compile_is_pointed_at(
    tmp_path: Path, good: str, bad: str, place: str
) -> None:
    lab = lay(tmp_path, {**GOOD, "lab/Lab/Guide.mo": EFFECT.replace(good, bad)})
    with pytest.raises(ModelicaError) as found:
        find_effects(library_class("Twinproof.Plants.Pendulum", (lab,)))
    assert f"{lab / 'Lab' / 'Guide.mo'}{place}" in str(found.value)


def test_the_module_is_the_command_and_shows_no_traceback(tmp_path: Path) -> None:
    words = ["effects", "--modelica-path", str(tmp_path / "gone")]
    done = subprocess.run(
        [sys.executable, "-m", "twinproof", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr == (
        f"twinproof: no such folder ({tmp_path / 'gone'}); give the folder that a library is in\n"
    )
