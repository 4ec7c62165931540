"""The page around a report's content: template, provenance, one whole file."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from foundation.files import write_text
from identification.problem import Problem
from twinproof.report.numbers import quantity, significant, with_unit
from twinproof.report.picture import Picture, unit_of

_TEMPLATES = Path(__file__).parent / "templates"
STYLE_SHEET = _TEMPLATES / "style.css"
_PACKAGES = ("twinproof", "rumoca", "casadi", "numpy", "scipy")


@dataclass(frozen=True)
class Provenance:
    """How a report was made.

    Attributes:
        command: That repeats it.
        horizon: The rule by which errors were computed.
        records: Caption → facts of one record.
        notes: What was ignored or assumed while reading and matching.
        versions: Package → version.
        made: When, UTC.
    """

    command: str
    horizon: str
    records: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...]
    versions: Mapping[str, str]
    made: str


def provenance(
    command: str, horizon: str, records: Mapping[str, Problem], notes: Sequence[str]
) -> Provenance:
    """Gather what a reader needs to repeat a report."""
    own = [note for problem in records.values() for note in problem.notes]
    return Provenance(
        command,
        horizon,
        {caption: record_facts(problem) for caption, problem in records.items()},
        tuple(dict.fromkeys((*notes, *own))),
        versions(),
        datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )


def record_facts(problem: Problem) -> tuple[str, ...]:
    """Return size, inputs and outputs of a record, in a line each."""
    n, h = len(problem.time), problem.sample_time
    facts = [
        f"{n} samples, one every {quantity(h, 's')}: {significant(float(problem.time[-1]), 4)} s",
    ]
    for k, variable in enumerate(problem.dae.inputs):
        low, high = float(np.min(problem.inputs[:, k])), float(np.max(problem.inputs[:, k]))
        facts.append(f"input {variable.name}: {_span(low, high, variable.unit)}")
    for k, name in enumerate(problem.output_names):
        unit = unit_of(problem, name)
        low, high = float(np.min(problem.outputs[:, k])), float(np.max(problem.outputs[:, k]))
        sd = float(problem.noise_sd[k])
        noise = f"sensor noise {quantity(sd, unit, 2)}" if np.isfinite(sd) else "sensor not known"
        facts.append(f"output {name}: {_span(low, high, unit)}; {noise}")
    return tuple(facts)


def _span(low: float, high: float, unit: str) -> str:
    return with_unit(f"{significant(low)} to {significant(high)}", unit)


def versions() -> dict[str, str]:
    """Return the versions of what a result depends on."""
    found = {"Python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def render(template: str, **context: object) -> str:
    """Fill a template; pictures in the context become inline SVG by the macro `figure`."""
    style = Markup(STYLE_SHEET.read_text(encoding="utf-8"))
    return _environment().get_template(template).render(style=style, svg=_svg, **context)


def write_page(path: Path, template: str, **context: object) -> None:
    """Fill a template and write it, whole or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    write_text(path, render(template, **context))


def _svg(picture: Picture) -> Markup:
    return Markup(picture.svg)
