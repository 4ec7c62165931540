"""The recording of a run: frames as a CAN log, or signals as CSV or MDF 4."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from foundation.errors import InputError
from foundation.files import written_whole
from hil.frame_log import SUFFIXES, FrameLog
from hil.loop import Trace
from hil.scenario import Scenario

_ALL = (*SUFFIXES, ".csv", ".mf4")


def check_suffix(path: Path) -> None:
    """Refuse a file that no recording can be written to.

    Raises:
        InputError: Another suffix, or a library that is not installed.
    """
    if path.suffix not in _ALL:
        raise InputError(
            f"no recording of the kind '{path.suffix}' can be written",
            where=str(path),
            remedy=f"use one of {', '.join(_ALL)}",
        )
    if path.suffix == ".mf4":
        _asammdf(path)


def write_recording(
    path: Path, scenario: Scenario, trace: Trace, log: FrameLog, epoch: float
) -> None:
    """Write what went over the bus, whole or not at all.

    Frames are stamped as the plant sent them, commands as it took them: a command acts from its
    stamp until the next. As CSV and MDF 4 the signals are called as the model's variables, so that
    `identify` and `diagnose` read them as they are; CAN logs need the DBC.

    Raises:
        InputError: As `check_suffix`.
        OSError: The file cannot be written.
    """
    check_suffix(path)
    if path.suffix in SUFFIXES:
        log.write(path, epoch=epoch)
        return
    columns = signals(scenario, trace)
    with written_whole(path) as beside:
        if path.suffix == ".csv":
            frame = pd.DataFrame({"time": trace.time, **columns})
            frame.to_csv(beside, index=False, lineterminator="\n")
            return
        mdf = _asammdf(path)
        file = mdf.MDF(version="4.10")
        file.append(
            [
                mdf.Signal(
                    samples=values, timestamps=trace.time, name=name, unit=scenario.plant.unit(name)
                )
                for name, values in columns.items()
            ]
        )
        named = beside.with_name(f"{beside.name}.mf4")
        try:
            file.save(named)
            named.replace(beside)
        finally:
            file.close()
            named.unlink(missing_ok=True)


def signals(scenario: Scenario, trace: Trace) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Return what the bus said of inputs and outputs, by the model's names, shape (n,) each."""
    found = {p.name: trace.columns[f"command.{p.name}"] for p in scenario.plant.inputs}
    return found | {p.name: trace.columns[f"measured.{p.name}"] for p in scenario.plant.outputs}


def _asammdf(path: Path) -> Any:
    try:
        import asammdf  # noqa: PLC0415 - large, and not installed everywhere
    except ImportError as error:
        raise InputError(
            "MDF 4 is written by asammdf, which is not installed",
            where=str(path),
            remedy="pip install asammdf, or record .blf or .csv",
        ) from error
    return asammdf
