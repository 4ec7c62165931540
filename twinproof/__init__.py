"""Physical models against measurements: find the missing effect, add it, watch the error fall.

Example:
    >>> import twinproof
    >>> model = twinproof.Model.of("Twinproof.Plants.Positioner")
    >>> sorted(model.variables)
    ['q', 'v', 'vir']
"""

from __future__ import annotations

from foundation.errors import TwinproofError
from identification import calibration
from identification.comparison import Comparison
from identification.discovery.diagnosis import Diagnosis, Outcome
from identification.discovery.ladder import Improvement
from identification.estimate import Estimate, ParameterEstimate
from recordings import Channel, Recording, Sensor
from twinproof.api import compare, diagnose, extend, identify, improve, read_recording
from twinproof.model import Model

__all__ = [
    "Channel",
    "Comparison",
    "Diagnosis",
    "Estimate",
    "Improvement",
    "Model",
    "Outcome",
    "ParameterEstimate",
    "Recording",
    "Sensor",
    "TwinproofError",
    "calibration",
    "compare",
    "diagnose",
    "extend",
    "identify",
    "improve",
    "read_recording",
]
