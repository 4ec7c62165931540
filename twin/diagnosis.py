"""What changed: did a parameter move, or has an effect appeared that the model does not have?"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from foundation.errors import DivergenceError, TwinproofError
from identification.discovery.drift import MOVED, Change, Moved, missing_or_drifted
from identification.discovery.extension import Addition, extend
from identification.discovery.innovation_scan import second_opinion
from identification.priors import Prior
from twin.estimation import LOOSE
from twin.events import JSON
from twin.excerpt import Excerpt

_NEARLY_ALL = 0.9


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


def diagnose(since: Excerpt, sd: Mapping[str, float]) -> Finding:
    """Say whether parameters moved or an effect appeared, from the data since a drift.

    The innovations are asked first (`second_opinion`): a plant in service has an unknown
    disturbance at its inputs, which output error takes for an effect or for a moved parameter, as
    it does on the balancing machine of the benchmark. Where they name no effect,
    `missing_or_drifted` ranks the moved parameters and the effects against each other: innovations
    alone would let a disturbance, as large as it must be, stand in for the effect, as they do for
    friction on a pendulum. An effect is named only if it predicts data it was not fitted to. It
    takes tens of seconds: run it in a process of its own.

    Args:
        since: The data, with the parameters as verified; the free ones may have moved.
        sd: Free parameter → standard deviation of the verified value; 0: that is not known.
    """
    known = {n: Prior(since.values[n], sd[n] or LOOSE * abs(since.values[n])) for n in since.free}
    disturbance = ""
    try:
        # A filter may lose a plant that is far from what was verified.
        with suppress(DivergenceError):
            opinion = second_opinion(extend(since.source, []), since.problem(), since.values)
            best, disturbance = opinion.best, opinion.disturbance
            if best is not None:
                return _effect(best.addition, best.evidence, disturbance)
        found = missing_or_drifted(since.source, since.problem(whole=True), known)
    except TwinproofError as error:
        return Finding("undetermined", because=str(error))
    chosen = found.diagnosis.chosen
    if found.change is Change.MISSING and chosen is not None:
        return _effect(chosen.addition, found.over_moved, "")
    if found.change is Change.MISSING:
        because = "no effect of the library explains what is left"
        return Finding("undetermined", disturbance=disturbance, because=because)
    alone = next((m for m in found.moved if len(m.values) == 1), None)
    # All parameters together always explain a little more than the one that moved.
    most = _NEARLY_ALL * found.moved[0].evidence if found.moved else 0.0
    if alone is not None and alone.deviations > MOVED and alone.evidence > most:
        value = _now(alone)
        return Finding("parameter", next(iter(value)), value, 0.0, disturbance)
    moved = _now(found.moved[0]) if found.change is not Change.NOTHING else {}
    because = (
        "several parameters moved" if moved else "the data show no moved parameter, and no effect"
    )
    return Finding("undetermined", "", moved, 0.0, disturbance, because)


def _now(moved: Moved) -> dict[str, float]:
    return {name: now for name, (_, now, _) in moved.values.items()}


def _effect(addition: Addition, evidence: float, disturbance: str) -> Finding:
    values = {name: float(v) for name, v in addition.values.items()}
    return Finding("effect", addition.label, values, float(evidence), disturbance)
