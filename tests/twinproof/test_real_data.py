"""Reduced benchmarks on measured data: what is found first, and what it is worth."""

import os
from dataclasses import replace

import pytest

from benchmarks import dfki, road_car, silverbox
from benchmarks.real_data.journey import Stretch
from benchmarks.real_data.page import write

pytestmark = pytest.mark.skipif(
    "TWINPROOF_DATA" not in os.environ,
    reason="measured data: TWINPROOF_DATA names the folder that has them",
)


def end(walked):
    """Errors of the last step, a share of the measurement's deviation."""
    last = walked.found.steps[-1]
    name = walked.journey.output
    return last.train.channels[name].nrmse, last.holdout.channels[name].nrmse


def test_silverbox_is_a_hardening_spring_driven_by_a_measured_voltage():
    begin = silverbox.JOURNEY.fitted.begin
    short = replace(
        silverbox.JOURNEY,
        fitted=Stretch("silverbox", begin, begin + 15),
        unseen=Stretch("silverbox", 40.0, 60.0),
        max_effects=2,
    )
    walked = short.walk()
    added = walked.found.added
    assert added[0].label == "CubicSpring@mass"
    assert added[0].values["k3"] == pytest.approx(3.79, rel=0.05)
    fitted, unseen = end(walked)
    assert fitted < 0.02
    assert unseen < 0.02


def test_the_pendulum_lacks_dry_friction_and_has_an_offset(tmp_path):
    walked = dfki.JOURNEY.walk()
    first, second = walked.found.steps[1:3]
    assert first.added.label == "CoulombFriction@joint"
    # One and the same in a swing that rarely turns round: this record does not tell them apart.
    (tie,) = first.diagnosis.ties
    assert second.added.label in tie
    assert "ConstantTorque@joint" in tie
    assert end(walked)[1] <= 0.012
    page = write(walked, folder=tmp_path)
    assert "CoulombFriction@joint" in page.read_text()
    assert (tmp_path / "dfki" / "errors.svg").stat().st_size < 100_000


def test_the_car_loses_the_sign_of_its_speed_in_reverse():
    """The effect is the user's own, beside the model, and asks for an input that it is not at."""
    walked = replace(road_car.JOURNEY, max_effects=1).walk()
    assert [a.label for a in walked.found.added] == ["SignLossInReverse@v"]
    before = walked.found.steps[0].train.channels["yaw_rate"].nrmse
    assert end(walked)[0] < 0.2 * before
