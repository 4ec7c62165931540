"""Output error over several records at once: against SciPy's simulations and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import truth_records as truth

import twinproof
from foundation.errors import ChannelError, InputError
from identification.estimators import ESTIMATORS
from identification.estimators.output_error import OutputError
from recordings import Channel, Recording

SWUNG = truth.own(
    """model A "A swing with gravity and a spring on a frame that can be turned"
      parameter Real J = 0.2 annotation(__twinproof(known = true));
      parameter Real mgl = 2.6; parameter Real k = 4.2; parameter Real d = 0.06;
      input Real tau; input Real frame;
      output Real theta(start = 0, fixed = true); Real omega(start = 0, fixed = true);
    equation
      der(theta) = omega;
      J * der(omega) = tau - mgl * sin(theta + frame) - k * theta - d * omega;
    end A;"""
)
TRUE = {"mgl": 2.0, "k": 5.0, "d": 0.05}


def swing(frame, *, step, sd, seed):
    """Small swings, so that one frame shows only k + mgl·cos(frame)."""
    t = np.arange(round(6.0 / step)) * step
    torque = 0.05 * np.sin(4 * t) + 0.05 * np.sin(7.3 * t)

    def rates(_, x, u):
        gravity = TRUE["mgl"] * np.sin(x[0] + frame)
        return [x[1], (u - gravity - TRUE["k"] * x[0] - TRUE["d"] * x[1]) / 0.2]

    theta = truth.held(rates, [0.01, 0.0], torque, step)[:, 0]
    noisy = theta + sd * np.random.default_rng(seed).standard_normal(len(t))
    inputs = np.column_stack([torque, np.full(len(t), frame)])
    return truth.problem(SWUNG, inputs, noisy, step, names=("theta",))


def pair():
    upright = swing(0.0, step=5e-3, sd=1e-4, seed=1)
    return upright, swing(np.pi, step=1e-2, sd=4e-4, seed=2)


def test_two_records_tell_what_neither_alone_can():
    upright, hanging = pair()
    for alone in (upright, hanging):
        estimate = OutputError().estimate(alone)
        assert any("cannot be told apart" in w for w in estimate.warnings), estimate.warnings
    together = OutputError().estimate_together([upright, hanging])
    assert together.warnings == ()
    for name, value in TRUE.items():
        found = together.parameters[name]
        assert abs(found.value - value) < 4 * found.sd, name
        assert found.sd < 0.05 * value, name


def test_every_record_has_its_own_weights_and_initial_states():
    fit = OutputError().estimate_together(pair()).details["fit"]
    np.testing.assert_allclose(fit.sd, [1e-4, 4e-4], rtol=0.1)
    assert fit.x0.shape == (12, 2)
    assert [len(r) for r in fit.at.residuals] == [200] * 6 + [100] * 6
    # Both begin where the truth was let go.
    np.testing.assert_allclose(fit.x0[[0, 6], 0], 0.01, atol=1e-3)


def test_the_order_of_records_does_not_matter():
    upright, hanging = pair()
    one = OutputError().estimate_together([upright, hanging])
    other = OutputError().estimate_together([hanging, upright])
    for name in TRUE:
        assert one.values[name] == pytest.approx(other.values[name], rel=1e-5)
        assert one.parameters[name].sd == pytest.approx(other.parameters[name].sd, rel=1e-3)


def recording(problem, origin):
    inputs = zip(problem.dae.inputs, problem.inputs.T, strict=True)
    channels = [Channel(v.name, column) for v, column in inputs]
    outputs = zip(problem.output_names, problem.outputs.T, strict=True)
    channels += [Channel(name, column) for name, column in outputs]
    return Recording(problem.time, {c.name: c for c in channels}, origin)


def test_from_python_every_record_is_reported():
    upright, hanging = pair()
    model = twinproof.Model("A", SWUNG)
    found = twinproof.identify(model, [recording(upright, "up"), recording(hanging, "down")])
    assert found.estimate.method == "output-error"
    assert [r.origin for r in found.records] == ["up", "down"]
    errors = [r.comparison.channels["theta"].rmse for r in found.records]
    np.testing.assert_allclose(errors, [1e-4, 4e-4], rtol=0.2)
    expected = OutputError().estimate_together([upright, hanging])
    for name in TRUE:
        assert found.estimate.values[name] == pytest.approx(expected.values[name], rel=1e-6)


@pytest.mark.parametrize("method", sorted(set(ESTIMATORS) - {"auto", "output-error"}))
def test_other_methods_refuse_several_records(method):
    upright, hanging = pair()
    model = twinproof.Model("A", SWUNG)
    records = [recording(upright, "up"), recording(hanging, "down")]
    with pytest.raises(InputError, match=r"one recording.*--method output-error"):
        twinproof.identify(model, records, method=method)


def test_a_record_that_is_given_twice_is_refused():
    record = recording(pair()[0], "up")
    with pytest.raises(InputError, match="given twice"):
        twinproof.identify(twinproof.Model("A", SWUNG), [record, record])


def test_records_with_other_channels_are_refused():
    both = truth.pendulum_problem(2.0, outputs=("theta", "omega"))
    angle = replace(both, outputs=both.outputs[:, :1] + 0.0, output_names=("theta",))
    angle = replace(angle, noise_sd=both.noise_sd[:1])
    with pytest.raises(ChannelError, match=r"\(theta against theta, omega\); map the same"):
        OutputError().estimate_together([both, angle])
