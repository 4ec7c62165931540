"""Hardware in the loop: jitter, deadlines and latency in real time; studies beside real time.

The real-time figures are meant for an idle machine with two cores; `python -m benchmarks hil` on
one that has other work to do measures that work. `TWINPROOF_HIL_MINUTES` sets the length of the
long run (default 10; 0 leaves it out).
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import numpy as np

from benchmarks.figures import Figure
from benchmarks.running import resident
from fmus.package import cached_fmu
from fmus.sources import library_class
from hil.bus import bridged_terminals
from hil.bus.slcan import SlcanBus
from hil.closed_loop import ClosedLoop, Signals
from hil.controllers import PID, Controller, FmuController, StateFeedback
from hil.linear import linear_model
from hil.rig import HilResult, run_scenario
from hil.scenario import scenario_of
from hil.settings import parse_toml
from hil.study import read_study, study_of
from hil.whatif import run_study

EXAMPLES = Path(__file__).parents[1] / "examples" / "hil"
REAL_TIME = """
[plant]
model = "Twinproof.Plants.WheeledPendulum"
[plant.sensors.theta_p]
sd = "0.5 deg"
[bus]
interface = "slcan"
[controller]
kind = "process"
built_in = "balance"
[references.theta_p]
kind = "sines"
amplitudes = ["20 deg"]
frequencies = [1.0]
[run]
clock = "real"
silence = 60.0
duration = {duration}
"""
SECONDS = 100.0
"""Simulated time of the figures on speed; they are in processor time, which other programs on the
machine lengthen less than the wall's."""


def run() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        yield from _round_trip()
        yield from _real_time(Path(folder))
        yield from _speed()
        yield from _workers(Path(folder))
        yield from _furuta(Path(folder))
        yield from _published()


def _round_trip() -> Iterator[Figure]:
    """A frame to the other end of the bridge and back, both ends in this process."""
    times = np.empty(3000)
    with bridged_terminals() as names, SlcanBus(names[0]) as one, SlcanBus(names[1]) as other:
        frame = can.Message(arbitration_id=1, is_extended_id=False, data=bytes(8))
        for k in range(times.size):
            began = time.perf_counter()
            one.send(frame)
            other.send(other.recv(5.0))
            one.recv(5.0)
            times[k] = time.perf_counter() - began
    yield Figure("hil: slcan round trip, median", 1e6 * float(np.median(times)), None, "µs")


def _scenario(folder: Path, duration: float) -> HilResult:
    table = parse_toml(REAL_TIME.format(duration=duration), folder / "real.toml")
    return run_scenario(scenario_of(table))


def _stalls(seconds: float) -> Iterator[Figure]:
    """Deadlines that any program would miss here: a loop that does nothing but read the clock.

    What keeps it from the processor for longer than a cycle (another program, or the host of a
    virtual machine) would have kept the plant's loop as well.
    """
    gaps: list[float] = []
    end = (last := time.perf_counter()) + seconds
    while last < end:
        now = time.perf_counter()
        if now - last > 1e-3:
            gaps.append(now - last)
        last = now
    missed = sum(int(gap / 1e-3) for gap in gaps)
    share = 100 * missed / (1000 * seconds)
    yield Figure("machine: deadlines of 1 kHz lost to stalls, no loop", share, None, "%")
    yield Figure("machine: longest stall", 1e3 * max(gaps, default=0.0), None, "ms")


def _real_time(folder: Path) -> Iterator[Figure]:
    yield from _stalls(60.0)
    result = _scenario(folder, 60.0)
    loop = result.loop
    share = 100 * loop.missed / loop.trace.count
    yield Figure("hil 1 kHz, 60 s, C over slcan: missed deadlines", share, 0.1, "%")
    yield Figure("hil: wake-up jitter p99", 1e6 * loop.jitter.percentile(99), 50.0, "µs")
    yield Figure("hil: wake-up jitter, largest", 1e6 * loop.jitter.longest, None, "µs")
    yield Figure("hil: sensor to actuator frame p50", 1e6 * loop.latency.percentile(50), None, "µs")
    yield Figure("hil: sensor to actuator frame p99", 1e3 * loop.latency.percentile(99), 1.0, "ms")
    lost = 100 * result.plant.dropped / loop.trace.count
    yield Figure("hil: frames lost or refused", lost, 0.1, "%")
    minutes = float(os.environ.get("TWINPROOF_HIL_MINUTES", "10"))
    if minutes > 0:
        yield from _long(folder, minutes)


def _long(folder: Path, minutes: float) -> Iterator[Figure]:
    """Memory while the loop runs: everything that it needs is there before it begins."""
    table = parse_toml(REAL_TIME.format(duration=60.0 * minutes), folder / "long.toml")
    scenario = scenario_of(table)
    sizes: list[int] = []
    # Told before the first cycle, and after the last.
    result = run_scenario(scenario, progress=lambda *_: sizes.append(resident()))
    yield Figure(f"hil {minutes:g} min: memory", (sizes[2] - sizes[1]) / 2**20, 1.0, "MB more")
    share = 100 * result.loop.missed / result.loop.trace.count
    yield Figure(f"hil {minutes:g} min: missed deadlines", share, 0.1, "%")


def _speed() -> Iterator[Figure]:
    """Simulated time over processor time, one core, 1 kHz, sensor noise included."""
    fmu = cached_fmu(library_class("Twinproof.Plants.WheeledPendulum"))
    n = round(SECONDS / 1e-3)
    times = np.arange(n) * 1e-3
    noise = 2e-3 * np.random.default_rng(1).standard_normal(n)
    signals = Signals({"theta_p": 0.1 * np.sin(times)}, {}, {"theta_p": noise})
    pid = PID(
        measured=("theta_p",),
        commanded=("V",),
        period=1e-3,
        proportional=-168.0,
        integral=-800.0,
        derivative=-8.8,
    )
    law = FmuController(
        measured=("theta_p",),
        commanded=("V",),
        period=1e-3,
        model=f"{EXAMPLES / 'PitchPID.mo'}:PitchPID",
    )
    with ExitStack() as stack:
        stack.callback(law.close)
        loop = stack.enter_context(ClosedLoop(fmu))

        def speed(controller: Controller) -> float:
            best = float("inf")
            for _ in range(5):
                began = time.process_time()
                loop.run(controller, {"theta_p_start": 0.05}, signals, 1e-3, n)
                best = min(best, time.process_time() - began)
            return SECONDS / best

        yield Figure("what-if: Python controller over real time", speed(pid), 100, "times", True)
        yield Figure("what-if: controller FMU over real time", speed(law), 1000, "times", True)


def _workers(folder: Path) -> Iterator[Figure]:
    """One worker and two on the same study, without the time in which workers start."""
    text = (EXAMPLES / "robust.toml").read_text().replace("draws = 20", "draws = 30")
    text = text.replace("duration = 5.0", "duration = 20.0")
    seconds: list[float] = []
    for workers in (1, 2):
        path = folder / f"workers{workers}.toml"
        study = study_of(parse_toml(text, path))
        stamps: list[float] = []

        def stamp(_: str, done: int = 0, _total: int = 0, stamps: list[float] = stamps) -> None:
            if done:
                stamps.append(time.monotonic())

        run_study(study, workers=workers, progress=stamp)
        skipped = len(stamps) // 10
        rate = (len(stamps) - 1 - skipped) / (stamps[-1] - stamps[skipped])
        runs_a_batch = len(study.cases()) / len(stamps)
        seconds.append(1 / (rate * runs_a_batch))
    ratio = seconds[0] / seconds[1]
    yield Figure("what-if: two workers over one", ratio, 1.8, "times", True)
    yield Figure("what-if: a run of 20 s with margins, one worker", 1e3 * seconds[0], None, "ms")


def _furuta(folder: Path) -> Iterator[Figure]:
    result = run_study(
        read_study(EXAMPLES / "furuta.toml"), workers=0, results=folder / "furuta.jsonl"
    )
    good = result.rate().passed
    settled = [r.verdicts[0].value for r in result.runs if r.passed]
    yield Figure("Furuta: up in 5 s and 20 s of balance, of 100", good, 90, "runs", True)
    yield Figure("Furuta: swing-up, median", float(np.median(settled)), 5.0, "s")


def _published() -> Iterator[Figure]:
    fmu = cached_fmu(library_class("Twinproof.Plants.BalancingRobot2D"))
    names = ("theta_b", "theta_m", "omega_b", "omega_m")
    poles = ("0.8", "0.9", "0.9+0.05j", "0.9-0.05j")
    law = StateFeedback(measured=names, commanded=("u",), period=0.01, poles=poles)
    law.design(linear_model(fmu))
    away = np.max(np.abs(law.F[0] / [32.2761, 1.7605, 4.3148, 0.5209] - 1))
    yield Figure("robot: gain against (2.10) as printed", 100 * float(away), 0.2, "%")
    yield Figure("Furuta: poles against those printed", _furuta_poles(), 5e-4)


def _furuta_poles() -> float:
    fmu = cached_fmu(library_class("Twinproof.Plants.FurutaPendulum"))
    # Without Coulomb friction: linearised, the smoothed sign would be a huge viscous friction.
    linear = linear_model(fmu, point={"beta": np.pi}, parameters={"K_f": 0.0})
    A, B = linear.in_outputs(["alpha", "omega_alpha", "beta", "omega_beta"]).sampled(0.01)
    whole = np.block([[A, B], [np.zeros((1, 4)), np.ones((1, 1))]])
    gains = np.array([[-6.0, -5.0, 137.0, 20.0, 0.15]])
    found = np.linalg.eigvals(whole - np.vstack([B, [[1.0]]]) @ gains)
    printed = [0.8731 + 0.3352j, 0.8731 - 0.3352j, 0.9372, 0.9868 + 0.0172j, 0.9868 - 0.0172j]
    return float(max(np.min(np.abs(found - p)) for p in printed))
