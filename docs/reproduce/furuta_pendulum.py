"""Regenerate the tables and main figures of the report on the rotary pendulum, by simulation.

M. B. Arnolds, "Identification and control of the Rotary Inverted Pendulum", report DCT 2003.100,
Technische Universiteit Eindhoven (2003): calibration (chapter 3), parameters (chapter 4), linear
models, poles, swing-up and balance (chapter 5), printed values beside what this run finds.
"""

from __future__ import annotations

from pathlib import Path

from docs.reproduce.furuta_calibration import calibration
from docs.reproduce.furuta_control import control, linear_models
from docs.reproduce.furuta_identification import moving_arm, rod
from docs.reproduce.page import Page


def write(folder: Path, *, repeats: int = 3) -> Path:
    """Write the page with its pictures and return its path.

    Args:
        folder: Created if it is not there.
        repeats: Experiments of each kind (direction and length of the pulse).
    """
    page = Page(folder, "furuta-pendulum")
    page.text(
        "# Identification and control of the rotary inverted pendulum",
        "M. B. Arnolds, report DCT 2003.100, Technische Universiteit Eindhoven, 2003. Its "
        "measurements are not published; its tables are repeated here on simulated plants with the "
        "report's own parameters, true (Karnopp) stiction and its sensors' counts, so that what "
        "each method makes of them can be told from what is true.",
    )
    _corrections(page)
    calibration(page)
    rod(page)
    moving_arm(page, repeats)
    linear_models(page)
    control(page)
    return page.write()


def _corrections(page: Page) -> None:
    page.text(
        "## What is corrected",
        "- l0 = 0.1505 m and l1 = 0.145 m reproduce (5.4) and both pole sets; (4.7) is l0.\n"
        "- (2.23): K_t K_b and K_t K_u, not K_f K_b and K_f K_u. (E.4): l0². (D.13), (D.15): "
        "2 m1 l1². (5.7): 0.0097 instead of 0.01.\n"
        "- (5.4) uses the least-squares averages with d = C0 + K_t K_b/R_a.\n"
        "- The poles of setup 1 belong to K5 = 0.15, not 0.16.\n"
        "- The amplifier's gain is affine: see below. 45 counts are 0.218 N.m, and K_f is only 7 "
        "counts: stiction and Coulomb friction are two parameters.",
    )
