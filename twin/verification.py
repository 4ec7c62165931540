"""Re-verification: the deployed controller on the plant as it is now, in a what-if study.

The plants are drawn from the present estimate's covariance, widened: the next estimate has an
error of its own, and must find itself inside what was verified as long as the plant stays.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.running import model_fmu
from foundation.errors import InputError
from foundation.progress import Progress, silent
from hil.plants import Fit, from_here
from hil.settings import Table, read_toml
from hil.study import Study, study_of, with_fit
from hil.study_result import Rate, RunResult, StudyResult
from hil.whatif import run_study
from twin.events import JSON
from twin.improvement import Improved, Improvement
from twin.store.documents import Evidence, ParameterSet

CONTROLLER = "deployed"
"""Name of the controller in the study's results."""
_WORST = 5


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's content.

    Raises:
        InputError: It cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror}", where=str(path), remedy="correct its name"
        ) from error


def controller_hash(path: Path) -> str:
    """Return the hash of a controller: of its file and of the model that it names, if any.

    Args:
        path: TOML with the keys of a scenario's `[controller]`, or any other file, which then can
            be compared but not verified.

    Raises:
        InputError: A file cannot be read.
    """
    digest = file_hash(path)
    if path.suffix != ".toml":
        return digest
    table = read_toml(path)
    if "model" not in table.values:
        return digest
    file = Path(from_here(str(table.values["model"]), table).partition(":")[0])
    return hashlib.sha256((digest + file_hash(file)).encode()).hexdigest()


def study_hash(path: Path, draws: int, widening: float) -> str:
    """Return the hash of a study: of its file and of what the service's settings change in it."""
    return hashlib.sha256(f"{file_hash(path)} {draws} {widening!r}".encode()).hexdigest()


@dataclass(frozen=True)
class Job:
    """What is to be verified.

    Attributes:
        parameters: Of the plant as it is now.
        model: MODEL that they are of.
        study, controller: Files.
        draws: Plants.
        widening: Factor on the standard deviations.
        roots: Folders of further Modelica libraries.
        improvement: What must be added to the model first; the parameters are those without it.
    """

    parameters: ParameterSet
    model: str
    study: Path
    controller: Path
    draws: int
    widening: float = 2.0
    roots: tuple[Path, ...] = ()
    improvement: Improvement | None = None

    @property
    def fit(self) -> Fit:
        """The distribution that plants are drawn from."""
        return fit_of(self.parameters, self.widening)


def fit_of(parameters: ParameterSet, widening: float = 1.0) -> Fit:
    """Return parameters as a distribution, with standard deviations so many times as large."""
    size = len(parameters.names)
    covariance = np.array(parameters.covariance, dtype=float).reshape(size, size)
    return Fit(parameters.values, parameters.names, covariance * widening**2)


def improved(job: Job, found: Improved) -> Job:
    """Return the job that verifies the improved model with its own parameters.

    Raises:
        TwinproofError: As for every MODEL.
    """
    assert job.improvement is not None
    parameters = replace(
        job.parameters,
        model=file_hash(model_fmu(found.model, job.roots)),
        names=found.names,
        values={n: float(v) for n, v in found.values.items()},
        covariance=tuple(tuple(row) for row in found.covariance.tolist()),
        origin={
            **job.parameters.origin,
            "model": found.model,
            "effect": job.improvement.effect,
            "method": "kalman",
        },
    )
    return replace(job, parameters=parameters, model=found.model, improvement=None)


def study_for(job: Job) -> Study:
    """Return the study that a job asks for.

    Raises:
        InputError: The study, the controller or the parameters do not fit the model; says where.
    """
    table = read_toml(job.study)
    # Whatever plant and parameters the file has: it is this plant that is in question.
    plant = table.sub("plant").without("parameters_from").with_value("model", job.model)
    plants = table.sub("plants").with_value("draws", job.draws)
    table = (
        table.with_value("plant", plant.values)
        .with_value("plants", plants.values)
        .with_value("controllers", {CONTROLLER: _controller(job.controller).values})
    )
    study = study_of(table, job.roots)
    # What runs depends on more than the study's file: the name under which results are kept.
    text = f"{table.text}\n{job.model}\n{job.draws}\n{controller_hash(job.controller)}"
    return with_fit(replace(study, table=replace(study.table, text=text)), job.fit)


def _controller(path: Path) -> Table:
    table = read_toml(path)
    if "model" in table.values:
        found = from_here(str(table.values["model"]), table)
        file, colon, name = found.partition(":")
        table = table.with_value("model", f"{Path(file).resolve()}{colon}{name}")
    return table


def verify(
    job: Job,
    clock: Callable[[], float],
    *,
    scheduler: str | None = None,
    workers: int | None = 1,
    progress: Progress = silent,
) -> Evidence:
    """Run the study and return its evidence, whatever it is.

    Args:
        job: What is to be verified.
        clock: Says when the study has ended [s].
        scheduler, workers, progress: See `hil.whatif.run_study`.

    Raises:
        InputError: The study, the controller or the parameters do not fit the model.
        ComputationError: A run failed for another reason than its criteria: nothing is shown.
    """
    study = study_for(job)
    fmu = file_hash(study.plant.fmu)
    if job.parameters.model != fmu:
        raise InputError(
            "the model has changed since its parameters were estimated",
            where=job.model,
            remedy="wait for the next estimate, and verify that",
        )
    with tempfile.TemporaryDirectory() as folder:
        result = run_study(
            study,
            scheduler=scheduler,
            workers=workers,
            results=Path(folder) / "results.jsonl",
            progress=progress,
        )
    fit = job.fit
    return Evidence(
        twin=job.parameters.twin,
        time=clock(),
        controller=controller_hash(job.controller),
        model=fmu,
        study=study_hash(job.study, job.draws, job.widening),
        parameters=job.parameters.id,
        names=fit.names,
        values=dict(fit.values),
        covariance=tuple(tuple(float(v) for v in row) for row in fit.covariance),
        passed=result.passed,
        detail=_detail(job, result),
    )


def _detail(job: Job, result: StudyResult) -> dict[str, JSON]:
    names = dict.fromkeys(v.name for r in result.runs for v in r.verdicts)
    return {
        "study": result.study.name,
        "seed": result.study.run.seed,
        "draws": job.draws,
        "widening": job.widening,
        "seconds": round(result.seconds, 3),
        **_rate(result.rate()),
        "criteria": {name: _rate(result.rate(criterion=name)) for name in names},
        "worst": [_run(r) for r in result.worst(_WORST)],
        "notes": list(result.notes),
    }


def _rate(rate: Rate) -> dict[str, JSON]:
    return {"passed": rate.passed, "runs": rate.runs, "interval": [rate.low, rate.high]}


def _run(result: RunResult) -> JSON:
    failed: list[JSON] = [
        {"name": v.name, "value": _number(v.value), "limit": _number(v.limit), "detail": v.detail}
        for v in result.verdicts
        if not v.passed
    ]
    parameters: dict[str, Any] = {n: float(v) for n, v in result.parameters.items()}
    return {
        "run": result.case.number,
        "effect": result.case.variant,
        "parameters": parameters,
        "failed": failed,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
