"""What `improve` and `extend` leave behind."""

from __future__ import annotations

import csv
import io
import shutil
from pathlib import Path

from fmus.master.ssp import write_ssp
from fmus.package import export
from foundation.errors import InputError
from foundation.files import write_text
from foundation.progress import Progress
from identification.discovery.assembly import assembled
from identification.discovery.extension import ExtendedModel
from identification.discovery.ladder import Step
from modelica import LIBRARY
from twinproof.answers import Improved
from twinproof.report import write_improvement as write_report


def write_improvement(
    result: Improved, folder: Path, *, command: str, progress: Progress
) -> dict[int, tuple[str, str]]:
    """Write every step's `.mo` and `.fmu`, `ladder.csv`, `report.html` and `repeat.sh`.

    The library that the models extend is put beside them, so the folder can be handed on. A step of
    a foreign FMU is a system, `.ssp`, with everything inside.

    Args:
        result: The finished ladder.
        folder: Created if need be; files of the same names are replaced.
        command: That repeats it.
        progress: Told what is being done.

    Returns:
        Step → (model file, FMU file); of a foreign FMU, both are the system.

    Raises:
        OSError: The folder cannot be written.
        CompilerError: An FMU cannot be compiled.
    """
    folder.mkdir(parents=True, exist_ok=True)
    foreign = result.improvement.steps[0].model.base.fmu is not None
    if not foreign:
        shutil.copytree(LIBRARY, folder / LIBRARY.name, dirs_exist_ok=True)
    files: dict[int, tuple[str, str]] = {}
    for step in result.improvement.steps:
        progress(f"exporting step {step.number}")
        if foreign:
            system = folder / f"{step.model.name}.ssp"
            write_ssp(assembled(step.model), system)
            files[step.number] = (str(system), str(system))
            continue
        model_path = folder / f"{step.model.name}.mo"
        fmu_path = folder / f"{step.model.name}.fmu"
        write_text(model_path, step.model.source.text)
        export(step.model.source, fmu_path)
        files[step.number] = (str(model_path), str(fmu_path))
    write_text(folder / "ladder.csv", _ladder_csv(result))
    write_text(folder / "repeat.sh", f"#!/bin/sh\n{command}\n")
    progress("drawing the report")
    write_report(
        result.improvement,
        result.problem,
        result.holdout,
        folder / "report.html",
        command=command,
        notes=[*result.problem.notes, *(f"Fitted at once with {one}." for one in result.also)],
    )
    return files


def write_extended(model: ExtendedModel, path: Path) -> str:
    """Write an extended model: its Modelica text, or the system around a foreign FMU.

    Returns:
        How the model in the file is called on the command line.

    Raises:
        InputError: The file's suffix is another one's.
        OSError: The file cannot be written.
        CompilerError: The FMU of an effect cannot be compiled.
    """
    if model.base.fmu is None:
        if path.suffix == ".ssp":
            raise InputError(
                "a Modelica model with effects is Modelica again",
                where=str(path),
                remedy="name a .mo file, and export that",
            )
        write_text(path, model.source.text)
        return f"{path}:{model.name}"
    if path.suffix != ".ssp":
        raise InputError(
            "an FMU with effects around it is a system of FMUs",
            where=str(path),
            remedy="name a .ssp file",
        )
    write_ssp(assembled(model), path)
    return str(path)


def _ladder_csv(result: Improved) -> str:
    names = list(result.improvement.noise_floor)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    sides = ("train", "holdout")
    writer.writerow(
        [
            "step",
            "added",
            *(f"{side}_{name}_rmse" for side in sides for name in names),
            "train_nrmse",
            "holdout_nrmse",
        ]
    )
    for step in result.improvement.steps:
        writer.writerow(_row(step, names))
    return text.getvalue()


def _row(step: Step, names: list[str]) -> list[object]:
    row: list[object] = [step.number, "" if step.added is None else step.added.label]
    for comparison in (step.train, step.holdout):
        row += ["" if comparison is None else comparison.channels[name].rmse for name in names]
    row += [step.train.nrmse, "" if step.holdout is None else step.holdout.nrmse]
    return row
