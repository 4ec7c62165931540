"""The pages in a real browser, of a desk's width and of a phone's."""

import shutil
import threading

import pytest
from scripted import drift, scripted_service, settle

from tests.accessibility import barriers
from twin.api import make_app, served
from twin.tokens import Tokens, add_token, read_tokens

PHONE = {"width": 390, "height": 844}
DESK = {"width": 1280, "height": 900}


@pytest.fixture(scope="module")
def browser():
    if shutil.which("chromium") is None:
        pytest.skip("no chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        yield found
        found.close()


class Rounds:
    """Lets a scripted service live on while a browser looks."""

    def __init__(self, service):
        self.service = service
        self.values = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._stop.wait(0.05):
            self.service.clock.now += 0.05
            for monitor in self.service.monitors.values():
                monitor.pipeline.at(self.service.clock.now - 0.01, **self.values)
            self.service._next.clear()
            self.service.step()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()


@pytest.fixture
def site(tmp_path):
    with scripted_service(tmp_path, ("robot", "crane")) as service:
        settle(service)
        with served(make_app(service, Tokens())) as server, Rounds(service) as rounds:
            yield server.url, service, rounds, server


@pytest.fixture
def page(browser):
    context = browser.new_context(viewport=DESK)
    found = context.new_page()
    found.set_default_timeout(15_000)
    faults = []
    found.on("pageerror", lambda error: faults.append(str(error)))
    found.on("console", lambda m: faults.append(m.text) if "Content Security" in m.text else None)
    yield found
    context.close()
    assert faults == []


def wait_for_text(page, selector, text):
    page.locator(selector).filter(has_text=text).first.wait_for()


def fits(page):
    return page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_the_live_page_follows_a_drift_to_a_closed_gate(page, site):
    base, service, rounds, _ = site
    page.goto(f"{base}/pages/twin?name=robot")
    wait_for_text(page, "#gate-word", "open")
    assert page.locator("[data-parameter]").count() == 3
    assert "0.5 ± 0.01 kg.m2" in page.locator("[data-parameter=J]").inner_text()
    assert page.locator("[data-parameter=J] rect.bar.far").count() == 0
    for kind in ("measured", "predicted", "residual"):
        drawn = page.locator(f"[data-channel=theta] path.{kind}").get_attribute("d")
        assert drawn.count("L") > 100
        assert "NaN" not in drawn
    assert "1.5 of 5" in page.locator("[data-test=J]").inner_text()
    rounds.values = {"J": 0.6}
    service.monitor("robot").feed([drift(service.clock.now)])
    wait_for_text(page, "#gate-word", "closed")
    wait_for_text(page, "#gate-because", "J drifted")
    page.locator("[data-parameter=J] rect.bar.far").wait_for()


def test_a_service_that_is_gone_is_not_shown_as_open(page, site):
    base, _, _, server = site
    page.goto(f"{base}/pages/twin?name=robot")
    wait_for_text(page, "#gate-word", "open")
    server.end()
    wait_for_text(page, "#gate-word", "unknown")
    wait_for_text(page, "#connection", "no connection")


def test_the_fleet_and_the_events(page, site):
    base, service, _, _ = site
    page.goto(base)
    wait_for_text(page, "[data-twin=crane] .word", "open")
    service.monitor("crane").feed([drift(service.clock.now, "mgl", "crane")])
    wait_for_text(page, "[data-twin=crane] .word", "closed")
    assert page.locator("[data-twin=robot] .word").inner_text() == "open"
    page.locator("[data-twin=crane] a").click()
    wait_for_text(page, "#gate-because", "mgl drifted")
    page.locator("#events-link").click()
    page.locator("[data-kind=drift]").wait_for()
    wait_for_text(page, "#audit", "The log is whole")
    kinds = page.locator("#events > li").evaluate_all("all => all.map((e) => e.dataset.kind)")
    assert kinds[:2] == ["gate", "drift"]
    page.locator("#kind").select_option("promoted")
    page.locator("[data-kind=drift]").wait_for(state="detached")
    page.locator("[data-kind=promoted]").wait_for()
    assert page.locator("#events > li").count() == 1
    page.locator("#twin").select_option("")
    wait_for_text(page, "#events", "robot")


@pytest.mark.parametrize("path", ["/", "/pages/twin?name=robot", "/pages/events"])
def test_pages_fit_a_phone(page, site, path):
    page.set_viewport_size(PHONE)
    page.goto(site[0] + path)
    page.locator("li, [data-parameter]").first.wait_for()
    assert fits(page)
    small = page.locator("button:visible, select:visible").evaluate_all(
        "all => all.filter((e) => e.getBoundingClientRect().height < 40).length"
    )
    assert small == 0


@pytest.mark.parametrize("path", ["/", "/pages/twin?name=robot", "/pages/events"])
def test_nothing_keeps_people_out_in_light_or_dark(page, site, path):
    page.goto(site[0] + path)
    page.locator("li, [data-parameter]").first.wait_for()
    assert barriers(page) == []


def test_a_token_is_asked_for_where_one_is_needed(page, tmp_path):
    secret = add_token(tmp_path / "tokens.toml", "eyes", ["read"])
    with scripted_service(tmp_path) as service:
        settle(service)
        app = make_app(service, read_tokens(tmp_path / "tokens.toml"))
        with served(app) as server, Rounds(service):
            page.goto(f"{server.url}/pages/twin?name=robot")
            page.locator("#token input").fill("guess")
            page.locator("#token button").click()
            page.locator("#token input").fill(secret)
            page.locator("#token button").click()
            wait_for_text(page, "#gate-word", "open")
            page.goto(server.url)
            wait_for_text(page, "[data-twin=robot] .word", "open")


def test_a_twin_that_is_not_there_is_said(page, site):
    page.goto(f"{site[0]}/pages/twin?name=nobody")
    wait_for_text(page, "#connection", "unknown twin 'nobody'")
