"""`python -m docs.reproduce [FOLDER]`: write every page, by default to `docs/reproduction`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from docs.reproduce import balancing_robot

PAGES: tuple[Callable[[Path], Path], ...] = (balancing_robot.write,)
DEFAULT = Path(__file__).parents[1] / "reproduction"


def main(folder: Path) -> None:
    """Write all pages, two at a time."""
    began = time.perf_counter()
    # Fresh interpreters: a fork would carry over locks of compiled libraries.
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for done in as_completed([pool.submit(write, folder) for write in PAGES]):
            print(f"{done.result()} after {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT)
