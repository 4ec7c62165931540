"""Work the same cases with a baseline: `python -m benchmarks.hidden_effects.baselines`.

`--method sindy` or `--method grey-box`. What is done is kept in a file of one line a case, so a run
may be interrupted and taken up again. Printed are the method's figures and, on the same cases,
those of any other results that are given (`--beside product=hidden_effects.jsonl`).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects import grey_box, sindy
from benchmarks.hidden_effects.cases import Case, cases
from benchmarks.hidden_effects.detectability import DETECTABLE
from benchmarks.hidden_effects.laws import MEMORIES
from benchmarks.hidden_effects.plants import PLANTS
from benchmarks.hidden_effects.table import interval

Row = dict[str, Any]
METHODS: Mapping[str, Callable[[Case], Row]] = {
    "sindy": sindy.baseline,
    "grey-box": grey_box.baseline,
}
_WITH_EFFECT = ("one", "two", "unknown")


def nameable(case: Case) -> bool:
    """Whether a baseline, which looks for a missing force, has a name for what is hidden."""
    sensors = PLANTS[case.plant].sensors
    return not any(e.effect in MEMORIES or e.place in sensors for e in case.hidden)


def side_by_side(results: Mapping[str, Sequence[Row]]) -> str:
    """Return a Markdown table of methods, on the cases that all of them answered.

    Args:
        results: Rows by the method's name; a row needs name, group, nats, first, point, seconds
            and trouble.
    """
    answered = [{r["name"]: r for r in rows if not r["trouble"]} for rows in results.values()]
    shared = set.intersection(*(set(rows) for rows in answered)) if answered else set[str]()
    known = [c for c in cases() if c.name in shared]
    # What a record shows is the truth's affair and the same in every file.
    seen = [c for c in known if c.group == "one" and answered[0][c.name]["nats"] > DETECTABLE]
    nothing = [c for c in known if c.group not in _WITH_EFFECT]
    kinds = sorted({c.group for c in nothing})
    forces = [c for c in seen if nameable(c)]
    lines = [
        "| figure | cases | " + " | ".join(results) + " |",
        "|---|---|" + "---|" * len(results),
    ]

    def line(name: str, kept: Sequence[Case], value: Callable[[Row], float]) -> None:
        shares = [_share([value(rows[c.name]) for c in kept]) for rows in answered]
        lines.append(f"| {name} | {len(kept)} | " + " | ".join(shares) + " |")

    line("named first, detectable single effects", seen, lambda r: r["point"])
    line("… without sensors' effects, lags and delays", forces, lambda r: r["point"])
    line("false additions, nothing missing", nothing, lambda r: bool(r["first"]))
    for kind in kinds:
        kept = [c for c in nothing if c.group == kind]
        line(f"… {kind}", kept, lambda r: bool(r["first"]))
    medians = [
        f"{np.median([rows[c.name]['seconds'] for c in known]):.1f}" if known else "–"
        for rows in answered
    ]
    lines.append(f"| seconds a case, median | {len(known)} | " + " | ".join(medians) + " |")
    lines.append("")
    for name, rows in results.items():
        silent = sum(bool(r["trouble"]) for r in rows)
        lines.append(f"- {name}: {len(rows)} cases worked, {silent} without an answer")
    return "\n".join(lines)


def _share(values: Sequence[float]) -> str:
    if not values:
        return "–"
    low, high = interval(sum(values), len(values))
    return f"{100 * np.mean(values):.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def read(path: Path) -> list[Row]:
    """Return the rows of a file of results; none if there is no file."""
    if not path.exists():
        return []
    rows = [json.loads(line) for line in path.read_text().splitlines() if line.strip()]
    return list({row["name"]: row for row in rows}.values())


def run(method: str, path: Path, workers: int, seconds: float) -> None:
    """Work through what is not done yet, for at most so many seconds."""
    done = {row["name"] for row in read(path)}
    todo = [c for c in cases() if c.name not in done]
    began = time.perf_counter()
    with ProcessPoolExecutor(workers) as pool, path.open("a") as out:
        while todo and time.perf_counter() - began < seconds:
            batch, todo = todo[: 4 * workers], todo[4 * workers :]
            for future in as_completed([pool.submit(METHODS[method], case) for case in batch]):
                out.write(json.dumps(future.result()) + "\n")
                out.flush()
    print(f"{len(todo)} to go, {time.perf_counter() - began:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hidden_effects.baselines", description=__doc__
    )
    parser.add_argument("--method", choices=tuple(METHODS), required=True)
    parser.add_argument("--results", type=Path, help="default: hidden_effects_METHOD.jsonl")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after these")
    parser.add_argument(
        "--beside", action="append", default=[], metavar="NAME=FILE", help="other results; repeat"
    )
    given = parser.parse_args()
    path = given.results or Path(f"hidden_effects_{given.method}.jsonl")
    run(given.method, path, given.workers, given.seconds)
    others = {name: read(Path(file)) for name, _, file in (b.partition("=") for b in given.beside)}
    print(side_by_side({given.method: read(path), **others}))


if __name__ == "__main__":
    main()
