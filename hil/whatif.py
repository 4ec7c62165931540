"""Studies run on Dask: both cores of this machine, or a cluster; results kept as they come.

A worker keeps plants and controllers open between runs. Every finished batch is appended to a file
beside the study, so that what was killed goes on where it was.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from fmus.cache import cache_folder, content_key
from foundation.errors import ComputationError, InputError, TwinproofError
from foundation.files import write_bytes
from foundation.progress import Progress, silent
from hil.closed_loop import ClosedLoop, Signals
from hil.controllers import Controller, FmuController
from hil.criteria import Evidence, Verdict
from hil.linear import linearised
from hil.margins import Margins, margins
from hil.study import Case, Study, Variant, controller_fmu
from hil.study_result import Rate, RunResult, StudyResult, rate

_BATCH = 8

__all__ = ["Bench", "Rate", "RunResult", "StudyResult", "rate", "replay", "run_batch", "run_study"]


class Bench:
    """A worker's plants and controllers, open. Close it at the end."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self._loops: dict[str, ClosedLoop] = {}
        self._controllers: dict[str, Controller] = {}
        self._margins: dict[tuple[str, str, int], Margins | None] = {}
        self._times = study.run.step * np.arange(study.run.cycles, dtype=np.float64)

    def close(self) -> None:
        """Close all."""
        for loop in self._loops.values():
            loop.plant.close()
        for controller in self._controllers.values():
            if isinstance(controller, FmuController):
                controller.close()

    def run(self, case: Case) -> RunResult:
        """Do one run.

        Raises:
            TwinproofError: The plant or the controller fails.
        """
        study = self.study
        columns, parameters = self.columns(case)
        n = len(columns[study.plant.outputs[0].name])
        evidence = Evidence(
            self._times[:n],
            columns,
            np.full(n, False),
            study.run.duration,
            study.run.step,
        )
        verdicts = [criterion.judge(evidence) for criterion in study.criteria]
        if study.margin_limits is not None:
            found = self._margin(case, parameters)
            if found is not None:
                verdicts += study.margin_limits.judge(found)
        return RunResult(case, tuple(verdicts), parameters)

    def columns(self, case: Case) -> tuple[dict[str, Any], dict[str, float]]:
        """Return the signals of a run, and the plant's parameters."""
        study = self.study
        parameters = study.parameters(case.draw)
        rng = np.random.default_rng([study.run.seed, 1, case.world])
        references = {
            n: w.values(self._times, rng) for n, w in study.references[case.reference].items()
        }
        disturbances = {
            n: w.values(self._times, rng) for n, w in study.disturbances[case.disturbance].items()
        }
        noise = {
            n: s.sd * rng.standard_normal(self._times.size)
            for n, s in study.plant.sensors.items()
            if s.sd
        }
        columns = self._loop(case.variant).run(
            self._controller(case.controller),
            parameters,
            Signals(references, disturbances, noise),
            study.run.step,
            study.run.cycles,
        )
        n = len(columns[study.plant.outputs[0].name])
        columns |= {f"reference.{name}": column[:n] for name, column in references.items()}
        return columns, parameters

    def _margin(self, case: Case, parameters: Mapping[str, float]) -> Margins | None:
        key = (case.controller, case.variant, case.draw)
        if key not in self._margins:
            plant = self._loop(case.variant).plant
            names = plant.parameters
            point = {
                (f"{n}_start" if f"{n}_start" in names else n): v
                for n, v in self.study.operating_point.items()
            }
            # At the operating point, wherever the run starts.
            starts = {n: 0.0 for n in names if n.endswith("_start") and n in parameters}
            plant.reset({**parameters, **starts, **point})
            linear = linearised(plant)
            self._margins[key] = margins(
                linear, self._controller(case.controller), self.study.run.step
            )
        return self._margins[key]

    def _loop(self, variant: str) -> ClosedLoop:
        if variant not in self._loops:
            fmu = next(v.fmu for v in self.study.variants if v.name == variant)
            self._loops[variant] = ClosedLoop(fmu, self.study.plant.sensors)
        return self._loops[variant]

    def _controller(self, name: str) -> Controller:
        if name not in self._controllers:
            self._controllers[name] = self.study.make_controller(name)
        return self._controllers[name]


@dataclass(frozen=True)
class Parcel:
    """A study as it is sent to a worker: FMUs by their content, since files may be elsewhere."""

    study: Study
    fmus: Mapping[str, bytes]

    def unpacked(self) -> Study:
        """Return the study with FMUs in this machine's cache."""
        places = {name: _kept(content) for name, content in self.fmus.items()}
        variants = tuple(Variant(v.name, places[str(v.fmu)]) for v in self.study.variants)
        plant = replace(self.study.plant, fmu=places[str(self.study.plant.fmu)])
        controllers = {
            name: table
            if (fmu := controller_fmu(table)) is None
            else table.with_value("model", str(places[fmu]))
            for name, table in self.study.controllers.items()
        }
        return replace(self.study, variants=variants, plant=plant, controllers=controllers)


def _parcel(study: Study) -> Parcel:
    """Make every FMU that a study needs, and pack it."""
    made = {
        name: table.with_value("model", str(fmu))
        if (fmu := controller_fmu(table)) is not None
        else table
        for name, table in study.controllers.items()
    }
    files = [v.fmu for v in study.variants]
    files += [Path(fmu) for table in made.values() if (fmu := controller_fmu(table)) is not None]
    return Parcel(
        replace(study, controllers=made), {str(file): file.read_bytes() for file in files}
    )


def _kept(content: bytes) -> Path:
    path = cache_folder("whatif") / f"{content_key(content.hex())}.fmu"
    if not path.is_file():
        write_bytes(path, content)
    return path


_BENCHES: dict[str, Bench] = {}


def run_batch(parcel: Parcel, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Do some runs, in a worker.

    Returns:
        Each run as it is kept in the file of results; of one that fails the error instead.
    """
    key = parcel.study.key
    if key not in _BENCHES:
        for bench in _BENCHES.values():
            bench.close()
        _BENCHES.clear()
        _BENCHES[key] = Bench(parcel.unpacked())
    done: list[dict[str, Any]] = []
    for case in cases:
        try:
            done.append(_as_row(_BENCHES[key].run(case)))
        except TwinproofError as error:
            done.append({"number": case.number, "error": str(error)})
    return done


def run_study(
    study: Study,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    results: Path | None = None,
    progress: Progress = silent,
) -> StudyResult:
    """Run a study, or what is left of it.

    Args:
        study: From `read_study`.
        scheduler: Address of a Dask scheduler; None: workers on this machine.
        workers: How many of these; None: one a core. 0: in this process, without Dask.
        results: File that results are appended to; None: beside the study.
        progress: Told how far it is.

    Raises:
        InputError: The scheduler does not answer; the file of results belongs to another study.
        ComputationError: A run failed for another reason than its criteria; says which.
    """
    cases = study.cases()
    path = results or study.path.with_suffix(".results.jsonl")
    known = _read_results(path, study, cases)
    left = [case for case in cases if case.number not in known]
    began = time.monotonic()
    resumed = len(known)
    text = f"running {study.name}"
    progress(text, resumed, len(cases))
    with path.open("a", encoding="utf-8") as file:
        if not known and not file.tell():
            file.write(json.dumps({"study": study.key, "name": study.name}) + "\n")
            file.flush()
        for batch in _batches(study, left, scheduler, workers):
            for row in batch:
                if "error" in row:
                    raise ComputationError(
                        f"run {row['number']} failed: {row['error']}",
                        where=str(study.path),
                        remedy=f"look at it alone: `twinproof whatif {study.path} "
                        f"--replay {row['number']}`; what is done is kept",
                    )
                known[row["number"]] = row
                file.write(json.dumps(row) + "\n")
            file.flush()
            progress(text, len(known), len(cases))
    runs = tuple(_of_row(known[case.number], case) for case in cases)
    return StudyResult(study, runs, resumed, time.monotonic() - began, _notes(runs, study))


def replay(study: Study, case_number: int) -> tuple[RunResult, dict[str, Any]]:
    """Do one run of a study again, in this process; return its result and all its signals.

    Raises:
        InputError: There is no run of that number.
    """
    cases = study.cases()
    if not 0 <= case_number < len(cases):
        raise InputError(
            f"there is no run {case_number}",
            where="--replay",
            remedy=f"give 0 to {len(cases) - 1}",
        )
    bench = Bench(study)
    try:
        result = bench.run(cases[case_number])
        columns, _ = bench.columns(cases[case_number])
        return result, columns
    finally:
        bench.close()


def _batches(
    study: Study, cases: Sequence[Case], scheduler: str | None, workers: int | None
) -> Iterator[list[dict[str, Any]]]:
    """Yield results as they come."""
    if not cases:
        return
    parcel = _parcel(study)
    # A controller's runs stand together: all of a worker's batches find it open.
    size = max(1, min(_BATCH, len(cases) // (4 * (workers or os.cpu_count() or 1)) or 1))
    parts = [cases[k : k + size] for k in range(0, len(cases), size)]
    if workers == 0 and scheduler is None:
        for part in parts:
            yield run_batch(parcel, part)
        return
    with _client(scheduler, workers) as client:
        from distributed import as_completed  # noqa: PLC0415 - slow to import

        sent = client.scatter(parcel, broadcast=True)
        futures = [client.submit(run_batch, sent, part, pure=False) for part in parts]
        for future in as_completed(futures):
            yield future.result()


@contextmanager
def _client(scheduler: str | None, workers: int | None) -> Generator[Any]:
    from dask.config import set as configured  # noqa: PLC0415 - slow to import
    from distributed import Client, LocalCluster  # noqa: PLC0415

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=10)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"the scheduler does not answer: {error}",
                where=f"--scheduler {scheduler}",
                remedy="start `dask scheduler`, and correct the address: tcp://host:8786",
            ) from error
        with client:
            yield client
        return
    settings = {
        # Each worker has a core: threads of the linear algebra would fight for it.
        "distributed.nanny.pre-spawn-environ.OMP_NUM_THREADS": 1,
        "distributed.nanny.pre-spawn-environ.OPENBLAS_NUM_THREADS": 1,
        "distributed.worker.daemon": False,
    }
    with (
        configured(settings),
        LocalCluster(
            n_workers=workers or os.cpu_count() or 1,
            threads_per_worker=1,
            processes=True,
            dashboard_address=cast("str", None),  # none at all: its stub forgets that
            silence_logs=40,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def _as_row(result: RunResult) -> dict[str, Any]:
    return {
        "number": result.case.number,
        "verdicts": [asdict(v) for v in result.verdicts],
        "parameters": dict(result.parameters),
    }


def _of_row(row: Mapping[str, Any], case: Case) -> RunResult:
    return RunResult(case, tuple(Verdict(**v) for v in row["verdicts"]), row["parameters"])


def _read_results(path: Path, study: Study, cases: Sequence[Case]) -> dict[int, dict[str, Any]]:
    """Read what is there of a study that was killed; cut off a line that is torn."""
    if not path.exists():
        return {}
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    lines = whole.decode("utf-8").splitlines()
    try:
        rows = [json.loads(line) for line in lines]
        head = rows[0]["study"] if rows else study.key
        found = {int(row["number"]): row for row in rows[1:]}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "the file of results is damaged",
            where=str(path),
            remedy="remove it: all runs are done again",
        ) from error
    if head != study.key:
        raise InputError(
            "the file of results belongs to another study, or to this one before it was changed",
            where=str(path),
            remedy="remove it, or name another with --results",
        )
    if len(whole) < len(content):
        path.write_bytes(whole)
    numbers = {case.number for case in cases}
    return {number: row for number, row in found.items() if number in numbers}


def _notes(runs: Sequence[RunResult], study: Study) -> tuple[str, ...]:
    if study.margin_limits is None:
        return ()
    without = sorted(
        {r.case.controller for r in runs if not any(v.kind == "margin" for v in r.verdicts)}
    )
    return tuple(f"'{name}' has no linear part that is known: no margins" for name in without)
