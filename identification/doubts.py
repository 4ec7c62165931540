"""What makes an answer doubtful that the numbers of a fit do not say themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foundation.errors import ExcitationError, TwinproofError
from identification.estimate import Estimate
from identification.estimators.filtered_least_squares import FilteredLeastSquares
from identification.problem import Problem, Vector

_LEVELS = 8
_QUIET = 1.5  # standard deviations of a sensor's noise below which a channel shows no motion
_SURE = 3.0  # standard deviations
_RUNAWAY = 5.0  # spans of the record before
_TURNED = "other way round"


def with_doubts(problem: Problem, estimate: Estimate) -> Estimate:
    """Return an estimate with warnings about its record and about what its values mean.

    Args:
        problem: The record; its values are the declared ones, or what the user gave.
        estimate: Of any method.
    """
    said = [*estimate.warnings, *about_record(problem), *about_values(problem, estimate)]
    if said and not any(_TURNED in line for line in said):
        said += _about_signs(problem)
    return replace(estimate, warnings=tuple(dict.fromkeys(said)))


def check_motion(problem: Problem, where: str = "") -> None:
    """Refuse a record in which nothing that is measured changes.

    Args:
        problem: The record.
        where: Where it comes from, for the message.

    Raises:
        ExcitationError: Every measured channel is constant.
    """
    if np.all(np.ptp(problem.outputs, axis=0) == 0):
        raise ExcitationError(
            f"{', '.join(problem.output_names)}: constant over the whole record",
            where=where,
            remedy="check that the right columns are mapped and the sensors' steps are finer than "
            "the motion, or record larger motion",
        )


def _about_signs(problem: Problem) -> list[str]:
    """Ask the method that knows no bounds whether the inputs' signs are right."""
    try:
        free = FilteredLeastSquares().estimate(problem)
    except TwinproofError:
        return []
    return [line for line in about_values(problem, free) if _TURNED in line]


def about_record(problem: Problem) -> list[str]:
    """Return what the channels themselves show: constants, coarse steps, noise alone.

    Example:
        >>> from fmus.frontend import load
        >>> from fmus.sources import library_class
        >>> dae, t = load(library_class("Twinproof.Plants.Pendulum")), np.arange(100) * 0.01
        >>> still = Problem(dae, t, np.ones((100, 1)), np.sin(t)[:, None], ("theta",),
        ...                 np.array([1e-3]), ("J",), dae.parameter_values)
        >>> about_record(still)[0].split(":")[0]
        'the input tau does not change'
    """
    found: list[str] = []
    for v, values in zip(problem.dae.inputs, problem.inputs.T, strict=True):
        if np.ptp(values) == 0:
            found.append(
                f"the input {v.name} does not change: it excites nothing; vary it, or check that "
                "the right column is mapped"
            )
    for name, values, sd in zip(
        problem.output_names, problem.outputs.T, problem.noise_sd, strict=True
    ):
        levels = len(np.unique(values))
        if levels == 1:
            found.append(
                f"{name} is constant over the whole record: its sensor is not connected, or its "
                "steps are larger than the motion; leave the channel out, or record larger motion"
            )
        elif levels <= _LEVELS and len(values) > 10 * levels:
            found.append(
                f"{name} takes only {levels} values: the steps of its sensor are as large as the "
                "motion, and the noise is not what a sensor's sd describes; record larger motion"
            )
        elif _runs_away(values):
            found.append(
                f"{name} grows without end: an unstable plant that runs without its controller "
                "shows little but its fastest motion; record it in closed loop"
            )
        elif sd > 0 and np.std(values) < _QUIET * sd:
            found.append(
                f"{name} shows no motion above its sensor's noise: excite the plant more, or check "
                "the sd given for the sensor"
            )
    return found


def _runs_away(values: Vector) -> bool:
    """Tell whether the last fifth of a channel leaves all that was before far behind."""
    late = values[-max(len(values) // 5, 1) :]
    early = values[: -len(late)]
    return len(early) > 1 and float(np.ptp(late)) > _RUNAWAY * float(np.ptp(early)) > 0


def about_values(problem: Problem, estimate: Estimate) -> list[str]:
    """Return which parameters are hardly told from zero, and signs that cannot be right."""
    found: list[str] = []
    vague = [
        name
        for name, p in estimate.parameters.items()
        if p.identifiable and not p.sd < abs(p.value) and problem.values[name] != 0
    ]
    if vague:
        found.append(
            f"{', '.join(vague)}: the standard deviation is larger than the value, so the record "
            "does not tell it from zero; excite what it acts on more strongly, for longer, or "
            "leave it out of --free"
        )
    declared = problem.dae.parameter_values
    sure = {
        name: p.value * declared[name] < 0
        for name, p in estimate.parameters.items()
        if p.identifiable and abs(p.value) > _SURE * p.sd and declared[name] != 0
    }
    turned = [name for name, opposite in sure.items() if opposite]
    if turned:
        inputs = ", ".join(v.name for v in problem.dae.inputs)
        cause = (
            f"the sign of {inputs} is most likely the {_TURNED} in the recording: turn it with "
            "factor = -1 in a channel map"
            if len(turned) > len(sure) / 2 and inputs
            else "check the signs of the channels, or try diagnose: an effect may be missing"
        )
        found.append(f"{', '.join(turned)} came out with the sign opposite to the model's; {cause}")
    return found
