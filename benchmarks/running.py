"""Running FMUs: batch stepping, whole runs and many parameter sets, beside FMPy's own loops."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import fmpy
import numpy as np

from benchmarks.figures import Figure
from fmus.package import cached_fmu
from fmus.plant import Plant, run_many
from fmus.running import Fmu, simulate
from fmus.sources import library_class


def best(action: Callable[[], object], repeats: int) -> float:
    """Return the shortest of some runs [s]: what else the machine does only adds."""
    seconds: list[float] = []
    for _ in range(repeats):
        began = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def run() -> Iterator[Figure]:
    fmu = cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"))
    yield from _batch(fmu)
    yield from _whole(fmu)
    yield from _many(fmu)
    yield from _memory(fmu)


def _batch(fmu: Path) -> Iterator[Figure]:
    n = 100_000
    V = 0.1 * np.sin(np.arange(n) * 1e-2)
    with Plant(fmu) as plant:
        assert (len(plant.inputs), len(plant.outputs)) == (1, 4)

        def batch() -> None:
            plant.reset()
            plant.run((np.arange(n) * 1e-3, {"V": V}))

        batch()
        ours = best(batch, 5) / n
    with Fmu(fmu) as opened:
        md = opened.model_description
        references = {v.name: v.valueReference for v in md.modelVariables}
        outputs = [references[v.name] for v in opened.description.outputs]
        slave, _ = opened.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        few = 10_000
        now = [0]

        def loop() -> None:
            for k in range(few):
                slave.setReal([references["V"]], [V[k]])
                slave.doStep(now[0] * 1e-3, 1e-3)
                slave.getReal(outputs)
                now[0] += 1

        theirs = best(loop, 5) / few
        slave.freeInstance()
    yield Figure("batch stepping, 1 input, 4 outputs", 1e6 * ours, 0.5, "µs/step")
    yield Figure("batch stepping over FMPy's loop", theirs / ours, 12.0, "times", True)


def _whole(fmu: Path) -> Iterator[Figure]:
    outputs = ["theta_w", "theta_p", "omega_w", "omega_p"]

    def theirs() -> None:
        fmpy.simulate_fmu(
            str(fmu), stop_time=100.0, output_interval=1e-3, step_size=1e-3, output=outputs
        )

    def ours() -> None:
        simulate(fmu, stop=100.0, step=1e-3, outputs=outputs)

    ours()
    mine = best(ours, 3)
    yield Figure("simulate 100 s at 1 ms", mine, None, "s")
    yield Figure("simulate over fmpy.simulate_fmu", best(theirs, 2) / mine, 10.0, "times", True)


def _many(fmu: Path) -> Iterator[Figure]:
    sets = {"theta_p_start": np.linspace(-0.2, 0.2, 1000)}

    def with_workers(workers: int) -> float:
        return best(lambda: run_many(fmu, sets, stop=2.0, step=1e-3, workers=workers), 2)

    one, all_cores = with_workers(1), with_workers(os.cpu_count() or 1)
    yield Figure("1000 parameter sets of 2000 steps", all_cores, None, "s")
    yield Figure("1000 parameter sets, all cores over one", one / all_cores, 1.4, "times", True)


def _memory(fmu: Path) -> Iterator[Figure]:
    with Plant(fmu) as plant:
        for _ in range(500):
            plant.reset()
        plant.run(stop=100.0, step=1e-3)
        before = resident()
        for _ in range(10_000):
            plant.reset()
        for _ in range(10):
            plant.run(stop=plant.time + 100.0, step=1e-3)
        grown = resident() - before
    yield Figure("memory after 1e6 steps and 1e4 resets", grown / 1024, 512.0, "KB more")
