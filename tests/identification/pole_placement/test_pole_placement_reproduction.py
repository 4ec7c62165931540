"""The dissertation's page is written whole, with every picture it shows."""

import re

import pytest

from docs.reproduce.balancing_robot import write


@pytest.mark.slow
def test_the_page(tmp_path):
    page = write(tmp_path / "out", runs=1, better_runs=1)
    text = page.read_text()
    pictures = re.findall(r"\]\(balancing-robot/([\w-]+\.svg)\)", text)
    assert len(pictures) == len(set(pictures)) == 11
    folder = page.with_suffix("")
    for name in pictures:
        assert (folder / name).read_text().lstrip().startswith("<?xml")
    assert sorted(p.name for p in folder.iterdir()) == sorted(pictures)
    for heading in ("(2.15)–(2.17)", "Table 3.1, subsystem 1", "Table 3.1, subsystem 2", "on-line"):
        assert heading in text
    # Column (initial) is the print, to its last digit but one.
    row = text.split("(initial) model")[1].splitlines()[1]
    assert "0.2427 | 0.5317 | 0.0025 | 0.0511 | 42.33" in row
    assert "nan" not in text
