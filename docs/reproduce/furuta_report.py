"""What the report on the rotary pendulum prints: its set-ups, measurements and results."""

from __future__ import annotations

from benchmarks.furuta import BACK_EMF
from identification.calibration import Track
from tests.identification import furuta_truth as truth

SETUPS = (truth.SETUP_1, truth.SETUP_2)
TRACKS = (Track(1024, -306, 717, 640), Track(1091, -322, 701, 701))
STICTION = (45, 38)
"""Counts at which the arm breaks away from rest, Table 3.2 type B."""
DRIVE = (40, -40, 50, -50, 60, -60, 70, -70)
VOLTS = (
    (2.10, -2.20, 2.90, -3.00, 3.75, -3.80, 4.50, -4.60),
    (2.59, -2.60, 3.35, -3.35, 4.14, -4.15, 4.82, -4.86),
)
PRINTED_ARM = (
    ("0.0035 ± 0.0002", "0.0169 ± 0.0040", "0.0351 ± 0.0166"),
    ("0.0059 ± 0.0009", "0.0140 ± 0.0106", "0.0665 ± 0.0143"),
)
PRINTED_EKF = (
    ("0.0070 ± 0.0007", "0.0268 ± 0.0064", "0.0486 ± 0.0120"),
    ("0.0052 ± 0.0024", "0.0160 ± 0.0165", "0.0569 ± 0.0220"),
)
PRINTED_DIRECTION = (
    (("0.0161 ± 0.0036", "0.0374 ± 0.0134"), ("0.0176 ± 0.0046", "0.0327 ± 0.0205")),
    (("0.0074 ± 0.0011", "0.0695 ± 0.0133"), ("0.0207 ± 0.0123", "0.0634 ± 0.0175")),
)
ASYMMETRY = (
    0.0695 / truth.SETUP_2.Kf,
    0.0634 / truth.SETUP_2.Kf,
    (0.0074 + BACK_EMF) / truth.SETUP_2.d,
    (0.0207 + BACK_EMF) / truth.SETUP_2.d,
)
"""Table 4.9 as factors of setup 2's mean friction."""
K_1 = (-6.0, -5.0, 137.0, 20.0, 0.15)
K_2 = (-5.5, -4.5, 140.0, 18.0, 0.17)
PLANT = "Twinproof.Plants.FurutaPendulum"
