"""Work through the cases, or print the table: `python -m benchmarks.hidden_effects run|table`.

What is done is kept in a file of one line a case, so a run may be interrupted and taken up again.
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from benchmarks.hidden_effects.cases import Case, cases
from benchmarks.hidden_effects.score import score
from benchmarks.hidden_effects.table import table

_RESULTS = Path("hidden_effects.jsonl")


def _done(path: Path) -> dict[str, dict[str, object]]:
    if not path.exists():
        return {}
    rows = (json.loads(line) for line in path.read_text().splitlines() if line.strip())
    return {str(row["name"]): row for row in rows}


def _work(case: Case) -> dict[str, object]:
    return score(case).row()


def run(path: Path, workers: int, seconds: float, plant: str) -> None:
    """Work through what is not done yet, for at most so many seconds."""
    done = _done(path)
    todo = [c for c in cases() if c.name not in done and plant in c.plant]
    began = time.perf_counter()
    # Fresh processes now and then: compiled models stay loaded in a process for good.
    while todo and time.perf_counter() - began < seconds:
        batch, todo = todo[: 12 * workers], todo[12 * workers :]
        with ProcessPoolExecutor(workers) as pool, path.open("a") as out:
            for future in as_completed([pool.submit(_work, case) for case in batch]):
                out.write(json.dumps(future.result()) + "\n")
                out.flush()
        print(f"{len(todo)} to go, {time.perf_counter() - began:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hidden_effects", description=__doc__
    )
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("--results", type=Path, default=_RESULTS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after these")
    parser.add_argument("--plant", default="", help="only machines with this in their name")
    given = parser.parse_args()
    if given.what == "run":
        run(given.results, given.workers, given.seconds, given.plant)
    print(table(list(_done(given.results).values())))


if __name__ == "__main__":
    main()
