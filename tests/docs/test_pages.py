"""The documentation's pages: every link leads somewhere, every example runs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
)
# Made when the documentation is built; what is in them is asserted in test_site.
MADE = ("reference/commands.md", "reference/python.md", "reference/effects.md")
_LINK = re.compile(r"(?<!`)!?\[[^\]]*\]\(([^)\s]+)\)")
_FENCE = re.compile(
    r"(?:<!-- file: (?P<file>\S+) -->\n|(?P<elsewhere><!-- run by \S+ -->)\n)?"
    r"^```(?P<kind>\w*)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
RUN = (
    "tutorial",
    *(f"how-to/{n}" for n in ("own-model", "own-effect", "can-log", "notebook", "co-simulation")),
    *(f"how-to/{n}" for n in ("foreign-fmu", "fleet")),
)
NEEDS_DATA = ("tutorial", "how-to/notebook")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts and Sphinx make them."""
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_link_leads_somewhere(page: Path) -> None:
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in _LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            assert link.startswith("https://"), link
            continue
        target, _, anchor = link.partition("#")
        path = (page.parent / target).resolve() if target else page
        if path.as_posix().endswith(MADE):
            continue
        assert path.exists(), f"{page.name}: {link}"
        assert not anchor or anchor in anchors(path), f"{page.name}: {link}"


@pytest.mark.parametrize("name", RUN)
def test_every_example_runs(name: str, tmp_path: Path) -> None:
    if name in NEEDS_DATA and not os.environ.get("TWINPROOF_DATA"):
        pytest.skip("needs TWINPROOF_DATA")
    page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    main = "-c 'from twinproof.cli import main; main()'"
    (tmp_path / "bin").mkdir()
    for command, words in (("twinproof", main), ("python", "")):
        script = tmp_path / "bin" / command
        script.write_text(f"#!/bin/sh\nexec '{sys.executable}' {words} \"$@\"\n")
        script.chmod(0o755)
    work = tmp_path / "work"
    work.mkdir()
    shell, python, ran = ["set -euo pipefail"], [], 0
    for fence in _FENCE.finditer(page):
        if fence["file"]:
            path = work / fence["file"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(fence["text"])
        elif fence["elsewhere"]:
            continue
        elif fence["kind"] == "sh":
            shell.append(fence["text"])
            ran += 1
        elif fence["kind"] == "python":
            python.append(fence["text"])
            ran += 1
    assert ran >= 1
    if python:
        (work / "page.py").write_text("\n".join(python))
        shell.append("python page.py")
    environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    environment["PYTHONPATH"] = f"{ROOT}:{environment.get('PYTHONPATH', '')}"
    done = subprocess.run(
        ["bash", "-c", "\n".join(shell)],
        cwd=work,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
