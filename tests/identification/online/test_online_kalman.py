"""The on-line Kalman filter: against the batch filter, the truth, and what it cannot do."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
import truth_records as truth

from foundation.errors import DivergenceError, InputError, UnsupportedModelError
from identification.innovations import Disturbance, InnovationFilter, with_input_disturbances
from identification.online import OnlineKalman

NOISE = [1e-3, 5e-3]


def problem(seed=1, duration=6.0, **options):
    clean = truth.pendulum_problem(
        duration, 2e-3, outputs=("theta", "omega"), wrong=1.15, **options
    )
    return truth.noisy(clean, NOISE, seed)


def make(given, **options):
    return OnlineKalman(
        given.dae,
        given.output_names,
        options.pop("free", given.free),
        options.pop("values", given.values),
        sample_time=given.sample_time,
        noise_sd=given.noise_sd,
        **options,
    )


def run(estimator, given):
    return [
        estimator.update(u.tolist(), y.tolist())
        for u, y in zip(given.inputs, given.outputs, strict=True)
    ]


def test_without_free_parameters_it_is_the_batch_filter():
    given = problem()
    dae, names = with_input_disturbances(given.dae)
    batch = InnovationFilter(dae, given.output_names, names)
    disturbance = [Disturbance(2.0, 0.05)]
    online = make(given, free=(), disturbances=disturbance)
    seen = run(online, given)
    first = given.outputs[0]
    p = batch.parameter_vector({**given.values, names[0]: 0.0})
    expected = batch.filter(
        first,
        (3 * given.noise_sd) ** 2,
        given.inputs,
        given.outputs,
        p,
        given.sample_time,
        given.noise_sd,
        disturbance,
        track=True,
    )
    np.testing.assert_allclose(
        [e.innovation for e in seen], expected.innovations, rtol=1e-9, atol=1e-13
    )
    np.testing.assert_allclose([e.innovation_sd**2 for e in seen], expected.variances, rtol=1e-9)
    ours = [*(v for v, _ in online.states.values()), online.disturbances["tau"][0]]
    np.testing.assert_allclose(ours, expected.means[-1], rtol=1e-9, atol=1e-13)


def test_the_truth_is_within_its_standard_deviations():
    hits, last = [], None
    for seed in range(16):
        given = problem(seed)
        last = run(make(given), given)[-1]
        for name, value in truth.PENDULUM.items():
            hits.append(abs(last.values[name] - value) <= 2 * last.sd[name])
    assert 0.85 <= np.mean(hits) <= 1.0
    assert last.sd["J"] < 0.01 * truth.PENDULUM["J"]


def test_innovations_are_white_and_of_the_size_predicted():
    seen = run(make(given := problem(3)), given)[500:]
    ratio = np.array([e.innovation / e.innovation_sd for e in seen])
    assert np.mean(ratio**2, axis=0) == pytest.approx([1, 1], abs=0.15)
    assert abs(np.mean(ratio[1:, 0] * ratio[:-1, 0])) < 0.1


def test_a_disturbance_is_seen_and_does_not_bias():
    """Half a newton metre pushes from 3 s on; without a disturbance state parameters give way."""
    n = 3001
    torque = truth.swing(n, 2e-3)
    push = np.where(np.arange(n) > 1500, 0.5, 0.0)
    states = truth.held(truth.pendulum_rates(), [0.4, -0.5], torque + push, 2e-3)
    clean = truth.problem(
        truth.library("Pendulum"), torque, states, 2e-3, names=("theta", "omega"), wrong=1.1
    )
    given = truth.noisy(clean, NOISE, 4)
    filter_ = make(given, disturbances=[Disturbance(0.5, 0.3)])
    last = run(filter_, given)[-1]
    value, sd = filter_.disturbances["tau"]
    assert abs(value - 0.5) < 3 * sd < 0.3
    for name, true in truth.PENDULUM.items():
        assert abs(last.values[name] - true) < 3.5 * last.sd[name]
    blind = run(make(given), given)[-1]
    off = [abs(blind.values[n] - v) / blind.sd[n] for n, v in truth.PENDULUM.items()]
    assert max(off) > 10


def test_missing_measurements_are_bridged():
    given = problem(5)
    outputs = given.outputs.copy()
    outputs[1000:1200] = np.nan
    outputs[2000:, 1] = np.nan
    seen = run(make(given), truth.replace(given, outputs=outputs))
    assert np.all(np.isnan(seen[1100].innovation))
    assert np.isnan(seen[2500].innovation[1])
    assert np.isfinite(seen[2500].innovation[0])
    for name, true in truth.PENDULUM.items():
        assert abs(seen[-1].values[name] - true) < 3.5 * seen[-1].sd[name]


def test_drift_keeps_the_filter_awake():
    """Friction rises twentyfold half-way."""
    n = 6001
    torque = truth.swing(n, 2e-3)
    first = truth.held(truth.pendulum_rates(d=0.05), [0.4, -0.5], torque[:3001], 2e-3)
    second = truth.held(truth.pendulum_rates(d=0.4), first[-1], torque[3000:], 2e-3)
    states = np.concatenate([first, second[1:]])
    clean = truth.problem(
        truth.library("Pendulum"), torque, states, 2e-3, names=("theta", "omega"), wrong=1.0
    )
    given = truth.noisy(clean, NOISE, 6)
    prior = {"d": 0.1, "J": 0.001, "mgl": 0.01}
    awake = run(make(given, drift=0.3, prior_sd=prior), given)[-1]
    asleep = run(make(given, drift=0.0, prior_sd=prior), given)[-1]
    assert abs(awake.values["d"] - 0.4) < 0.05
    assert abs(asleep.values["d"] - 0.4) > 0.1


def test_wrong_signs_end_in_an_error_or_in_innovations_that_shout():
    given = truth.replace(problem(7), inputs=-problem(7).inputs)
    try:
        seen = run(make(given), given)
    except DivergenceError as error:
        remedy = error.remedy
    else:
        remedy = ""
    if remedy:
        assert "sign" in remedy
        return
    ratio = np.array([e.innovation / e.innovation_sd for e in seen[500:]])
    assert np.max(np.mean(ratio**2, axis=0)) > 10


def test_what_it_cannot_do_is_said():
    given = problem()
    with pytest.raises(InputError, match="noise") as caught:
        make(truth.replace(given, noise_sd=np.array([1e-3, np.nan])))
    assert caught.value.remedy
    with pytest.raises(InputError, match="disturbances"):
        make(given, disturbances=[Disturbance(1, 1)] * 2)
    delayed = truth.own(
        "model A parameter Real T = 0.1; input Real u; output Real x(start = 0, fixed = true); "
        "equation der(x) = delay(u, T) - x; end A;"
    )
    with pytest.raises(UnsupportedModelError, match="delays") as caught:
        OnlineKalman(
            truth.load(delayed),
            ["x"],
            [],
            truth.load(delayed).parameter_values,
            sample_time=1e-3,
            noise_sd=[1e-3],
        )
    assert "lag" in caught.value.remedy
