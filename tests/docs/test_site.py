"""The documentation as it is built: whole, and open to everyone."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import twinproof
from identification.discovery.effects import find_effects
from twinproof.cli import command

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "docs.site", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "docs"


@pytest.mark.slow
def test_the_reference_has_everything(site: Path) -> None:
    reference = site / "docs" / "reference"
    commands = (reference / "commands.html").read_text(encoding="utf-8")
    for name in command.list_commands(None):  # type: ignore[arg-type]
        assert f'id="twinproof-{name}"' in commands, name
    python = (reference / "python.html").read_text(encoding="utf-8")
    for name in set(twinproof.__all__) - {"calibration"}:
        assert f'id="twinproof.{name}"' in python, name
    effects = (reference / "effects.html").read_text(encoding="utf-8")
    for effect in find_effects():
        assert effect.name in effects


@pytest.mark.slow
@pytest.mark.parametrize("name", ["index", "README", "docs/tutorial", "docs/reference/effects"])
def test_nothing_keeps_people_out(site: Path, name: str) -> None:
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no chromium")
    from playwright.sync_api import sync_playwright

    from tests.accessibility import barriers

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.goto((site / f"{name}.html").as_uri())
        assert barriers(page) == []
        browser.close()
