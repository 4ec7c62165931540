"""The bundled demo: Coulomb friction at the wheel that the model does not have."""

from __future__ import annotations

import time
from collections.abc import Iterator
from importlib.resources import as_file, files

import twinproof
from benchmarks.figures import Figure


def run() -> Iterator[Figure]:
    model = twinproof.Model.of("Twinproof.Plants.WheeledPendulum")
    with as_file(files("twinproof") / "demo_data") as folder:
        train, unseen = (
            twinproof.read_recording(
                folder / name,
                model,
                channel_map=folder / "channels.toml",
                dbc=folder / "wheeled_pendulum.dbc",
            )
            for name in ("balancing.blf", "held_out.blf")
        )
    began = time.perf_counter()
    found = twinproof.improve(model, train, unseen).improvement
    seconds = time.perf_counter() - began
    first = found.added[0].label if found.added else ""
    yield Figure(
        "demo CoulombFriction@wheel first", float(first == "CoulombFriction@wheel"), 1, "", True
    )
    yield Figure("demo effects added", len(found.added), 1)
    yield Figure(
        "demo verdict complete", float(found.outcome is twinproof.Outcome.COMPLETE), 1, "", True
    )
    last = found.steps[-1]
    assert last.holdout is not None
    for name, error in last.holdout.channels.items():
        yield Figure(
            f"demo unseen {name} over noise floor", error.rmse / found.noise_floor[name], 1.2
        )
        if name != "theta_w":
            yield Figure(
                f"demo unseen {name} over sensor noise", error.rmse / found.sensor_noise[name], 1.2
            )
    yield Figure("demo improve, whole", seconds, 180.0, "s")
