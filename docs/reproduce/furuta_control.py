"""Chapter 5 of the report on the rotary pendulum: linear models, poles, swing-up, balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import cont2discrete

from benchmarks.furuta import BACK_EMF
from docs.reproduce.furuta_loop import Balance, Run, balance, swing_up
from docs.reproduce.furuta_report import (
    K_1,
    K_2,
    PLANT,
    SETUPS,
)
from docs.reproduce.page import Page, curve
from fmus.plant import Plant
from fmus.running import model_fmu
from identification.calibration import (
    zero_from_balance,
)
from tests.identification import furuta_truth as truth


def linear(setup: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A, B of [alpha, alpha', beta, beta'] upright, from the FMU's derivatives."""
    plant = SETUPS[setup]
    values = {
        "beta_start": np.pi,
        "J_z0": plant.J,
        "C0": plant.d - BACK_EMF,
        "J_r1": plant.Jr,
        "C1": plant.C1,
        "K_u": plant.motor * 0.9 / 0.0706,
        "K_f": 0.0,
    }
    of = ["omega_alpha", "der(omega_alpha)", "omega_beta", "der(omega_beta)"]
    with Plant(model_fmu(PLANT), parameters=values) as fmu:
        slopes = fmu.derivatives(of[1::2], ["alpha", "omega_alpha", "beta", "omega_beta", "u"])
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1::2] = slopes[:, :4]
    return A, np.array([[0.0], [slopes[0, 4]], [0.0], [slopes[1, 4]]])


def incremental(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (5.10): the sampled model with u(k-1) as a fifth state."""
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 1))), truth.STEP)
    return np.block([[Ad, Bd], [np.zeros((1, 4)), np.ones((1, 1))]]), np.vstack([Bd, [[1.0]]])


def dirty_poles(A: np.ndarray, B: np.ndarray, K: Sequence[float]) -> np.ndarray:
    """Return the closed-loop poles with rates by (5.14), (5.15)."""
    Ai, _ = incremental(A, B)
    h = truth.STEP
    gain = np.zeros(7)  # x(4), alpha and beta of the sample before, u before
    gain[[0, 2]] = -K[0] - K[1] / h, -K[2] - K[3] / h
    gain[4:] = K[1] / h, K[3] / h, 1 - K[4]
    loop = np.zeros((7, 7))
    loop[:4, :4] = Ai[:4, :4]
    loop[:4] += Ai[:4, 4:] @ gain[None]
    loop[4, 0] = loop[5, 2] = 1.0
    loop[6] = gain
    return np.linalg.eigvals(loop)


def linear_models(page: Page) -> None:
    """Linear models upright, and the poles that the report places."""
    page.text("## Chapter 5: linear models and poles")
    A, B = linear(0)
    Ai, Bi = incremental(A, B)
    page.table(
        ("setup 1", "printed", "here"),
        [
            ("A, row 2 of (5.4)", "0 -6.1 8.1 -0.021", _row(A[1], 3)),
            ("A, row 4", "0 -4.7 55.5 -0.14", _row(A[3], 3)),
            ("B", "0 1.32 0 1.01", _row(B.ravel(), 3)),
            ("A_d, row 2 of (5.7)", "0 0.94 0.08 0.0002", _row(Ai[1, :4], 4)),
            ("A_d, row 4", "0 -0.045 0.553 1.001", _row(Ai[3, :4], 4)),
            ("B_d", "0.0001 0.013 0 0.01 (0.0097)", _row(Ai[:4, 4], 4)),
            ("open-loop poles", "1, 1, 1.0746, 0.9520, 0.9183", _poles(np.linalg.eigvals(Ai))),
        ],
    )
    printed = (
        "0.8731 ± 0.3352j, 0.9372, 0.9868 ± 0.0172j",
        "0.9093 ± 0.2585j, 0.9186, 0.9885 ± 0.0162j",
    )
    rows, maps = [], []
    for setup, K in enumerate((K_1, K_2)):
        A, B = linear(setup)
        Ai, Bi = incremental(A, B)
        closed = np.linalg.eigvals(Ai - Bi @ np.array([K]))
        dirty = dirty_poles(A, B, K)
        rows.append((f"setup {setup + 1}", printed[setup], _poles(closed), _poles(dirty)))
        maps.append((closed, dirty))
    A, B = linear(0)
    Ai, Bi = incremental(A, B)
    K = (*K_1[:4], 0.16)
    stated = _poles(np.linalg.eigvals(Ai - Bi @ np.array([K])))
    stated_dirty = _poles(dirty_poles(A, B, K))
    page.text("### Closed loop with the report's gains, K5 = 0.15 and 0.17")
    page.table(("", "printed", "here", "with the dirty derivative"), rows)
    page.text(
        f"With K5 = 0.16, as the text has it, setup 1 has {stated}, and with the dirty derivative "
        f"{stated_dirty} (recomputed: a pair at 0.8675 ± 0.334j, at 0.898 ± 0.353j with the dirty "
        "derivative). The stability radii (0.81, 1.35, 1.46) cannot be recomputed: (5.20) lacks j, "
        "and E1, E2 are not defined."
    )

    def draw(axes: list[Axes]) -> None:
        circle = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
        for axis, (closed, dirty), setup in zip(axes, maps, (1, 2), strict=True):
            axis.plot(circle.real, circle.imag, lw=0.5, color="0.6")
            axis.plot(closed.real, closed.imag, "x", ms=5, label="states known")
            axis.plot(dirty.real, dirty.imag, ".", ms=5, label="dirty derivative")
            axis.set(title=f"poles, setup {setup}", xlabel="Re", ylabel="Im")
            axis.set(xlim=(-0.2, 1.1), ylim=(-0.6, 0.6), aspect="equal")
        axes[0].legend(loc="lower left")

    page.picture("poles", "Closed-loop poles.", 1, 2, draw, height=2.6)


def control(page: Page) -> None:
    """Swing-up, the switch to balance, and balance."""
    page.text(
        "## Swing-up, switching and balance",
        "At 100 Hz from counts, rates by the dirty derivative; in at 10 deg, out at 20 deg; "
        "u = 85 while the rod falls through 3 to 50 deg. The plant is "
        f"`{PLANT}` with stiction (`StribeckFriction` at the arm), encoder and potentiometer, as "
        "an FMU.",
    )
    run = swing_up()
    caught = float(run.time[int(np.argmax(run.balancing))])
    drops = int(np.sum(np.diff(run.balancing.astype(int)) < 0))
    late = run.tilt[run.time > run.time[-1] / 2]
    page.text(
        f"Caught after {caught:.1f} s (recomputed 4.4 s, the report's swing-up takes about 8 "
        f"swings), dropped {drops} times; then {np.rad2deg(np.sqrt(np.mean(late**2))):.2f} deg rms "
        "from upright."
    )
    page.picture("swing-up", "Figure 5.3: swing-up and catch.", 1, 3, lambda a: _draw_loop(a, run))
    _balance(page)


def _balance(page: Page) -> None:
    page.text(
        "### Balance of setup 1 from 2 and from 8 deg, 20 s",
        "K = [-6, -5, 137, 20, 0.16]; rms of the tilt over the second half, on the plant with "
        "Karnopp's stiction. A hard dead zone passes commands beyond 45 counts whole, an offset "
        "one reduced by 45.",
    )
    plain = truth.SETUP_1
    cases = (
        ("no dry friction", Balance(replace(plain, Kf=0.0)), "0.18"),
        ("Coulomb friction", Balance(plain), "0.5"),
        ("45 counts of stiction", Balance(plain.sticky()), "1.0"),
        ("hard dead zone of 45", Balance(plain, zone="hard"), "1.6"),
        ("offset dead zone of 45", Balance(plain, zone="offset"), "3"),
        ("the same, compensated", Balance(plain, zone="offset", compensated=True), "0.5"),
    )
    rows, shown = [], []
    for name, case, printed in cases:
        found = []
        for start in (2.0, 8.0):
            run = balance(case, np.deg2rad(start))
            late = run.tilt[run.time > 10.0]
            fell = np.abs(run.tilt).max() > 0.6
            found.append("fell" if fell else f"{np.rad2deg(np.sqrt(np.mean(late**2))):.2f}")
            shown.append((name, run))
        rows.append((name, printed, *found))
    page.table(("plant", "recomputed [deg]", "from 2 deg", "from 8 deg"), rows)
    perfect, less = shown[1][1], shown[5][1]
    wrong = balance(Balance(plain.sticky(), bias=np.deg2rad(0.7)), np.deg2rad(8.0))
    bias = zero_from_balance((wrong.tilt + np.deg2rad(0.7))[wrong.time > 5.0])
    page.picture(
        "balance",
        "Figure 5.6: Coulomb friction, from 2 deg.",
        1,
        3,
        lambda a: _draw_loop(a, perfect),
    )
    page.picture(
        "balance-stiction",
        "Figures 5.7 and 5.10: 45 counts of stiction, from 8 deg.",
        1,
        3,
        lambda a: _draw_loop(a, less),
    )
    page.text(
        "### An upright that is 0.7 deg wrong",
        "The controller balances about a wrong upright, and the arm goes where the gain on it "
        f"makes up for that: {np.rad2deg(np.mean(wrong.arm[wrong.time > 10])):.0f} deg away in "
        "the mean. The mean of the tilt that is read tells the error: `zero_from_balance` gives "
        f"{np.rad2deg(bias.value):.2f} ± {np.rad2deg(bias.sd):.2f} deg.",
    )
    page.picture(
        "balance-wrong-zero",
        "Figure 5.8: an upright that is 0.7 deg wrong.",
        1,
        3,
        lambda a: _draw_loop(a, wrong),
    )


def _draw_loop(axes: list[Axes], run: Run) -> None:
    curve(axes[0], run.time, np.rad2deg(run.arm), lw=0.7)
    curve(axes[1], run.time, np.rad2deg(np.unwrap(run.tilt)), lw=0.7)
    curve(axes[2], run.time, run.u, lw=0.5)
    for axis, title in zip(axes, ("arm [deg]", "from upright [deg]", "u [counts]"), strict=True):
        axis.set(title=title, xlabel="t [s]")


def _row(values: np.ndarray, digits: int) -> str:
    return " ".join(f"{v + 0.0:.{digits}f}" for v in np.round(values, digits))


def _poles(values: np.ndarray) -> str:
    words = []
    for value in sorted(values, key=lambda p: (-abs(p), -p.imag)):
        if abs(value.imag) < 1e-9:
            words.append(f"{round(value.real, 4) + 0.0:.4f}")
        elif value.imag > 0:
            words.append(f"{value.real:.4f} ± {value.imag:.4f}j")
    return ", ".join(words)
