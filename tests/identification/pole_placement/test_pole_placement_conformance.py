"""What every method must do, run on every method there is."""

import numpy as np
import pytest

from foundation.errors import ExcitationError, InputError, UnknownNameError, UnsupportedModelError
from identification.pole_placement import METHODS, Samples, method_of, place
from identification.pole_placement.gains import pole_distance

WANTED = np.array([0.4, 0.6, 0.7])
A = np.array([[1.05, 0.1, 0.0], [0.05, 0.95, 0.1], [0.0, -0.1, 0.8]])
B = np.array([[0.0], [0.05], [0.3]])
FEEDBACK = np.array([[-6.0, -4.0, -1.5]])
ALL = pytest.mark.parametrize("word", METHODS)
ONE_INPUT = {"published", "total-least-squares"}


def linear_run(seed=1, steps=400, *, noise=0.0, process=0.0, a=A, b=B, feedback=FEEDBACK):
    rng = np.random.default_rng(seed)
    n, m = b.shape
    x, u = np.zeros((steps + 1, n)), np.zeros((steps, m))
    y = np.zeros_like(x)
    for k in range(steps + 1):
        y[k] = x[k] + noise * rng.standard_normal(n)
        if k < steps:
            u[k] = feedback @ y[k] + rng.standard_normal(m)
            x[k + 1] = a @ x[k] + b @ u[k] + process * rng.standard_normal(n)
    return Samples(y, u)


def test_there_are_as_many_as_are_told():
    assert len(METHODS) == 8
    assert all(METHODS[word](1).word == word for word in METHODS)


@ALL
@pytest.mark.parametrize("prefilter", [1, 5])
def test_exact_data_give_the_exact_model_and_gain(word, prefilter):
    found = place(linear_run(), WANTED, method=word, prefilter=prefilter)
    np.testing.assert_allclose(found.A, A, atol=2e-6)
    np.testing.assert_allclose(found.B, B, atol=2e-6)
    assert pole_distance(np.linalg.eigvals(A + B @ found.F), WANTED.astype(complex)) < 1e-4
    np.testing.assert_allclose(found.poles, WANTED, atol=1e-6)
    assert found.method == word


@ALL
def test_noise_is_borne_and_its_doubt_told(word):
    # Total least squares of the published form takes every entry to be equally noisy.
    noise = 1e-4 if word in ONE_INPUT else 3e-3
    found = place(linear_run(noise=noise), WANTED, method=word, prefilter=1)
    assert np.max(np.abs(found.A - A)) < 0.05
    covariance = found.covariance
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12 * np.max(covariance))
    assert np.min(np.linalg.eigvalsh(covariance)) > -1e-9 * np.max(covariance)
    for sd in (found.A_sd, found.B_sd, found.poles_sd, found.open_loop_poles_sd):
        assert np.all(sd > 0)
        assert np.all(sd < 0.5)


@ALL
def test_the_same_data_give_the_same_answer(word):
    first, second = (place(linear_run(noise=1e-3, steps=120), WANTED, method=word) for _ in "ab")
    np.testing.assert_array_equal(first.F, second.F)
    np.testing.assert_array_equal(first.covariance, second.covariance)


@ALL
def test_units_do_not_matter(word):
    run = linear_run(noise=1e-3, steps=200)
    scale = np.array([1e3, 1.0, 1e-2])
    other = Samples(run.states * scale, run.inputs * 50.0)
    first = place(run, WANTED, method=word)
    second = place(other, WANTED, method=word)
    if word in ONE_INPUT:
        # The published equation errors are weighted by units, like it or not; the model is near.
        assert np.all(np.isfinite(second.F))
        return
    tolerance = 2e-3 if word in {"auto", "prediction-error"} else 1e-7
    np.testing.assert_allclose(second.F / 50.0 * scale, first.F, rtol=tolerance)


@ALL
def test_too_few_steps_are_refused(word):
    run = linear_run(steps=3)
    with pytest.raises(ExcitationError, match=r"steps"):
        place(run, WANTED, method=word)


@ALL
def test_feedback_without_excitation_is_refused(word):
    run = linear_run(noise=0.0)
    blind = Samples(run.states, run.states[:-1] @ FEEDBACK.T)
    with pytest.raises(ExcitationError, match="u1"):
        place(blind, WANTED, method=word)


@ALL
def test_a_redundant_state_is_refused(word):
    run = linear_run()
    twice = Samples(np.column_stack([run.states, run.states[:, 0] * 2]), run.inputs)
    with pytest.raises(ExcitationError, match="x1, x4"):
        place(twice, [*WANTED, 0.1], method=word)


@ALL
def test_two_inputs(word):
    b = np.column_stack([B, [0.2, 0.0, 0.1]])
    run = linear_run(a=A, b=b, feedback=np.zeros((2, 3)), steps=60)
    if word in ONE_INPUT:
        with pytest.raises(UnsupportedModelError, match="serves one input"):
            place(run, WANTED, method=word)
        return
    found = place(run, WANTED, method=word)
    np.testing.assert_allclose(found.B, b, atol=1e-5)
    assert pole_distance(np.linalg.eigvals(A + b @ found.F), WANTED.astype(complex)) < 1e-3


@ALL
def test_a_prefilter_below_one_is_refused(word):
    with pytest.raises(InputError, match="prefilter of order 0"):
        method_of(word, 0)


def test_an_unknown_method_is_refused_with_the_nearest():
    with pytest.raises(UnknownNameError, match="two-step"):
        method_of("twostep")


def test_few_steps_have_no_standard_deviation_and_say_so():
    found = place(linear_run(steps=6), WANTED, method="two-step")
    assert np.all(np.isinf(found.A_sd))
    assert any("too few" in w for w in found.warnings)
    np.testing.assert_allclose(found.A, A, atol=1e-6)


def test_noise_makes_the_biased_ones_warn():
    run = linear_run(noise=0.1)
    assert any("biases two-step" in w for w in place(run, WANTED, method="two-step").warnings)
    quiet = linear_run(process=0.05)
    assert not any("biases" in w for w in place(quiet, WANTED, method="two-step").warnings)


def test_an_equilibrium_that_is_not_at_zero_makes_a_warning():
    run = linear_run(process=0.02)
    assert not any("equilibrium" in w for w in place(run, WANTED, method="two-step").warnings)
    shifted = Samples(run.states + np.array([0.0, 3.0, 0.0]), run.inputs)
    found = place(shifted, WANTED, method="two-step")
    assert any("the equilibrium is not at zero" in w for w in found.warnings)


def test_little_excitation_makes_a_warning():
    run = linear_run(process=0.05)
    weak = Samples(run.states, run.states[:-1] @ FEEDBACK.T + 1e-5 * run.inputs)
    found = place(weak, WANTED, method="two-step")
    assert any("is a function of the states but for" in w for w in found.warnings)


def test_a_gain_that_may_fail_makes_a_warning():
    run = linear_run(process=2.0, steps=25)
    found = place(run, [0.97, 0.98, 0.96], method="two-step")
    assert any("stabilises" in w for w in found.warnings)


def test_known_noise_is_used():
    """Half the variance said to be process noise: told the truth, prediction error is nearer."""
    errors = {"told": [], "guessed": []}
    for seed in range(3):
        run = linear_run(seed, steps=60, noise=0.2)
        told = Samples(run.states, run.inputs, noise_sd=np.full(3, 0.2))
        errors["told"].append(np.abs(place(told, WANTED, method="prediction-error").A - A).max())
        errors["guessed"].append(np.abs(place(run, WANTED, method="prediction-error").A - A).max())
    assert np.median(errors["told"]) <= 1.05 * np.median(errors["guessed"])
