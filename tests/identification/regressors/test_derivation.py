"""From Modelica to columns: against the paper, textbooks, and refusals that say why."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fmus.casadi_expressions import OPERATORS as CASADI_OPERATORS
from fmus.casadi_expressions import CasadiFold
from fmus.expressions import Literal, Operation, Symbol
from fmus.frontend import load
from fmus.sources import ModelicaSource, library_class
from foundation.errors import UnknownNameError, UnsupportedModelError
from identification.problem import fitted_by_default
from identification.regressors import derive
from identification.regressors.implicit_form import Coordinate
from identification.regressors.split import split
from identification.regressors.sympy_fold import OPERATORS, SympyFold, exact


def model(text, name="A"):
    return load(ModelicaSource(text, name, f"{name}.mo", name))


def plant(name):
    return load(library_class(f"Twinproof.Plants.{name}"))


def derived(dae, *, free=None, measured=None, values=None, **options):
    return derive(
        dae,
        free=fitted_by_default(dae) if free is None else free,
        values=values or {},
        measured=[v.name for v in dae.outputs] if measured is None else measured,
        **options,
    )


def symbols(names):
    return sp.symbols(names, real=True)


def vanishes(expression):
    return sp.simplify(expression) == 0


# --- Folding --------------------------------------------------------------------------------------

UNARY = ("negate", "abs", "no_event", "sign", "floor", "ceil", "sqrt", "log", "log10", "exp")
ANGLES = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
ARITHMETIC = ("add", "subtract", "multiply", "divide", "power", "min", "max", "mod", "atan2")
BINARY = (*ARITHMETIC, "element_multiply", "element_divide", "element_power", "smooth", "homotopy")
COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")


@settings(max_examples=10, deadline=None)
@given(a=st.floats(0.01, 0.99), b=st.floats(0.01, 0.99))
def test_every_operator_means_what_it_means_to_casadi(a, b):
    assume(abs(a / b - round(a / b)) > 1e-6)  # beside the jumps of mod
    operations = [Operation(name, (Symbol("a"),)) for name in (*UNARY, *ANGLES)]
    operations += [Operation(name, (Symbol("a"), Symbol("b"))) for name in BINARY]
    for name in COMPARISONS:
        condition = Operation(name, (Symbol("a"), Symbol("b")))
        both = Operation("and", (condition, Operation("not", (condition,))))
        either = Operation("or", (condition, both))
        operations.append(Operation("if", (either, Literal(2.0), Symbol("b"))))
    seen = {node.operator for node in operations} | {*COMPARISONS, "and", "or", "not"}
    assert set(OPERATORS) == seen
    assert set(CASADI_OPERATORS) <= seen, "CasADi understands more than sympy"
    numbers = {"a": a, "b": b}
    fold = SympyFold(lambda leaf: symbols(leaf.name))
    reference = CasadiFold.of_numbers(numbers)
    for operation in operations:
        got = float(fold(operation).subs({symbols(k): v for k, v in numbers.items()}))
        assert got == pytest.approx(float(reference(operation)), abs=1e-12), operation


def test_an_unknown_operator_is_refused():
    with pytest.raises(UnsupportedModelError, match=r"'bessel'.*output-error"):
        SympyFold(lambda leaf: leaf)(Operation("bessel", (Literal(1),)))


@given(st.floats(-1e6, 1e6))
def test_numbers_are_taken_exactly(value):
    assert float(exact(value)) == value


# --- Splitting ------------------------------------------------------------------------------------

Q1, Q2, W1, W2, A1, A2, U, T = symbols("q1 q2 w1 w2 a1 a2 u t")
TWO = [Coordinate(Q1, W1, A1), Coordinate(Q2, W2, A2)]
TERMS = [
    A1,
    sp.cos(Q1) * A1 - sp.sin(Q1) * W1**2,
    -sp.cos(Q2) * A1,
    sp.cos(Q1 - Q2) * A2 + sp.sin(Q1 - Q2) * W2**2,
    Q1**2 * Q2 * A1 + 3 * W1 * W2,
    W1 * abs(W1),
    W1**2 * A1,
    sp.tanh(20 * W1) * sp.exp(-(W1**2)),
    U * sp.cos(Q1),
    U * W1,
    sp.sin(2 * T) * Q1,
    Q1 * W2 + Q2 * W1,
    Q2 * W1,
    sp.cos(Q2) ** 2 * A1 - 2 * sp.sin(Q2) * sp.cos(Q2) * W1 * W2,
]


@settings(max_examples=60, deadline=None)
@given(
    chosen=st.lists(st.sampled_from(range(len(TERMS))), min_size=1, max_size=4, unique=True),
    recorded=st.sets(st.sampled_from([W1, W2])),
    seed=st.integers(0, 99),
)
def test_a_split_is_the_term_along_any_motion(chosen, recorded, seed):
    """Numerically along polynomials in time, so independent of the calculus inside."""
    e = sum(TERMS[i] for i in chosen)
    found = split(e, TWO, T, recorded)
    c = np.random.default_rng(seed).uniform(-1, 1, (3, 4))
    q1, q2, u = (sum(sp.Float(ck, 30) * T**k for k, ck in enumerate(row)) for row in c)
    motion = {Q1: q1, Q2: q2, U: u}
    motion |= {W1: sp.diff(q1, T), W2: sp.diff(q2, T)}
    motion |= {A1: sp.diff(q1, T, 2), A2: sp.diff(q2, T, 2)}

    def along(f):
        return f.subs(motion, simultaneous=True)

    total = (
        sp.diff(along(found.phi2), T, 2) + sp.diff(along(found.phi1), T) + along(found.phi0)
    ) - along(e)
    for instant in (0.3, 0.7):
        assert abs(total.subs(T, sp.Float(instant, 30)).evalf(30)) < 1e-20
    assert not found.phi2.free_symbols & {W1, W2, A1, A2, U}
    assert not found.phi1.free_symbols & {A1, A2, U}
    assert not found.phi0.free_symbols & {A1, A2}


def test_exact_terms_need_no_rate():
    found = split(TERMS[1], TWO, T)
    assert (found.phi2, found.phi1, found.phi0) == (sp.sin(Q1), 0, 0)
    assert split(TERMS[11], TWO, T).phi1 == Q1 * Q2
    assert split(TERMS[13], TWO, T).phi1 == sp.cos(Q2) ** 2 * W1


def test_a_recorded_rate_is_differentiated_once():
    found = split(A1 + 2 * A2, TWO, T, [W1])
    assert (found.phi2, found.phi1) == (2 * Q2, W1)


@pytest.mark.parametrize("term", [U * A1, T * A1, A1**2])
def test_what_no_filter_can_form_is_refused(term):
    with pytest.raises(UnsupportedModelError, match="output-error"):
        split(term, TWO, T)


# --- Plants of the library ------------------------------------------------------------------------


def test_wheeled_pendulum_gives_the_corrected_regressor_of_the_paper():
    """(26), with -θp'' in φ24 and, better than the print, φ13 = d²/dt² sin θp."""
    measured = ["theta_w", "theta_p", "omega_p"]
    regression = derived(plant("WheeledPendulum"), measured=measured, use_rates=False)
    w, p, ww, wp, V = symbols("theta_w theta_p omega_w omega_p V")
    zero = (0, 0, 0)
    expected = {
        "X1": [(w, 0, 0), zero],
        "X2": [(w - p, 0, 0), (w - p, 0, 0)],
        "X3": [
            (sp.sin(p), 0, 0),
            (0, -sp.cos(p) * ww, -sp.sin(p) * wp * ww),
        ],
        "X4": [zero, (-p, 0, 0)],
        "X5": [zero, (0, 0, sp.sin(p))],
        "X6": [(0, w, 0), (0, w, 0)],
        "X7": [(0, -p, 0), (0, -p, 0)],
    }
    assert [str(c.lump) for c in regression.columns] == list(expected)
    assert all(k.phi2 == k.phi1 == 0 for k in regression.known)
    for row, known in enumerate(regression.known):
        sign = known.phi0 / V  # an equation may come out multiplied by -1
        assert abs(sign) == 1
        for column in regression.columns:
            term = column.terms[row]
            for got, want in zip(
                (term.phi2, term.phi1, term.phi0), expected[str(column.lump)][row], strict=True
            ):
                assert vanishes(got - sign * want), (column.lump, row)
    assert regression.differenced == ("omega_w",)
    assert any("omega_w is not recorded" in note for note in regression.notes)
    needs = {str(c.lump): c.needs for c in regression.columns}
    assert needs["X3"] == {"theta_p", "omega_p", "omega_w"}
    assert needs["X6"] == {"theta_w"}


@pytest.mark.parametrize("name", ["Positioner", "Pendulum", "WheeledPendulum"])
def test_one_to_one_parameters_are_their_own_lumps(name):
    dae = plant(name)
    regression = derived(dae)
    free = fitted_by_default(dae)
    assert sorted(str(c.lump) for c in regression.columns) == sorted(free)
    assert regression.parameters == free
    values = {p: float(i) for i, p in enumerate(free)}
    order = [free.index(str(c.lump)) for c in regression.columns]
    assert regression.lumps(values).tolist() == order
    np.testing.assert_array_equal(regression.lump_jacobian(values), np.eye(len(free))[order])


def test_only_ratios_to_an_unknown_gain():
    dae = plant("Positioner")
    regression = derived(dae, free=["M", "Fv", "gtau"])
    assert [str(c.lump) for c in regression.columns] == ["M/gtau", "Fv/gtau"]
    assert "only ratios to gtau are determined" in regression.notes


FRICTION = ("CoulombFriction", "StribeckFriction", "AsymmetricViscousFriction", "ViscousFriction")
OTHERS = ("QuadraticDrag", "AsymmetricCoulombFriction", "ConstantTorque", "LinearSpring")
NINE = (*FRICTION, *OTHERS, "CubicSpring")


def test_effects_are_columns_of_their_own_and_derived_once():
    parts = " ".join(f"Twinproof.Effects.Rotational.{e} e{i};" for i, e in enumerate(NINE))
    joints = " ".join(
        f"connect(e{i}.flange, {'wheel' if i % 2 else 'body'}.flange);" for i in range(len(NINE))
    )
    dae = model(
        f"model A extends Twinproof.Plants.WheeledPendulum; {parts} equation {joints} end A;"
    )
    regression = derived(dae, measured=["theta_w", "theta_p", "omega_p"])
    assert regression.shape == ("e1.w_s",)
    assert {str(c.lump) for c in regression.columns} == set(fitted_by_default(dae)) - {"e1.w_s"}
    assert derived(dae, measured=["theta_w", "theta_p", "omega_p"]) is regression


def test_shape_parameters_stand_at_their_values():
    dae = model(
        "model A extends Twinproof.Plants.Pendulum; "
        "Twinproof.Effects.Rotational.StribeckFriction s(tau_s=1); "
        "equation connect(s.flange, joint.flange); end A;"
    )
    w = symbols("omega")
    for w_s in (0.5, 1.25):
        regression = derived(dae, values={"s.w_s": w_s})
        column = next(c for c in regression.columns if str(c.lump) == "s.tau_s")
        law = sp.exp(-((w / exact(w_s)) ** 2)) * sp.tanh(20 * w)
        assert vanishes(column.terms[0].phi0 / law - 1) or vanishes(column.terms[0].phi0 / law + 1)


def test_dead_zone_before_the_plant_stays_a_function_of_the_input():
    dae = load(library_class("Twinproof.Examples.WheeledPendulumWithDeadZone"))
    regression = derived(dae)
    assert regression.shape == ("deadZone.w",)
    held = regression.known[0].phi0
    assert {s.name for s in held.free_symbols} == {"V"}
    got = [abs(float(held.subs(symbols("V"), v))) for v in (-1.0, -0.1, 0.1, 1.0)]
    assert got == pytest.approx([0.8, 0.0, 0.0, 0.8])


def test_a_gain_before_the_plant_leaves_ratios():
    dae = model(
        "model A Twinproof.Plants.Pendulum plant; Twinproof.Effects.Signal.Gain g; "
        "Twinproof.Interfaces.RealInput tau; Twinproof.Interfaces.RealOutput theta; "
        "equation connect(tau, g.u); connect(g.y, plant.tau); connect(plant.theta, theta); end A;"
    )
    regression = derived(dae, measured=["theta"])
    k = symbols("g.k")
    ratios = {c.lump for c in regression.columns}
    assert ratios == {symbols(f"plant.{n}") / (1 + k) for n in ("J", "mgl", "d")}
    assert [n for n in regression.notes if "ratios to" in n] == [
        "only ratios to g.k + 1 are determined"
    ]


# --- Users' models --------------------------------------------------------------------------------

FURUTA = """model A
  parameter Real J0 = 0.004; parameter Real m1 = 0.03; parameter Real l0 = 0.15;
  parameter Real l1 = 0.14; parameter Real J1 = 2e-4; parameter Real d0 = 0.02;
  parameter Real d1 = 1e-4; parameter Real K = 0.1;
  input Real u;
  output Real alpha(start = 0, fixed = true); output Real beta(start = 0.3, fixed = true);
  Real wa(start = 0, fixed = true); Real wb(start = 0, fixed = true); Real Jr; Real tau;
equation
  der(alpha) = wa; der(beta) = wb; Jr = J1 + m1*l1^2; tau = K*u - d0*wa;
  (J0 + m1*l0^2 + Jr*sin(beta)^2)*der(wa) + m1*l0*l1*cos(beta)*der(wb)
    + 2*Jr*sin(beta)*cos(beta)*wa*wb - m1*l0*l1*sin(beta)*wb^2 = tau;
  Jr*der(wb) + m1*l0*l1*cos(beta)*der(wa) - Jr*sin(beta)*cos(beta)*wa^2
    - m1*9.81*l1*sin(beta) = -d1*wb;
end A;"""


def test_furuta_pendulum_has_six_base_parameters():
    free = ["J0", "m1", "l0", "l1", "J1", "d0", "d1"]
    regression = derived(model(FURUTA), free=free, measured=["alpha", "beta"])
    J0, m1, l0, l1, J1, d0, d1 = symbols(free)
    expected = [J0 + m1 * l0**2, J1 + m1 * l1**2, l0 * l1 * m1, l1 * m1, d0, d1]
    found = [c.lump for c in regression.columns]
    assert len(found) == len(expected)
    assert all(any(vanishes(f - e) for f in found) for e in expected)


CART = """model A
  parameter Real M = 1; parameter Real m = 0.2; parameter Real l = 0.5; parameter Real J = 0.01;
  input Real F; output Real x(start = 0, fixed = true); output Real th(start = 0.1, fixed = true);
  Real v(start = 0, fixed = true); Real w(start = 0, fixed = true); Real N; Real P;
equation
  der(x) = v; der(th) = w; M*der(v) = F - N;
  N = m*(der(v) + l*der(w)*cos(th) - l*w^2*sin(th));
  P = m*(9.81 - l*der(w)*sin(th) - l*w^2*cos(th));
  J*der(w) = P*l*sin(th) - N*l*cos(th);
end A;"""


def test_internal_forces_are_eliminated():
    regression = derived(model(CART))
    M, m, length, J = symbols("M m l J")
    found = [c.lump for c in regression.columns]
    assert len(found) == 3
    assert all(any(vanishes(f - e) for f in found) for e in (M + m, length * m, J + length**2 * m))


def test_an_algebraic_behind_a_parameter_is_divided_out():
    dae = model(
        "model A parameter Real R1 = 1; parameter Real R2 = 2; parameter Real J = 0.1; "
        "parameter Real K = 0.5; input Real u; output Real th(start = 0, fixed = true); "
        "Real w(start = 0, fixed = true); Real i; equation der(th) = w; "
        "(R1 + R2)*i = u - K*w; J*der(w) = K*i; end A;"
    )
    regression = derived(dae)
    R1, R2, J, K = symbols("R1 R2 J K")
    found = [c.lump for c in regression.columns]
    assert any(vanishes(f - K) for f in found)
    assert any(vanishes(f - J * (R1 + R2) / K) for f in found)
    assert len(found) == 2


def test_an_unknown_angle_offset_is_opened():
    dae = model(
        "model A parameter Real J = 1; parameter Real k = 2; parameter Real b = 0.1; input Real u; "
        "output Real q(start = 0, fixed = true); Real w(start = 0, fixed = true); "
        "equation der(q) = w; J*der(w) + k*sin(q + b) = u; end A;"
    )
    regression = derived(dae)
    J, k, b = symbols("J k b")
    found = [c.lump for c in regression.columns]
    assert all(any(vanishes(f - e) for f in found) for e in (J, k * sp.cos(b), k * sp.sin(b)))


def test_parameters_in_branches_are_columns():
    dae = model(
        "model A parameter Real J = 1; parameter Real up = 2; parameter Real down = 3; "
        "input Real u; output Real q(start = 0, fixed = true); Real w(start = 0, fixed = true); "
        "equation der(q) = w; J*der(w) + (if w > 0 then up*w else down*w) = u; end A;"
    )
    regression = derived(dae)
    assert [str(c.lump) for c in regression.columns] == ["J", "up", "down"]
    w = symbols("w")
    for name, forward, back in (("up", 2, 0), ("down", 0, -2)):
        law = next(c.terms[0].phi0 for c in regression.columns if str(c.lump) == name)
        assert abs(law.subs(w, 2)) == abs(forward)
        assert abs(law.subs(w, -2)) == abs(back)


def test_a_speed_alone_is_enough_where_the_position_does_not_matter():
    regression = derived(plant("Positioner"), measured=["v"])
    v = symbols("v")
    terms = {str(c.lump): c.terms[0] for c in regression.columns}
    assert terms["M"].phi1 == v
    assert terms["Fv"].phi0 == v


def test_a_scaled_output_shows_its_state():
    dae = model(
        "model A parameter Real J = 1; parameter Real d = 2; input Real u; output Real deg; "
        "Real q(start = 0, fixed = true); Real w(start = 0, fixed = true); "
        "equation der(q) = w; J*der(w) + d*w = u; deg = 57.3*q + 4; end A;"
    )
    reading = derived(dae, measured=["deg"]).readings["q"]
    assert (reading.channel, reading.gain, reading.offset) == ("deg", 57.3, 4.0)


def test_an_absent_lag_does_not_stand_in_the_way():
    dae = model(
        "model A Twinproof.Plants.Pendulum plant; Twinproof.Effects.Signal.FirstOrderLag lag; "
        "Twinproof.Interfaces.RealInput tau; Twinproof.Interfaces.RealOutput theta; "
        "equation connect(tau, lag.u); connect(lag.y, plant.tau); connect(plant.theta, theta); "
        "end A;"
    )
    free = ["plant.J", "plant.mgl", "plant.d"]
    assert len(derived(dae, free=free).columns) == 3
    with pytest.raises(UnsupportedModelError, match=r"lag\.x of A is neither recorded"):
        derived(dae, free=free, values={"lag.T": 0.02})


# --- Refusals -------------------------------------------------------------------------------------

HEAD = (
    "model A parameter Real J = 1; parameter Real k = 2; input Real u; "
    "output Real q(start = 0, fixed = true); Real w(start = 0, fixed = true); "
)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            HEAD + "Real i(start = 0, fixed = true); "
            "equation der(q) = w; 0.1*der(i) = u - i; J*der(w) + k*q = i; end A;",
            "i of A is neither recorded nor the rate of a recorded one.*record it, or use",
        ),
        (
            HEAD + "equation der(q) = w; J*der(w) + k*delay(q, 0.1) = u; end A;",
            "a delay, which no channel shows; use --method output-error",
        ),
        (
            HEAD + "equation der(q) = w; (J + u)*der(w) + k*q = u; end A;",
            "multiplied by u.*use --method output-error",
        ),
        (
            HEAD + "Real z; equation der(q) = w; J*der(w) + k*z^3 = u; z^3 + z = q; end A;",
            "cannot be solved symbolically for z; use --method output-error",
        ),
        (
            HEAD + "equation der(q) = w; J*der(w) + k*q = u; "
            "when q < 0 then reinit(w, -pre(w)); end when; end A;",
            "changes its states at events",
        ),
        (
            HEAD + "equation der(q) = w; der(w) + tanh(J*w) + tanh(k*q) = u; end A;",
            "no free parameter enters the equations of motion linearly",
        ),
    ],
)
def test_what_has_no_regression_is_refused_with_reason_and_remedy(text, reason):
    with pytest.raises(UnsupportedModelError, match=reason):
        derived(model(text), measured=["q"])


def test_a_position_that_is_not_recorded_is_named():
    with pytest.raises(UnsupportedModelError, match=r"omega and theta of Pendulum are neither"):
        derived(plant("Pendulum"), measured=["omega"])


def test_an_unknown_parameter_is_named():
    with pytest.raises(UnknownNameError, match="did you mean"):
        derived(plant("Pendulum"), free=["mglx"])
