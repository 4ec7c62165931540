"""What changed: did a parameter move, or has an effect appeared that the model does not have?"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from foundation.errors import DivergenceError, TwinproofError
from hil.plants import Fit
from identification.discovery.drift import MOVED, Change, Drift, Moved, missing_or_drifted
from identification.discovery.extension import Addition, extend
from identification.discovery.innovation_scan import second_opinion
from identification.likelihood import Maximum
from identification.priors import Prior
from twin.estimation import LOOSE
from twin.events import JSON
from twin.excerpt import Excerpt

_NEARLY_ALL = 0.9
_USUAL = 1.5
"""A disturbance this many times as large as the settings say may be an effect in disguise."""
_CHANCE = 1e-3


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
        fit: The parameters at the data's maximum of likelihood, if these explain the data.
    """

    verdict: str
    name: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    evidence: float = 0.0
    disturbance: str = ""
    because: str = ""
    fit: Fit | None = None

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
    it does on the balancing machine of the benchmark. Where they are white and the disturbance is
    what the settings say, moved parameters explain all. Where they name no effect otherwise,
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
            if opinion.white and _is_usual(opinion.base, since):
                return _moved(opinion.base, known, disturbance)
        found = missing_or_drifted(since.source, since.problem(whole=True), known)
    except TwinproofError as error:
        return Finding("undetermined", because=str(error))
    return _ranked(found, disturbance)


def _ranked(found: Drift, disturbance: str) -> Finding:
    """Say what output error says of moved parameters against effects."""
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


def _is_usual(base: Maximum, since: Excerpt) -> bool:
    stated = since.disturbance_sd
    found = np.array([d.sd for d in base.disturbances])
    return stated is not None and bool(np.all(found <= _USUAL * stated))


def _moved(base: Maximum, known: Mapping[str, Prior], disturbance: str) -> Finding:
    """Say which parameter moved, from where all of them are most likely now.

    If only parameter j did, the rest of the difference is chance: the generalised least-squares
    fit of one component to a difference whose covariance is that of both estimates.
    """
    names = base.free
    before = np.array([known[n].value for n in names])
    scale = np.where(before != 0, np.abs(before), 1.0)
    apart = (np.array([base.values[n] for n in names]) - before) / scale
    sd = np.array([known[n].sd for n in names]) / scale
    covariance = base.covariance / np.outer(scale, scale) + np.diag(sd**2)
    inverse = np.linalg.pinv(covariance, rcond=1e-13, hermitian=True)
    along, power = inverse @ apart, np.diag(inverse)
    whole, explained = float(apart @ along), along**2 / power
    fit = Fit({**base.values}, names, base.covariance)
    j = int(np.argmax(explained))
    if whole <= chi2.isf(_CHANCE, len(names)):
        because = "the data show no moved parameter, and no effect"
        return Finding("undetermined", disturbance=disturbance, because=because, fit=fit)
    by_chance = chi2.isf(_CHANCE, len(names) - 1) if len(names) > 1 else 0.0
    if whole - explained[j] <= max(by_chance, (1 - _NEARLY_ALL) * whole):
        value = float(before[j] + scale[j] * along[j] / power[j])
        return Finding("parameter", names[j], {names[j]: value}, 0.0, disturbance, fit=fit)
    values = {n: float(base.values[n]) for n in names}
    because = "several parameters moved"
    return Finding("undetermined", "", values, 0.0, disturbance, because, fit)


def _now(moved: Moved) -> dict[str, float]:
    return {name: now for name, (_, now, _) in moved.values.items()}


def _effect(addition: Addition, evidence: float, disturbance: str) -> Finding:
    values = {name: float(v) for name, v in addition.values.items()}
    return Finding("effect", addition.label, values, float(evidence), disturbance)
