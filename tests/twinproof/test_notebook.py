"""What the Python calls return is shown, plotted and turned into pandas."""

from __future__ import annotations

import doctest
import importlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import twinproof
from foundation.errors import InputError
from twinproof.report.notebook import Plot

VOID = {"br", "img", "meta", "link", "hr"}


class Balance(HTMLParser):
    """Fails on tags that are not closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def words(html: str) -> str:
    """Return the text of a piece of HTML that is well-formed."""
    parser = Balance()
    parser.feed(html)
    parser.close()
    assert parser.open == []
    return " ".join(parser.text)


def run(seconds: float, seed: int) -> twinproof.Recording:
    """Return a pushed pendulum with dry friction, simulated by SciPy."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * 200)) / 200
    phases = rng.uniform(0, 6, 4)
    tau = sum(0.8 * np.sin(w * time + p) for w, p in zip((1.1, 2.3, 3.7, 5.9), phases, strict=True))

    def rate(t: float, x: np.ndarray) -> list[float]:
        torque = tau[min(int(t * 200 + 1e-9), len(tau) - 1)]
        friction = 0.05 * x[1] + 0.4 * np.tanh(x[1] / 0.01)
        return [x[1], (torque - 1.5 * np.sin(x[0]) - friction) / 0.2]

    solved = solve_ivp(rate, (0, time[-1]), [0.3, 0.0], t_eval=time, max_step=0.005, rtol=1e-6)
    theta = solved.y[0] + 1e-4 * rng.standard_normal(len(time))
    frame = pd.DataFrame({"time": time, "tau": tau, "theta": theta})
    return twinproof.Recording.from_frame(frame, units={"tau": "N.m", "theta": "rad"})


@pytest.fixture(scope="module")
def model() -> twinproof.Model:
    return twinproof.Model.of("Twinproof.Plants.Pendulum")


@pytest.fixture(scope="module")
def record() -> twinproof.Recording:
    return run(8.0, 1)


def test_a_model_and_a_recording_say_what_they_are(
    model: twinproof.Model, record: twinproof.Recording
) -> None:
    said = words(model._repr_html_())
    assert all(name in said for name in ("tau", "theta", "joint", "mgl"))
    assert "1600 samples" in words(record._repr_html_())
    figure = record.plot()
    assert [ax.get_ylabel() for ax in figure.axes] == ["tau [N.m]", "theta [rad]"]


def test_answers_are_shown_plotted_and_turned_into_pandas(
    model: twinproof.Model, record: twinproof.Recording
) -> None:
    compared = twinproof.compare(model, record)
    frame = compared.to_frame()
    error = frame["theta", "measured"] - frame["theta", "simulated"]
    pd.testing.assert_series_equal(error, frame["theta", "error"], check_names=False)
    assert "theta" in words(compared._repr_html_())
    assert len(compared.plot().pictures) == 2

    identified = twinproof.identify(model, record, horizon=1.0)
    table = identified.to_frame()
    assert table.loc["J", "value"] == identified.estimate.parameters["J"].value
    assert "±" in words(identified._repr_html_())

    improved = twinproof.improve(model, record, run(8.0, 2), max_effects=1)
    ladder = improved.to_frame()
    assert ladder["added"].tolist() == ["", "CoulombFriction@joint"]
    assert ladder["unseen"].is_monotonic_decreasing
    assert "CoulombFriction" in words(improved._repr_html_())
    assert len(improved.plot().pictures) == 2
    # What was found goes on as a model.
    assert twinproof.compare(improved.model, record).comparison.nrmse < 0.02

    diagnosed = twinproof.diagnose(model, record)
    assert diagnosed.to_frame().loc[0, ["effect", "place"]].tolist() == ["CoulombFriction", "joint"]
    assert "CoulombFriction@joint" in words(diagnosed._repr_html_())
    # The shape of the force, the curves, the error.
    assert len(diagnosed.plot().pictures) == 3


def test_a_plot_stands_by_itself(
    model: twinproof.Model, record: twinproof.Recording, tmp_path: Path
) -> None:
    plot: Plot = twinproof.compare(model, record).plot()
    plot.save(tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert ElementTree.fromstring(text).tag == "{http://www.w3.org/2000/svg}svg"
    assert "var(--" not in text
    assert "var(--" not in plot._repr_html_()
    with pytest.raises(InputError, match=r"\.svg"):
        plot.save(tmp_path / "a.png")


@pytest.mark.parametrize(
    "name", ["report.notebook", "cli.options", "workbench.project", "workbench.mapping"]
)
def test_examples_in_docstrings(name: str) -> None:
    found = doctest.testmod(importlib.import_module(f"twinproof.{name}"))
    assert found.failed == 0
    assert found.attempted > 0


def test_every_public_name_is_there() -> None:
    assert sorted(dir(twinproof)) == sorted(twinproof.__all__)
    assert all(getattr(twinproof, name) is not None for name in twinproof.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = twinproof.nonsense
