"""From text to the flat model: aliases, places, the linter, messages with positions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_runs import source

from fmus.dae import Role
from fmus.explicit import explicit
from fmus.frontend import load
from fmus.modelica_text import without_comments_and_strings
from fmus.places import places
from fmus.sources import ModelicaSource, find_source, library_class
from foundation.errors import InputError, ModelicaError, UnsupportedModelError
from modelica import LIBRARY

CLASSES = [
    ".".join(("Twinproof", *file.relative_to(LIBRARY).with_suffix("").parts))
    for folder in ("Plants", "Examples")
    for file in sorted((LIBRARY / folder).rglob("*.mo"))
    if file.stem != "package"
]
MECHANICS = """
  connector Flange Real phi(unit = "rad"); flow Real tau(unit = "N.m"); end Flange;
  connector Rod Real s(unit = "m"); flow Real f(unit = "N"); end Rod;
  connector Pin Real v(unit = "V"); flow Real i(unit = "A"); end Pin;
  model Inertia "Rigid shaft" Flange flange_a; Flange flange_b; parameter Real J = 1;
    Real phi(start = 0, fixed = true); Real w(start = 0, fixed = true);
  equation flange_a.phi = phi; flange_b.phi = phi; w = der(phi);
    J * der(w) = flange_a.tau + flange_b.tau; end Inertia;
  model Spring Flange flange_a; Flange flange_b; parameter Real c = 1;
  equation flange_a.tau = c * (flange_a.phi - flange_b.phi); flange_b.tau = -flange_a.tau;
  end Spring;
  model Wall Flange flange; equation flange.phi = 0; end Wall;
"""


@pytest.mark.parametrize("name", CLASSES)
def test_every_class_of_the_library_passes_the_linter(name):
    assert load(library_class(name)).outputs


# Aliases


def test_aliases_follow_signs_and_chains():
    dae = load(
        source(
            "model T Real x(start = 2, fixed = true); Real a; Real b; Real c; Real d; Real e;"
            " equation der(x) = -x; a = -x; b = a; 0 = b + c; d = 7; e + d = 0; end T;"
        )
    )
    assert {n: (a.of, a.sign) for n, a in dae.aliases.items()} == {
        "a": ("x", -1.0), "b": ("x", -1.0), "c": ("x", 1.0),
    }  # fmt: skip
    assert {n: c.value for n, c in dae.constant_values.items()} == {"d": 7.0, "e": -7.0}
    assert len(dae.residuals) == 1


def test_derivative_of_an_alias_makes_no_second_state():
    """An effect that differentiates its flange's angle, mirrored: der(a) = der(-x) = -v."""
    dae = load(
        source(
            "model T Real x(start = 1, fixed = true); Real v(start = 2, fixed = true); Real a;"
            " Real w; equation der(x) = v; der(v) = -x + w; a = -x; w = der(a); end T;"
        )
    )
    assert [v.name for v in dae.states] == ["x", "v"]
    model = explicit(dae)
    import casadi as ca

    f = ca.Function("f", [model.x], [model.derivatives, model.value("w"), model.value("a")])
    dx, w, a = (np.array(r).ravel().tolist() for r in f([0.5, 3.0]))
    assert (dx, w, a) == ([3.0, -3.5], [-3.0], [-0.5])


def test_a_fixed_start_survives_on_whichever_name():
    dae = load(
        source(
            "model T Real x; Real y(start = 3, fixed = true); equation der(x) = -x; y = -x; end T;"
        )
    )
    (state,) = dae.states
    assert (state.name, state.fixed, dae.number(state.start, 0)) == ("y", True, 3.0)


def test_inputs_and_parameters_are_never_removed():
    dae = load(
        source(
            "model T parameter Real p = 2; input Real u; output Real y; Real a; Real b;"
            " Real x(start = 0, fixed = true);"
            " equation y = u; a = p; b = a; der(x) = y + b; end T;"
        )
    )
    assert {v.name: v.role for v in dae.variables.values()} == {
        "p": Role.PARAMETER, "u": Role.INPUT, "y": Role.ALGEBRAIC, "x": Role.STATE,
    }  # fmt: skip
    assert {n: a.of for n, a in dae.aliases.items()} == {"a": "p", "b": "p"}


@settings(deadline=None, max_examples=25)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 30)), min_size=1, max_size=8))
def test_any_chain_of_aliases_ends_at_the_state(links):
    """z0 = x; z_k = ±z_j for an earlier j: the sign is the product along the way."""
    signs, text = [1], ["z0 = x;"]
    for k, (negative, pick) in enumerate(links, start=1):
        j = pick % k
        signs.append(signs[j] * (-1 if negative else 1))
        text.append(f"z{k} {'+' if negative else '-'} z{j} = 0;")
    declared = " ".join(f"Real z{k};" for k in range(len(signs)))
    dae = load(
        source(
            f"model T Real x(start = 1, fixed = true); {declared}"
            f" equation der(x) = -x; {' '.join(reversed(text))} end T;"
        )
    )
    kept = dae.states[0].name
    sign_of = {kept: 1.0, **{n: a.sign for n, a in dae.aliases.items()}}
    assert len(dae.residuals) == 1
    for k, sign in enumerate(signs):
        assert sign_of[f"z{k}"] * sign_of["x"] == sign


# Places


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Pendulum", {"joint": "rotational", "tau": "input", "theta": "output", "omega": "output"}),
        ("Positioner", {"carriage": "translational", "vir": "input", "q": "output", "v": "output"}),
        (
            "WheeledPendulum",
            {
                "wheel": "rotational", "body": "rotational", "V": "input", "theta_w": "output",
                "theta_p": "output", "omega_w": "output", "omega_p": "output",
            },
        ),
    ],
)  # fmt: skip
def test_places_of_the_plants(name, expected):
    found = places(library_class(f"Twinproof.Plants.{name}"))
    assert {place.name: place.kind for place in found} == expected
    points = [place for place in found if place.kind.endswith("ional")]
    assert [p.connector for p in points] == [f"{p.name}.flange" for p in points]
    assert all(p.inherited_connect and p.description for p in points)
    assert {p.unit for p in points} <= {"N.m", "N"}
    assert not any(p.inherited_connect for p in found if p.kind in ("input", "output"))


def test_places_of_a_model_with_flanges_of_another_library():
    found = places(
        source(
            f"model T {MECHANICS} Inertia motor; Inertia load; Spring s; Flange flange; Wall wall;"
            " Spring t; equation connect(motor.flange_b, s.flange_a);"
            " connect(s.flange_b, load.flange_a); connect(load.flange_b, flange);"
            " connect(load.flange_b, t.flange_a); connect(t.flange_b, wall.flange); end T;"
        )
    )
    # Both ends of a shaft move alike; the wall does not move.
    assert [(p.name, p.inherited_connect) for p in found] == [
        ("motor.flange_a", True), ("load.flange_a", True),
    ]  # fmt: skip
    assert set(found[0].also) == {"motor.flange_b", "s.flange_a"}
    assert set(found[1].also) == {"load.flange_b", "s.flange_b", "t.flange_a", "flange"}


def test_bare_flange_needs_a_wrapper_and_electric_pins_are_no_places():
    found = places(
        source(
            f"model T {MECHANICS} Flange flange; Pin pin; Real w(start = 0, fixed = true);"
            " equation w = der(flange.phi); der(w) = flange.tau - w; pin.v = 3 * pin.i; end T;"
        )
    )
    assert [(p.name, p.kind, p.inherited_connect) for p in found] == [
        ("flange", "rotational", False)
    ]


def test_an_effect_at_a_point_is_the_same_place():
    found = places(
        source(
            "model T extends Twinproof.Plants.Pendulum;"
            " Twinproof.Effects.Rotational.LinearSpring f;"
            " equation connect(f.flange, joint.flange); end T;"
        )
    )
    assert [p.name for p in found if p.kind == "rotational"] == ["joint"]
    assert found[0].also == ("f.flange",)


# The linter


PENDULUM = "extends Twinproof.Plants.Pendulum"
FRICTION = "Twinproof.Effects.Rotational.CoulombFriction f(tau_c = 1)"
REPLACEABLE = """
partial model I input Real x; output Real y; parameter Real k = 1; end I;
model L extends I; equation y = k * x; end L;
model C extends I; equation y = k * x ^ 3; end C;
model B replaceable L law constrainedby I; Real x(start = 1, fixed = true);
equation law.x = x; der(x) = -law.y; end B;"""


@pytest.mark.parametrize(
    ("text", "line", "column", "message"),
    [
        (f"model T {PENDULUM}(J = 1,\n  X9 = 1); end T;", 2, 3, "nothing called 'X9'"),
        (f"model T {PENDULUM}(\n theta_stort = 1); end T;", 2, 2, "did you mean theta_start"),
        (f"model T {PENDULUM}(joint(foo = 1)); end T;", 1, 49, "nothing called 'joint.foo'"),
        (f"model T {PENDULUM}(J(maks = 1)); end T;", 1, 45, "nothing called 'J.maks'"),
        (
            f"model A {PENDULUM}(X8 = 2); end A;\nmodel T extends A; end T;",
            1, 43, "nothing called 'X8'",
        ),
        (
            f"model T {PENDULUM}; Twinproof.Effects.Translational.CoulombFriction f(f_c = 1);\n"
            "equation\n  connect(f.flange, joint.flange); end T;",
            3, 3, "different kinds",
        ),
        (
            f"model T {PENDULUM};\n  {FRICTION}; end T;",
            2, 48, "nothing is connected to 'f.flange'",
        ),
        (
            f"model T {PENDULUM};\n Twinproof.Effects.Signal.DeadZone z;\n"
            "equation z.u = tau; end T;",
            2, 36, "nothing is connected to 'z.y'",
        ),
        (
            f"model T {PENDULUM}; Twinproof.Effects.Signal.DeadZone z;\n"
            "equation connect(tau, z.u);\n  connect(z.y, joint.flange); end T;",
            3, 3, "is a flange and",
        ),
        (
            "package P model L = M; model M parameter Real k = 1; end M;\n"
            "model B replaceable model L = M; L l; end B;\n"
            "model T extends B(redeclare model L = M(k = 4)); end T; end P;",
            3, 19, "modifier of this redeclare",
        ),
    ],
)  # fmt: skip
def test_swallowed_mistakes_are_reported(text, line, column, message):
    with pytest.raises(ModelicaError, match=message) as caught:
        load(ModelicaSource(text, "P.T" if "package" in text else "T", "my.mo", "my.mo:T"))
    assert str(caught.value).startswith(f"my.mo:{line}:{column}: ")


@pytest.mark.parametrize(
    "text",
    [
        f"model T {PENDULUM}(J = 2, theta(min = -9), joint(flange(phi(nominal = 2)))); end T;",
        f"model T {PENDULUM}; {FRICTION}; equation connect(f.flange, joint.flange); end T;",
        # Comments and strings may hold anything.
        f'model T "extends A(X9 = 1)" {PENDULUM}; // extends A(X9 = 1); connect(a, b)\n'
        " /* (redeclare model L = C(k = 1) */ end T;",
        # Two bodies that have nothing to do with each other, the second only with itself.
        f"model T {MECHANICS} Inertia a; Spring s; Wall wall;"
        " equation connect(a.flange_b, s.flange_a); connect(s.flange_b, wall.flange); end T;",
        # A shaft alone, whose angle is looked at.
        f"model T {MECHANICS} Inertia a; output Real y = a.phi; end T;",
        # The redeclarations that keep their modifiers.
        f"{REPLACEABLE} model T extends B(redeclare C law(k = 4)); end T;",
        # Another class of the file is none of the model's business.
        f"model T {PENDULUM}; end T; model U {PENDULUM}(X9 = 3); end U;",
        # Connectors of other physics, blocks, several on one line.
        "model T Twinproof.Interfaces.RealInput u; Twinproof.Effects.Signal.Gain a(k = 1), b;"
        " Twinproof.Plants.Pendulum p; Twinproof.Interfaces.RealOutput y;"
        " equation connect(u, a.u); connect(a.y, b.u); connect(b.y, p.tau); connect(p.theta, y);"
        " end T;",
    ],
)
def test_valid_models_pass(text):
    load(source(text))


def test_redeclared_component_keeps_its_modifier():
    dae = load(source(f"{REPLACEABLE} model T extends B(redeclare C law(k = 4)); end T;"))
    assert dae.parameter_values["law.k"] == 4.0


# Messages


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("model T\n Real x;\nequation der(x) = -x end T;", "3:22", "end"),
        ("model T\n Real x;\nequation der(x) = -zz; end T;", "3:20", "zz"),
        ("model T\n Bar x; end T;", "2:2", "Bar"),
        ("model T\n Real x(start = \"a\"); equation der(x) = 1; end T;", "2:17", "start"),
        ("model T extends Twinproof.Plants.Nope; end T;", "1:34", "Nope"),
        ("\nmodel T Real x; Real y; equation der(x) = 1; end T;", "2:1", "1 equations for 2"),
        (
            f"model T {PENDULUM}; {FRICTION};\nequation connect(f.flange, joint); end T;",
            "2:18", "incompatible",
        ),
    ],
)  # fmt: skip
def test_mistakes_have_a_position(text, place, message):
    with pytest.raises(ModelicaError, match=message) as caught:
        load(ModelicaSource(text, "T", "bad.mo", "bad.mo"))
    assert str(caught.value).startswith(f"bad.mo:{place}: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("String s = \"a\"; Real x; equation der(x) = -x;", "'s'"),
        ("Real x; Real y; equation der(x) = -y; y = if terminal() then 1 else x;", "terminal"),
    ],
)  # fmt: skip
def test_untranslated_constructs_are_refused_by_name(text, message):
    with pytest.raises(UnsupportedModelError, match=message) as caught:
        load(source(f"model T {text} end T;"))
    assert str(caught.value).startswith("T.mo:")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Real x; Real y; equation der(x) = y; y ^ 3 + y = x;", "nonlinear"),
        ("Real x; Real y; Real f; input Real u; equation der(x) = y; der(y) = f; x = u;",
         "derivative of the input 'u'"),
        ("Real x; Real y; Real z; equation der(x) = 1; x = 3 * time; y + z = 1;",
         "no finite index"),
    ],
)  # fmt: skip
def test_unsolvable_equations_are_refused(text, message):
    with pytest.raises(UnsupportedModelError, match=message):
        explicit(load(source(f"model T {text} end T;")))


def test_words_for_models(tmp_path):
    with pytest.raises(ModelicaError, match="no such Modelica file"):
        find_source(str(tmp_path / "none.mo"))
    with pytest.raises(InputError, match="neither a file nor"):
        find_source("what is this")
    (tmp_path / "e.mo").write_text("// nothing")
    with pytest.raises(ModelicaError, match="no class"):
        find_source(str(tmp_path / "e.mo"))
    (tmp_path / "b.mo").write_bytes(b"model \xff")
    with pytest.raises(ModelicaError, match="UTF-8"):
        find_source(str(tmp_path / "b.mo"))


@given(st.text(alphabet='ab"\\/*\n ;(', max_size=40))
def test_blanking_keeps_every_offset(text):
    blanked = without_comments_and_strings(text)
    assert len(blanked) == len(text)
    assert [i for i, c in enumerate(blanked) if c == "\n"] == [
        i for i, c in enumerate(text) if c == "\n"
    ]
    assert all(b in (t, " ") for b, t in zip(blanked, text, strict=True))
