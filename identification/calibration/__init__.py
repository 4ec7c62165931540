"""From counts to physical quantities: what is to be known of sensors and amplifier before a fit.

M. B. Arnolds, "Identification and control of the Rotary Inverted Pendulum", report DCT 2003.100,
Technische Universiteit Eindhoven (2003), chapter 3, shows the experiments.

Example:
    A record in counts becomes one that `twinproof.identify` takes:

    >>> import numpy as np
    >>> from recordings import Channel, Recording, Sensor
    >>> counts = [500.0, 650.0, 717.0, -306.0, -200.0]
    >>> track = Track(1024, low=-306, high_up=717, high_down=640)
    >>> rod = unwrap(counts, track)
    >>> beta = Channel("beta", rod.angle, "rad", Sensor(resolution=2 * np.pi / 1024))
    >>> volts = affine_gain([40, -40, 60, -60], [2.0, -2.0, 4.0, -4.0]).voltage([0, 30, 30, 0, -50])
    >>> record = Recording(np.arange(5) * 0.01, {"beta": beta, "V": Channel("V", volts, "V")})
    >>> np.round(np.rad2deg(record["beta"].values)).tolist(), np.round(volts, 6).tolist()
    ([176.0, 229.0, 249.0, 269.0, 290.0], [0.0, 1.0, 1.0, 0.0, -3.0])

    Samples in `rod.blind` are guesses: cut them out with `record.between`, or take care that the
    rod stays where it is seen.
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
