"""Chapter 3 of the report on the rotary pendulum: calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from docs.reproduce.furuta_report import DRIVE, SETUPS, STICTION, TRACKS, VOLTS
from docs.reproduce.page import Page
from fmus.running import simulate_model
from identification.calibration import (
    Track,
    affine_gain,
    counts_per_turn,
    dead_zone,
    find_track,
    fit_scale,
    rest_shift,
    sweeps_of,
    unwrap,
    zero_from_swing,
)
from tests.identification import furuta_truth as truth


def calibration(page: Page) -> None:
    """Encoders, the potentiometer and its blind zone, the amplifier, where zero is."""
    page.text(
        "## Chapter 3: calibration",
        "Counts come from `Twinproof.Sensors` and from the plant; `twinproof.calibration` turns "
        "them back.",
    )
    rows = []
    for setup, (track, printed) in enumerate(zip(TRACKS, (52330, 52505), strict=True), 1):
        encoder = _encoder(printed / 8)
        rows.append((f"setup {setup}: encoder, counts in 8 turns", str(printed), encoder))
        found = find_track(_turned(track), track.counts_per_turn)
        for name in ("high_up", "low", "high_down"):
            words = {"high_up": "exit up", "low": "entrance up, exit down"}
            rows.append(
                (
                    f"setup {setup}: potentiometer, {words.get(name, 'entrance down')}",
                    f"{getattr(track, name):g}",
                    f"{getattr(found, name):g}",
                )
            )
        rows.append(
            (
                f"setup {setup}: blind zone, up and down",
                ("1, 27 deg", "22 deg")[setup - 1],
                f"{np.rad2deg(found.blind_up):.1f}, {np.rad2deg(found.blind_down):.1f} deg",
            )
        )
        rows.append((f"setup {setup}: counts a quarter turn", *_quarter(setup - 1)))
    for setup, volts in enumerate(VOLTS, 1):
        gain = affine_gain(DRIVE, volts)
        rows.append(
            (
                f"setup {setup}: amplifier, from Table B.2",
                ("0.0618 V/count", "0.0682 V/count")[setup - 1],
                f"{gain.gain.value:.4f} ± {gain.gain.sd:.4f} V/count beyond "
                f"{gain.threshold.value:.1f} ± {gain.threshold.sd:.1f} counts",
            )
        )
    printed_zone = (("45.4, -43.8", "45.6, -44.6"), ("28.4, -30.4", "36.4, -38.4"))
    for setup in (0, 1):
        for kind, words in enumerate(("A", "B")):
            rows.append(
                (
                    f"setup {setup + 1}: dead zone, type {words}",
                    printed_zone[setup][kind],
                    _dead_zone(setup, returns=bool(kind)),
                )
            )
    page.table(("quantity", "printed", "here"), rows)
    page.text(
        "In the simulation friction at rest does not depend on how long the arm has rested, so "
        "types A and B find the same; the report's setup 2 breaks away earlier when it has just "
        "moved.",
        "### The zero of the rod",
        _zero(),
    )
    track = TRACKS[0]
    time = np.arange(0, 8, 0.01)
    angle = 0.7 * time * np.sin(3 * time)
    counts = _potentiometer(track, angle)
    found = unwrap(counts, track)

    def draw(axes: list[Axes]) -> None:
        axes[0].plot(time, counts, lw=0.7)
        axes[0].set(title="counts of setup 1", xlabel="t [s]")
        axes[1].plot(time, np.rad2deg(angle), lw=1.2, color="0.7", label="true")
        axes[1].plot(time, np.rad2deg(found.angle), lw=0.6, label="unwrapped")
        axes[1].plot(
            time[found.blind], np.rad2deg(found.angle[found.blind]), "r.", ms=2, label="blind"
        )
        axes[1].set(title="rod [deg]", xlabel="t [s]")
        axes[1].legend()

    page.picture(
        "calibration", "Figure 3.1: wrap and blind zone of a potentiometer, undone.", 1, 2, draw
    )


def _potentiometer(track: Track, angle: np.ndarray) -> np.ndarray:
    fine = np.arange((len(angle) - 1) * 20 + 1) / 2000
    found = simulate_model(
        "Twinproof.Sensors.Potentiometer",
        inputs=(fine, {"phi": np.interp(fine * 100, np.arange(len(angle)), angle)}),
        parameters={
            "N": track.counts_per_turn,
            "low": track.low,
            "high_up": track.high_up,
            "high_down": track.high_down,
            "T": 1e-4,
            "x_start": float(angle[0]) - 1e-6,
        },
        outputs=["counts"],
    )
    return found["counts"][::20]


def _turned(track: Track) -> np.ndarray:
    up = np.arange(0, 3 * np.pi, 0.3 * 2 * np.pi / 1024)
    return _potentiometer(track, np.concatenate([up, up[::-1]]))


def _encoder(per_turn: float) -> str:
    time = np.arange(0, 30, 0.01)
    turns = np.interp(time, [0, 5, 15, 25, 30], [0, 4, -4, 4, 0])
    run = simulate_model(
        "Twinproof.Sensors.Encoder",
        inputs=(time, {"phi": 2 * np.pi * turns}),
        parameters={"N": per_turn},
        outputs=["counts"],
    )
    return f"{8 * counts_per_turn(sweeps_of(run['counts']), 8).value:.0f}"


def _quarter(setup: int) -> tuple[str, str]:
    """Table A.3's readings with hands that err by a degree, on the Modelica potentiometer."""
    tables = (
        (257, 255, 260, 257, 257, -255, -258, -256, -255, -255),
        (274, 274, 275, 274, 274, -279, -277, -276, -275, -275),
    )
    degrees = np.repeat([90.0, -90.0], 5)
    printed = fit_scale(degrees, tables[setup]).slope
    track = TRACKS[setup]
    hands = np.deg2rad(degrees + np.random.default_rng(setup).normal(0, 0.7, 10))
    read = [_potentiometer(track, np.linspace(0, hand, 50))[-1] for hand in hands]
    here = fit_scale(degrees, read).slope
    return (
        f"{90 * printed.value:.1f} ± {90 * printed.sd:.1f}",
        f"{90 * here.value:.1f} ± {90 * here.sd:.1f} (true {track.counts_per_turn / 4:g})",
    )


def _dead_zone(setup: int, *, returns: bool) -> str:
    plant = replace(SETUPS[setup].sticky(STICTION[setup]), C1=5e-3)  # somebody holds the rod
    first = STICTION[setup] - 10
    sizes = np.arange(first, first + 16.0)
    ramp = np.ravel(np.column_stack([sizes, 0 * sizes])) if returns else sizes
    held = 100 if returns else 200
    u = np.repeat(np.concatenate([[0.0], ramp, [0.0], -ramp]), held)
    found = dead_zone(u, truth.record(plant, u).angles[:, 0], least=np.deg2rad(5))
    return f"{found.forwards.value:.0f}, {found.backwards.value:.0f}"


def _zero() -> str:
    plant, count = truth.SETUP_1, truth.BETA_STEP
    weight = plant.m * truth.G * plant.l1
    friction = weight * np.sin(np.deg2rad(0.7))
    shift = 0.011
    rests, zeros = [], []
    for start in (40.0, 52.0, -47.0, 61.0, -33.0):
        _, true = truth.rod(plant, np.deg2rad(start), 25.0, dry=friction, sharp=2000.0)
        read = np.round((true + shift) / count) * count
        rests.append(np.rad2deg(true[-1]))
        zeros.append(np.rad2deg(zero_from_swing(read, resolution=count).value - shift))
    return (
        f"Pivot friction of {friction:.2g} N.m holds the rod up to "
        f"{np.rad2deg(rest_shift(friction, weight)):.1f} deg from the vertical, the report's 2 "
        "counts; whoever takes the rest position for zero errs by as much, and so does his "
        f"upright. Five swings end {', '.join(f'{v:.2f}' for v in rests)} deg from the vertical; "
        "`zero_from_swing` on the same records errs by "
        f"{', '.join(f'{v:.2f}' for v in zeros)} deg."
    )
