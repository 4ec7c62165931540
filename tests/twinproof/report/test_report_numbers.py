import doctest
import math
import re

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from twinproof.report import envelope, ladder_plot, numbers, wording
from twinproof.report.numbers import scale_for, significant, typeset, uncertain

NUMBER = re.compile(
    r"\(?(?P<value>−?[\d.]+)(?:·10(?P<own>[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?(?: ± (?P<sd>[\d.]+))?\)?"
    r"(?:·10(?P<power>[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?\Z"
)
PLAIN = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def read(text: str) -> tuple[float, float | None, int]:
    """The number, its deviation, and how many decimals are written."""
    found = NUMBER.match(text)
    assert found is not None, text
    power, own = (10.0 ** int((found[name] or "⁰").translate(PLAIN)) for name in ("power", "own"))
    # In brackets the value shares the deviation's power.
    of_value = power if text.startswith("(") else own
    value = float(found["value"].replace("−", "-")) * of_value
    return value, None if found["sd"] is None else float(found["sd"]) * power, len(found["value"])


@pytest.mark.parametrize("module", [numbers, envelope, wording, ladder_plot])
def test_examples_in_docstrings(module):
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0


@given(st.floats(1e-12, 1e12), st.sampled_from([-1.0, 1.0]), st.integers(1, 6))
def test_significant_is_right_to_its_digits(size, sign, digits):
    value, _, _ = read(significant(sign * size, digits))
    assert math.isclose(value, sign * size, rel_tol=0.5 * 10.0 ** (1 - digits) * (1 + 1e-9))


@given(st.floats(-1e9, 1e9), st.floats(1e-9, 1e6))
def test_uncertain_rounds_value_and_deviation_to_the_same_place(value, sd):
    assume(abs(value) > 1e-9)
    text = uncertain(value, sd)
    shown, shown_sd, _ = read(text)
    assert shown_sd is not None
    assert math.isclose(shown_sd, sd, rel_tol=0.051)
    # No digit of the value is dropped that the deviation leaves meaningful, of the first nine.
    assert abs(shown - value) <= max(0.051 * sd + 1e-12 * abs(value), 0.51e-8 * abs(value))
    assert len(text) < 40


def test_uncertain_without_a_deviation_shows_no_deviation():
    assert "±" not in uncertain(3.2, math.inf)


def test_units_are_typeset_and_scaled():
    assert typeset("kg.m2/s2") == "kg·m²/s²"
    assert scale_for("V", 2000.0).unit == "kV"
    assert scale_for("m", 2000.0).unit == "m"
    assert scale_for("kg", 1e-4) == numbers.Scale(1.0, "kg")
    assert scale_for("rad", 0.0) == numbers.Scale(1.0, "rad")


@given(st.integers(30, 400), st.integers(2, 12), st.integers(0, 2**31))
def test_envelope_keeps_extremes_and_order(n, bins, seed):
    time = np.arange(float(n))
    values = np.random.default_rng(seed).standard_normal(n)
    values[n // 3 : n // 3 + 2] = np.nan
    t, y = envelope.envelope(time, values, bins)
    assert len(t) <= max(2 * bins, n if n <= 2 * bins else 0)
    assert np.all(np.diff(t) > 0)
    assert np.nanmax(y) == np.nanmax(values)
    assert np.nanmin(y) == np.nanmin(values)


def test_envelope_breaks_where_nothing_is_known():
    values = np.ones(100)
    values[40:60] = np.nan
    _, y = envelope.envelope(np.arange(100.0), values, 10)
    assert np.count_nonzero(np.isnan(y)) == 2


def test_profile_agrees_with_numpy_on_a_law_with_noise():
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, 20000)
    y = 0.1 * x**2 + 0.1 * rng.standard_normal(20000)
    shown = envelope.profile(x, y)
    assert np.allclose(shown.middle, 0.1 * shown.x**2, atol=0.02)
    assert np.allclose(shown.high - shown.low, 2 * 1.2816 * 0.1, atol=0.03)
