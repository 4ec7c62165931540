"""From counts to physical quantities: what is to be known of sensors and amplifier before a fit.

M. B. Arnolds, "Identification and control of the Rotary Inverted Pendulum", report DCT 2003.100,
Technische Universiteit Eindhoven (2003), chapter 3, shows the experiments.
"""

from identification.calibration.amplifier import AffineGain, affine_gain
from identification.calibration.dead_zone import DeadZone, dead_zone
from identification.calibration.measured import Measured
from identification.calibration.potentiometer import Track, Unwrapped, find_track, unwrap
from identification.calibration.scale import Scale, counts_per_turn, fit_scale, sweeps_of
from identification.calibration.zero import rest_shift, zero_from_balance, zero_from_swing

__all__ = [
    "AffineGain",
    "DeadZone",
    "Measured",
    "Scale",
    "Track",
    "Unwrapped",
    "affine_gain",
    "counts_per_turn",
    "dead_zone",
    "find_track",
    "fit_scale",
    "rest_shift",
    "sweeps_of",
    "unwrap",
    "zero_from_balance",
    "zero_from_swing",
]
