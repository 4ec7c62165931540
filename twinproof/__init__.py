"""Physical models against measurements: find the missing effect, add it, watch the error fall.

Example:
    >>> import twinproof
    >>> model = twinproof.Model.of("Twinproof.Plants.Positioner")
    >>> sorted(model.variables)
    ['q', 'v', 'vir']
"""

from __future__ import annotations

from foundation.errors import TwinproofError
from hil.prediction import LoopPrediction, predict_loop
from hil.rig import HilResult, run_scenario
from hil.scenario import Scenario, read_scenario
from hil.study import Study, read_study
from hil.whatif import StudyResult, run_study
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
    "HilResult",
    "Improvement",
    "LoopPrediction",
    "Model",
    "Outcome",
    "ParameterEstimate",
    "Recording",
    "Scenario",
    "Sensor",
    "Study",
    "StudyResult",
    "TwinproofError",
    "calibration",
    "compare",
    "diagnose",
    "extend",
    "identify",
    "improve",
    "predict_loop",
    "read_recording",
    "read_scenario",
    "read_study",
    "run_scenario",
    "run_study",
]
