"""A conformance list for any FMU: the standard's rules, and whether it does what it says."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from fmus.running import simulate
from foundation.errors import FmuError, TwinproofError

_DURATION = 1.0
_STEP = 0.01


@dataclass(frozen=True)
class Check:
    """One line of the list.

    Attributes:
        name: What was tried.
        ok: Whether it held.
        detail: What was seen.
    """

    name: str
    ok: bool
    detail: str


def check_fmu(path: Path) -> tuple[Check, ...]:
    """Try an FMU against the list.

    Args:
        path: The file. An FMU is native code, and this runs it.

    Raises:
        FmuError: The file is not there or is no archive with a model description.

    Example:
        >>> check_fmu(Path("missing.fmu"))
        Traceback (most recent call last):
        ...
        foundation.errors.FmuError: no such FMU (missing.fmu); check the path
    """
    if not path.is_file():
        raise FmuError("no such FMU", where=str(path), remedy="check the path")
    try:
        description = fmpy.read_model_description(str(path), validate=False)
    except Exception as error:
        raise FmuError(
            f"the model description cannot be read: {error}",
            where=str(path),
            remedy="export the FMU again",
        ) from error
    return tuple(_checks(path, description))


def _checks(path: Path, description: Any) -> Iterator[Check]:
    messages = [str(m) for m in validate_fmu(str(path))]
    yield Check("rules of the standard", not messages, "; ".join(messages) or "no message")
    kinds = [
        kind
        for kind, there in (
            ("CoSimulation", description.coSimulation),
            ("ModelExchange", description.modelExchange),
        )
        if there is not None
    ]
    results: list[Any] = []
    for kind in kinds:
        result = _attempt(lambda kind=kind: _run(path, kind))
        ok = not isinstance(result, str)
        yield Check(f"runs as {kind}", ok, _span(result) if ok else str(result))
        if ok:
            results.append(result)
    if len(results) == 2:
        worst = max(
            (
                float(np.max(np.abs(results[0][n] - results[1][n]) / (1 + np.abs(results[0][n]))))
                for n in results[0]
            ),
            default=0.0,
        )
        yield Check("both kinds agree", worst < 1e-3, f"largest relative difference {worst:.1e}")
    if kinds:
        again = _attempt(lambda: _run(path, kinds[0]))
        same = (
            bool(results)
            and not isinstance(again, str)
            and all(np.array_equal(results[0][n], again[n]) for n in again)
        )
        yield Check("repeats itself", same, "bit for bit" if same else "two runs differ")
    co_simulation = description.coSimulation
    if (
        co_simulation is not None
        and co_simulation.canGetAndSetFMUstate
        and str(description.fmiVersion).startswith("2")
    ):
        said = _attempt(lambda: _restore(path, description))
        yield Check("restores its state", said == "", said or "a replay equals the first run")


def _attempt(action: Callable[[], Any]) -> Any:
    """Return what an action returns, or what went wrong as text."""
    try:
        return action()
    except TwinproofError as error:
        return str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def _run(path: Path, kind: str) -> dict[str, Any]:
    run = simulate(path, start=0.0, stop=_DURATION, step=_STEP, kind=kind)  # type: ignore[arg-type]
    return dict(run.columns)


def _span(columns: dict[str, Any]) -> str:
    bad = [n for n, values in columns.items() if not np.all(np.isfinite(values))]
    return f"not finite: {', '.join(bad)}" if bad else f"{len(columns)} outputs, all finite"


def _restore(path: Path, description: Any) -> str:
    """Run, save, run on, restore, run on again; return "" if both continuations are equal."""
    references = [
        v.valueReference
        for v in description.modelVariables
        if v.causality == "output" and v.type == "Real"
    ]
    folder = fmpy.extract(str(path))
    try:
        fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            instanceName="check",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )
        fmu.instantiate()
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()

        def advance(begin: int, end: int) -> list[float]:
            for k in range(begin, end):
                fmu.doStep(k * _STEP, _STEP)
            return list(fmu.getReal(references)) if references else []

        advance(0, 20)
        state = fmu.getFMUstate()
        first = advance(20, 60)
        fmu.setFMUstate(state)
        second = advance(20, 60)
        fmu.freeFMUstate(state)
        fmu.terminate()
        fmu.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return "" if first == second else "a replay from a saved state differs"
