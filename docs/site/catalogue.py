"""The effects' catalogue, made from the Modelica library: formula, parameters, curve, source."""

from __future__ import annotations

import html as entities
import re
from pathlib import Path

import numpy as np

from fmus.frontend import load
from fmus.sources import library_class
from foundation.errors import TwinproofError
from identification.discovery.characteristic import characteristic
from identification.discovery.effects import Effect, find_effects
from modelica import LIBRARY
from twinproof.report.notebook import standalone
from twinproof.report.numbers import typeset
from twinproof.report.picture import Picture, limits
from twinproof.report.svg import Role, figure, inline

_EQUATION = re.compile(r"^equation\b(.*?)^\s*(?:annotation|end)\b", re.DOTALL | re.MULTILINE)
_ALGORITHM = re.compile(r"^algorithm\b(.*?)^\s*(?:annotation|end)\b", re.DOTALL | re.MULTILINE)
_INFO = re.compile(r"<p>(.*?)</p>", re.DOTALL)
_WORK = re.compile(r"<li>(.*?)</li>", re.DOTALL)
_RANGES = {"rotational": 3.0, "translational": 0.5, "signal": 2.0}
_ANY = load(library_class("Twinproof.Plants.Pendulum"))
_KINDS = {
    "rotational": "Torques, on what turns",
    "translational": "Forces, on what slides",
    "signal": "In series with an input or an output",
}


def write_catalogue(folder: Path) -> None:
    """Write `effects.md` and one picture an effect."""
    lines = [
        "# Effects",
        "",
        "Made from the Modelica library when this documentation is built. With its default",
        "parameters an effect is absent. Forces and torques are what the machine spends on the",
        "effect, so that a passive effect opposes motion with positive parameters. The pictures",
        "are evaluated from the classes, main parameters at their typical size.",
        "",
    ]
    effects = find_effects()
    for kind, title in _KINDS.items():
        lines += [f"## {title}", ""]
        for effect in sorted((e for e in effects if e.kind == kind), key=lambda e: e.name):
            lines += _entry(effect, folder)
    (folder / "effects.md").write_text("\n".join(lines), encoding="utf-8")


def _entry(effect: Effect, folder: Path) -> list[str]:
    text = _source(effect).read_text(encoding="utf-8")
    info, _, works = text.partition("<h4>Reference</h4>")
    found = _EQUATION.search(text) or _ALGORITHM.search(text)
    assert found is not None, f"{effect.class_name} has no equation"
    law = "\n".join(line.removeprefix("  ") for line in found[1].strip("\n").splitlines())
    anchor = f"({effect.kind}-{effect.name.lower()})="
    lines = [anchor, f"### {effect.name}", "", f"{effect.description}.", ""]
    if not effect.searched:
        lines += ["Added by name; the search leaves it out.", ""]
    elif effect.empirical:
        lines += ["A curve without a name in physics: proposed where no law explains the data.", ""]
    lines += ["```modelica", law, "```", ""]
    lines += ["| parameter | unit | default | what |", "|---|---|---|---|"]
    for parameter, default in zip(effect.parameters, effect.defaults, strict=True):
        fitted = " (not fitted)" if parameter.known else ""
        lines.append(
            f"| `{parameter.name}` | {typeset(parameter.unit)} | {default:g} "
            f"| {parameter.description}{fitted} |"
        )
    lines.append("")
    picture = _picture(effect)
    if picture is not None:
        name = f"{effect.kind}-{effect.name}.svg"
        (folder / name).write_text(standalone(picture), encoding="utf-8")
        lines += [f"![{picture.description}]({name})", ""]
    else:
        lines += ["It has a memory of the motion, or acts over time: no single curve shows it.", ""]
    paragraphs = [_plain(p) for p in _INFO.findall(info)]
    lines += [paragraph + "\n" for paragraph in paragraphs]
    cited = [f"- {_plain(work)}" for work in _WORK.findall(works)]
    lines += ["Source:", "", *cited, ""] if cited else []
    return lines


def _source(effect: Effect) -> Path:
    return LIBRARY.parent.joinpath(*effect.class_name.split(".")).with_suffix(".mo")


def _plain(text: str) -> str:
    """Return a sentence of a Modelica documentation as Markdown."""
    text = re.sub(r"</?(code|tt)>", "`", text.replace('\\"', '"'))
    text = re.sub(r"</?em>", "*", text)
    text = re.sub(r"<[^>]*>", "", text)
    return " ".join(entities.unescape(text).split())


def _picture(effect: Effect) -> Picture | None:
    values = dict(zip((p.name for p in effect.parameters), effect.defaults, strict=True))
    for parameter in effect.parameters:
        if parameter.name in effect.main_parameters:
            # What a class says of a parameter's own size needs no other parameter.
            values[parameter.name] = _ANY.number(parameter.nominal, 1.0) or 1.0
    reach = _RANGES[effect.kind]
    try:
        curve = characteristic(effect, values, -reach, reach)
    except TwinproofError:
        return None
    if not np.any(curve.y):
        return None
    unit = {"rotational": "N·m", "translational": "N", "signal": "unit of the signal"}[effect.kind]
    what = {"rotational": "torque", "translational": "force", "signal": "what it adds"}[effect.kind]
    across = typeset(curve.variable.unit) if curve.variable.unit else "unit of the signal"
    with figure(2.4, 5.2) as drawn:
        ax = drawn.subplots()
        ax.axhline(0.0, color=Role.MUTED.value, lw=0.6)
        ax.plot(curve.x, curve.y, color=Role.LAST.value, lw=1.8)
        limits(ax, curve.y, room=0.15)
        ax.set_xlabel(f"{curve.variable.words} [{across}]")
        ax.set_ylabel(f"{what} [{unit}]")
        svg = inline(drawn, effect.name)
    return Picture(svg, f"{effect.name} over {curve.variable.words}", "")
