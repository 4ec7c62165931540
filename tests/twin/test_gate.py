"""The gate is never open on anything unverified."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, multivariate_normal

from twin.gate import Limits, Question, Situation, decide
from twin.store.documents import Evidence

LIMITS = Limits(evidence=1000.0, telemetry=0.5, estimate=100.0, settle=5.0)
QUESTION = Question("controller", "model", "study")
COVARIANCE = ((0.04, 0.01, 0.0), (0.01, 0.09, 1e3), (0.0, 1e3, 4e8))
EVIDENCE = Evidence(
    twin="robot",
    time=500.0,
    controller="controller",
    model="model",
    study="study",
    parameters="set",
    names=("a", "b", "c"),
    values={"a": 1.0, "b": -2.0, "c": 1e6, "held": 9.81},
    covariance=COVARIANCE,
    passed=True,
)
OPEN = Situation(
    now=1000.0,
    verified=True,
    because="",
    healthy=True,
    telemetry=999.9,
    followed_since=400.0,
    estimate=990.0,
    values=dict(EVIDENCE.values),
    evidence=(EVIDENCE,),
)


def allowed(situation=OPEN, question=QUESTION, limits=LIMITS):
    return decide(question, situation, limits).allowed


def test_open_when_everything_fits():
    found = decide(QUESTION, OPEN, LIMITS)
    assert found.allowed
    assert found.verified_at == 500.0
    assert found.evidence == EVIDENCE.id


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"verified": False, "because": "friction appeared"}, "friction appeared"),
        ({"healthy": False, "because": "the database fails"}, "database"),
        ({"telemetry": None}, "telemetry"),
        ({"telemetry": 999.4}, "telemetry"),
        ({"telemetry": math.nan}, "telemetry"),
        ({"telemetry": 1002.0}, "future"),
        ({"now": math.nan}, "age"),
        ({"now": 10.0}, "future"),
        ({"now": 1e9}, "telemetry"),
        ({"followed_since": None}, "followed"),
        ({"followed_since": 996.0}, "followed"),
        ({"followed_since": math.nan}, "followed"),
        ({"estimate": None}, "estimate"),
        ({"estimate": 899.0}, "estimate"),
        ({"values": None}, "known"),
        ({"values": {}}, "known"),
        ({"values": {**EVIDENCE.values, "a": math.nan}}, "known"),
        ({"values": {**EVIDENCE.values, "d": 1.0}}, "known"),
        ({"values": {**EVIDENCE.values, "a": 2.0}}, "left"),
        ({"values": {**EVIDENCE.values, "held": 9.82}}, "left"),
        ({"evidence": ()}, "no verification"),
        ({"evidence": (replace(EVIDENCE, passed=False),)}, "did not pass"),
        ({"evidence": (replace(EVIDENCE, controller="x"),)}, "controller"),
        ({"evidence": (replace(EVIDENCE, model="x"),)}, "model"),
        ({"evidence": (replace(EVIDENCE, study="x"),)}, "study"),
        ({"evidence": (replace(EVIDENCE, time=-1.0),)}, "verification is"),
        ({"evidence": (replace(EVIDENCE, time=1100.0),)}, "future"),
    ],
)
def test_each_single_fault_closes_it_and_is_said(change, word):
    found = decide(QUESTION, replace(OPEN, **change), LIMITS)
    assert not found.allowed
    assert word in found.because


@pytest.mark.parametrize("name", ["controller", "model", "study"])
def test_an_unknown_hash_never_matches_an_unknown_hash(name):
    evidence = replace(EVIDENCE, **{name: ""})
    assert not allowed(replace(OPEN, evidence=(evidence,)), replace(QUESTION, **{name: ""}))


@given(st.integers(0, 2**32 - 1))
def test_the_ellipsoid_is_that_of_the_normal_distribution(seed):
    # Against SciPy: inside the 95 % ellipsoid is where the density exceeds its value on the edge.
    rng = np.random.default_rng(seed)
    mean = np.array([1.0, -2.0, 1e6])
    drawn = rng.multivariate_normal(mean, np.array(COVARIANCE) * rng.choice([0.5, 1.0, 2.0]))
    units = np.array([1.0, 1.0, 1e-5])  # SciPy takes the covariance for singular otherwise
    normal = multivariate_normal(mean * units, np.array(COVARIANCE) * np.outer(units, units))
    gap = normal.logpdf(mean * units) - normal.logpdf(drawn * units)
    inside = gap <= chi2.ppf(0.95, 3) / 2
    values = {**EVIDENCE.values, **dict(zip("abc", drawn.tolist(), strict=True))}
    assert allowed(replace(OPEN, values=values)) == inside


def test_a_direction_that_was_not_varied_was_verified_at_one_place_only():
    flat = ((1.0, 1.0), (1.0, 1.0))
    evidence = replace(EVIDENCE, names=("a", "b"), values={"a": 0.0, "b": 0.0}, covariance=flat)
    together = replace(OPEN, evidence=(evidence,), values={"a": 1.5, "b": 1.5})
    assert allowed(together)
    assert not allowed(replace(together, values={"a": 0.1, "b": -0.1}))


times = st.one_of(st.none(), st.floats(allow_nan=True, allow_infinity=True), st.floats(0, 2000))
hashes = st.sampled_from(["controller", "model", "study", "", "other"])
numbers = st.one_of(st.floats(), st.floats(-3, 3))
evidences = st.builds(
    replace,
    st.just(EVIDENCE),
    time=st.floats(-1000, 3000),
    controller=hashes,
    model=hashes,
    study=hashes,
    passed=st.booleans(),
    values=st.dictionaries(st.sampled_from("abc"), numbers, min_size=3),
)
situations = st.builds(
    Situation,
    now=st.one_of(st.floats(), st.floats(0, 2000)),
    verified=st.booleans(),
    because=st.just("x"),
    healthy=st.booleans(),
    telemetry=times,
    followed_since=times,
    estimate=times,
    values=st.one_of(st.none(), st.dictionaries(st.sampled_from("abcd"), numbers)),
    evidence=st.lists(evidences, max_size=3),
)


def _must_be_closed(s, q):
    """The rules again, written the other way round."""
    ages = [(s.telemetry, 0.5), (s.estimate, 100.0)]
    if not (s.verified and s.healthy) or s.values is None or s.followed_since is None:
        return True
    if any(t is None or not -1.0 <= s.now - t <= limit for t, limit in ages):
        return True
    if not s.now - s.followed_since >= 5.0:
        return True
    covering = [
        e
        for e in s.evidence
        if e.passed
        and (e.controller, e.model, e.study) == (q.controller, q.model, q.study)
        and -1.0 <= s.now - e.time <= 1000.0
        and set(s.values) == set(e.values)
        and all(math.isfinite(v) for v in s.values.values())
    ]
    return not covering


@settings(max_examples=400)
@given(situations)
def test_never_open_where_any_rule_closes_it(situation):
    found = decide(QUESTION, situation, LIMITS)
    assert found.because
    if _must_be_closed(situation, QUESTION):
        assert not found.allowed


one_fault = st.sampled_from(
    [
        {"verified": False},
        {"healthy": False},
        {"telemetry": None},
        {"estimate": None},
        {"values": None},
        {"followed_since": None},
        {"evidence": ()},
    ]
)


@given(
    one_fault,
    st.floats(0, 0.49),
    st.floats(0, 99),
    st.floats(5, 900),
    st.floats(0, 499),
)
def test_one_fault_closes_what_is_otherwise_open(fault, telemetry, estimate, followed, evidence):
    situation = replace(
        OPEN,
        telemetry=OPEN.now - telemetry,
        estimate=OPEN.now - estimate,
        followed_since=OPEN.now - followed,
        evidence=(replace(EVIDENCE, time=OPEN.now - evidence),),
    )
    assert allowed(situation)
    assert not allowed(replace(situation, **fault))
