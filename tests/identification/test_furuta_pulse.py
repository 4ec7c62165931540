"""The rotary pendulum's arm from one pulse of 10 s, on a plant with true stiction."""

import numpy as np
import pytest

from benchmarks.furuta import errors
from tests.identification import furuta_truth as truth


@pytest.mark.parametrize("counts", [0.0, 45.0], ids=["no stiction", "45 counts of stiction"])
def test_one_pulse_gives_the_arm(counts):
    found = errors(truth.SETUP_1.sticky(counts), [(0.5, 1.5, 50.0), (0.5, 2.0, -50.0)], [7])
    assert np.abs(found).max() < (0.1 if counts else 0.01), found


def test_the_truth_sticks():
    """A pulse below breakaway does not move the arm, and one above it does."""
    sticky = truth.SETUP_1.sticky()
    for counts, moves in ((40, False), (50, True)):
        record = truth.record(sticky, truth.pulses(1.0, (0.1, 0.9, counts)))
        assert (np.ptp(record.states[:, 0]) > 0.1) == moves


def test_the_truth_keeps_energy_without_friction():
    free = truth.Setup(d=0.0, C1=0.0, Kf=0.0)
    states = truth.record(free, np.zeros(300), x0=(0.0, 1.0, 2.0, -1.0)).states
    _, beta, wa, wb = states.T
    p, s, c = free, np.sin(beta), np.cos(beta)
    kinetic = (p.J + p.m * p.l0**2 + p.m * p.l1**2 * s**2) * wa**2 / 2 + p.Jr * wb**2 / 2
    kinetic += p.m * p.l0 * p.l1 * c * wa * wb
    energy = kinetic - p.m * truth.G * p.l1 * c
    assert np.ptp(energy) < 1e-4 * np.ptp(kinetic)
