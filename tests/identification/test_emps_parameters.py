"""The published parameters of the positioner from the authors' own record."""

import os

import pytest

from benchmarks.emps import published
from foundation.errors import InputError
from identification.estimators import Differencing


@pytest.mark.skipif(
    not os.environ.get("TWINPROOF_DATA"),
    reason="TWINPROOF_DATA does not name the data sets' folder",
)
def test_the_published_parameters_come_out_within_one_per_cent():
    figures = list(published())
    assert len(figures) == 4
    for figure in figures:
        assert figure.value <= 1.0, str(figure)


def test_a_band_beyond_half_the_sampling_rate_is_refused():
    import truth_records as truth

    given = truth.pendulum_problem(1.0, 2e-3)
    with pytest.raises(InputError, match="400 Hz") as caught:
        Differencing(band=400.0).estimate(given)
    assert "250 Hz" in caught.value.remedy
