"""What the page shows of a project, as JSON."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from recordings import list_sets
from twinproof.workbench.project import UPLOADS, Project
from twinproof.workbench.worker import Job

RESULTS = ("compare", "diagnose", "change", "ladder", "improve", "export")
"""What can have been answered."""
_PLANTS = "Twinproof.Plants."


def state(project: Project, job: Job | None, *, looking: bool) -> dict[str, Any]:
    """Return everything that the page shows, without curves and pieces of page.

    Args:
        project: The folder.
        job: The task that runs, or ran last.
        looking: `look` is not yet that of what is chosen.
    """
    choices = project.choices
    question = project.question()
    results: dict[str, Any] = {}
    for name in RESULTS:
        found = project.result(name)
        if found is not None:
            path = project.results / f"{name}.html"
            results[name] = {
                "stamp": path.stat().st_mtime_ns if path.exists() else 0,
                "stale": found.get("made_with") != question,
                "command": found.get("command", ""),
                **_shown(name, found),
            }
    look = project.cache / "look.json"
    return {
        "folder": str(project.folder),
        "choices": asdict(choices),
        "present_model": choices.present_model,
        "look": json.loads(look.read_text(encoding="utf-8")) if look.is_file() else None,
        "results": results,
        "job": None if job is None else asdict(job),
        "looking": looking,
        "commands": _commands(project),
        "models": [*_library(), *project.files("models", (".mo", ".fmu"))],
        "recordings": [
            *(s.name for s in list_sets()),
            *project.files("recordings", [e for e in UPLOADS["recordings"] if e != ".dbc"]),
        ],
        "dbcs": project.files("recordings", (".dbc",)),
        "exports": exports(project),
    }


def _library() -> list[str]:
    from modelica import LIBRARY  # noqa: PLC0415 - a constant, but its package is imported late

    plants = LIBRARY / "Plants"
    return sorted(_PLANTS + p.stem for p in plants.glob("*.mo") if p.stem != "package")


def _shown(name: str, found: Mapping[str, Any]) -> dict[str, Any]:
    if name == "diagnose":
        refitted = [row for row in found["ranking"] if row["refitted"]]
        candidates = [
            ",".join(
                [
                    f"{row['effect']}@{row['place']}",
                    *(f"{k}={p['value']:.6g}" for k, p in row["parameters"].items()),
                ]
            )
            for row in refitted
        ]
        proposal = found.get("proposal")
        return {
            "verdict": found["verdict"],
            "candidates": candidates + ([proposal["add"]] if proposal else []),
        }
    if name == "compare":
        return {"records": [record["data"] for record in found.get("records", [])]}
    if name == "change":
        return {key: found[key] for key in ("label", "name", "before", "after")}
    return {}


def _commands(project: Project) -> list[str]:
    choices = project.choices
    if not choices.model or not choices.recording:
        return []
    lines = [project.command("compare", recording=word) for word in choices.fitted_words]
    lines += [project.command(name) for name in ("identify", "diagnose")]
    if choices.steps:
        step = choices.steps[-1]
        # A name of its own: the accepted file has fitted values of the model's own parameters too.
        path = f"{step.model.rpartition(':')[2]}.mo"
        added = "".join(f" --add {text}" for text in step.additions)
        libraries = "".join(f" {shlex.quote(word)}" for word in project.library_options())
        lines.append(f"twinproof extend {choices.model}{added}{libraries} -o {path}")
    if choices.holdout:
        lines.append(
            project.command(
                "improve",
                model=choices.model,
                more=["--holdout", choices.holdout, "-o", "improved"],
            )
        )
    return lines


def exports(project: Project) -> list[str]:
    """Return the files that are there to be kept, relative to the project's folder."""
    improved = project.folder / "improved"
    found = [
        f"improved/{path.name}"
        for path in sorted(improved.glob("*"))
        if path.is_file() and not path.name.startswith(".")
    ]
    return [*project.files("models", (".mo", ".fmu")), *found]
