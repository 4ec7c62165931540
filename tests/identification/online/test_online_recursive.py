"""Recursive estimates against batch ones, sample by sample."""

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1]))
import truth_records as truth

from foundation.errors import ExcitationError, InputError
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.estimators.recursive import Recursive
from identification.online import RecursiveFilter, StreamingRows, Triangles
from identification.regressors import derive

TAU = (0.08, 0.05)


def online(problem, tau=TAU, **options):
    regression = derive(
        problem.dae, free=problem.free, values=problem.values, measured=problem.output_names
    )
    return RecursiveFilter(
        regression,
        problem.output_names,
        problem.values,
        tau=tau,
        sample_time=problem.sample_time,
        **options,
    )


def run(estimator, problem, begin=0, end=None):
    last = None
    for u, y in zip(problem.inputs[begin:end], problem.outputs[begin:end], strict=True):
        last = estimator.update(u.tolist(), y.tolist())
    return last


# --- Triangles ------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 3),
    st.integers(1, 6),
    st.integers(40, 3000),
    st.sampled_from([1.0, 0.9999, 0.99]),
)
def test_triangles_are_the_batchs(seed, equations, unknowns, n, forgetting):
    """Weighted least squares by NumPy on all rows at once, to 1e-8."""
    random = np.random.default_rng(seed)
    rows = random.standard_normal((n, equations, unknowns + 1)) * 10.0 ** random.integers(
        -3, 4, unknowns + 1
    )
    kept = Triangles(equations, unknowns + 1, forgetting=forgetting)
    for row in rows:
        kept.add(row)
    weight = np.sqrt(forgetting) ** np.arange(n)[::-1]
    for i, triangle in enumerate(kept.triangle()):
        ours = np.linalg.solve(triangle[:-1, :-1], triangle[:-1, -1])
        batch = rows[:, i] * weight[:, None]
        theirs = np.linalg.lstsq(batch[:, :-1], batch[:, -1], rcond=None)[0]
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8 * np.max(np.abs(theirs)))
    triangles, counts = kept.blocks(1)
    assert counts.sum() == n == kept.rows
    assert len(triangles) <= 65
    together = np.einsum("bmij,bmik->mjk", triangles, triangles)
    whole = kept.triangle()
    np.testing.assert_allclose(
        together, np.transpose(whole, (0, 2, 1)) @ whole, rtol=1e-9, atol=1e-9 * together.max()
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(40, 900), st.integers(100, 3000))
def test_a_window_holds_the_last_rows_only(seed, memory, n):
    rows = np.random.default_rng(seed).standard_normal((n, 1, 4))
    kept = Triangles(1, 4, memory=memory)
    for row in rows:
        kept.add(row)
    count = kept.rows
    assert min(n, memory) <= count <= memory + memory // 32 + 33
    triangle = kept.triangle()[0]
    window = rows[n - count :, 0]
    np.testing.assert_allclose(triangle.T @ triangle, window.T @ window, atol=1e-9)


@pytest.mark.parametrize("options", [{"forgetting": 0.0}, {"forgetting": 1.5}, {"memory": 5}])
def test_impossible_memories_are_refused(options):
    with pytest.raises(InputError) as caught:
        Triangles(1, 3, **options)
    assert caught.value.remedy


# --- Rows and estimates ---------------------------------------------------------------------------


@pytest.mark.parametrize("outputs", [("theta", "omega"), ("theta",)])
def test_rows_are_the_batchs(outputs):
    problem = truth.noisy(
        truth.pendulum_problem(2.0, 1e-3, outputs=outputs), [1e-3] * len(outputs), 1
    )
    batch = FilteredLeastSquares(tau=TAU).prepare(problem)
    stream = StreamingRows(batch.regression, problem.output_names, TAU, problem.sample_time)
    samples = zip(problem.inputs.tolist(), problem.outputs.tolist(), strict=True)
    rows = np.array([stream.push(u, y) for u, y in samples])
    # The batch extrapolates a slope at the very end.
    expected = np.concatenate([batch.rows.matrix, batch.rows.right[:, :, None]], axis=2)
    np.testing.assert_allclose(
        rows[:-1, :, 2:],
        np.transpose(expected, (1, 0, 2))[:-1],
        atol=1e-10 * np.abs(expected).max(),
    )


@settings(max_examples=12, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(0.02, 0.3),
    st.floats(0.02, 0.3),
    st.integers(1500, 6000),
    st.sampled_from([("theta", "omega"), ("theta",)]),
)
def test_recursive_equals_batch(seed, tau1, tau2, n, outputs):
    clean = PENDULUM[outputs].part(0, n)
    problem = truth.noisy(clean, [2e-3] * len(outputs), seed)
    batch = FilteredLeastSquares(tau=(tau1, tau2)).estimate(problem)
    recursive = Recursive(tau=(tau1, tau2)).estimate(problem)
    for name, value in batch.values.items():
        assert recursive.values[name] == pytest.approx(value, rel=1e-8)
        # Standard deviations come from other sums of the same scores; where the record is shorter
        # than the filter's memory, the recursive ones are the more careful.
        ratio = recursive.parameters[name].sd / batch.parameters[name].sd
        assert ratio > 0.2
        assert ratio < 5 or n * 1e-3 < 40 * (tau1 + tau2)


def test_measured_inputs_run_in_straight_lines_in_both():
    problem = truth.replace(PENDULUM["theta",], measured_inputs=("tau",))
    batch = FilteredLeastSquares(tau=TAU).estimate(problem)
    recursive = Recursive(tau=TAU).estimate(problem)
    held = FilteredLeastSquares(tau=TAU).estimate(PENDULUM["theta",])
    for name, value in batch.values.items():
        assert recursive.values[name] == pytest.approx(value, rel=1e-8)
    assert held.values["J"] != pytest.approx(batch.values["J"], rel=1e-7)


PENDULUM = {
    outputs: truth.pendulum_problem(6.0, 1e-3, outputs=outputs)
    for outputs in (("theta", "omega"), ("theta",))
}


def test_two_coupled_equations_equal_the_batch():
    volts, states = truth.balanced(6.0)
    names = ("theta_w", "theta_p", "omega_p")
    clean = truth.problem(
        truth.library("WheeledPendulum"), volts, states[:, [0, 1, 3]], 1e-3, names=names, wrong=1.3
    )
    problem = truth.noisy(clean, [3e-5, 1e-3, 1e-3], 5)
    batch = FilteredLeastSquares(tau=(0.1, 0.1)).estimate(problem)
    estimator = online(problem, (0.1, 0.1), every=500)
    last = run(estimator, problem)
    solution = estimator.solution()
    for name, value in batch.values.items():
        assert solution.values[name] == pytest.approx(value, rel=1e-8)
        assert last.values[name] == pytest.approx(value, rel=0.02)
        assert 0.2 < last.sd[name] / batch.parameters[name].sd < 5


def test_standard_deviations_are_honest():
    """An unknown force, as in the batch's test; 40 seeds."""
    volts = truth.shuttle(3001, 1e-3)
    states = truth.held(truth.positioner_rates(), [0.01, 0.1], volts, 1e-3)
    hits = []
    for seed in range(40):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(len(volts))
        problem = truth.problem(
            truth.library("Positioner"), volts + noise, states, 1e-3, names=("q", "v"), sd=[0, 0]
        )
        last = run(online(problem, (0.03, 0.03), every=3001), problem)
        for name, value in truth.POSITIONER.items():
            hits.append(abs(last.values[name] - value) <= 2 * last.sd[name])
    assert 0.88 <= np.mean(hits) <= 1.0


def test_what_was_expected_is_compared_with_what_came():
    problem = truth.noisy(PENDULUM["theta", "omega"], [1e-4, 1e-3], 3)
    estimator = online(problem, every=50)
    samples = zip(problem.inputs.tolist(), problem.outputs.tolist(), strict=True)
    seen = [estimator.update(u, y) for u, y in samples]
    assert np.isnan(seen[0].innovation[0])
    assert not seen[0].sd["J"] < np.inf
    late = [abs(e.innovation[0]) / e.innovation_sd[0] for e in seen[3000:]]
    assert 0.5 < np.sqrt(np.mean(np.square(late))) < 2
    assert [e.samples for e in seen] == list(range(1, len(seen) + 1))


# --- Time-varying plants, gaps, memory ------------------------------------------------------------


def changing():
    """The pendulum's friction is twenty times as large in the second half."""
    n = 6001
    torque = truth.swing(2 * n, 1e-3)
    first = truth.held(truth.pendulum_rates(), [0.4, -0.5], torque[:n], 1e-3)
    second = truth.held(truth.pendulum_rates(d=0.12), first[-1], torque[n - 1 :], 1e-3)
    states = np.concatenate([first, second[1:]])
    given = truth.problem(
        truth.library("Pendulum"), torque[: len(states)], states, 1e-3, names=("theta", "omega")
    )
    return truth.noisy(given, [1e-5, 1e-5], 1)


@pytest.mark.parametrize("options", [{"memory": 2.0}, {"forgetting": 0.6}])
def test_forgetting_follows_a_change(options):
    problem = changing()
    last = run(online(problem, every=100, **options), problem)
    assert last.values["d"] == pytest.approx(0.12, rel=0.02)
    slow = run(online(problem, every=100), problem)
    assert abs(slow.values["d"] - 0.12) > 0.02


def test_after_a_gap_the_filter_settles_first():
    problem = truth.noisy(PENDULUM["theta", "omega"], [1e-5, 1e-4], 2)
    outputs = problem.outputs.copy()
    outputs[3000:3100] = np.nan
    last = run(online(problem, every=10), truth.replace(problem, outputs=outputs))
    for name, value in truth.PENDULUM.items():
        assert last.values[name] == pytest.approx(value, rel=5e-3)
    assert last.samples == len(problem.time)


@pytest.mark.parametrize("options", [{}, {"memory": 1.0}, {"forgetting": 1.0}])
def test_memory_is_constant(options):
    problem = PENDULUM["theta", "omega"]
    kept = Triangles(1, 6, memory=options.get("memory") and 1000)
    random = np.random.default_rng(1)
    sizes = []
    for k in range(40_000):
        kept.add(random.standard_normal((1, 6)))
        if k in (9_999, 39_999):
            sizes.append(len(pickle.dumps(kept)))
    assert sizes[1] < 2.2 * sizes[0]  # between 32 and 64 blocks
    estimator = online(problem, every=100, **options)
    run(estimator, problem)
    assert len(estimator._triangles._blocks) <= 64


def test_nothing_seen_is_said():
    problem = PENDULUM["theta",]
    estimator = online(problem)
    with pytest.raises(ExcitationError):
        estimator.solution()
    for _ in range(200):
        last = estimator.update([0.0], [0.0])
    assert all(np.isinf(sd) for sd in last.sd.values())
    assert last.values == {n: problem.values[n] for n in problem.free}
