"""Physical models against measurements: find the missing effect, add it, watch the error fall.

Example:
    >>> import twinproof
    >>> model = twinproof.Model.of("Twinproof.Plants.Positioner")
    >>> sorted(model.variables)
    ['q', 'v', 'vir']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
    from twinproof.answers import Compared, Diagnosed, Identified, Improved
    from twinproof.api import compare, diagnose, extend, identify, improve, read_recording
    from twinproof.model import Model
    from twinproof.pendulum_example import example

__all__ = [
    "Channel",
    "Compared",
    "Comparison",
    "Diagnosed",
    "Diagnosis",
    "Estimate",
    "HilResult",
    "Identified",
    "Improved",
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
    "example",
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

# The numerical packages take seconds to import: each name brings its module when it is first
# used, so that `twinproof --help` and the completion of a shell come at once.
_HOME = {
    "Improved": "twinproof.answers",
    "Identified": "twinproof.answers",
    "Diagnosed": "twinproof.answers",
    "Compared": "twinproof.answers",
    "Channel": "recordings",
    "Comparison": "identification.comparison",
    "Diagnosis": "identification.discovery.diagnosis",
    "Estimate": "identification.estimate",
    "HilResult": "hil.rig",
    "Improvement": "identification.discovery.ladder",
    "LoopPrediction": "hil.prediction",
    "Model": "twinproof.model",
    "Outcome": "identification.discovery.diagnosis",
    "ParameterEstimate": "identification.estimate",
    "Recording": "recordings",
    "Scenario": "hil.scenario",
    "Sensor": "recordings",
    "Study": "hil.study",
    "StudyResult": "hil.whatif",
    "TwinproofError": "foundation.errors",
    "calibration": "identification.calibration",
    "compare": "twinproof.api",
    "diagnose": "twinproof.api",
    "example": "twinproof.pendulum_example",
    "extend": "twinproof.api",
    "identify": "twinproof.api",
    "improve": "twinproof.api",
    "predict_loop": "hil.prediction",
    "read_recording": "twinproof.api",
    "read_scenario": "hil.scenario",
    "read_study": "hil.study",
    "run_scenario": "hil.rig",
    "run_study": "hil.whatif",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'twinproof' has no attribute '{name}'")
    home = _HOME[name]
    whole = home.endswith(f".{name}")  # the name is a module's own
    value = import_module(home) if whole else getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
