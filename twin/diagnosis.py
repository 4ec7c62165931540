"""What changed: did a parameter move, or has an effect appeared that the model does not have?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.frontend import load
from fmus.sources import find_source
from foundation.errors import TwinproofError
from identification.discovery.extension import extend
from identification.discovery.innovation_scan import second_opinion
from identification.problem import Problem
from twin.events import JSON

Array = NDArray[np.float64]

_SHOWN = 5


@dataclass(frozen=True, eq=False)
class Suspicion:
    """A drift, and the data since.

    Attributes:
        model: MODEL.
        roots: Folders of further Modelica libraries.
        time: Of the last sample [s].
        sample_time: [s].
        inputs: (n, nu).
        outputs: (n, ny); NaN where missing.
        output_names: Measured variables.
        noise_sd: (ny,) of the sensors.
        free: Parameters that may have moved.
        values: Every parameter, as verified.
        parameter: What the drift test named; empty: none.
    """

    model: str
    roots: tuple[Path, ...]
    time: float
    sample_time: float
    inputs: Array
    outputs: Array
    output_names: tuple[str, ...]
    noise_sd: Array
    free: tuple[str, ...]
    values: Mapping[str, float]
    parameter: str


@dataclass(frozen=True)
class Finding:
    """What changed.

    Attributes:
        verdict: `parameter`, `effect`, or `undetermined`.
        name: The parameter, or `EFFECT@PLACE`; empty: undetermined.
        parameters: Of the effect, name → value; of a parameter, its value now.
        evidence: ΔlogL of the effect over moved parameters [nats]; 0 without one.
        disturbance: The unknown disturbance found beside, in words.
        because: Why it is undetermined.
    """

    verdict: str
    name: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    evidence: float = 0.0
    disturbance: str = ""
    because: str = ""

    def detail(self) -> dict[str, JSON]:
        """Return it as an event's detail."""
        return {
            "verdict": self.verdict,
            "name": self.name,
            "parameters": dict(self.parameters),
            "evidence": self.evidence,
            "disturbance": self.disturbance,
            "because": self.because,
        }


def diagnose(suspicion: Suspicion) -> Finding:
    """Compare "parameters moved" with "an effect appeared" on the data since a drift.

    Every effect of the library is tried at every place beside parameters that are all free to move
    and an unknown disturbance (`identification.discovery.innovation_scan`); one is named only if it
    predicts data it was not fitted to. It takes tens of seconds: run it in a process of its own.
    """
    try:
        source = find_source(suspicion.model, suspicion.roots)
        dae = load(source)
        measured = [
            j
            for j in range(suspicion.outputs.shape[1])
            if np.any(np.isfinite(suspicion.outputs[:, j]))
        ]
        n = len(suspicion.outputs)
        problem = Problem(
            dae,
            suspicion.sample_time * np.arange(n, dtype=np.float64),
            suspicion.inputs,
            np.ascontiguousarray(suspicion.outputs[:, measured]),
            tuple(suspicion.output_names[j] for j in measured),
            suspicion.noise_sd[measured],
            suspicion.free,
            dict(suspicion.values),
        )
        opinion = second_opinion(extend(source, []), problem, suspicion.values)
    except TwinproofError as error:
        return Finding("undetermined", because=str(error))
    best = opinion.best
    if best is not None:
        values = {name: float(v) for name, v in best.addition.values.items()}
        return Finding(
            "effect", best.addition.label, values, float(best.evidence), opinion.disturbance
        )
    moved = {n: float(opinion.base.values[n]) for n in suspicion.free}
    if suspicion.parameter and opinion.white:
        value = {suspicion.parameter: moved[suspicion.parameter]}
        return Finding("parameter", suspicion.parameter, value, 0.0, opinion.disturbance)
    because = (
        "no effect of the library explains what is left"
        if not opinion.white
        else "several parameters moved, or none by itself"
    )
    return Finding("undetermined", "", moved, 0.0, opinion.disturbance, because)
