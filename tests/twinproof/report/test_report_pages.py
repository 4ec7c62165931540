"""Whole pages: what they say equals the results; they are sound HTML and need nothing else."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from lxml import html

from identification import comparison
from identification.discovery.diagnosis import Outcome
from identification.estimators import estimator
from identification.experiment import Experiment
from identification.prediction import choose_horizon
from twinproof.report import (
    write_comparison,
    write_diagnosis,
    write_identification,
    write_improvement,
)
from twinproof.report.numbers import percent, quantity, significant, uncertain
from twinproof.report.svg import Role

COMMAND = "twinproof improve Pendulum a.csv --holdout 'b & <c>.csv' -o out"


def said(page) -> str:
    """A page's words, without style sheet and with single spaces."""
    for style in page.xpath("//style"):
        style.drop_tree()
    return re.sub(r"\s+", " ", page.text_content())


@pytest.fixture(scope="session")
def improvement_page(pendulum, tmp_path_factory):
    path = tmp_path_factory.mktemp("improvement") / "report.html"
    write_improvement(
        pendulum.improvement,
        pendulum.problem,
        pendulum.holdout,
        path,
        command=COMMAND,
        notes=["recorded on a rainy day"],
    )
    return path


@pytest.fixture(scope="session")
def single_pages(pendulum, tmp_path_factory):
    """The reports of compare, identify and diagnose by name."""
    folder = tmp_path_factory.mktemp("single")
    problem = pendulum.problem
    experiment = Experiment.of(problem)
    estimate = estimator("auto").estimate(problem)
    fitted = problem.with_values(estimate.values)
    horizon = choose_horizon(fitted, experiment.shooting, fitted.values)
    prediction = experiment.on(fitted).predict(fitted.values, horizon)
    compared = comparison.compare(fitted, experiment.shooting, prediction)
    paths = {name: folder / f"{name}.html" for name in ("compare", "identify", "diagnose")}
    write_comparison(compared, problem, paths["compare"], command=COMMAND)
    write_identification(estimate, compared, problem, paths["identify"], command=COMMAND)
    diagnosis = pendulum.improvement.steps[0].diagnosis
    write_diagnosis(diagnosis, compared, problem, paths["diagnose"], command=COMMAND)
    return paths, estimate, compared


@pytest.fixture(params=["improvement", "compare", "identify", "diagnose"])
def any_page(request, improvement_page, single_pages):
    return improvement_page if request.param == "improvement" else single_pages[0][request.param]


def test_a_page_is_whole_and_small(any_page):
    text = any_page.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert len(text) < 3_000_000
    page = html.fromstring(text)
    assert len(page.xpath("//h1")) == 1
    assert page.xpath("/html/@lang") == ["en"]
    levels = [int(h.tag[1]) for h in page.xpath("//h1|//h2|//h3|//h4")]
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))


def test_a_page_fetches_nothing_and_runs_nothing(any_page):
    text = any_page.read_text(encoding="utf-8")
    page = html.fromstring(text)
    assert not page.xpath("//script|//link|//iframe|//img|//object|//embed")
    links = page.xpath("//@href|//@src|//@*[local-name()='href']")
    assert links
    assert all(link.startswith("#") for link in links)
    assert not re.search(r"https?:|@import|url\((?!#)|[\"'(]data:", text)


def test_links_and_references_lead_somewhere(any_page):
    text = any_page.read_text(encoding="utf-8")
    page = html.fromstring(text)
    identifiers = page.xpath("//@id")
    assert len(identifiers) == len(set(identifiers))
    wanted = {link[1:] for link in page.xpath("//@href")}
    wanted |= set(re.findall(r"url\(#([^)]+)\)", text)) | set(page.xpath("//@aria-labelledby"))
    assert wanted <= set(identifiers)


def test_figures_are_drawn_in_the_pages_colours_and_described(any_page):
    text = any_page.read_text(encoding="utf-8")
    page = html.fromstring(text)
    pictures = page.xpath("//figure/div[@role='img']")
    assert len(pictures) >= 3
    for picture in pictures:
        assert len(picture.get("aria-label")) > 20
        drawn = [d for d in picture.xpath(".//path/@d") if len(d) > 100]
        assert drawn, picture.get("aria-label")
        assert "nan" not in " ".join(drawn).lower()
        # Axes carry their units.
        assert re.search(r"\[[^\]]+\]", picture.text_content())
    assert not any(role.value in text for role in Role)
    defined = set(re.findall(r"(--[a-z]+):", text))
    assert set(re.findall(r"var\((--[a-z]+)\)", text)) <= defined


def test_every_colour_has_a_dark_and_a_printed_value(improvement_page):
    style = html.fromstring(improvement_page.read_text(encoding="utf-8")).xpath("//style")[0].text
    light, dark, printed = (
        set(re.findall(r"(--[a-z]+):", part)) for part in style.split(":root")[1:]
    )
    assert light == dark == printed
    assert "prefers-color-scheme: dark" in style


def test_the_command_is_there_as_typed(any_page):
    page = html.fromstring(any_page.read_text(encoding="utf-8"))
    assert page.xpath("//pre[@class='command']")[0].text_content() == COMMAND


def test_improvement_gives_the_answer_first(improvement_page, pendulum):
    page = html.fromstring(improvement_page.read_text(encoding="utf-8"))
    assert page.xpath("//h1")[0].text == "CoulombFriction at joint is missing from Pendulum"
    first, last = pendulum.improvement.steps[0], pendulum.improvement.steps[-1]
    lead = said(page.xpath("//*[@class='lead']")[0])
    assert f"from {percent(first.holdout.nrmse)} to {percent(last.holdout.nrmse)}" in lead
    assert first.holdout.nrmse > 5 * last.holdout.nrmse
    sections = page.xpath("//section/@id")
    assert sections == [
        "answer",
        "ladder",
        "traces",
        "residuals",
        "ranking",
        "shape",
        "diff",
        "parameters",
        "made",
    ]


def test_improvement_shows_the_results_numbers(improvement_page, pendulum):
    page = html.fromstring(improvement_page.read_text(encoding="utf-8"))
    words = said(page)
    improvement = pendulum.improvement
    for step in improvement.steps:
        for side in (step.train, step.holdout):
            assert percent(side.nrmse) in words
            assert quantity(side.channels["theta"].rmse, "rad") in words
            assert quantity(side.channels["omega"].rmse, "rad/s") in words
    last = improvement.steps[-1]
    assert len(page.xpath("//section[@id='parameters']//tbody/tr")) == len(last.fit.free)
    for k, name in enumerate(last.fit.free):
        sd = np.sqrt(last.fit.covariance[k, k])
        assert uncertain(last.fit.values[name], sd) in words
    assert significant(last.fit.condition_number, 2) in words
    chosen = improvement.steps[0].diagnosis.ranking[0]
    assert significant(chosen.evidence) in words
    assert "recorded on a rainy day" in words
    assert "1201 samples" in words


def test_improvement_ranks_every_candidate(improvement_page, pendulum):
    words = said(html.fromstring(improvement_page.read_text(encoding="utf-8")))
    for step in pendulum.improvement.steps:
        for row in step.diagnosis.ranking:
            assert row.label.replace("@", " at ") in words
        for label, why in step.diagnosis.skipped.items():
            assert label.replace("@", " at ") in words
            assert why in words


def test_improvement_shows_the_modelica_change(improvement_page):
    page = html.fromstring(improvement_page.read_text(encoding="utf-8"))
    added = [line.text_content() for line in page.xpath("//pre[@class='diff']//*[@class='add']")]
    assert "+  connect(coulombFriction_joint.flange, joint.flange);" in added


def test_improvement_without_an_unseen_record_says_so(pendulum, tmp_path):
    steps = tuple(replace(s, holdout=None) for s in pendulum.improvement.steps)
    path = tmp_path / "report.html"
    improvement = replace(pendulum.improvement, steps=steps)
    write_improvement(improvement, pendulum.problem, None, path, command=COMMAND)
    words = said(html.fromstring(path.read_text(encoding="utf-8")))
    assert "no unseen one was given" in words
    assert "none given" in words
    assert "The unseen record supports" not in words


def test_a_contradicted_step_is_reported_as_such(pendulum, tmp_path):
    first, last = pendulum.improvement.steps
    improvement = replace(
        pendulum.improvement,
        steps=(first, replace(last, contradicted=True)),
        outcome=Outcome.UNKNOWN_SHAPE,
    )
    path = tmp_path / "report.html"
    write_improvement(improvement, pendulum.problem, pendulum.holdout, path, command=COMMAND)
    page = html.fromstring(path.read_text(encoding="utf-8"))
    answer = said(page.xpath("//section[@id='answer']")[0])
    assert "The unseen record contradicts CoulombFriction at joint" in answer
    assert "supports every step" not in answer
    assert next(tag.text for tag in page.xpath("//*[@class='tag bad']")) == "contradicted"


def test_nothing_missing_is_an_answer(pendulum, tmp_path):
    last = pendulum.improvement.steps[-1]
    only = replace(last, number=0, added=None, verdict=None)
    path = tmp_path / "report.html"
    improvement = replace(pendulum.improvement, steps=(only,), outcome=Outcome.COMPLETE)
    complete = replace(improvement, steps=(replace(only, model=_bare(only.model)),))
    write_improvement(complete, pendulum.problem, None, path, command=COMMAND)
    page = html.fromstring(path.read_text(encoding="utf-8"))
    assert page.xpath("//h1")[0].text == "Nothing is missing from Pendulum_1"
    assert "shape" not in page.xpath("//section/@id")


def _bare(model):
    """The same model as if the user's own class had the effect from the start."""
    return replace(model, base=model.source, additions=())


def test_identification_shows_its_estimate(single_pages):
    paths, estimate, compared = single_pages
    words = said(html.fromstring(paths["identify"].read_text(encoding="utf-8")))
    assert estimate.method in words
    for name, parameter in estimate.parameters.items():
        assert name in words
        assert uncertain(parameter.value, parameter.sd) in words
    assert percent(compared.nrmse) in words


def test_diagnosis_names_the_effect(single_pages):
    page = html.fromstring(single_pages[0]["diagnose"].read_text(encoding="utf-8"))
    assert page.xpath("//h1")[0].text == "CoulombFriction at joint is missing from Pendulum"
    assert page.xpath("//section[@id='ranking']//tbody/tr")[0].xpath(".//*[@class='tag good']")


def test_comparison_says_where_it_fails(single_pages):
    paths, _, compared = single_pages
    words = said(html.fromstring(paths["compare"].read_text(encoding="utf-8")))
    assert "Where it fails, worst first" in words
    assert f"{significant(compared.worst[0].begin, 4)} to" in words


@pytest.mark.parametrize("case", ["perfect", "diverged", "diverged at once", "still", "zero"])
def test_extreme_records_make_a_page_without_a_warning(pendulum, tmp_path, case):
    problem = pendulum.problem
    if case in ("still", "zero"):
        value = 0.0 if case == "zero" else 0.7
        problem = replace(
            problem,
            inputs=np.zeros_like(problem.inputs),
            outputs=np.full_like(problem.outputs, value),
        )
    experiment = Experiment.of(problem)
    prediction = experiment.predict(problem.values, None)
    simulated = prediction.simulated.copy()
    if case == "perfect":
        simulated = problem.outputs.copy()
    elif case.startswith("diverged"):
        simulated[0 if case == "diverged at once" else 700 :] = np.nan
    prediction = replace(prediction, simulated=simulated, error=problem.outputs - simulated)
    compared = comparison.compare(problem, experiment.shooting, prediction)
    path = tmp_path / "report.html"
    write_comparison(compared, problem, path, command=COMMAND)
    page = html.fromstring(path.read_text(encoding="utf-8"))
    assert not re.search(r"\bnan\b|\binf\b", said(page))
    assert len(page.xpath("//svg")) >= 2
    assert ("leaves the finite numbers" in said(page)) == case.startswith("diverged")
