"""The hidden-effects benchmark's own simulator and figures, against facts it does not contain."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binomtest

from benchmarks.hidden_effects.baselines import side_by_side
from benchmarks.hidden_effects.cases import Case, cases
from benchmarks.hidden_effects.detectability import DETECTABLE, log_likelihood_ratio
from benchmarks.hidden_effects.library import candidates, given
from benchmarks.hidden_effects.plants import DRIVE, OSCILLATOR, PENDULUM, PLANTS
from benchmarks.hidden_effects.simulation import SAMPLE, Hidden, simulate, windows
from benchmarks.hidden_effects.table import interval
from fmus.package import cached_fmu
from fmus.plant import Plant
from fmus.sources import find_source

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "benchmarks" / "hidden_effects" / "models"
# State names as the Modelica classes have them, in the order of the NumPy equations.
STATES = {
    "wheeled pendulum": ("theta_w", "theta_p", "omega_w", "omega_p"),
    "positioner": ("q", "v"),
    "pendulum": ("theta", "omega"),
    "balancing robot": ("theta_b", "theta_m", "omega_b", "omega_m"),
    "rotary pendulum": ("alpha", "beta", "omega_alpha", "omega_beta"),
    "oscillator": ("s", "v"),
    "two-mass drive": ("phi_1", "phi_2", "w_1", "w_2"),
}


def test_undamped_oscillator_against_its_solution():
    mass, stiffness = np.array([2.0, 0.5]), np.array([180.0, 50.0])
    start, push = np.array([[0.03, -0.01], [0.2, 0.4]]), 3.0
    p = {"m": mass, "k": stiffness, "d": np.zeros(2)}
    x = windows(OSCILLATOR, p, start, np.full((1000, 2), push))
    t = SAMPLE * np.arange(1000)[:, None]
    omega, rest = np.sqrt(stiffness / mass), push / stiffness
    swing = (start[0] - rest) * np.cos(omega * t) + start[1] / omega * np.sin(omega * t)
    assert np.max(np.abs(x[:, 0] - rest - swing)) < 1e-9


def test_energy_is_kept_without_damping():
    p = {"J": 0.185, "mgl": 3.61, "d": 0.0}
    x = windows(PENDULUM, p, np.array([[2.5], [1.0]]), np.zeros((2000, 1)))
    energy = 0.5 * p["J"] * x[:, 1] ** 2 - p["mgl"] * np.cos(x[:, 0])
    assert np.ptp(energy) < 1e-8

    p = {"J1": 0.02, "J2": 0.06, "k": 15.0, "d": 0.0, "d1": 0.0, "d2": 0.0}
    x = windows(DRIVE, p, np.array([[0.3], [0.0], [1.0], [2.0]]), np.zeros((2000, 1)))
    kinetic = 0.5 * (p["J1"] * x[:, 2] ** 2 + p["J2"] * x[:, 3] ** 2)
    assert np.ptp(kinetic + 0.5 * p["k"] * (x[:, 0] - x[:, 1]) ** 2) < 1e-6


@pytest.mark.parametrize("name", PLANTS)
def test_equations_are_those_of_the_modelica_class(name):
    plant = PLANTS[name]
    library = plant.model.startswith("Twinproof.")
    source = find_source(plant.model if library else f"{MODELS / plant.model}.mo:{plant.model}")
    # Slow at first, so that rounded dry friction is felt.
    start = np.array([0.2, -0.15, -0.05, -0.4])[: plant.states]
    command, count = 0.4 * plant.command_scale, 50
    begins = {f"{state}_start": v for state, v in zip(STATES[name], start, strict=True)}
    with Plant(cached_fmu(source), parameters={**plant.parameters, **begins}) as fmu:
        outputs = [state for state in STATES[name] if state in fmu.outputs]
        fmu.set({plant.command[0]: command})
        fmu.step(count * SAMPLE)
        theirs = fmu.read()
    p = {k: np.array([v]) for k, v in plant.parameters.items()}
    x = windows(plant, p, start[:, None], np.full((count + 1, 1), command))[:, :, 0]
    assert outputs
    for output in outputs:
        row = STATES[name].index(output)
        moved = np.ptp(x[:, row])
        assert theirs[output] == pytest.approx(x[-1, row], abs=1e-4 * moved)


def test_hidden_drag_against_scipy():
    hidden = [Hidden("QuadraticDrag", "mass", 0.5)]
    p, f = OSCILLATOR.parameters, OSCILLATOR.flanges["mass"]
    run = simulate(OSCILLATOR, p, hidden, excitation="rich", noise=0.0, seed=3, duration=1.0)

    def rates(t, x):
        # A record's command holds from its sample on.
        u = run.command[min(int(t / SAMPLE + 1e-9), len(run.command) - 1)]
        w = x[1] / f.speed_scale
        drag = -0.5 * f.force_scale * 0.7 * w * abs(w) ** 0.9
        return [x[1], (u - p["k"] * x[0] - p["d"] * x[1] + drag) / p["m"]]

    there = solve_ivp(rates, (0.0, 1.0), [0.0, 0.0], rtol=1e-8, atol=1e-10, max_step=SAMPLE)
    assert run.states[-1] == pytest.approx(there.y[:, -1], abs=1e-5)
    without = simulate(OSCILLATOR, p, [], excitation="rich", noise=0.0, seed=3, duration=1.0)
    assert abs(without.states[-1] - run.states[-1]).max() > 1e-3


def test_nothing_is_not_detectable_and_friction_is():
    p = {k: 1.1 * v for k, v in OSCILLATOR.parameters.items()}
    nats = [
        log_likelihood_ratio(
            OSCILLATOR,
            p,
            simulate(OSCILLATOR, p, hidden, excitation="rich", noise=1.0, seed=5, duration=3.0),
            1.0,
        )
        for hidden in ([], [Hidden("CoulombFriction", "mass", 0.1)])
    ]
    assert nats[0] == pytest.approx(0.0, abs=1e-3)
    assert nats[1] > DETECTABLE


@pytest.mark.parametrize(("successes", "trials"), [(0, 300), (3, 300), (57, 60), (60, 60), (1, 2)])
def test_interval_is_scipys(successes, trials):
    exact = binomtest(successes, trials).proportion_ci(0.95, "exact")
    assert interval(successes, trials) == pytest.approx((exact.low, exact.high), abs=1e-12)


def test_every_law_of_the_baselines_is_in_the_library():
    effects = {path.stem for path in (ROOT / "modelica" / "Twinproof" / "Effects").rglob("*.mo")}
    for plant in PLANTS.values():
        case = Case("", "noise", plant.name, (), "rich", 1.0, 0.0, 1)
        run = simulate(
            plant, plant.parameters, [], excitation="rich", noise=1.0, seed=1, duration=0.2
        )
        g = given(case, run)
        assert g.parameters.keys() == plant.parameters.keys()
        found = candidates(g, run.states.T, run.command, run.time)
        assert {c.label.split("@")[0] for c in found} <= effects
        assert {c.place for c in found} == {*plant.flanges, plant.command[0]}


def test_methods_are_compared_on_the_cases_that_all_answered():
    ones = [c for c in cases() if c.group == "one" and c.hidden[0].effect == "DeadZone"][:2]
    lag = next(c for c in cases() if c.group == "one" and c.hidden[0].effect == "Delay")
    nothing = next(c for c in cases() if c.group == "noise")

    def row(case, point, first="x", trouble=""):
        return {
            "name": case.name,
            "group": case.group,
            "nats": 9.0 if case.hidden else 0.0,
            "first": first,
            "point": point,
            "seconds": 2.0,
            "trouble": trouble,
        }

    one = [row(ones[0], 1.0), row(ones[1], 0.0), row(lag, 0.0), row(nothing, 0.0, "")]
    other = [row(ones[0], 1.0), row(ones[1], 0.0, trouble="no"), row(lag, 1.0), row(nothing, 0.0)]
    lines = side_by_side({"a": one, "b": other}).splitlines()
    assert "| 2 | 50.0 %" in lines[2]
    assert "100.0 %" in lines[2]
    assert lines[3].count("100.0 % (") == 2
    assert "| 1 | 0.0 %" in lines[4]
    assert "| 100.0 %" in lines[4]
    assert lines[-1] == "- b: 4 cases worked, 1 without an answer"
