"""Chapter 4 of the report on the rotary pendulum: parameters of rod and arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import filtfilt

from benchmarks.furuta import BACK_EMF, arm, fit
from docs.reproduce.furuta_report import (
    ASYMMETRY,
    PLANT,
    PRINTED_ARM,
    PRINTED_DIRECTION,
    PRINTED_EKF,
    SETUPS,
    STICTION,
)
from docs.reproduce.page import Page, curve
from fmus.running import simulate_model
from tests.identification import furuta_truth as truth
from twinproof import Channel, Model, Recording, Sensor, identify


def rod(page: Page) -> None:
    """The rod alone."""
    page.text(
        "## Table 4.3: the rod alone",
        "Five free swings of 10 s a setup, read at 0.35 deg, started as in the report from "
        "C1 = 0.3e-3 and J_r1 = 0.5e-3. Only m1 g l1/J_r1 can be told from a swing: m1 g l1 is "
        "given.",
    )
    rows = []
    printed = (
        ("0.100 ± 0.013", "0.790 ± 0.0009"),
        ("0.120 ± 0.0025", "0.770 ± 0.0002"),
    )
    for setup, (plant, words) in enumerate(zip(SETUPS, printed, strict=True), 1):
        rows.append((f"setup {setup}, printed (EKF)", *words))
        for method in ("kalman", "output-error", "output-filter"):
            fits = np.array(
                [_rod_fit(plant, 40.0 + 10 * s, s, method) for s in range(5)], dtype=float
            )
            rows.append((f"setup {setup}, `{method}`", *_spreads(1e3 * fits, 4)))
        rows.append((f"setup {setup}, true", f"{1e3 * plant.C1:.3f}", f"{1e3 * plant.Jr:.3f}"))
    dry = np.array([_rod_fit(truth.SETUP_1, 46.0, s, "kalman", dry=2e-4) for s in range(3)])
    rows.append(("setup 1 with 2e-4 N.m of dry friction, `kalman`", *_spreads(1e3 * dry, 4)))
    page.table(("", "C1 [1e-3 N.m.s/rad]", "J_r1 [1e-3 kg.m²]"), rows)
    page.text(
        "Dry friction that the model lacks goes into C1: recomputed + 67 %, here "
        f"{100 * (dry[:, 0].mean() / truth.SETUP_1.C1 - 1):+.0f} %."
    )
    time, true = truth.rod(truth.SETUP_1, 0.8)
    angle = truth.counted(true, truth.BETA_STEP, 1)
    C1, J_r1 = _rod_fit(truth.SETUP_1, np.rad2deg(0.8), 1, "kalman")
    model = simulate_model(
        "Twinproof.Plants.Pendulum",
        inputs=(time, {"tau": 0 * time}),
        parameters={"J": J_r1, "d": C1, "mgl": _weight(truth.SETUP_1), "theta_start": 0.8},
        outputs=["theta"],
    )

    def draw(axes: list[Axes]) -> None:
        curve(axes[0], time, np.rad2deg(angle), lw=0.6, label="counted")
        curve(axes[0], time, np.rad2deg(model["theta"]), lw=0.6, label="model")
        axes[0].legend()
        curve(axes[1], time, np.rad2deg(angle - model["theta"]), lw=0.6)
        for axis, title in zip(axes, ("rod [deg]", "difference [deg]"), strict=True):
            axis.set(title=title, xlabel="t [s]")

    page.picture("rod", "Figure 4.3: a free swing and its fit.", 1, 2, draw)


def _weight(plant: truth.Setup) -> float:
    return plant.m * truth.G * plant.l1


def _rod_fit(
    plant: truth.Setup, degrees: float, seed: int, method: str, *, dry: float = 0.0
) -> tuple[float, float]:
    """Return C1 and J_r1 of one swing."""
    time, true = truth.rod(plant, np.deg2rad(degrees), dry=dry)
    angle = truth.counted(true, truth.BETA_STEP, seed)
    channels = {
        "tau": Channel("tau", 0 * time, "N.m"),
        "theta": Channel("theta", angle, "rad", Sensor(resolution=truth.BETA_STEP)),
    }
    values = identify(
        Model.of("Twinproof.Plants.Pendulum"),
        Recording(time, channels),
        method=method,
        free=["J", "d"],
        parameters={"J": 0.5e-3, "d": 0.3e-3, "mgl": _weight(plant)},
        horizon="1",
    ).estimate.values
    return values["d"], values["J"]


def least_squares(plant: truth.Setup, record: truth.Record, *, with_u: bool = False) -> np.ndarray:
    """Return J, d, K_f by (4.17), (4.18): angles filtered forwards and backwards, u not.

    Args:
        plant: For what is known.
        record: Counted angles and commands.
        with_u: Filter u too.
    """

    def smooth(values: np.ndarray) -> np.ndarray:
        return filtfilt([0.15], [1, -0.85], values)

    h, p = truth.STEP, plant
    alpha, beta = smooth(record.angles[:, 0]), smooth(record.angles[:, 1])
    u = smooth(record.u) if with_u else record.u
    (wa, wb), s, c = (np.gradient(a, h) for a in (alpha, beta)), np.sin(beta), np.cos(beta)
    aa, ab = (np.convolve(a, [1, -2, 1], "same") / h**2 for a in (alpha, beta))
    known = (p.m * p.l0**2 + p.m * p.l1**2 * s**2) * aa + p.m * p.l0 * p.l1 * (c * ab - s * wb**2)
    known += 2 * p.m * p.l1**2 * wa * wb * s * c
    inside = slice(3, -3)
    table = np.column_stack([aa, wa, np.tanh(15 * wa)])[inside]
    return np.linalg.lstsq(table, (p.motor * u - known)[inside], rcond=None)[0]


def _experiments(
    plant: truth.Setup, repeats: int, *, gain: tuple[float, float] = (1.0, 1.0)
) -> list[tuple[str, truth.Record]]:
    """Return C and CC pulses of 1.0 and 1.5 s just beyond the dead zone, as in Table B.3."""
    found = []
    for direction, sign in (("C", 1.0), ("CC", -1.0)):
        for length in (1.0, 1.5):
            for s in range(repeats):
                u = truth.pulses(10.0, (0.5, 0.5 + length, sign * (50.0 + s)))
                record = truth.record(plant, u * gain[int(sign < 0)], seed=100 + s)
                found.append((direction, replace(record, u=u)))
    return found


def moving_arm(page: Page, repeats: int) -> None:
    """The arm, by every method; the direction of its friction; and the hidden effect."""
    page.text(
        "## Tables 4.6 and 4.7: the arm",
        f"{4 * repeats} pulses of 10 s a setup, C and CC, 1.0 and 1.5 s, on a plant with stiction "
        "(45 and 38 counts). Mean ± standard deviation of one experiment. The least-squares form "
        "is the report's (4.17): angles through the filter (4.12) both ways, u without it.",
    )
    heads = ("", "J_z0 [kg.m²]", "C0 [N.m.s/rad]", "K_f [N.m]")
    methods = ("output-filter", "auto", "kalman")
    by_direction = []
    for setup, plant in enumerate(SETUPS):
        runs = _experiments(plant.sticky(STICTION[setup]), repeats)
        rows = [
            ("printed, least squares", *PRINTED_ARM[setup]),
            ("printed, EKF", *PRINTED_EKF[setup]),
            ("least squares as published", *_arm_row([least_squares(plant, r) for _, r in runs])),
            (
                "the same, u filtered too",
                *_arm_row([least_squares(plant, r, with_u=True) for _, r in runs]),
            ),
        ]
        for method in methods:
            fits = [arm(fit(plant, record, method)) for _, record in runs]
            rows.append((f"`{method}`", *_arm_row(fits)))
        true = (plant.J, plant.d - BACK_EMF, plant.Kf)
        rows.append(("true", *(f"{v:.4f}" for v in true)))
        page.text(f"### Setup {setup + 1}")
        page.table(heads, rows)
    page.text(
        "Output error cuts the record into windows whose initial states are free, so that what "
        "stiction does at rest is hardly seen; a Kalman filter takes it for friction at speed. "
        "`auto` goes on from output error to the filter only if that explains the record.",
        "## Tables 4.8 and 4.9: directions",
        "Setup 1 is simulated with one friction for both directions, setup 2 with that of Table "
        "4.9; C is the positive direction.",
    )
    for setup, plant in enumerate((truth.SETUP_1, replace(truth.SETUP_2, asymmetry=ASYMMETRY))):
        runs = _experiments(plant.sticky(STICTION[setup]), repeats)
        for k, direction in enumerate(("C", "CC")):
            name = f"setup {setup + 1}, {direction}"
            by_direction.append((f"{name}, printed", *PRINTED_DIRECTION[setup][k]))
            chosen = [record for way, record in runs if way == direction]
            for method, fits in (
                ("least squares", [least_squares(plant, r) for r in chosen]),
                ("`output-error`", [arm(fit(plant, r, "output-error")) for r in chosen]),
            ):
                by_direction.append((f"{name}, {method}", *_arm_row(fits)[1:]))
            dry, viscous = plant.asymmetry[k], plant.asymmetry[2 + k]
            by_direction.append(
                (
                    f"{name}, true",
                    f"{plant.d * viscous - BACK_EMF:.4f}",
                    f"{plant.Kf * dry:.4f}",
                )
            )
    page.table(("", "C0 [N.m.s/rad]", "K_f [N.m]"), by_direction)
    _hidden_effect(page, repeats)
    _arm_picture(page)


def _hidden_effect(page: Page, repeats: int) -> None:
    page.text(
        "### A hidden effect in Table B.6",
        "Setup 2's J_z0 differs between directions, 0.0051 (C) and 0.0067 (CC), which no inertia "
        "can do. Ratio CC/C of J_z0 by least squares as published, and by output error:",
    )
    plant = truth.SETUP_2
    causes = (
        ("friction of Table 4.9", replace(plant, asymmetry=ASYMMETRY), (1.0, 1.0)),
        ("± 15 % of gain", plant, (1.15, 0.85)),
    )
    rows = [("observed", "1.31", "")]
    for name, changed, gain in causes:
        runs = _experiments(changed.sticky(STICTION[1]), repeats, gain=gain)
        ratios = []
        for method in (
            lambda r: least_squares(plant, r)[0],
            lambda r: arm(fit(plant, r, "output-error"))[0],
        ):
            each = {
                way: np.mean([method(record) for w, record in runs if w == way])
                for way in ("C", "CC")
            }
            ratios.append(f"{each['CC'] / each['C']:.2f}")
        rows.append((name, *ratios))
    page.table(("cause", "least squares", "`output-error`"), rows)
    page.text(
        "Recomputed: 1.06 and 1.43. If an inertia changes with direction, suspect the gain before "
        "friction."
    )


def _arm_picture(page: Page) -> None:
    plant = truth.SETUP_1.sticky()
    record = truth.record(plant, truth.pulses(10.0, (0.5, 1.5, 50.0)), seed=3)
    values = fit(plant, record).values
    start = {**values, "J_r1": plant.Jr, "C1": plant.C1}
    model = simulate_model(
        PLANT, inputs=(record.time, {"u": record.u}), parameters=start, outputs=["alpha", "beta"]
    )

    def draw(axes: list[Axes]) -> None:
        for axis, name, counted in zip(axes, ("alpha", "beta"), record.angles.T, strict=True):
            curve(axis, record.time, np.rad2deg(counted), lw=0.7, label="counted")
            curve(axis, record.time, np.rad2deg(model[name]), lw=0.7, label="model, `auto`")
            axis.set(title=f"{name} [deg]", xlabel="t [s]")
        axes[0].legend()

    page.picture(
        "arm", "Figure 4.7: one pulse of 10 s on a plant with stiction, and its fit.", 1, 2, draw
    )


def _arm_row(fits: Sequence[np.ndarray]) -> list[str]:
    values = np.array(fits) - [0.0, BACK_EMF, 0.0]
    return _spreads(values, 5)


def _spreads(values: np.ndarray, digits: int) -> list[str]:
    return [
        f"{m:.{digits}f} ± {s:.{digits}f}"
        for m, s in zip(values.mean(axis=0), values.std(axis=0, ddof=1), strict=True)
    ]
