"""Run all benchmarks, or those named: `python -m benchmarks emps demo`."""

from __future__ import annotations

import importlib
import sys

NAMES = (
    "emps",
    "demo",
    "dfki",
    "silverbox",
    "road_car",
    "hidden",
    "fmus",
    "running",
    "recordings",
    "pole_placement",
    "furuta",
    "wheeled_pendulum",
    "hil",
    "twin",
)


def main(names: list[str]) -> int:
    missed = 0
    for name in names or NAMES:
        for figure in importlib.import_module(f"benchmarks.{name}").run():
            print(figure, flush=True)
            missed += not figure.kept
    print(f"{missed} figures missed" if missed else "all figures kept")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
