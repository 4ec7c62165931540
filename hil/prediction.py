"""A record in closed loop, predicted: outputs and control input from the reference alone.

The sharper test of a model that is to carry a controller: the input is not taken from the record,
it comes from the controller around the model. C.-C. Peng, N.-J. Cheng, M.-C. Tsai, Electronics 12
(2023) 4569, Figures 4 to 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foundation.errors import ChannelError, DivergenceError, InputError, UnknownNameError
from hil.closed_loop import Array, ClosedLoop, Signals
from hil.controllers import Controller
from recordings import Recording


@dataclass(frozen=True, eq=False)
class LoopPrediction:
    """A closed loop beside its record.

    Attributes:
        time: (n,) from the start of the record [s].
        simulated: Output or commanded input → (n,).
        recorded: The same, of those that are recorded.
    """

    time: Array
    simulated: Mapping[str, Array]
    recorded: Mapping[str, Array]

    @property
    def rmse(self) -> dict[str, float]:
        """Root-mean-square difference of every recorded output and commanded input."""
        return {
            name: float(np.sqrt(np.mean((self.simulated[name] - column) ** 2)))
            for name, column in self.recorded.items()
        }


def predict_loop(
    plant: Path,
    controller: Controller,
    recording: Recording,
    references: Mapping[str, Array],
    *,
    parameters: Mapping[str, float] | None = None,
    at_once: bool = True,
) -> LoopPrediction:
    """Simulate a model under a controller and compare with a record of the machine under it.

    Args:
        plant: The model's FMU (`fmus.package.cached_fmu`, `twinproof export`).
        controller: The one that ran on the machine.
        recording: In the model's names and units; inputs that the controller does not command are
            taken from it, all else is only compared.
        references: Output → (n,) at the record's samples, on its uniform grid.
        parameters: Fitted values, and start values for the state in which the record begins.
        at_once: A command acts at the sample whose sensors it answers; else one sample later, as
            over a bus.

    Raises:
        ChannelError: An input that nobody commands is not recorded, or nothing is to be compared.
        UnknownNameError: The model has no such variable.
        InputError: A reference of another length; a period that is no multiple of the record's.
        DivergenceError: The loop around the model is unstable.
        FmuError: The FMU fails.

    Example:
        >>> from fmus.package import cached_fmu
        >>> from fmus.sources import library_class
        >>> from hil.controllers import PID
        >>> from recordings import Channel
        >>> fmu = cached_fmu(library_class("Twinproof.Plants.Pendulum"))
        >>> pid = PID(measured=("theta",), commanded=("tau",), period=0.01, proportional=8.0)
        >>> still = {name: Channel(name, np.zeros(100)) for name in ("theta", "tau")}
        >>> record = Recording(np.arange(100) * 0.01, still)
        >>> predict_loop(fmu, pid, record, {"theta": np.zeros(100)}).rmse
        {'theta': 0.0, 'tau': 0.0}
    """
    uniform = recording.uniform()
    n = len(uniform.time)
    step = float(uniform.time[1] - uniform.time[0])
    with ClosedLoop(plant) as loop:
        _check(loop, controller, references, n)
        given = [name for name in loop.inputs if name not in controller.commanded]
        missing = [name for name in given if name not in uniform.channels]
        if missing:
            raise ChannelError(
                f"the input '{missing[0]}' is neither commanded nor recorded",
                where=recording.origin,
                remedy="map its channel",
            )
        compared = [
            name for name in (*loop.outputs, *controller.commanded) if name in uniform.channels
        ]
        if not compared:
            raise ChannelError(
                "neither an output nor a commanded input is recorded",
                where=recording.origin,
                remedy="map one of " + ", ".join((*loop.outputs, *controller.commanded)),
            )
        signals = Signals(references, {name: uniform[name].values for name in given}, {})
        columns = loop.run(controller, parameters or {}, signals, step, n, at_once=at_once)
        simulated = {name: columns[name] for name in (*loop.outputs, *controller.commanded)}
    lasted = len(next(iter(simulated.values())))
    finite = np.all([np.isfinite(column) for column in simulated.values()], axis=0)
    if lasted < n or not np.all(finite):
        end = lasted if np.all(finite) else int(np.argmin(finite))
        raise DivergenceError(
            f"the loop around the model leaves all bounds after {end * step:.3g} s",
            where=recording.origin,
            remedy="check the parameters, the controller's signs and the start values",
        )
    recorded = {name: uniform[name].values for name in compared}
    return LoopPrediction(uniform.time - uniform.time[0], simulated, recorded)


def _check(
    loop: ClosedLoop, controller: Controller, references: Mapping[str, Array], n: int
) -> None:
    for kind, names, known in (
        ("output", controller.measured, loop.outputs),
        ("input", controller.commanded, loop.inputs),
        ("measured output", tuple(references), controller.measured),
    ):
        for name in names:
            if name not in known:
                raise UnknownNameError(kind, name, known)
    for name, values in references.items():
        if np.shape(values) != (n,):
            raise InputError(
                f"the reference of {name} has shape {np.shape(values)}, the record {n} samples",
                remedy="give one value for each sample of recording.uniform()",
            )
