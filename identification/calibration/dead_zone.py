"""The command at which a motor begins to move."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from foundation.errors import ExcitationError, InputError
from identification.calibration.measured import Measured, Vector, mean, pair


@dataclass(frozen=True, eq=False)
class DeadZone:
    """Smallest commands that move a motor from rest.

    Attributes:
        forwards: Mean over the ramps with positive commands; NaN without one.
        backwards: Mean over the others, negative; NaN without one.
        each: (ramps,) signed, in the order of the record.
    """

    forwards: Measured
    backwards: Measured
    each: Vector


def dead_zone(u: ArrayLike, angle: ArrayLike, *, least: float) -> DeadZone:
    """Find the breakaway commands in a record of ramps of steps.

    A ramp is a run of steps of one sign and growing size, each held for seconds, with or without a
    return to zero in between (types B and A of the report; B finds the greater breakaway of a plant
    that is at rest before each step). The breakaway is the first command of a ramp from which on
    every step moves the motor.

    What is found is friction at rest together with what the amplifier swallows: Coulomb friction
    may be much smaller, so a model needs separate parameters for them.

    Args:
        u: (n,) command at each sample.
        angle: (n,) any unit.
        least: Motion during one step that counts as such, in the unit of `angle`: above the
            sensor's noise and creep, and below what a step beyond breakaway does.

    Raises:
        InputError: Shapes do not fit, or `least` is not positive.
        ExcitationError: A ramp never moves the motor, moves it with its first step, or there is
            none.

    Reference:
        M. B. Arnolds, report DCT 2003.100, Technische Universiteit Eindhoven (2003), section 3.3.

    Example:
        >>> u = np.repeat([8.0, 9.0, 10.0, 11.0], 10)
        >>> angle = np.concatenate([np.zeros(20), 0.1 * np.arange(20)])
        >>> dead_zone(u, angle, least=0.5).each.tolist()
        [10.0]
    """
    command, position = pair(u, angle, ("commands", "angles"))
    if not least > 0:
        raise InputError(f"a least motion of {least:g}", remedy="give a positive angle")
    each = np.array([_breakaway(ramp, least) for ramp in _ramps(command, position)])
    if each.size == 0:
        raise ExcitationError(
            "the record holds no ramp of growing commands",
            remedy="raise the command step by step from zero, in both directions",
        )
    forwards, backwards = each[each > 0], each[each < 0]
    nothing = Measured(float("nan"), float("inf"))
    return DeadZone(
        mean(forwards) if forwards.size else nothing,
        mean(backwards) if backwards.size else nothing,
        each,
    )


def _ramps(command: Vector, position: Vector) -> list[list[tuple[float, float]]]:
    """Return (command, motion during it) of the steps of each ramp."""
    cuts = np.flatnonzero(np.diff(command)) + 1
    ramps: list[list[tuple[float, float]]] = []
    for begin, end in pairwise([0, *cuts.tolist(), command.size]):
        held = float(command[begin])
        if held == 0:
            continue
        step = (held, float(np.ptp(position[begin:end])))
        grows = bool(ramps) and held * ramps[-1][-1][0] > 0 and abs(held) > abs(ramps[-1][-1][0])
        if grows:
            ramps[-1].append(step)
        else:
            ramps.append([step])
    return [ramp for ramp in ramps if len(ramp) > 1]


def _breakaway(ramp: list[tuple[float, float]], least: float) -> float:
    moves = np.array([motion > least for _, motion in ramp])
    where = f"ramp from {ramp[0][0]:g} to {ramp[-1][0]:g} counts"
    if not moves[-1]:
        raise ExcitationError(
            "the motor never moves", where=where, remedy="go on to larger commands"
        )
    first = len(ramp) - int(np.argmin(moves[::-1])) if not moves.all() else 0
    if first == 0:
        raise ExcitationError(
            "the motor moves with the first step", where=where, remedy="begin with smaller commands"
        )
    return ramp[first][0]
