"""`python -m docs.reproduce [FOLDER]`: write every page, by default to `docs/reproduction`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from docs.reproduce import balancing_robot, furuta_pendulum, wheeled_pendulum
from foundation.files import write_text

PAGES: tuple[Callable[[Path], Path], ...] = (
    wheeled_pendulum.write,
    balancing_robot.write,
    furuta_pendulum.write,
)
DEFAULT = Path(__file__).parents[1] / "reproduction"


INDEX = """# The three published works, reproduced

Written by `make reproduce`. Every page has the printed values, those recomputed with the misprints
corrected, and what this program finds, with the main figures.

- [The output-filtering method on a wheel-driven pendulum](wheeled-pendulum.md): Peng, Cheng, Tsai,
  Electronics 12 (2023) 4569.
- [Data-driven pole placement of a self-balancing robot](balancing-robot.md): Shwe, dissertation,
  Kanazawa University, 2017.
- [Identification and control of the rotary inverted pendulum](furuta-pendulum.md): Arnolds, report
  DCT 2003.100, Technische Universiteit Eindhoven, 2003.
"""


def main(folder: Path) -> None:
    """Write all pages, two at a time."""
    began = time.perf_counter()
    write_text(folder / "README.md", INDEX)
    # Fresh interpreters: a fork would carry over locks of compiled libraries.
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for done in as_completed([pool.submit(write, folder) for write in PAGES]):
            print(f"{done.result()} after {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT)
