"""Signals as they were sampled, each at its own times, and the recording made of them on demand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ChannelError, TimeError
from recordings.names import listing, suggestion
from recordings.recording import LONGEST_GAP, Channel, Recording, Sensor
from recordings.resample import Kind, resample


@dataclass(frozen=True, eq=False)
class Samples:
    """One signal as it was sampled.

    Attributes:
        name: Its name, usually that of a model's variable.
        time: Shape (n,), s, increasing: stamps of the samples, its sensor's delay not taken off.
        values: Shape (n,), in `unit`.
        unit: As Modelica writes it; empty where nobody said.
        sensor: What is known of its instrument.
        kind: What happens between the samples.
    """

    name: str
    time: NDArray[np.float64]
    values: NDArray[np.float64]
    unit: str = ""
    sensor: Sensor = field(default_factory=Sensor)
    kind: Kind = Kind.MEASURED

    def __len__(self) -> int:
        return self.time.size


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of one measurement, none of them interpolated.

    Attributes:
        samples: By name.
        origin: Where the numbers come from.
        notes: What reading changed or left out, one sentence each.
        step: Step, in s, of the recording that is made where none is named; None: the times of
            the signal that has most.

    Example:
        >>> fast = Samples("a", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
        >>> slow = Samples("b", np.array([0.0, 2.0]), np.array([0.0, 20.0]))
        >>> both = Signals({"a": fast, "b": slow})
        >>> run = both.recording()
        >>> run["b"].values.tolist(), run.notes
        ([0.0, 10.0, 20.0], ("interpolated to the times of 'a': b",))
        >>> len(run.raw["b"]), both.recording(step=0.5).time.tolist()
        (2, [0.0, 0.5, 1.0, 1.5, 2.0])
    """

    samples: Mapping[str, Samples]
    origin: str = "memory"
    notes: tuple[str, ...] = ()
    step: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", MappingProxyType(dict(self.samples)))

    def __getitem__(self, name: str) -> Samples:
        """Return a signal by name.

        Raises:
            ChannelError: There is none of that name.
        """
        try:
            return self.samples[name]
        except KeyError:
            raise ChannelError(
                f"no channel '{name}'",
                where=self.origin,
                remedy=suggestion("channel", name, self.samples),
            ) from None

    def __reduce__(self) -> tuple[Any, ...]:
        # The read-only view of the signals cannot be pickled.
        return Signals, (dict(self.samples), self.origin, self.notes, self.step)

    @staticmethod
    def of(recording: Recording) -> Signals:
        """Return the signals that a recording was made of; its channels if it was not resampled."""
        if recording.raw is not None:
            return recording.raw
        samples = {
            name: Samples(name, recording.time, c.values, c.unit, c.sensor, c.kind or Kind.MEASURED)
            for name, c in recording.channels.items()
        }
        return Signals(samples, recording.origin, recording.notes)

    def select(self, names: Iterable[str]) -> Signals:
        """Return only the named signals, in that order.

        Raises:
            ChannelError: There is none of that name.
        """
        return replace(self, samples={name: self[name] for name in names})

    def between(self, start: float, stop: float) -> Signals:
        """Return the samples with `start <= time <= stop`, in s, and one more on either side."""
        kept: dict[str, Samples] = {}
        for name, signal in self.samples.items():
            first = max(int(np.searchsorted(signal.time, start, side="right")) - 1, 0)
            last = int(np.searchsorted(signal.time, stop, side="left")) + 1
            part = slice(first, last)
            kept[name] = replace(signal, time=signal.time[part], values=signal.values[part])
        return replace(self, samples=kept)

    def recording(self, *, step: float | None = None) -> Recording:
        """Return the signals on one time base, each read earlier by its sensor's delay.

        Signals that share their stamps keep every number. Others are put on the times of the one
        with most samples, or on equal steps, by what kind they are (`recordings.resample`), and
        cut to the span that all of them cover. What was done is in the recording's notes, the
        signals themselves in `raw`.

        Args:
            step: Step of the recording, s; None: `Signals.step`.

        Raises:
            TimeError: There is no span that all of them cover.
        """
        step = step if step is not None else self.step
        signals = list(self.samples.values())
        times = [s.time - s.sensor.delay if s.sensor.delay else s.time for s in signals]
        for signal, time in zip(signals, times, strict=True):
            if time.size < 2:
                raise ChannelError(
                    f"signal '{signal.name}' has fewer than two values",
                    where=self.origin,
                    remedy="leave it out, or record for longer",
                )
        base = _fastest(signals, times)
        if step is None and all(np.array_equal(times[base], time) for time in times):
            grid, target, raw = times[base], "", None
        else:
            start, stop = self._span(signals, times)
            grid, target = _grid(times[base], signals[base].name, start, stop, step)
            raw = replace(self, step=None)
            if grid.size < 2:
                raise self._no_overlap(signals, times)
        done: dict[str, list[str]] = {}
        notes: list[str] = []
        channels: dict[str, Channel] = {}
        for signal, time in zip(signals, times, strict=True):
            put = resample(time, signal.values, grid, signal.kind)
            if put.what and (step is not None or not np.array_equal(time, times[base])):
                done.setdefault(put.what, []).append(signal.name)
                notes += _gaps(signal, time, grid)
            if signal.sensor.delay:
                delay = f"{signal.sensor.delay:.4g} s earlier: its sensor's delay"
                notes.append(f"'{signal.name}' is read {delay}")
            sd = signal.sensor.sd
            sensor = Sensor(sd and sd * put.noise_gain, signal.sensor.resolution)
            channels[signal.name] = Channel(
                signal.name, put.values, signal.unit, sensor, signal.kind
            )
        told = [f"{what} to {target}: {listing(names)}" for what, names in done.items()]
        return Recording(grid, channels, self.origin, (*self.notes, *told, *notes), raw)

    def _span(
        self, signals: list[Samples], times: list[NDArray[np.float64]]
    ) -> tuple[float, float]:
        """Return the span that all cover; what holds goes on beyond its last sample."""
        start = max(float(time[0]) for time in times)
        moving = [t for t, s in zip(times, signals, strict=True) if s.kind is Kind.MEASURED]
        stop = min((float(time[-1]) for time in moving), default=max(float(t[-1]) for t in times))
        if stop < start:
            raise self._no_overlap(signals, times)
        return start, stop

    def _no_overlap(self, signals: list[Samples], times: list[NDArray[np.float64]]) -> TimeError:
        late = max(range(len(times)), key=lambda k: times[k][0])
        early = min(range(len(times)), key=lambda k: times[k][-1])
        return TimeError(
            f"signals that do not overlap: '{signals[late].name}' starts at "
            f"{times[late][0]:.6g} s, '{signals[early].name}' ends at {times[early][-1]:.6g} s",
            where=self.origin,
            remedy="leave one of them out",
        )


def _fastest(signals: list[Samples], times: list[NDArray[np.float64]]) -> int:
    """Return which signal has most samples; of several, a measured one, and one without delay."""
    return max(
        range(len(times)),
        key=lambda k: (
            times[k].size,
            signals[k].kind is Kind.MEASURED,
            not signals[k].sensor.delay,
        ),
    )


def _grid(
    base: NDArray[np.float64], name: str, start: float, stop: float, step: float | None
) -> tuple[NDArray[np.float64], str]:
    """Return times from start to stop, and what they are."""
    if step is None:
        return base[(base >= start) & (base <= stop)], f"the times of '{name}'"
    count = int(np.floor((stop - start) / step * (1 + 1e-12) + 1e-9)) + 1
    return start + step * np.arange(count, dtype=np.float64), f"steps of {step:g} s"


def _gaps(signal: Samples, time: NDArray[np.float64], grid: NDArray[np.float64]) -> list[str]:
    """Return what to say of long steps: of a measured signal, nobody knows what happened there."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    if signal.kind is not Kind.MEASURED:
        beyond = float(grid[-1] - time[-1])
        if beyond <= LONGEST_GAP * usual:
            return []
        return [f"'{signal.name}' ends at {time[-1]:.6g} s and is held for {beyond:.4g} s more"]
    long = steps > LONGEST_GAP * usual
    if not np.any(long):
        return []
    k = int(np.argmax(steps))
    return [
        f"'{signal.name}' has {np.count_nonzero(long)} gaps, bridged by straight lines; the "
        f"longest is {steps[k]:.4g} s at {time[k]:.6g} s"
    ]
