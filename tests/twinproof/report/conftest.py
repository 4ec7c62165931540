"""One finished ladder, shared by all tests of the reports."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from swinging_pendulum import swing

from fmus.frontend import load
from fmus.sources import ModelicaSource, library_class
from identification.discovery.ladder import Improvement, improve
from identification.problem import Problem, match


@dataclass(frozen=True)
class Case:
    source: ModelicaSource
    problem: Problem
    holdout: Problem
    improvement: Improvement


@pytest.fixture(scope="session")
def pendulum() -> Case:
    source = library_class("Twinproof.Plants.Pendulum")
    dae = load(source)
    problem, holdout = match(dae, swing(6.0, 1)), match(dae, swing(4.0, 2))
    return Case(source, problem, holdout, improve(source, problem, holdout))
