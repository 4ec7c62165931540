"""The service: a drift until it is verified anew, and many readers of live data."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx2
import numpy as np

from benchmarks.figures import Figure
from benchmarks.twin.kills import prepare
from hil.plants import plant_of
from hil.settings import parse_toml
from twin.apart import apart
from twin.api import make_app, served
from twin.ingest.buses import BusSource
from twin.pipeline import Pipeline
from twin.service import Service
from twin.store import ParameterSet
from twin.tokens import Tokens
from twin.verification import Job, file_hash, verify

PLANT = "Twinproof.Plants.WheeledPendulum"
DRAWS = 200
READERS, SECONDS = 200, 10.0
CONTROLLER = """
kind = "pid"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
proportional = -168.0
integral = -800.0
derivative = -8.8
"""
STUDY = f"""
[plant]
model = "{PLANT}"
[plant.sensors.theta_p]
sd = "0.5 deg"
[controllers.any]{CONTROLLER}
[references.slow.theta_p]
kind = "sines"
amplitudes = ["10 deg"]
frequencies = [1.0]
[disturbances.push.V]
kind = "step"
at = 2.0
stop = 2.1
after = 20.0
[[criteria]]
kind = "limit"
signal = "theta_p"
low = "-30 deg"
high = "30 deg"
[margins]
gain_db = 6.0
phase_deg = 30.0
[run]
duration = 5.0
"""


def verification() -> float:
    """Return the seconds from asking for a verification of the balancing robot to its evidence."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "pid.toml").write_text(CONTROLLER)
        plant = plant_of(parse_toml(f'model = "{PLANT}"'))
        names = ("X1", "X2", "X3", "X4", "X5", "X6", "X7")
        values = {v.name: float(v.start) for v in plant.described.parameters if v.name in names}
        sd = np.array([0.01 * abs(values[n]) for n in names])
        set_ = ParameterSet(
            "robot",
            0.0,
            file_hash(plant.fmu),
            names,
            values,
            tuple(map(tuple, np.diag(sd**2).tolist())),
        )
        study = folder / "study.toml"
        study.write_text(STUDY)
        job = Job(set_, PLANT, study, folder / "pid.toml", DRAWS)
        began = time.perf_counter()
        apart(threading.Event(), verify, job, time.time, workers=0)
        return time.perf_counter() - began


async def _read(client: httpx2.AsyncClient, url: str, seconds: float) -> tuple[int, float]:
    """Return how many documents came, and the longest time between two."""
    count, longest, last, newest = 0, 0.0, time.monotonic(), ""
    end = last + seconds
    async with client.stream("GET", url) as answer:
        async for line in answer.aiter_lines():
            if line.startswith("data: "):
                now, newest = time.monotonic(), line
                count, longest, last = count + 1, max(longest, now - last), now
                if now > end:
                    break
    # One is looked into: this process shares its processor with the service.
    json.loads(newest.removeprefix("data: "))
    return count, longest


async def read_live(base: str, twins: Sequence[str]) -> tuple[float, float]:
    """Read live data of as many twins at once as are named, again and again if named so.

    Returns:
        Documents a second of the slowest reader, and the longest that any of them waited [s].
    """
    limits = httpx2.Limits(max_connections=None)
    async with httpx2.AsyncClient(timeout=60, limits=limits) as client:
        urls = [f"{base}/twins/{name}/live" for name in twins]
        found = await asyncio.gather(*(_read(client, url, SECONDS) for url in urls))
    return min(count for count, _ in found) / SECONDS, max(longest for _, longest in found)


def readers() -> tuple[float, float]:
    """Return documents a second and reader, and the longest that any of them waited [s]."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        with Service(
            folder / "config.toml",
            lambda settings, start, executor: Pipeline(settings, start, executor=executor),
            BusSource,
        ) as service:
            service.start()
            with served(make_app(service, Tokens())) as server:
                return asyncio.run(read_live(server.url, ["arm"] * READERS))


def run() -> Iterator[Figure]:
    yield Figure(f"twin: verified with {DRAWS} draws after", verification(), 60.0, "s")
    rate, longest = readers()
    name = f"twin: {READERS} readers, live documents a second each"
    yield Figure(name, rate, 4.0, "1/s", at_least=True)
    yield Figure(f"twin: {READERS} readers, longest wait", longest, 1.0, "s")
