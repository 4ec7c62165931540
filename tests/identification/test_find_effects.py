"""Effects are found in Modelica sources: the library's, a user's own, and nothing else."""

from pathlib import Path

import pytest
import truth_records as truth
import user_models

from fmus.places import Place
from foundation.errors import ModelicaError, UnknownNameError
from identification.discovery.effects import find_effects, resolve, unit_at
from modelica import LIBRARY

# `LIBRARY` is the path that holds the package Twinproof.
FILES = sorted(LIBRARY.rglob("Effects/*/*.mo"))
KINDS = {"Rotational": "rotational", "Translational": "translational", "Signal": "signal"}


def class_of(path: Path) -> str:
    return f"Twinproof.Effects.{path.parent.name}.{path.stem}"


def test_all_effects_of_the_library_and_nothing_else():
    expected = {class_of(p): KINDS[p.parent.name] for p in FILES if p.stem != "package"}
    assert len(expected) >= 20
    assert {e.class_name: e.kind for e in find_effects()} == expected


def test_an_effect_is_what_its_class_says():
    effect = resolve("StribeckFriction", "rotational", find_effects())
    assert effect.name == "StribeckFriction"
    assert effect.description.startswith("Excess of friction near standstill")
    assert effect.main_parameters == ("tau_s",)
    assert effect.shape_parameters == ("w_s",)
    by_name = {p.name: p for p in effect.parameters}
    assert by_name["tau_s"].unit == "N.m"
    assert by_name["w_0"].known
    assert not effect.delays


@pytest.mark.parametrize(
    ("effect", "parameter", "expected"),
    [
        ("Saturation", "inverse_limit", "1/V"),
        ("RateLimit", "inverse_rate", "s/V"),
        ("RateLimit", "T", "s"),
        ("Drift", "b_t", "V/s"),
        ("DeadZone", "w", "V"),
        ("Gain", "k", "1"),
    ],
)
def test_units_where_a_block_stands_in_a_voltage(effect, parameter, expected):
    found = resolve(effect, "signal", find_effects())
    declared = next(p for p in found.parameters if p.name == parameter)
    assert unit_at(declared, Place("V", "input", "V")) == expected


def test_only_the_delay_delays():
    assert [e.name for e in find_effects() if e.delays] == ["Delay"]


def test_every_effect_of_the_library_has_a_description_and_a_main_parameter():
    for effect in find_effects():
        assert effect.description, effect.class_name
        assert effect.main_parameters, effect.class_name


def test_a_users_package_joins_without_python(tmp_path):
    source = truth.library_class("Twinproof.Plants.Pendulum", (user_models.library(tmp_path),))
    found = {e.class_name: e for e in find_effects(source)}
    own = {name for name in found if not name.startswith("Twinproof.")}
    assert own == {"Shop.Cogging", "Shop.Square", "Shop.Rubber"}
    assert found["Shop.Cogging"].kind == "rotational"
    assert found["Shop.Cogging"].main_parameters == ("a",)
    assert found["Shop.Cogging"].description.startswith("Cogging of twelve teeth")
    assert found["Shop.Rubber"].kind == "translational"
    assert found["Shop.Rubber"].description == "Spring with a soft middle"
    assert found["Shop.Square"].kind == "signal"


def test_a_class_beside_the_model_joins():
    source = truth.own(user_models.OWN_EFFECT + user_models.DISC, "Disc")
    found = {e.class_name: e for e in find_effects(source)}
    assert found["Ratchet"].kind == "rotational"
    assert found["Ratchet"].main_parameters == ("tau_r",)
    assert found["Ratchet"].description == "Friction in one direction only"


def test_a_text_may_end_in_a_comment():
    source = truth.own(user_models.DISC + user_models.OWN_EFFECT + "// the end", "Disc")
    assert "Ratchet" in {e.class_name for e in find_effects(source)}


def test_a_users_class_hides_the_librarys_of_the_same_name():
    text = user_models.OWN_EFFECT.replace("Ratchet", "CoulombFriction")
    source = truth.own(text + user_models.DISC, "Disc")
    found = find_effects(source)
    assert resolve("CoulombFriction", "rotational", found).class_name == "CoulombFriction"
    named = [e.class_name for e in found if e.name == "CoulombFriction"]
    assert set(named) == {"Twinproof.Effects.Translational.CoulombFriction", "CoulombFriction"}


def test_a_broken_effect_of_the_user_is_named():
    text = user_models.OWN_EFFECT.replace("tau_r * (1", "tau_x * (1")
    with pytest.raises(ModelicaError, match=r"Ratchet|tau_x"):
        find_effects(truth.own(text + user_models.DISC, "Disc"))


def test_an_effect_may_extend_another_effect():
    text = """model Sticky "Coulomb friction with a default width of its own"
  extends Twinproof.Effects.Rotational.CoulombFriction(w_0 = 0.01);
end Sticky;
"""
    found = find_effects(truth.own(text + user_models.DISC, "Disc"))
    sticky = resolve("Sticky", "rotational", found)
    assert sticky.main_parameters == ("tau_c",)
    assert dict(zip([p.name for p in sticky.parameters], sticky.defaults, strict=True)) == {
        "tau_c": 0.0,
        "w_0": 0.01,
    }


@pytest.mark.parametrize(
    ("word", "kind", "class_name"),
    [
        ("CoulombFriction", "rotational", "Twinproof.Effects.Rotational.CoulombFriction"),
        ("CoulombFriction", "translational", "Twinproof.Effects.Translational.CoulombFriction"),
        ("Offset", "input", "Twinproof.Effects.Signal.Offset"),
        ("Twinproof.Effects.Signal.Gain", "output", "Twinproof.Effects.Signal.Gain"),
    ],
)
def test_words_are_resolved_by_the_kind_of_place(word, kind, class_name):
    assert resolve(word, kind, find_effects()).class_name == class_name


@pytest.mark.parametrize(
    ("word", "kind", "hint"),
    [("Colomb", "rotational", "CoulombFriction"), ("CoulombFriction", "input", "signal effect")],
)
def test_unknown_words_are_refused(word, kind, hint):
    with pytest.raises(UnknownNameError, match=hint):
        resolve(word, kind, find_effects())


def test_a_class_can_say_that_it_is_not_searched():
    """Such an effect is found, added by name, and left out of the scan with that reason."""
    found = {e.name: e.searched for e in find_effects() if e.kind == "rotational"}
    assert not found["LuGreFriction"]
    assert found["CoulombFriction"]
