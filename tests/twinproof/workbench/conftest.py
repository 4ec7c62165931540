"""A workbench that runs as a user starts it, and a browser."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from shutil import which

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

# The first task waits for the imports of a process that has just been started.
expect.set_options(timeout=30_000)

START = "from twinproof.cli import main; main()"


@dataclass(frozen=True)
class Running:
    """A running workbench."""

    url: str
    folder: Path

    def clear(self) -> None:
        """Empty the project of the tests before; nothing may be running."""
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


@pytest.fixture(scope="module")
def workbench(tmp_path_factory: pytest.TempPathFactory) -> Generator[Running]:
    """One for all tests of a module: starting takes seconds."""
    tmp_path = tmp_path_factory.mktemp("workbench")
    process = subprocess.Popen(
        [sys.executable, "-c", START, "workbench", str(tmp_path), "--port", "0", "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:\d+/", line)
    assert found, line
    try:
        yield Running(found[0], tmp_path)
    finally:
        process.terminate()
        process.wait(timeout=10)
        process.stdout.close()


@pytest.fixture(scope="session")
def browser() -> Generator[Browser]:
    chromium = which("chromium")
    if chromium is None:
        pytest.skip("no chromium")
    with sync_playwright() as playwright:
        # CI runs as root in a container, where Chromium's sandbox cannot be had.
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Browser, workbench: Running) -> Generator[Page]:
    """A page that must not complain on its console."""
    workbench.clear()
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    page = context.new_page()
    page.set_default_timeout(60_000)
    # A refused request is what the page is about in some tests: it is shown beside a field.
    page.on(
        "console",
        lambda m: (
            complaints.append(m.text)
            if m.type in ("error", "warning") and "status of 422" not in m.text
            else None
        ),
    )
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(workbench.url)
    yield page
    context.close()
    assert complaints == []
