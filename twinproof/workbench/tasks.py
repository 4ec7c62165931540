"""What takes long: every task reads the project's files, and writes its answer among them."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.package import export as export_fmu
from foundation.errors import InputError, TwinproofError
from foundation.files import write_text
from foundation.progress import Progress
from identification.comparison import Comparison
from identification.discovery.extension import ExtendedModel, extend, text_diff
from identification.estimate import Estimate
from identification.prediction import WINDOW
from identification.problem import Problem
from recordings import Recording
from twinproof import api, documents
from twinproof.answers import Compared, FittedRecord
from twinproof.model import Model
from twinproof.report import pieces
from twinproof.report.picture import unit_of
from twinproof.results import write_improvement
from twinproof.workbench import curves
from twinproof.workbench.look import look as look_at
from twinproof.workbench.project import Project

Task = Callable[[Project, Mapping[str, str], Progress], None]


_FIELD_OF = {"--horizon": "horizon", "--max-effects": "max_effects"}


class FieldError(Exception):
    """A user's mistake, and the field of the form that it belongs to."""

    def __init__(self, field: str, error: TwinproofError) -> None:
        super().__init__(str(error))
        self.field = field
        self.error = error


@contextmanager
def of_field(field: str) -> Generator[None]:
    """Name the field that mistakes met inside belong to."""
    try:
        yield
    except TwinproofError as error:
        raise FieldError(field, error) from error


def look(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Look at what was chosen."""
    progress("reading what was chosen")
    found = look_at(project)
    write_text(project.cache / "look.json", documents.dumps(found))


def compare(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Compare the present model with every record."""
    model, recordings = _present(project, progress)
    words = project.choices.fitted_words
    results: list[Compared] = []
    for word, recording in zip(words, recordings, strict=True):
        progress(f"simulating {word}")
        results.append(api.compare(model, recording, horizon=project.choices.horizon))
    # One measure for all records: free simulation only where every one stays bounded.
    length = next((found.horizon for found in results if found.horizon is not None), None)
    results = [
        found if found.horizon == length else api.compare(model, recording, horizon=length)
        for found, recording in zip(results, recordings, strict=True)
    ]
    records = [
        FittedRecord(word, found.problem, found.comparison, found.horizon)
        for word, found in zip(words, results, strict=True)
    ]
    _write_comparison(
        project,
        {
            **documents.compared(results[0]),
            "records": [documents.fitted_record(record) for record in records],
            "command": project.command("compare"),
        },
        records,
        None,
        progress,
    )


def identify(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Fit the present model's parameters, then compare."""
    model, recordings = _present(project, progress)
    progress("fitting the parameters")
    result = api.identify(model, recordings, horizon=project.choices.horizon)
    words = project.choices.fitted_words
    _write_comparison(
        project,
        {**documents.identified(result), "command": project.command("identify")},
        [replace(record, origin=word) for word, record in zip(words, result.records, strict=True)],
        result.estimate,
        progress,
    )


def diagnose(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Find out what the present model lacks."""
    model, recordings = _present(project, progress)
    result = api.diagnose(model, recordings, progress=progress)
    progress("drawing")
    project.write_result(
        "diagnose",
        {**documents.diagnosed(result), "command": project.command("diagnose")},
        pieces.diagnosis_piece(result.diagnosis, result.problem),
    )


def propose(project: Project, arguments: Mapping[str, str], progress: Progress) -> None:
    """Write the model with one more effect, refit it, and show what changes."""
    choices = project.choices
    present, records = _present(project, progress)
    base = _model(project, choices.model)
    earlier = choices.steps[-1].additions if choices.steps else ()
    number = len(choices.steps) + 1
    with of_field("add"):
        text = arguments.get("add", "").strip()
        if not text:
            raise InputError("nothing to add", remedy="choose an effect, or write EFFECT@PLACE")
        name = f"{base.source.short_name}_{number}"
        extended = api.extend(base, [*earlier, text], name=name)
    progress("fitting the model as it is")
    before = api.identify(present, records, horizon=choices.horizon)
    progress(f"fitting it with {text.partition(',')[0]}")
    with_effect = Model.of(extended)
    after = api.identify(with_effect, records, horizon=before.horizon)
    short: tuple[Comparison, Comparison] | None = None
    if after.horizon is None:
        progress("comparing over windows of 1 s")
        first, second = (
            api.compare(one, records[0], parameters=found.estimate.values, horizon=WINDOW)
            for one, found in ((present, before), (with_effect, after))
        )
        short = first.comparison, second.comparison
    fitted = with_estimate(extended, after.estimate)
    difference = text_diff(present.source.written, fitted)
    proposal = {
        "additions": [_spelled(a.label, a.values) for a in fitted.additions],
        "label": text.partition(",")[0],
        "name": name,
        "before": before.comparison.nrmse,
        "after": after.comparison.nrmse,
    }
    write_text(project.cache / "proposal.mo", fitted.source.text)
    project.write_result(
        "change",
        {"schema": "twinproof/change/1", **proposal},
        pieces.change_piece(
            difference, after.estimate, after.problem, (before.comparison, after.comparison), short
        ),
    )


def with_estimate(extended: ExtendedModel, estimate: Estimate) -> ExtendedModel:
    """Write an extended model with fitted values as defaults."""
    values = {extended.user_name(n): p.value for n, p in estimate.parameters.items()}
    additions = list(extended.additions)
    for k, addition in enumerate(additions):
        prefix = f"{addition.instance}."
        own = {
            name.removeprefix(prefix): values.pop(name)
            for name in list(values)
            if name.startswith(prefix)
        }
        additions[k] = replace(addition, values={**addition.values, **own})
    return extend(extended.base, additions, values=values, name=extended.name)


def _spelled(label: str, values: Mapping[str, float]) -> str:
    return ",".join([label, *(f"{name}={value:.9g}" for name, value in values.items())])


def score(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Refit every accepted step, and score it on the fitted and on the unseen record."""
    choices = project.choices
    model, records = _read(project, choices.model, progress)
    words = [(choices.model, "", model)]
    for step in choices.steps:
        with of_field("model"):
            label = step.additions[-1].partition(",")[0]
            words.append((step.model, label, _model(project, step.model)))
    # The last model says over which length errors are meaningful; one rule for all steps.
    horizon: float | str | None = choices.horizon
    if horizon == "auto":
        progress("choosing the horizon")
        horizon = api.compare(words[-1][2], records[0]).horizon
    steps: list[pieces.Scored] = []
    for number, (_, label, one) in enumerate(words):
        progress("fitting every step", number, len(words))
        fitted = api.identify(one, records, horizon=horizon)
        unseen: Comparison | None = None
        if choices.holdout:
            with of_field("holdout"):
                other = _recording(project, choices.holdout, one)
            unseen = api.compare(
                one, other, parameters=fitted.estimate.values, horizon=horizon
            ).comparison
        steps.append(
            pieces.Scored(label, fitted.problem, fitted.estimate, fitted.comparison, unseen)
        )
    progress("drawing")
    project.write_result(
        "ladder",
        documents.document(
            "ladder",
            {
                "ladder": [
                    {
                        "step": k,
                        "model": words[k][0],
                        "added": step.added or None,
                        "parameters": documents.estimate(step.estimate),
                        "train": {"nrmse": step.train.nrmse},
                        "holdout": None if step.unseen is None else {"nrmse": step.unseen.nrmse},
                    }
                    for k, step in enumerate(steps)
                ]
            },
        ),
        pieces.ladder_piece(steps),
    )


def improve(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Do all steps at once, from the model as it was; leaves the folder `improved`."""
    choices = project.choices
    with of_field("holdout"):
        if not choices.holdout:
            raise InputError("no unseen record is chosen", remedy="choose one, under Data")
    model, records = _read(project, choices.model, progress)
    with of_field("holdout"):
        unseen = _recording(project, choices.holdout, model)
    with of_field("max_effects"):
        try:
            most = int(choices.max_effects)
        except ValueError:
            raise InputError(
                f"'{choices.max_effects}' is no number of effects", remedy="write 0, 1, 2 …"
            ) from None
    command = project.command(
        "improve",
        model=choices.model,
        more=["--holdout", choices.holdout, "--max-effects", str(most), "-o", "improved"],
    )
    result = api.improve(
        model, records, unseen, max_effects=most, horizon=choices.horizon, progress=progress
    )
    files = write_improvement(result, Path("improved"), command=command, progress=progress)
    project.write_result("improve", {**documents.improved(result, files), "command": command}, "")


def export(project: Project, _arguments: Mapping[str, str], progress: Progress) -> None:
    """Translate the present model to an FMU."""
    with of_field("model"):
        model = _model(project, project.choices.present_model)
        progress("translating to C, compiling")
        path = Path("models") / f"{model.source.short_name}.fmu"
        path.parent.mkdir(exist_ok=True)
        export_fmu(model.source, path)
    project.write_result(
        "export",
        {
            "schema": "twinproof/export/1",
            "fmu": str(path),
            "command": shlex.join(
                [
                    *("twinproof", "export", project.choices.present_model),
                    *project.library_options(),
                    *("-o", str(path)),
                ]
            ),
        },
        "",
    )


TASKS: Mapping[str, Task] = {
    task.__name__: task
    for task in (look, compare, identify, diagnose, propose, score, improve, export)
}
"""Every task by its name."""


def run(name: str, folder: Path, arguments: Mapping[str, str], progress: Progress) -> None:
    """Run a task in a project's folder.

    Raises:
        FieldError: A mistake that belongs to a field of the form.
        TwinproofError: Another mistake.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # Words such as models/axis.mo:Axis mean the same here as on the command line.
    os.chdir(folder)
    try:
        TASKS[name](Project(folder), arguments, progress)
    except TwinproofError as error:
        if error.where in _FIELD_OF:
            raise FieldError(_FIELD_OF[error.where], error) from error
        raise


def _present(project: Project, progress: Progress) -> tuple[Model, list[Recording]]:
    return _read(project, project.choices.present_model, progress)


def _model(project: Project, word: str) -> Model:
    with of_field("libraries"):
        libraries = project.library_folders()
    return Model.of(word, libraries)


def _read(project: Project, word: str, progress: Progress) -> tuple[Model, list[Recording]]:
    """Return a model, and all records that are fitted at once."""
    choices = project.choices
    progress("reading model and record")
    with of_field("model"):
        if not word:
            raise InputError("no model is chosen", remedy="choose one, under Data")
        model = _model(project, word)
        _ = model.dae
    with of_field("recording"):
        if not choices.recording:
            raise InputError("no recording is chosen", remedy="choose one, under Data")
        recording = _recording(project, choices.recording, model)
    with of_field("also"):
        also = [_recording(project, data, model) for data in choices.also_words]
    return model, [recording, *also]


def _recording(project: Project, data: str, model: Model) -> Recording:
    dbc = project.choices.dbc
    return api.read_recording(
        data,
        model,
        channel_map=Path(project.map_file.name) if project.map_file.is_file() else None,
        dbc=Path(dbc) if dbc else None,
    )


def _write_comparison(
    project: Project,
    document: documents.Document,
    records: Sequence[FittedRecord],
    estimate: Estimate | None,
    progress: Progress,
) -> None:
    progress("drawing")
    for number, record in enumerate(records):
        _save_curves(project.curves(number), record.problem, record.comparison)
    project.write_result(
        "compare",
        document,
        pieces.comparison_piece(records, estimate),
    )


def _save_curves(folder: Path, problem: Problem, comparison: Comparison) -> None:
    prediction = comparison.prediction
    drawn: dict[str, Any] = {}
    channels: list[dict[str, Any]] = []
    for k, name in enumerate(problem.output_names):
        drawn[f"{name} measured"] = problem.outputs[:, k]
        drawn[f"{name} simulated"] = prediction.simulated[:, k]
        drawn[f"{name} error"] = np.where(prediction.scored, prediction.error[:, k], np.nan)
        channels.append({"name": name, "unit": unit_of(problem, name)})
    spans = [{"begin": f.begin, "end": f.end, "channel": f.channel} for f in comparison.worst]
    curves.save(folder, problem.time, drawn, {"channels": channels, "spans": spans})
