"""The whole journey without a mouse, every step of it audited in light and in dark."""

from __future__ import annotations

import pandas as pd
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.accessibility import barriers
from tests.twinproof.workbench.conftest import Running
from tests.twinproof.workbench.test_workbench_browser import PENDULUM, lab

_FIELDS = {
    "model": PENDULUM,
    "recording": "recordings/one.csv",
    "holdout": "recordings/unseen.csv",
    "also": "recordings/two.csv",
}


def reach(page: Page, selector: str) -> None:
    """Press Tab until an element has the focus, and can be seen to have it."""
    for _ in range(150):
        page.keyboard.press("Tab")
        if page.evaluate("(s) => document.activeElement?.matches(s) ?? false", selector):
            outline = "getComputedStyle(document.activeElement).outlineStyle"
            assert page.evaluate(outline) != "none", f"the focus on {selector} is not seen"
            return
    raise AssertionError(f"{selector} cannot be reached")


def press(page: Page, selector: str, key: str = "Enter") -> None:
    reach(page, selector)
    page.keyboard.press(key)


def work(page: Page, selector: str) -> None:
    press(page, selector)
    expect(page.locator("#job")).to_be_visible()
    expect(page.locator("#job")).to_be_hidden(timeout=180_000)


def go(page: Page, tab: str) -> None:
    press(page, f'nav a[href="#{tab}"]')
    expect(page.locator(f'[data-tab="{tab}"]')).to_be_visible()


def compare_both_records(page: Page) -> None:
    work(page, '[data-task="compare"]')
    piece = page.locator('[data-piece="compare"]')
    expect(piece.locator("[data-record] > h3")).to_have_text(
        [_FIELDS["recording"], _FIELDS["also"]]
    )
    expect(page.locator("#panels canvas")).to_have_count(4)
    with page.expect_response("**/api/curves?record=1&*"):
        press(page, "#record", "ArrowDown")
    expect(page.locator("#record")).to_have_value("1")
    with page.expect_response("**/api/curves?record=0&*"):
        press(page, '[data-record="0"] button.span')
    expect(page.locator("#record")).to_have_value("0")
    press(page, "#panels", "+")
    assert barriers(page) == []


def do_all_steps(page: Page, workbench: Running) -> None:
    reach(page, "#field-max_effects")
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("one")
    work(page, '[data-task="improve"]')
    expect(page.locator("#error-max_effects")).to_contain_text("no number of effects")
    reach(page, "#field-max_effects")
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("1")
    work(page, '[data-task="improve"]')
    report = page.frame_locator("#report")
    expect(report.locator("h1")).to_have_text("CubicSpring at joint is missing from Pendulum")
    assert barriers(page) == []
    ladder = pd.read_csv(workbench.folder / "improved" / "ladder.csv", keep_default_na=False)
    assert list(ladder["added"]) == ["", "CubicSpring@joint"]
    assert ladder["holdout_nrmse"][1] < 0.2 * ladder["holdout_nrmse"][0]


def test_the_audit_sees_barriers(browser: Browser) -> None:
    page = browser.new_page()
    page.set_content("<title>a</title><main><button></button></main>")
    assert {text.split(": ")[1] for text in barriers(page)} >= {"button-name", "html-has-lang"}
    page.close()


@pytest.mark.slow
def test_the_journey_by_keyboard_without_barriers(page: Page, workbench: Running) -> None:
    lab(workbench.folder)
    assert barriers(page) == []
    for field, word in _FIELDS.items():
        reach(page, f"#field-{field}")
        page.keyboard.type(word)
        page.keyboard.press("Tab")
        expect(page.locator(f"#error-{field}")).to_be_empty()
    expect(page.locator("#channels polyline")).to_have_count(3)
    assert barriers(page) == []

    go(page, "compare")
    compare_both_records(page)
    go(page, "diagnose")
    work(page, '[data-task="diagnose"]')
    expect(page.locator('[data-piece="diagnose"] h3').first).to_contain_text("CubicSpring")
    assert barriers(page) == []

    go(page, "add")
    press(page, "#candidate-0", "Space")
    work(page, "#propose")
    expect(page.locator(".diff .add").first).to_be_visible()
    assert barriers(page) == []
    press(page, "#accept")
    expect(page.locator("#steps li")).to_have_count(1)

    go(page, "ladder")
    work(page, '[data-task="score"]')
    expect(page.locator('[data-piece="ladder"] tbody tr')).to_have_count(2)
    do_all_steps(page, workbench)
    go(page, "export")
    expect(page.locator('#exports a[href="/files/improved/report.html"]')).to_be_visible()
    assert barriers(page) == []
