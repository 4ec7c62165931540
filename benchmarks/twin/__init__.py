"""The twin service: drift, false alarms, load of the bus, replay, memory, readers, kills, machines,
the way from a drift to a verified plant, many twins in one process.

`TWINPROOF_TWIN_HOURS` sets the simulated hours for the rate of false alarms (default 2; the figure
in the documentation is of 100), `TWINPROOF_TWIN_KILLS` how often the service is killed (10).
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.twin import bus, drift, kills, load, machines, recovery, service


def run() -> Iterator[Figure]:
    yield from drift.run()
    yield from bus.run()
    yield from service.run()
    yield from recovery.run()
    yield from load.run()
    yield from kills.run()
    yield from machines.run()
