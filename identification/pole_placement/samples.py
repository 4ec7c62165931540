"""Sampled states and inputs: the data of data-driven pole placement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.errors import ChannelError, ExcitationError, InputError
from recordings import Recording

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Samples:
    """States and inputs of x(k+1) = A x(k) + B u(k), sampled at equal steps.

    Attributes:
        states: (N+1, n), each column in its own unit.
        inputs: (N, m); `inputs[k]` is held from sample k to k+1.
        state_names: n names.
        input_names: m names.
        step: Sample time, s.
        noise_sd: (n,) standard deviations of the states' sensors, NaN where not known.
        excitation: (N, m) the part v of u = F x + v that is independent of the noise; None where
            it was not recorded.

    Raises:
        InputError: Shapes do not fit, or a number is not finite.

    Example:
        >>> run = Samples(np.array([[1.0], [0.5], [0.25]]), np.zeros((2, 1)))
        >>> len(run), run.n, run.m, run.state_names
        (2, 1, 1, ('x1',))
    """

    states: Matrix
    inputs: Matrix
    state_names: tuple[str, ...] = ()
    input_names: tuple[str, ...] = ()
    step: float = 1.0
    noise_sd: Vector | None = None
    excitation: Matrix | None = None

    def __post_init__(self) -> None:
        states = np.asarray(self.states, np.float64)
        inputs = np.asarray(self.inputs, np.float64)
        if states.ndim != 2 or inputs.ndim != 2 or len(states) != len(inputs) + 1:
            raise InputError(
                f"states have shape {states.shape} and inputs {inputs.shape}",
                remedy="give (N+1, n) states and (N, m) inputs",
            )
        if not (np.all(np.isfinite(states)) and np.all(np.isfinite(inputs))):
            raise InputError("states or inputs are not finite", remedy="remove those samples")
        object.__setattr__(self, "states", states)
        object.__setattr__(self, "inputs", inputs)
        state_names = self.state_names or tuple(f"x{i + 1}" for i in range(self.n))
        input_names = self.input_names or tuple(f"u{i + 1}" for i in range(self.m))
        object.__setattr__(self, "state_names", state_names)
        object.__setattr__(self, "input_names", input_names)

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def n(self) -> int:
        """Number of states."""
        return self.states.shape[1]

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.inputs.shape[1]

    def prefiltered(self, order: int) -> Samples:
        """Return the moving averages over `order` samples, the FIR prefilter Φ of (3.11).

        An average of solutions of a linear system is a solution; noise shrinks, the excitation at
        low frequencies stays.

        Raises:
            ExcitationError: There are too few samples.

        Example:
            >>> run = Samples(np.arange(5.0)[:, None], np.ones((4, 1))).prefiltered(2)
            >>> run.states.ravel().tolist(), run.inputs.ravel().tolist()
            ([0.5, 1.5, 2.5, 3.5], [1.0, 1.0, 1.0])
        """
        if order < 1:
            raise InputError(
                f"a prefilter of order {order}", where="--prefilter", remedy="give 1 (none) or more"
            )
        if order == 1:
            return self
        if len(self) < order + self.n + self.m:
            raise ExcitationError(
                f"{len(self)} steps are too few for a prefilter of order {order}",
                where="--prefilter",
                remedy="record longer, or filter less",
            )
        return replace(
            self,
            states=moving_average(self.states, order),
            inputs=moving_average(self.inputs, order),
            excitation=None if self.excitation is None else moving_average(self.excitation, order),
        )

    def between(self, first: int, last: int) -> Samples:
        """Return the steps first … last-1, with the state after the last of them."""
        return replace(
            self,
            states=self.states[first : last + 1],
            inputs=self.inputs[first:last],
            excitation=None if self.excitation is None else self.excitation[first:last],
        )


def floats(values: ArrayLike) -> Matrix:
    """Return an array of double precision; tells the type checker what linear algebra gives."""
    return np.asarray(values, np.float64)


def moving_average(values: Matrix, order: int) -> Matrix:
    """Return the means of every `order` neighbouring rows, (N, k) → (N - order + 1, k)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, order, axis=0)
    return windows.mean(axis=-1)


def samples_of(
    recording: Recording,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    excitation: Sequence[str] | None = None,
) -> Samples:
    """Return the samples in a recording.

    Args:
        recording: On (nearly) equal steps; uneven ones are interpolated.
        states: Channels of the states in order; default: those whose names start with `x`.
        inputs: Channels of the inputs in order; default: those whose names start with `u`.
        excitation: Channels of the excitation v, in the order of the inputs, where recorded.

    Raises:
        ChannelError: A channel is missing or named twice.
        TimeError: There is a gap in time.
        ExcitationError: A channel never changes, or there are too few samples.

    Example:
        >>> from recordings import Channel
        >>> time = np.arange(9) * 0.1
        >>> run = Recording(
        ...     time, {"x": Channel("x", np.cos(time)), "u": Channel("u", np.sin(5 * time))}
        ... )
        >>> samples_of(run).states.shape
        (9, 1)
    """
    even = recording.uniform()
    state_names = _chosen(even, states, "x*", "--states")
    input_names = _chosen(even, inputs, "u*", "--inputs")
    twice = sorted(set(state_names) & set(input_names))
    if twice:
        raise ChannelError(
            f"'{twice[0]}' is both a state and an input",
            where=recording.origin,
            remedy="name it in one of --states and --inputs",
        )
    if excitation is not None and len(excitation) != len(input_names):
        raise ChannelError(
            f"{len(excitation)} excitations for {len(input_names)} inputs",
            where="--excitation",
            remedy="name one for each input, in their order",
        )

    def table(names: Sequence[str]) -> Matrix:
        return np.column_stack([even[name].values for name in names])

    for name in (*state_names, *input_names):
        values = even[name].values
        if np.ptp(values) <= 1e-12 * max(np.max(np.abs(values)), 1e-300):
            raise ExcitationError(
                f"'{name}' never changes",
                where=recording.origin,
                remedy="excite it, or leave it out with --states or --inputs",
            )
    sensors = [even[name].sensor for name in state_names]
    noise = [
        s.sd if s.sd is not None else s.resolution / np.sqrt(12) if s.resolution else np.nan
        for s in sensors
    ]
    return Samples(
        table(state_names),
        table(input_names)[:-1],
        state_names,
        input_names,
        even.sample_time,
        np.array(noise, np.float64),
        None if excitation is None else table(excitation)[:-1],
    )


def _chosen(
    recording: Recording, names: Sequence[str] | None, pattern: str, flag: str
) -> tuple[str, ...]:
    if names is None:
        chosen = tuple(n for n in recording.channels if fnmatchcase(n, pattern))
        if not chosen:
            raise ChannelError(
                f"no channel is named {pattern}",
                where=recording.origin,
                remedy=f"name the channels with {flag}; there are: "
                + ", ".join(recording.channels),
            )
        return chosen
    chosen = tuple(recording[name].name for name in names)
    if len(set(chosen)) < len(chosen) or not chosen:
        raise ChannelError(
            "a channel is named twice" if chosen else "no channel is named",
            where=flag,
            remedy="name each channel once, like x1,x2",
        )
    return chosen
