"""Exporting FMUs: how long it takes warm, how large they are; what stiffness costs."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure
from fmus.package import cached_fmu, export
from fmus.running import Fmu
from fmus.sources import ModelicaSource, library_class

_PLANT = library_class("Twinproof.Plants.WheeledPendulum")
_STIFF = """model Stiff
  parameter Real rate = 1e6;
  Real x(start = 2, fixed = true);
  output Real y(start = 0, fixed = true);
equation
  der(x) = -rate*(x - cos(time));
  der(y) = x - y;
end Stiff;
"""
_REPEATS = 5


def run() -> Iterator[Figure]:
    """Measure; the export of another model before it has loaded the front end."""
    with tempfile.TemporaryDirectory() as folder:
        export(library_class("Twinproof.Plants.Pendulum"), Path(folder) / "first.fmu")
        for fmi in ("2", "3"):
            path = Path(folder) / f"{fmi}.fmu"
            # A parameter value of its own, so that no step of the translation is remembered.
            seconds = min(
                export(_PLANT, path, fmi=fmi, parameters={"X1": 0.04 + 1e-4 * k}).seconds
                for k in range(_REPEATS)
            )
            yield Figure(f"export WheeledPendulum, warm, FMI {fmi}", seconds, 1.0, "s")
            yield Figure(f"its size, FMI {fmi}", path.stat().st_size / 1000, 100.0, "kB")
    yield _stiffness()


def _stiffness() -> Figure:
    """Time of a model of stiffness ratio 1e6, relative to the same model at ratio 1."""
    fmu = cached_fmu(ModelicaSource(_STIFF, "Stiff", "Stiff.mo", "Stiff.mo:Stiff"))

    def seconds(opened: Fmu, rate: float) -> float:
        began = time.perf_counter()
        opened.simulate(stop=10.0, step=0.1, parameters={"rate": rate})
        return time.perf_counter() - began

    with Fmu(fmu) as opened:
        stiff, easy = (min(seconds(opened, r) for _ in range(_REPEATS)) for r in (1e6, 1.0))
    return Figure("stiffness ratio 1e6: time relative to ratio 1", stiff / easy, 10.0)
