"""A conformance list for any FMU: the standard's rules, and whether it does what it says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.validation import validate_fmu

from fmus.archive import FmuDescription, check_archive, describe, read_description
from fmus.guarded import ask, is_ours
from fmus.plant import Plant
from fmus.running import Kind, simulate
from foundation.errors import TwinproofError

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
        path: The file, of any FMI version; a foreign one runs in a child process.

    Raises:
        FmuError: The file is not there or is no archive with a model description; or the FMU
            takes its process down.

    Example:
        >>> check_fmu(Path("missing.fmu"))
        Traceback (most recent call last):
        ...
        foundation.errors.FmuError: no such FMU (missing.fmu); check the path
    """
    check_archive(path)
    if is_ours(path):
        return check_directly(path)
    lines: list[list[Any]] = ask("check", path)
    return tuple(Check(str(name), bool(ok), str(detail)) for name, ok, detail in lines)


def check_directly(path: Path) -> tuple[Check, ...]:
    """As `check_fmu`, in this process."""
    description = read_description(path)
    return tuple(_checks(path, description))


def _checks(path: Path, description: Any) -> Iterator[Check]:
    messages = [str(m) for m in validate_fmu(str(path))]
    yield Check("rules of the standard", not messages, "; ".join(messages) or "no message")
    offered: list[tuple[Kind, Any]] = [
        ("CoSimulation", description.coSimulation),
        ("ModelExchange", description.modelExchange),
    ]
    kinds: list[Kind] = [kind for kind, there in offered if there is not None]
    results: list[Any] = []
    for kind in kinds:
        result = _attempt(partial(_run, path, kind))
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
    if kinds and description.coSimulation is not None:
        yield from _checks_of_stepping(path, describe(path))


def _checks_of_stepping(path: Path, description: FmuDescription) -> Iterator[Check]:
    trials: list[tuple[str, Callable[[Path], str]]] = [
        ("values at the start", _starts),
        ("reset starts anew", _reset),
        ("instances share nothing", _instances),
    ]
    if description.saves_state:
        trials.append(("restores its state", _restore))
    if description.directional_derivatives and description.inputs and description.outputs:
        trials.append(("directional derivatives", _derivatives))
    for name, trial in trials:
        said = _attempt(lambda trial=trial: trial(path))
        wrong = said.removeprefix("ok: ") if isinstance(said, str) else str(said)
        yield Check(name, wrong != said, wrong)


def _attempt(action: Callable[[], Any]) -> Any:
    """Return what an action returns, or what went wrong as text."""
    try:
        return action()
    except TwinproofError as error:
        return str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def _run(path: Path, kind: Kind) -> dict[str, Any]:
    run = simulate(path, start=0.0, stop=_DURATION, step=_STEP, kind=kind, guarded=False)
    return dict(run.columns)


def _span(columns: dict[str, Any]) -> str:
    bad = [n for n, values in columns.items() if not np.all(np.isfinite(values))]
    return f"not finite: {', '.join(bad)}" if bad else f"{len(columns)} outputs, all finite"


def _starts(path: Path) -> str:
    """Compare what the FMU gives after its initialization with what its description says."""
    description = read_description(path)
    exact = {
        str(v.name): float(v.start)
        for v in description.modelVariables
        if v.type in ("Real", "Float64")
        and v.initial == "exact"
        and v.start not in (None, "")
        and not getattr(v, "dimensions", ())
    }
    with Plant(path, outputs=list(exact)) as plant:
        values = plant.read()
    wrong = [n for n, start in exact.items() if not np.isclose(values[n], start, 1e-9, 1e-12)]
    if wrong:
        name = wrong[0]
        return f"{name} is {values[name]:g}, its start is {exact[name]:g}"
    return f"ok: {len(exact)} values as declared"


def _advance(plant: Plant, steps: int) -> list[dict[str, float]]:
    rows: list[dict[str, float]] = []
    for _ in range(steps):
        plant.step(_STEP)
        rows.append(plant.read())
    return rows


def _reset(path: Path) -> str:
    with Plant(path) as plant:
        first = _advance(plant, 30)
        plant.reset()
        second = _advance(plant, 30)
    return "ok: the second run equals the first" if first == second else "the second run differs"


def _instances(path: Path) -> str:
    with Plant(path) as plant:
        alone = _advance(plant, 20)
    with Plant(path) as one, Plant(path) as other:
        pairs = [(_advance(one, 1)[0], _advance(other, 1)[0]) for _ in range(20)]
    same = all(a == b == c for a, (b, c) in zip(alone, pairs, strict=True))
    return "ok: two at a time do as one alone" if same else "two at a time differ from one alone"


def _restore(path: Path) -> str:
    """Run, save, run on, restore, run on again."""
    with Plant(path) as plant:
        _advance(plant, 20)
        state = plant.save()
        first = _advance(plant, 40)
        plant.rewind(state)
        second = _advance(plant, 40)
        plant.forget(state)
    return (
        "ok: a replay equals the first run"
        if first == second
        else "a replay from a saved state differs"
    )


def _derivatives(path: Path) -> str:
    """Compare outputs' derivatives by inputs with central differences."""
    with Plant(path) as plant:
        _advance(plant, 5)
        reals = [n for n in plant.outputs if plant.is_real(n)]
        inputs = [n for n in plant.inputs if plant.is_real(n)]
        given = plant.derivatives(reals, inputs)
        numeric = np.empty_like(given)
        for column, name in enumerate(inputs):
            middle = plant.held(name)
            width = 1e-5 * max(1.0, abs(middle))
            sides: list[dict[str, float]] = []
            for value in (middle + width, middle - width):
                plant.set({name: value})
                sides.append(plant.read())
            plant.set({name: middle})
            numeric[:, column] = [(sides[0][n] - sides[1][n]) / (2 * width) for n in reals]
    error = float(np.max(np.abs(given - numeric) / (1 + np.abs(numeric)), initial=0.0))
    what = f"largest difference from finite differences {error:.1e}"
    return f"ok: {what}" if error < 1e-4 else what
