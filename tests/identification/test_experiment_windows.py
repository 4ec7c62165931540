"""Over which windows a model is fitted: the longest over which it can be."""

from dataclasses import replace

import numpy as np
import truth_records as truth

from identification.experiment import Experiment
from identification.prediction import WINDOW


def test_a_model_that_fits_is_fitted_over_whole_windows():
    record = truth.noisy(truth.pendulum_problem(6.0), [1e-3], 1)
    experiment, fit = Experiment.of(record).followed(record.values)
    assert experiment.window == WINDOW
    assert fit.converged
    assert len(fit.x0) == len(experiment.windows)


def test_where_only_short_windows_converge_these_are_kept(monkeypatch):
    record = truth.noisy(truth.pendulum_problem(6.0), [1e-3], 1)
    experiment = Experiment.of(record)
    fits = experiment.fit_stages()
    stuck = (fits[0], *(replace(fit, converged=False) for fit in fits[1:]))
    monkeypatch.setattr(Experiment, "fit_stages", lambda *_, **__: stuck)
    shorter, fit = experiment.followed(record.values)
    assert fit is fits[0]
    assert shorter.window == 0.25 * WINDOW
    assert len(fit.x0) == len(shorter.windows)


def test_records_beside_one_another_have_the_same_windows():
    one = truth.noisy(truth.pendulum_problem(6.0), [1e-3], 1)
    other = truth.noisy(truth.pendulum_problem(4.0), [1e-3], 2)
    short = Experiment.together([one, other]).lasting(0.5)
    assert [len(record.windows) for record in short.records] == [12, 8]
    assert [len(part.windows) for part in short.parts()] == [12, 8]
    assert [len(part.windows) for part in short.parts(1.0)] == [6, 4]
    assert np.isclose(short.on(other).window, 0.5)
