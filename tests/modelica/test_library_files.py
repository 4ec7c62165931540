"""Every file of the library is well-formed, documented, and understood by two parsers."""

from __future__ import annotations

import re
from pathlib import Path

import pymoca.parser
import pytest
import rumoca
from front_end import class_name, load_class, names_in, source_files, variables

from foundation.units import factor_and_offset
from modelica import LIBRARY

FILES = source_files()
CLASSES = [p for p in FILES if p.stem != "package"]
PACKAGES = [p.parent for p in FILES if p.stem == "package"]
SIMULATED = [
    f"Twinproof.{folder.replace('/', '.')}.{name}"
    for folder in (
        "Plants",
        "Effects/Rotational",
        "Effects/Translational",
        "Effects/Signal",
        "Sensors",
        "Examples",
    )
    for name in names_in(folder)
]
PERIODIC = {"Imbalance", "Cogging", "ForceRipple", "Eccentricity"}
EFFECTS = [name for name in SIMULATED if ".Effects." in name]
KNOWN = "annotation(__twinproof(known = true))"
by_class = pytest.mark.parametrize("path", CLASSES, ids=class_name)


def declaration(name: str, parameter: str) -> str:
    """Source text of one parameter, up to its semicolon."""
    text = (LIBRARY.parent / Path(*name.split("."))).with_suffix(".mo").read_text()
    found = re.search(rf"parameter Real {parameter}\b[^;]*;", text)
    assert found, f"{name} declares {parameter} in an unusual way"
    return found[0]


def test_the_library_is_all_there() -> None:
    assert len(SIMULATED) == 7 + 22 + 20 + 18 + 4 + 2
    assert len(CLASSES) == len(SIMULATED) + 12


@pytest.mark.parametrize("path", FILES, ids=class_name)
def test_second_parser_reads_it(path: Path) -> None:
    tree = pymoca.parser.parse(path.read_text(encoding="ascii"))
    assert tree is not None


@pytest.mark.parametrize("path", FILES, ids=class_name)
def test_front_end_has_no_complaint(path: Path) -> None:
    assert [d.message for d in rumoca.validate_source(path.read_text())] == []


@by_class
def test_file_says_where_it_belongs(path: Path) -> None:
    name = class_name(path)
    text = path.read_text()
    assert text.startswith(f"within {name.rpartition('.')[0]};\n")
    assert re.search(rf"^(partial )?(model|block|connector) {path.stem}\b", text, re.MULTILINE)
    assert max(len(line) for line in text.splitlines()) <= 100


@by_class
def test_described_and_referenced(path: Path) -> None:
    text = path.read_text()
    head = text.split("\n", 2)[1]
    assert re.search(r'"[^"]{8,}"', head), "one-line description"
    assert "Documentation(info" in text
    assert "<h4>Reference</h4>" in text


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda p: p.name)
def test_package_order_lists_what_is_there(folder: Path) -> None:
    listed = (folder / "package.order").read_text().split()
    files = {p.stem for p in folder.glob("*.mo")} - {"package"}
    folders = {p.name for p in folder.iterdir() if p.is_dir()}
    assert set(listed) == files | folders
    assert len(listed) == len(set(listed))


@pytest.mark.parametrize("name", SIMULATED)
def test_loads_alone_and_every_variable_has_unit_and_description(name: str) -> None:
    model = load_class(name)
    assert model.structure().is_balanced
    for variable in variables(model):
        assert variable.description, variable.name
        if variable.unit is None:
            signal_port = variable.name.rpartition(".")[2] in {"u", "y"}
            assert ".Signal." in name or "DeadZone" in name
            assert signal_port or "unit of the signal" in variable.description, variable.name
        else:
            # A factor to appended seconds and back: any unit that pint cannot read raises.
            assert factor_and_offset(f"{variable.unit}.s/s", variable.unit) == (1.0, 0.0)


@pytest.mark.parametrize("root", [LIBRARY, LIBRARY.parent], ids=["library", "its parent"])
def test_either_folder_serves_as_root(root: Path) -> None:
    text = "model Q extends Twinproof.Plants.Positioner; end Q;"
    assert rumoca.Session(roots=[str(root)]).loads(text, model="Q").structure().is_balanced


@pytest.mark.parametrize("name", EFFECTS)
def test_parameters_of_an_effect_follow_the_conventions(name: str) -> None:
    """Main ones default to 0 and have a nominal; others are bounded shapes or known widths."""
    public = [
        p
        for p in load_class(name).parameters
        if p.kind != "structural" and not p.name.endswith("_start")
    ]
    main = [p for p in public if p.value == 0]
    # A periodic effect has a phase, of which nothing is known beforehand.
    short = name.rpartition(".")[2]
    if short.startswith("Empirical"):
        # A curve drawn from data: bumps that its base declares, over a range that is known.
        bumps = 17 if short.endswith("Signal") else 9
        assert {p.name for p in main} == {f"c_{k}" for k in range(1, bumps + 1)}
        assert {p.name for p in public} - {p.name for p in main} == {"lowest", "highest"}
        return
    assert len(main) == (2 if short in PERIODIC else 1)
    for parameter in main:
        assert parameter.nominal is not None
        assert parameter.nominal > 0
        assert KNOWN not in declaration(name, parameter.name)
    for parameter in public:
        if parameter.value != 0 and KNOWN not in declaration(name, parameter.name):
            assert parameter.min < parameter.value < parameter.max


@pytest.mark.parametrize(
    ("plant", "known"),
    [
        ("WheeledPendulum", {"alpha"}),
        ("Positioner", {"gtau"}),
        ("Pendulum", set()),
        ("BalancingRobot2D", {"M_w", "M_b", "r", "g_r", "a", "g"}),
        ("BalancingRobot3D", {"M_w", "M_b", "d", "r", "g_r", "K_t", "R_m", "g"}),
        ("FurutaPendulum", {"m1", "l0", "l1", "K_t", "K_b", "K_u", "R_a", "g", "w_0"}),
        ("RoadCar", {"L"}),
    ],
)
def test_plant_declares_what_is_known_and_where_states_start(plant: str, known: set[str]) -> None:
    name = f"Twinproof.Plants.{plant}"
    model = load_class(name)
    parameters = {p.name for p in model.parameters}
    starts = {f"{state}_start" for state in model.states.names}
    assert starts < parameters
    marked = {p for p in parameters if KNOWN in declaration(name, p)}
    assert marked == known
    # Those computed from others are no more than abbreviations.
    own = {p.name for p in model.parameters if p.kind != "structural"}
    for parameter in own - starts:
        assert model.parameters[parameter].min is not None


# Parameters that multiply a power of position and of rate.
OF_POWER = {
    "d": (1, 1), "d_a": (1, 1), "d_w": (1, 1), "c": (2, 2),
    "k": (1, 0), "k_e": (1, 0), "k_h": (1, 0), "k3": (3, 0),
}  # fmt: skip
OF_TIME = {"T_b": "s", "T_w": "s", "f_n": "Hz", "omega_n": "rad/s"}
NUMBERS = {"n", "r_s", "zeta", "z_start"}
POSITIONS = {"phi_b", "phi_e", "phi_y", "s_b", "s_e", "s_y", "p", "x_start"}
RATES = {"w_0", "w_r", "w_s", "w_f_start", "v_0", "v_r", "v_s", "v_f_start"}


@pytest.mark.parametrize("name", [n for n in EFFECTS if ".Signal." not in n])
def test_units_make_a_torque_or_a_force(name: str) -> None:
    effort, angle, rate = ("N.m", "rad", "rad/s") if ".Rotational." in name else ("N", "m", "m/s")
    model = load_class(name)
    for parameter in model.parameters:
        if parameter.name in OF_POWER:
            power, seconds = OF_POWER[parameter.name]
            product = f"{parameter.unit}.{angle}{power}" + (f"/s{seconds}" if seconds else "")
            assert factor_and_offset(product, effort) == pytest.approx((1.0, 0.0))
        elif parameter.name in {"J_f", "m_f"}:
            product = f"{parameter.unit}.{angle}/s2"
            assert factor_and_offset(product, effort) == pytest.approx((1.0, 0.0))
        elif parameter.name in OF_TIME:
            assert parameter.unit == OF_TIME[parameter.name]
        elif parameter.name in NUMBERS:
            assert parameter.unit == "1"
        elif parameter.name in POSITIONS:
            assert parameter.unit == angle
        elif parameter.name in {"lowest", "highest"}:
            assert parameter.unit == (rate if name.endswith("Speed") else angle)
        elif parameter.name in RATES:
            assert parameter.unit == rate
        else:
            assert parameter.unit == effort
