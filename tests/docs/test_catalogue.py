"""The catalogue of effects has all of the library, with their laws, pictures and sources."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from docs.site.catalogue import write_catalogue
from identification.discovery.effects import find_effects


def test_every_effect_has_its_law_its_source_and_a_picture_if_it_is_a_curve(tmp_path: Path) -> None:
    write_catalogue(tmp_path)
    text = (tmp_path / "effects.md").read_text(encoding="utf-8")
    entries = {
        (kind, entry.splitlines()[0]): entry
        for kind, part in zip(
            ("rotational", "translational", "signal"), text.split("\n## ")[1:], strict=True
        )
        for entry in part.split("\n### ")[1:]
    }
    effects = find_effects()
    assert set(entries) == {(e.kind, e.name) for e in effects}
    pictures = 0
    for effect in effects:
        entry = entries[effect.kind, effect.name]
        assert effect.description in entry
        assert "```modelica\n" in entry
        for parameter in effect.parameters:
            assert f"| `{parameter.name}` |" in entry
        svg = tmp_path / f"{effect.kind}-{effect.name}.svg"
        assert svg.exists() == (f"]({svg.name})" in entry)
        if svg.exists():
            ElementTree.parse(svg)
            pictures += 1
        assert svg.exists() or effect.has_memory or effect.jumps or "no single curve" in entry
    assert pictures > 30
