"""Values from which a candidate is refitted.

The score test predicts them, but for a limit: that has no slope until it acts, and nothing acts
where no signal reaches. It is looked for where this record has it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.discovery.extension import ExtendedModel
from identification.discovery.scan import Scored
from identification.experiment import Experiment
from identification.linearisation import simulate
from identification.problem import Matrix

# What acts however small it is, but cannot begin at nothing (the score test points beyond a bound),
# is tried from these shares of its nominal value.
_SHARES = (0.1, 0.5, 1.0, 3.0, 10.0, 30.0)
# A limit is looked for between these shares of its nominal value...
_SMALLEST, _LARGEST = 1e-3, 1e3
_HALVINGS = 10
# ... and tried from where it begins to act, times these.
_BEYOND = (1.03, 1.1, 1.25, 1.5, 2.0, 4.0)


def starts(
    larger: Experiment, model: ExtendedModel, scored: Scored, x0: Matrix
) -> list[dict[str, float]]:
    """Return where to refit a candidate from, by the larger model's names.

    Args:
        larger: The model with the candidate on the record.
        model: That model.
        scored: What the score test says of the candidate.
        x0: (windows of all records, nx) initial states.

    Returns:
        One or several; none if the candidate does nothing in this record, whatever its values.
    """
    addition = scored.addition
    if addition.effect.shape_parameters:
        return [
            {model.parameter_of(addition, p): value for p, value in start.items()}
            for start in scored.shaped
        ]
    mains = [model.parameter_of(addition, p) for p in addition.effect.main_parameters]
    predicted = dict(zip(mains, scored.values.values(), strict=True))
    if any(value != 0.0 for value in predicted.values()):
        return [predicted]
    return _from_onset(larger, model, mains, x0)


def _from_onset(
    larger: Experiment, model: ExtendedModel, mains: list[str], x0: Matrix
) -> list[dict[str, float]]:
    """Return values just beyond those at which the candidate begins to act, if it does begin."""
    dae = model.dae
    nominal = {name: dae.number(dae.variables[name].nominal, 1.0) for name in mains}

    def at(share: float) -> dict[str, float]:
        return {name: share * value for name, value in nominal.items()}

    absent = _simulated(larger, x0, dict.fromkeys(mains, 0.0))

    def acts(share: float) -> bool:
        return not np.array_equal(_simulated(larger, x0, at(share)), absent, equal_nan=True)

    low, high = _SMALLEST, _LARGEST
    if not acts(high):
        return []
    if acts(low):
        return [at(share) for share in _SHARES]
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
