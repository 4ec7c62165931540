"""What the form shows beside its fields: the model, the record, and how they fit together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from foundation.errors import TwinproofError
from foundation.units import factor_and_offset
from recordings import Samples, fetch, list_sets, load_signals, parse_map
from recordings.channel_map import ChannelSource
from recordings.readers import RawTable, reader_for
from recordings.readers import Request as SignalRequest
from twinproof.model import Model
from twinproof.workbench import curves, mapping
from twinproof.workbench.project import Project

_PREVIEW = 240
_MOST_COLUMNS = 400


def look(project: Project) -> dict[str, Any]:
    """Return what there is to see of the chosen model and records, with what is wrong, by field."""
    choices = project.choices
    errors: dict[str, dict[str, str]] = {}
    found: dict[str, Any] = {"errors": errors}
    model: Model | None = None
    libraries: tuple[Path, ...] = ()
    try:
        libraries = project.library_folders()
    except TwinproofError as error:
        errors["libraries"] = said(error)
    if choices.model:
        try:
            model = Model.of(choices.model, libraries)
            found["model"] = _model(model)
        except TwinproofError as error:
            model = None
            errors["model"] = said(error)
    if not _is_horizon(choices.horizon):
        errors["horizon"] = {
            "what": f"the horizon '{choices.horizon}' is not usable",
            "where": choices.horizon,
            "remedy": "write auto, free, or a length in seconds",
        }
    sets = {s.name: s for s in list_sets()}
    words = [("recording", choices.recording), ("holdout", choices.holdout)]
    words += [("also", word) for word in choices.also_words]
    for number, (field, word) in enumerate(words):
        if not word:
            continue
        if field == "also" and word in [earlier for _, earlier in words[:number]]:
            errors.setdefault("also", _given_twice(word))
            continue
        try:
            dbc = project.folder / choices.dbc if choices.dbc else None
            if dbc is not None and not dbc.is_file():
                errors["dbc"] = {
                    "what": "no such file",
                    "where": choices.dbc,
                    "remedy": "upload it",
                }
                dbc = None
            table, own = _open(project, word, dbc, set(sets))
            record = _record(project, table, own, model, dbc, word, errors, field)
            if field == "recording":
                found[field] = record
            elif all(not row["error"] for row in found.get("recording", {}).get("rows", [])):
                _say_at_field(record, word, errors, field)
        except TwinproofError as error:
            errors.setdefault(field, said(error))
    return found


def _is_horizon(word: str) -> bool:
    if word in ("auto", "free"):
        return True
    try:
        return 0.0 < float(word) < float("inf")
    except ValueError:
        return False


def _given_twice(word: str) -> dict[str, str]:
    return {
        "what": f"{word} is given twice",
        "where": word,
        "remedy": "give each record once, and the unseen one here never",
    }


def _say_at_field(
    record: Mapping[str, Any], word: str, errors: dict[str, dict[str, str]], field: str
) -> None:
    """Say what is wrong with a channel of a record whose rows are not shown."""
    for row in record.get("rows", []):
        if row["error"]:
            what = f"{row['name']} in {word}: {row['error']}"
            errors.setdefault(field, {"what": what, "where": word, "remedy": ""})


def said(error: TwinproofError) -> dict[str, str]:
    """Return an error as the page shows it."""
    return {"what": error.what, "where": error.where, "remedy": error.remedy}


def _model(model: Model) -> dict[str, Any]:
    dae = model.dae
    return {
        "name": dae.name,
        "inputs": [_variable(v) for v in dae.inputs],
        "outputs": [_variable(v) for v in dae.outputs],
        "places": [
            {"name": p.name, "kind": p.kind, "unit": p.unit, "description": p.description}
            for p in model.places
        ],
        "has_equations": model.modelica is not None,
    }


def _variable(variable: Any) -> dict[str, str]:
    return {
        "name": variable.name,
        "unit": variable.unit,
        "description": variable.description,
    }


def _open(
    project: Project, word: str, dbc: Path | None, sets: set[str]
) -> tuple[RawTable, Mapping[str, ChannelSource]]:
    """Open a record as its file has it, with the channel map that a data set brings along."""
    path = project.folder / word
    if path.is_file() or word not in sets:
        if not path.is_file():
            # The same message, with the nearest names, as on the command line.
            load_signals(path if path.suffix or "/" in word else word)
        return reader_for(path).read(path, dbc=dbc), {}
    files = fetch(word)
    own = next(s.map_text for s in list_sets() if s.name == word)
    return reader_for(files.data).read(files.data, dbc=dbc or files.dbc), parse_map(own).channels


def _record(
    project: Project,
    table: RawTable,
    own: Mapping[str, ChannelSource],
    model: Model | None,
    dbc: Path | None,
    word: str,
    errors: dict[str, dict[str, str]],
    field: str,
) -> dict[str, Any]:
    names = list(table.names)
    found: dict[str, Any] = {"columns": names[:_MOST_COLUMNS], "all": len(names)}
    if model is None:
        return found
    tables = mapping.read_tables(project.map_file)
    said_of: dict[str, dict[str, Any]] = tables.get("channels", {})
    variables = {v.name: v for v in (*model.dae.inputs, *model.dae.outputs)}
    rows: list[dict[str, Any]] = []
    sources: dict[str, str] = {}
    for name, variable in variables.items():
        typed = said_of.get(name, {})
        given = own.get(name, ChannelSource())
        source = str(typed.get("source") or given.source or name)
        unit = str(typed.get("unit") or given.unit or "")
        row: dict[str, Any] = {
            **_variable(variable),
            "kind": "input" if variable in model.dae.inputs else "output",
            "source": source if source in names else "",
            "recorded_unit": unit,
            "units": mapping.units_for(variable.unit),
            "typed": {k: str(v) for k, v in typed.items()},
            "error": "",
        }
        if source not in names and ("source" in typed or given.source):
            row["error"] = table.missing(source).what + "; " + table.missing(source).remedy
        rows.append(row)
        if source in names:
            sources[name] = source
            if not unit:
                row["file_unit"] = _unit_in_file(table, source)
            _check_unit(row, unit or row.get("file_unit") or "", variable.unit)
    suggested = mapping.suggest(
        {n: (v.unit, v.description) for n, v in variables.items() if n not in sources},
        {c: None for c in names[:_MOST_COLUMNS] if c not in sources.values() and c != "time"},
    )
    for row in rows:
        row["suggested"] = suggested.get(row["name"], "")
        if row["kind"] == "input" and row["name"] not in sources and not row["error"]:
            row["error"] = "the model needs this input: say which column it is"
    found["rows"] = rows
    found["unknown"] = [n for n in said_of if n not in variables]
    found["time"] = {k: str(v) for k, v in dict(tables.get("time", {})).items()}
    if sources and not any(row["error"] for row in rows if row["name"] in sources):
        _preview(project, found, rows, model, dbc, word, errors, field)
    return found


def _unit_in_file(table: RawTable, source: str) -> str:
    try:
        return table.signals([SignalRequest(source)])[0].unit or ""
    except TwinproofError:
        # Said by the preview, with more to go by.
        return ""


def _check_unit(row: dict[str, Any], unit: str, wanted: str) -> None:
    if unit and wanted:
        try:
            factor_and_offset(unit, wanted)
        except TwinproofError as error:
            row["error"] = f"{error.what}; choose another unit or column"


def _preview(
    project: Project,
    found: dict[str, Any],
    rows: list[dict[str, Any]],
    model: Model,
    dbc: Path | None,
    word: str,
    errors: dict[str, dict[str, str]],
    field: str,
) -> None:
    try:
        path = project.folder / word
        signals = load_signals(
            path if path.is_file() else word,
            variables=model.variables,
            channel_map=project.map_file if project.map_file.is_file() else None,
            dbc=dbc,
            inputs=[v.name for v in model.dae.inputs],
        )
    except TwinproofError as error:
        # Beside the row that it speaks of; else beside the file.
        text = f"{error.what} {error.where}"
        for row in rows:
            if f"'{row['source']}'" in text or f"[channels.{row['name']}]" in text:
                row["error"] = f"{error.what}; {error.remedy}"
                return
        errors["time" if "time" in text and "column" in text else field] = said(error)
        return
    found["notes"] = list(signals.notes)
    for row in rows:
        samples = signals.samples.get(row["name"])
        if samples is not None:
            row["preview"] = preview(samples)


def preview(samples: Samples) -> dict[str, Any]:
    """Return a signal as a small picture's points, and what there is of it."""
    time, values = samples.time, samples.values
    if len(values) > _PREVIEW:
        edges = np.linspace(0, len(values), _PREVIEW // 2 + 1).astype(int)[:-1]
        shown = curves.thin_time(time, edges), curves.extremes(values, edges)
    else:
        shown = time, values
    finite = values[np.isfinite(values)]
    return {
        "t": [round(float(t), 6) for t in shown[0]],
        "y": [float(f"{v:.4g}") if np.isfinite(v) else None for v in shown[1]],
        "samples": len(values),
        "begin": float(time[0]),
        "end": float(time[-1]),
        "least": float(np.min(finite)) if len(finite) else None,
        "most": float(np.max(finite)) if len(finite) else None,
    }
