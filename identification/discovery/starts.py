"""Values from which a candidate is refitted.

The score test predicts main parameters, for the shapes that are their effects' defaults. A shape
has no slope while its effect is absent, and a limit none until it acts: a bumper that nothing
touches, a saturation that no signal reaches. Both are looked for here where this record has them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.discovery.extension import Addition, ExtendedModel
from identification.discovery.scan import score_at
from identification.experiment import Experiment
from identification.linearisation import linearise_all, simulate
from identification.problem import Matrix, Vector

# So many shapes over their range are scored, and so many of the best are tried.
_SHAPES = 13
_BEST_SHAPES = 3
# A limit is looked for between these shares of its nominal value...
_SMALLEST, _LARGEST = 1e-3, 1e3
_HALVINGS = 10
# ... and tried from where it begins to act, times these.
_BEYOND = (1.03, 1.1, 1.25, 1.5, 2.0, 4.0)


def starts(
    larger: Experiment,
    model: ExtendedModel,
    addition: Addition,
    predicted: Mapping[str, float],
    x0: Matrix,
    sd: Vector,
) -> list[dict[str, float]]:
    """Return where to refit a candidate from, by the larger model's names.

    Args:
        larger: The model with the candidate on the record.
        model: That model.
        addition: The candidate.
        predicted: Its main parameters by the score test.
        x0: (windows of all records, nx) initial states.
        sd: (channels of all records,) weights.

    Returns:
        One or several; none if the candidate does nothing in this record, whatever its values.
    """
    if addition.effect.shape_parameters:
        return _from_shapes(larger, model, addition, predicted, x0, sd)
    if any(value != 0.0 for value in predicted.values()):
        return [dict(predicted)]
    return _from_onset(larger, model, predicted, x0)


def _from_shapes(
    larger: Experiment,
    model: ExtendedModel,
    addition: Addition,
    predicted: Mapping[str, float],
    x0: Matrix,
    sd: Vector,
) -> list[dict[str, float]]:
    """Score the candidate once more for shapes over their range, and return the best few.

    The one that promises most may keep nothing of it: where windows begin to run away, a model that
    does not fit yet goes where the machine never was, and touches bumpers there.
    """
    shapes = [model.parameter_of(addition, p) for p in addition.effect.shape_parameters]
    sensitive = larger.shooting.sensitive
    base = np.flatnonzero([name not in (*predicted, *shapes) for name in sensitive])
    absent = {**larger.problem.values, **dict.fromkeys(predicted, 0.0)}
    found: list[tuple[float, dict[str, float]]] = []
    for share in np.linspace(0.0, 1.0, _SHAPES):
        shaped = {name: _between(larger, model, name, float(share)) for name in shapes}
        at = linearise_all(larger.parts(), x0, {**absent, **shaped}, sd)
        if not np.isfinite(at.cost):
            continue
        scored = score_at(larger.problem, at, base, sensitive, addition, list(predicted))
        if scored.gain > 0:
            found.append((scored.gain, {**scored.values, **shaped}))
    found.sort(key=lambda one: -one[0])
    return [start for _, start in found[:_BEST_SHAPES]]


def _between(larger: Experiment, model: ExtendedModel, name: str, share: float) -> float:
    """Return what is a share of the way up between the bounds, by their ratio; else the default."""
    variable = model.dae.variables[name]
    low = model.dae.number(variable.minimum, np.nan)
    high = model.dae.number(variable.maximum, np.nan)
    if not (0 < low < high):
        return larger.problem.values[name]
    return float(low * (high / low) ** share)


def _from_onset(
    larger: Experiment, model: ExtendedModel, predicted: Mapping[str, float], x0: Matrix
) -> list[dict[str, float]]:
    """Return values just beyond those at which the candidate begins to act."""
    dae = model.dae
    nominal = {name: dae.number(dae.variables[name].nominal, 1.0) for name in predicted}

    def at(share: float) -> dict[str, float]:
        return {name: share * value for name, value in nominal.items()}

    absent = _simulated(larger, x0, dict.fromkeys(predicted, 0.0))

    def acts(share: float) -> bool:
        return not np.array_equal(_simulated(larger, x0, at(share)), absent, equal_nan=True)

    low, high = _SMALLEST, _LARGEST
    if not acts(high):
        return []
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if acts(middle) else (middle, high)
    return [at(high * beyond) for beyond in _BEYOND]


def _simulated(larger: Experiment, x0: Matrix, added: Mapping[str, float]) -> Matrix:
    """Return (samples of all windows, ny) outputs."""
    found: list[Matrix] = []
    first = 0
    for part in larger.parts():
        values = {**part.problem.values, **added}
        states = x0[first : first + len(part.windows)]
        found.extend(simulate(part.problem, part.shooting, part.windows, states, values))
        first += len(part.windows)
    return np.concatenate(found)
