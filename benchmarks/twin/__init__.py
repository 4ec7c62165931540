"""The twin service: drift and false alarms, load of the bus, speed of a replay, memory.

`TWINPROOF_TWIN_HOURS` sets the simulated hours for the rate of false alarms (default 2; the figure
in the documentation is of 100).
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.twin import bus, drift


def run() -> Iterator[Figure]:
    yield from drift.run()
    yield from bus.run()
