"""An effect that appeared is added to the model, fitted, verified and followed."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scripted import Script, drift, event, evidence_for
from test_monitor import House

from fmus.frontend import load
from fmus.sources import find_source
from hil.plants import Fit
from twin.events import EventKind
from twin.excerpt import Excerpt
from twin.improvement import Improved, Improvement, improve, with_model
from twin.verification import file_hash, improved

PENDULUM = "Twinproof.Plants.Pendulum"


def swinging(seconds=12.0, h=0.01, friction=0.25, seed=4):
    """A pendulum with Coulomb friction, integrated here, by our own equations."""
    rng = np.random.default_rng(seed)
    fine = 20
    n = round(seconds / h)
    t = h * np.arange(n)
    u = 1.2 * np.sin(1.3 * t) + 1.0 * np.sin(3.1 * t + 1)
    angle = rate = 0.0
    y = np.empty((n, 2))
    for k in range(n):
        y[k] = angle, rate
        for _ in range(fine):
            torque = u[k] - 0.1 * rate - 2.0 * np.sin(angle) - friction * np.tanh(rate / 0.05)
            rate += h / fine * torque / 0.5
            angle += h / fine * rate
    return u[:, None], y + rng.standard_normal((n, 2)) * [1e-3, 1e-2]


def wanted(folder):
    inputs, outputs = swinging()
    values = dict(load(find_source(PENDULUM)).parameter_values)
    data = Excerpt(
        PENDULUM,
        (),
        0.01,
        inputs,
        outputs,
        ("theta", "omega"),
        np.array([1e-3, 1e-2]),
        ("J", "mgl", "d"),
        {**values, "J": 0.5, "mgl": 2.0, "d": 0.1},
    )
    return Improvement(data, "CoulombFriction@joint", {"tau_c": 0.2}, folder)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return improve(wanted(tmp_path_factory.mktemp("models")))


def test_the_effect_is_fitted_beside_the_parameters(found):
    truth = {"J": 0.5, "mgl": 2.0, "d": 0.1, "coulombFriction_joint.tau_c": 0.25}
    assert set(found.names) == set(truth)
    sd = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    for name, value in truth.items():
        # Our integration is a simple one, and no model of the library.
        assert abs(found.values[name] - value) < max(5 * sd[name], 0.02 * abs(value)), name
    text = Path(found.model.partition(":")[0]).read_text()
    assert "CoulombFriction" in text
    assert "extends Twinproof.Plants.Pendulum" in text


class WithData(Script):
    def __init__(self, settings, start):
        super().__init__(settings, start)
        self.plant = SimpleNamespace(noise_sd=np.array([1e-3, 1e-2]), free=("J", "mgl", "d"))

    @property
    def predictions(self):
        inputs, outputs = swinging(12.0)
        return SimpleNamespace(
            time=self.newest - 12.0 + 0.01 * np.arange(1200),
            inputs=inputs,
            output_names=("theta", "omega"),
            measured=outputs,
            predicted=outputs,
        )


def test_the_twin_follows_the_improved_model_once_it_is_verified(tmp_path, monkeypatch, found):
    monkeypatch.setattr("test_monitor.Script", WithData)
    house = House(tmp_path)
    house.verified()
    base = house.monitor.settings.plant
    house.monitor.feed([drift(house.clock.now)])
    detail = {"verdict": "effect", "name": "CoulombFriction@joint", "parameters": {"tau_c": 0.2}}
    house.monitor.feed([event(house.clock.now, EventKind.DIAGNOSIS, **detail)])
    assert "effect: CoulombFriction@joint" in house.monitor.decide().because
    house.run(6.0, J=0.6)
    job, _ = house.monitor.next_job()
    assert job.improvement.effect == "CoulombFriction@joint"
    assert job.improvement.effect_values == {"tau_c": 0.2}
    # Of the last 12 s, only the 6 s after the drift are fitted.
    assert len(job.improvement.data.outputs) == pytest.approx(600, abs=2)
    assert len(job.improvement.data.inputs) == len(job.improvement.data.outputs)
    job = improved(job, found)
    assert job.parameters.model not in ("", file_hash(base.fmu))
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    monitor = house.monitor
    assert monitor.settings.plant.model == found.model
    assert monitor.settings.estimator.free == found.names
    assert monitor.in_force[0].values["coulombFriction_joint.tau_c"] == pytest.approx(0.25, rel=0.1)

    def estimate(time):
        house.pipeline.at(time)
        old = house.pipeline.estimate
        house.pipeline.estimate = type(old)(
            time, found.names, dict(found.values), {}, found.covariance, 1.0, {}
        )

    def follow():
        for _ in range(2):
            house.clock.now += 6.0
            estimate(house.clock.now)
            house.monitor.feed([])

    follow()
    assert house.monitor.decide().allowed, house.monitor.decide().because
    # Also after a restart; the settings still name the model without the effect.
    house.kill()
    house.start()
    assert house.monitor.settings.plant.model == found.model
    follow()
    assert house.monitor.decide().allowed, house.monitor.decide().because
    # Rolled back, it is the plain model again.
    house.monitor.roll_back("maria")
    assert house.monitor.settings.plant.model == PENDULUM
    house.kill()


def test_an_effect_is_fitted_to_the_data_wherever_the_estimate_may_be(tmp_path, monkeypatch):
    monkeypatch.setattr("test_monitor.Script", WithData)
    house = House(tmp_path)
    house.verified()
    drifted = house.clock.now
    house.monitor.feed([drift(drifted)])
    detail = {"verdict": "effect", "name": "CoulombFriction@joint", "parameters": {"tau_c": 0.2}}
    house.monitor.feed([event(drifted, EventKind.DIAGNOSIS, **detail)])
    # The filter's estimate is from before the drift, and stays so.
    before = house.pipeline.estimate
    for _ in range(5):
        assert house.monitor.next_job() is None
        house.clock.now += 1.0
        house.pipeline.newest = house.clock.now
        house.monitor.feed([])
    assert house.pipeline.estimate is before
    job, _ = house.monitor.next_job()
    assert job.improvement.effect == "CoulombFriction@joint"
    assert job.parameters.time >= drifted + 5
    house.kill()


def test_an_improved_model_that_is_gone_closes_the_gate(tmp_path, monkeypatch, found):
    monkeypatch.setattr("test_monitor.Script", WithData)
    house = House(tmp_path)
    house.verified()
    house.monitor.feed([drift(house.clock.now)])
    detail = {"verdict": "effect", "name": "CoulombFriction@joint", "parameters": {"tau_c": 0.2}}
    house.monitor.feed([event(house.clock.now, EventKind.DIAGNOSIS, **detail)])
    house.run(6.0, J=0.6)
    job, _ = house.monitor.next_job()
    file = tmp_path / "elsewhere.mo"
    whole, _, name = found.model.partition(":")
    file.write_text(Path(whole).read_text())
    moved = Improved(f"{file}:{name}", found.names, found.values, found.covariance)
    job = improved(job, moved)
    house.monitor.conclude(job, evidence_for(job, house.clock.now))
    house.kill()
    file.unlink()
    house.start()
    assert house.monitor.settings.plant.model == PENDULUM
    house.run(6.0)
    assert "improved model cannot be used" in house.monitor.decide().because
    house.kill()


def test_the_same_buses_and_sensors_serve_the_improved_model(tmp_path, found):
    house = House(tmp_path)
    settings = house.settings.twins[0]
    fit = Fit(found.values, found.names, found.covariance)
    changed = with_model(settings, found.model, fit)
    assert changed.buses[0].dbc.endswith("Pendulum.dbc")
    assert changed.file(changed.buses[0].dbc).is_file()
    assert [p.name for p in changed.plant.outputs] == [p.name for p in settings.plant.outputs]
    house.kill()
