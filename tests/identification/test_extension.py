"""Models with effects added: a second parser reads the text, and it does what it says."""

import numpy as np
import pymoca.parser
import pytest
import truth_records as truth
import user_models

from fmus.frontend import load
from foundation.errors import InputError, UnknownNameError
from identification.discovery.extension import extend, parse_addition, text_diff
from identification.discovery.ladder import start_values
from identification.discovery.transfer import flat_name, transfer_problem
from identification.experiment import Experiment
from identification.shooting import Shooting

PENDULUM = truth.library("Pendulum")
DISC = truth.own(user_models.DISC, "Disc")
BENCH = truth.own(user_models.BENCH, "Bench")
CAR = truth.own(user_models.NAMESAKE, "Car")


def added(source, *texts, values=None, name=None):
    return extend(source, [parse_addition(t, source) for t in texts], values=values, name=name)


def step_response(model, outputs, inputs, start, **values):
    """Simulated outputs, (n, ny), from an initial state by the user's names of the states."""
    dae = model.dae
    shooting = Shooting(dae, outputs, ())
    known = {name: dae.parameter_values[name] for name in shooting.parameter_names}
    for name, value in values.items():
        assert model.flat_name(name) in known, (name, sorted(known))
        known[model.flat_name(name)] = value
    p = shooting.parameter_vector(known)
    names = [model.user_name(name) for name in shooting.state_names]
    x0 = np.array([start.get(name, 0.0) for name in names])
    columns = shooting.inputs_with_delays(inputs.reshape(-1, 1), 1e-3, p)
    return shooting.run(x0, columns, p, 1e-3).outputs


CASES = {
    "flange effect": (PENDULUM, ["CoulombFriction@joint,tau_c=0.2"]),
    "two flange effects": (PENDULUM, ["CoulombFriction@joint,tau_c=0.2", "CubicSpring@joint,k3=3"]),
    "input effect": (PENDULUM, ["DeadZone@tau,w=0.1"]),
    "output effect": (PENDULUM, ["Offset@theta,b=0.05"]),
    "two in series": (PENDULUM, ["Gain@tau,k=0.1", "Delay@tau,T=0.01"]),
    "both kinds": (PENDULUM, ["CoulombFriction@joint,tau_c=0.2", "Gain@tau,k=0.1"]),
    "bare connector": (DISC, ["CoulombFriction@shaft,tau_c=0.2"]),
    "bare connector and series": (DISC, ["QuadraticDrag@shaft,c=0.1", "Offset@phi,b=0.1"]),
    "composed model": (BENCH, ["CoulombFriction@load.flange_b,tau_c=0.2"]),
    "composed model in series": (BENCH, ["CoulombFriction@load.flange_b,tau_c=0.2", "Gain@i,k=1"]),
    "a component called plant": (CAR, ["ViscousFriction@plant.joint.flange", "Gain@tau,k=0.5"]),
}
# What a component's point holds is one level too deep to be connected to.
del CASES["a component called plant"]
CASES["a component called plant"] = (CAR, ["Gain@tau,k=0.5"])


@pytest.mark.parametrize("case", CASES)
def test_what_is_written_loads_and_a_second_parser_reads_it(case):
    source, texts = CASES[case]
    model = added(source, *texts)
    assert pymoca.parser.parse(model.source.text) is not None
    before, after = load(source), model.dae
    assert [v.name for v in after.inputs] == [v.name for v in before.inputs]
    assert [v.name for v in after.outputs] == [v.name for v in before.outputs]
    assert [v.unit for v in after.outputs] == [v.unit for v in before.outputs]
    # Every parameter of the user is there, tunable, under a name that leads back to his.
    for parameter in before.parameters:
        if parameter.name in before.dependent_parameters:
            continue
        flat = model.flat_name(parameter.name)
        assert flat in after.parameter_values
        assert flat not in after.dependent_parameters
        assert model.user_name(flat) == parameter.name
        assert after.parameter_values[flat] == before.parameter_values[parameter.name]
        assert after.variables[flat].tunable
        assert after.variables[flat].known == parameter.known
        assert after.variables[flat].unit == parameter.unit
    for addition in model.additions:
        for name, value in addition.values.items():
            assert after.parameter_values[model.parameter_of(addition, name)] == value


@pytest.mark.parametrize("case", CASES)
def test_names_lead_from_one_extension_to_the_next(case):
    source, texts = CASES[case]
    additions = [parse_addition(t, source) for t in texts]
    small, large = extend(source, additions[:1]), extend(source, additions)
    for name in small.dae.parameter_values:
        if name not in small.dae.dependent_parameters:
            assert flat_name(large, small, name) in large.dae.parameter_values, name


def test_a_flange_effect_is_one_component_and_one_connection():
    model = added(PENDULUM, "CoulombFriction@joint,tau_c=0.2")
    assert model.class_text == (
        'model Pendulum_1 "Pendulum with CoulombFriction@joint"\n'
        "  extends Twinproof.Plants.Pendulum;\n"
        "  Twinproof.Effects.Rotational.CoulombFriction coulombFriction_joint(tau_c = 0.2)\n"
        '    "Dry friction: torque of constant size against the direction of motion";\n'
        "equation\n"
        "  connect(coulombFriction_joint.flange, joint.flange);\n"
        "end Pendulum_1;\n"
    )


def test_fitted_values_are_in_the_text():
    model = added(
        PENDULUM, "Gain@tau,k=0.125", values={"J": 0.25, "theta_start": 0.5}, name="Fitted"
    )
    values = model.dae.parameter_values
    assert values["J"] == 0.25
    assert values["theta_start"] == 0.5
    assert values["gain_tau.k"] == 0.125
    assert "model Fitted" in model.source.text
    assert "0.185" not in model.class_text


@pytest.mark.parametrize("texts", [[], ["CoulombFriction@load.flange_b"], ["Gain@i"]])
def test_fitted_values_of_components_are_in_the_text(texts):
    model = added(BENCH, *texts, values={"load.J": 0.4, "motor.k": 0.75}, name="Fitted")
    assert pymoca.parser.parse(model.source.text) is not None
    values = model.dae.parameter_values
    assert values[model.flat_name("load.J")] == 0.4
    assert values[model.flat_name("motor.k")] == 0.75
    assert model.flat_name("load.J") not in model.dae.dependent_parameters


@pytest.mark.parametrize("texts", [[], ["CoulombFriction@load.flange_b"], ["Gain@i"]])
def test_a_start_without_parameter_is_written_too(texts):
    model = added(BENCH, *texts, values={"load.phi.start": 0.9, "load.w.start": -2.0})
    dae = model.dae
    starts = {model.user_name(v.name): dae.number(v.start, 0.0) for v in dae.states}
    assert sorted(starts.values()) == [-2.0, 0.9]


@pytest.mark.parametrize("texts", [[], ["CoulombFriction@load.flange_b"], ["Gain@i"]])
def test_the_state_that_a_fit_found_is_the_start_of_what_is_written(texts):
    """The state is called after the output, its start belongs to a component."""
    model = added(BENCH, *texts)
    n = 200
    problem = truth.problem(BENCH, np.zeros(n), np.zeros(n), 1e-3, names=("angle",))
    problem = transfer_problem(problem, model, problem.values, extend(BENCH, []))
    experiment = Experiment.of(problem)
    x0 = np.arange(1.0, 1.0 + experiment.shooting.nx) / 4
    values = {model.user_name(k): v for k, v in start_values(experiment, x0).items()}
    dae = added(BENCH, *texts, values=values).dae
    assert [dae.number(v.start, 0.0) for v in dae.states] == x0.tolist()


def test_starts_are_written_by_parameter_where_there_is_one():
    problem = truth.pendulum_problem(1.0)
    experiment = Experiment.of(problem)
    x0 = np.array([0.1, 0.2])
    order = {name: k for k, name in enumerate(experiment.shooting.state_names)}
    assert start_values(experiment, x0) == {
        "theta_start": x0[order["theta"]],
        "omega_start": x0[order["omega"]],
    }


@pytest.mark.parametrize("texts", [[], ["CoulombFriction@joint"], ["FirstOrderLag@tau"]])
def test_an_absent_effect_changes_nothing(texts):
    inputs = truth.swing(1000, 1e-3)
    start = {"theta": 0.4, "omega": -0.5}
    plain = truth.held(truth.pendulum_rates(), [0.4, -0.5], inputs, 1e-3)
    found = step_response(added(PENDULUM, *texts), ("theta", "omega"), inputs, start)
    np.testing.assert_allclose(found, plain, atol=1e-8)


def test_series_and_flange_effects_do_what_their_laws_say():
    """Gain, dead zone and offset in series with friction and a spring: against DOP853."""
    inputs = truth.swing(1000, 1e-3)
    model = added(
        PENDULUM,
        "ViscousFriction@joint,d=0.03",
        "CubicSpring@joint,k3=0.8",
        "Gain@tau,k=0.25",
        "DeadZone@tau,w=0.2",
        "Offset@theta,b=0.125",
    )

    def rates(_, x, torque):
        torque = 1.25 * torque
        torque = np.sign(torque) * max(abs(torque) - 0.2, 0.0)
        return [
            x[1],
            (torque - 3.61 * np.sin(x[0]) - 0.036 * x[1] - 0.8 * x[0] ** 3) / 0.185,
        ]

    states = truth.held(rates, [0.4, -0.5], inputs, 1e-3)
    found = step_response(model, ("theta", "omega"), inputs, {"theta": 0.4, "omega": -0.5})
    np.testing.assert_allclose(found, states + np.array([0.125, 0.0]), atol=1e-7)


def test_effects_on_composed_and_bare_models_do_what_their_laws_say():
    inputs = truth.swing(800, 1e-3)
    bare = added(DISC, "ViscousFriction@shaft,d=0.3")
    composed = added(BENCH, "ViscousFriction@load.flange_b,d=0.3", "Gain@i,k=0.5")

    for model, outputs, start, J, scale in (
        (bare, ("phi",), {"phi": 0.5}, 0.2, 1.0),
        (composed, ("angle",), {"angle": 0.5}, 0.25, 0.75),
    ):
        names = [model.user_name(v.name) for v in model.dae.states]
        assert set(start) <= set(names), names
        states = truth.held(
            lambda _, x, u, J=J, scale=scale: [x[1], (scale * u - 0.3 * x[1]) / J],
            [0.5, 0.0],
            inputs,
            1e-3,
        )
        found = step_response(model, outputs, inputs, start)
        np.testing.assert_allclose(found[:, 0], states[:, 0], atol=1e-8)


def test_a_users_own_effect_is_added_in_his_file():
    source = truth.own(user_models.OWN_EFFECT + user_models.DISC, "Disc")
    model = added(source, "Ratchet@shaft,tau_r=0.1")
    assert model.source.text.startswith(source.text.rstrip())
    assert pymoca.parser.parse(model.source.text) is not None
    assert model.dae.parameter_values["ratchet_shaft.tau_r"] == 0.1


def test_a_users_library_is_used_without_python(tmp_path):
    source = truth.library_class("Twinproof.Plants.Pendulum", (user_models.library(tmp_path),))
    model = added(source, "Cogging@joint,a=0.1", "Square@theta,q=0.01")
    assert pymoca.parser.parse(model.source.text) is not None
    values = model.dae.parameter_values
    assert values[model.flat_name("cogging_joint.a")] == 0.1


def test_an_extension_can_be_extended_by_the_same_effect_again():
    """What `extend` wrote is a user's model like any other."""
    first = added(PENDULUM, "CoulombFriction@joint,tau_c=0.2")
    second = added(first.source, "CoulombFriction@joint,tau_c=0.3", "Gain@tau,k=0.1")
    again = added(second.source, "Gain@tau,k=0.2")
    found = step_response(again, ("theta",), truth.swing(500, 1e-3), {})
    once = added(PENDULUM, "CoulombFriction@joint,tau_c=0.5", "Gain@tau,k=0.32")
    expected = step_response(once, ("theta",), truth.swing(500, 1e-3), {})
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_users_class_may_be_called_as_our_nested_one():
    source = truth.own(user_models.BENCH.replace("Bench", "Plant"), "Plant")
    model = added(source, "CoulombFriction@load.flange_b,tau_c=0.2", "Gain@i,k=0.1")
    assert pymoca.parser.parse(model.source.text) is not None
    assert model.dae.parameter_values[model.flat_name("load.J")] == 0.25


def test_user_names_keep_a_component_called_plant():
    plain, wrapped = extend(CAR, []), added(CAR, "Gain@tau,k=0.5")
    for model in (plain, wrapped):
        names = {model.user_name(v.name) for v in model.dae.parameters}
        assert "plant.J" in names
        assert "J" not in names
        assert model.flat_name("plant.J") in model.dae.parameter_values


def test_other_kinds_of_parameters_stay_as_they_are():
    source = truth.own(
        """model A
          parameter Integer n = 2 "Teeth"; parameter Boolean lit = true;
          parameter Real k = 3; final parameter Real c = 2 * k;
          input Real u; output Real y(start = 0, fixed = true);
        equation
          der(y) = n * c * u - (if lit then y else 0.0);
        end A;"""
    )
    model = added(source, "Gain@u,k=0.5")
    assert pymoca.parser.parse(model.source.text) is not None
    found = step_response(model, ("y",), np.ones(1000), {}, k=1.0)
    np.testing.assert_allclose(found[-1, 0], 2 * 2 * 1.5 * (1 - np.exp(-0.999)), rtol=1e-6)


def test_the_diff_is_what_was_typed():
    model = added(DISC, "Gain@u,k=0.5")
    lines = text_diff(DISC, model).splitlines()
    assert lines[0].startswith("--- Disc.mo")
    assert lines[1].startswith("+++ Disc_1.mo")
    assert not [line for line in lines[2:] if line.startswith("-")]
    new = "\n".join(line[1:] for line in lines[2:] if line.startswith("+"))
    assert new.strip() == model.class_text.strip()


@pytest.mark.parametrize(
    ("text", "error", "hint"),
    [
        ("CoulombFriction@jont", UnknownNameError, "did you mean joint"),
        ("ColoumbFriction@joint", UnknownNameError, "CoulombFriction"),
        ("CoulombFriction@tau", UnknownNameError, "unknown signal effect"),
        ("CoulombFriction@joint,tauc=3", UnknownNameError, "did you mean tau_c"),
        ("CoulombFriction@joint,tau_c=three", InputError, "write a number"),
        ("CoulombFriction@joint,tau_c=nan", InputError, "write a number"),
        ("CoulombFriction@joint,tau_c", InputError, "write a number"),
        ("CoulombFriction", InputError, "EFFECT@PLACE"),
    ],
)
def test_additions_that_mean_nothing_are_refused(text, error, hint):
    with pytest.raises(error) as caught:
        parse_addition(text, PENDULUM)
    assert hint in str(caught.value)
    assert caught.value.exit_status == 2
