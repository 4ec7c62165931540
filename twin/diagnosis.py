"""What changed: did a parameter move, or has an effect appeared that the model does not have?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from foundation.errors import TwinproofError
from identification.discovery.extension import extend
from identification.discovery.innovation_scan import second_opinion
from twin.events import JSON
from twin.excerpt import Excerpt

_SHOWN = 5


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


def diagnose(since: Excerpt, parameter: str = "") -> Finding:
    """Compare "parameters moved" with "an effect appeared" on the data since a drift.

    Every effect of the library is tried at every place beside parameters that are all free to move
    and an unknown disturbance (`identification.discovery.innovation_scan`); one is named only if it
    predicts data it was not fitted to. It takes tens of seconds: run it in a process of its own.

    Args:
        since: The data, with the parameters as verified; the free ones may have moved.
        parameter: What the drift test named; empty: none.
    """
    try:
        opinion = second_opinion(extend(since.source, []), since.problem(), since.values)
    except TwinproofError as error:
        return Finding("undetermined", because=str(error))
    best = opinion.best
    if best is not None:
        values = {name: float(v) for name, v in best.addition.values.items()}
        return Finding(
            "effect", best.addition.label, values, float(best.evidence), opinion.disturbance
        )
    moved = {n: float(opinion.base.values[n]) for n in since.free}
    if parameter and opinion.white:
        value = {parameter: moved[parameter]}
        return Finding("parameter", parameter, value, 0.0, opinion.disturbance)
    because = (
        "no effect of the library explains what is left"
        if not opinion.white
        else "several parameters moved, or none by itself"
    )
    return Finding("undetermined", "", moved, 0.0, opinion.disturbance, because)
