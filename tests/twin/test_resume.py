"""A pipeline that is taken up elsewhere goes on as if nothing had been."""

import pickle

import numpy as np
import pytest

from tests.twin import pendulum_bus as bus
from twin.pipeline import Pipeline

SECONDS, STEP = 16.0, 60


def heavier(time):
    return {"J": 1.4 * bus.TRUE["J"]} if time > 8.0 else {}


@pytest.fixture(scope="module")
def frames():
    return bus.frames(bus.motion(SECONDS, seed=5, change=heavier))


def test_a_snapshot_at_any_moment_goes_on_the_same(tmp_path, frames):
    settings = bus.diagnosing(tmp_path)
    check(settings, frames, (0, 1111, 2750))


def test_so_does_the_output_filter(tmp_path, frames):
    settings = bus.twin(tmp_path, 'kind = "output-filter"')
    check(settings, frames, (1111,))


def check(settings, frames, cuts):
    whole = Pipeline(settings)
    events = run(whole, frames, 0, len(frames))
    first, begun = Pipeline(settings), 0
    found = []
    for cut in cuts:
        found += run(first, frames, begun, cut)
        other = Pipeline(settings)
        other.resume(pickle.loads(pickle.dumps(first.snapshot())))
        first, begun = other, cut
    found += run(first, frames, begun, len(frames))
    assert found == events
    assert {e.kind.value for e in events} >= {"parameters", "drift"}
    assert first.estimate.values == whole.estimate.values
    assert first.estimate.moved == whole.estimate.moved > 0
    assert np.array_equal(first.estimate.covariance, whole.estimate.covariance)
    assert first.drift == whole.drift
    assert first.health == whole.health
    assert np.array_equal(first.predictions.predicted, whole.predictions.predicted, equal_nan=True)
    assert np.array_equal(first.free.predicted, whole.free.predicted, equal_nan=True)


def run(pipeline, frames, begin, end):
    events = []
    for k in range(begin, end, STEP):
        events += pipeline.feed(bus.part(frames, k, min(k + STEP, end)))
    return events
