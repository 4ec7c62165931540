"""Measured signals on one time base, with what is known of their units and sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from foundation.errors import ChannelError, TimeError
from recordings.names import suggestion
from recordings.resample import Kind, resample

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from recordings.signals import Signals

UNIFORM_TOLERANCE = 1e-6
"""Steps that differ by less than this, relative to their median, count as equal."""
LONGEST_GAP = 5.0
"""Steps longer than this, in median steps, are gaps: nothing is known of what happened there."""


@dataclass(frozen=True)
class Sensor:
    """What is known of the instrument behind a channel; None where it is not known.

    Attributes:
        sd: Standard deviation of its noise, in the channel's unit.
        resolution: Smallest difference it can tell, in the channel's unit.
        delay: Time by which its values lag behind what they measure, s.
    """

    sd: float | None = None
    resolution: float | None = None
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Channel:
    """One measured signal.

    Attributes:
        name: Its name, usually that of a model's variable.
        values: Shape (n,), in `unit`; read-only.
        unit: As Modelica writes it (`rad/s`, `N.m`); empty where nobody said.
        sensor: What is known of its instrument.
        kind: What happens between its samples; None: nobody said. Such a signal is interpolated
            like a measured one, but drives a model like a command.
    """

    name: str
    values: NDArray[np.float64]
    unit: str = ""
    sensor: Sensor = field(default_factory=Sensor)
    kind: Kind | None = None

    def __post_init__(self) -> None:
        values = _read_only(self.values)
        if values.ndim != 1:
            raise ChannelError(
                f"channel '{self.name}' has shape {values.shape}",
                remedy="give one vector a channel",
            )
        object.__setattr__(self, "values", values)


@dataclass(frozen=True, eq=False)
class Recording:
    """Channels measured together.

    Attributes:
        time: Shape (n,), n >= 2, in s, finite and strictly increasing; read-only.
        channels: Channels by name, each with n finite values.
        origin: Where the numbers come from, for messages and reports.
        notes: What reading changed or left out, one sentence each.
        raw: The signals as they were sampled, where the channels were interpolated; None where
            the channels are the samples.

    Raises:
        TimeError: Time is too short, not finite or not increasing; says at which row. Rows are
            counted from 1, without a header.
        ChannelError: A channel has another length, or a value that is not finite.

    Example:
        >>> time = np.array([0.0, 0.1, 0.2])
        >>> run = Recording(time, {"q": Channel("q", np.array([1.0, 2.0, 4.0]), "m")})
        >>> run.sample_time, run["q"].unit
        (0.1, 'm')
    """

    time: NDArray[np.float64]
    channels: Mapping[str, Channel]
    origin: str = "memory"
    notes: tuple[str, ...] = ()
    raw: Signals | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _read_only(self.time))
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        _check_time(self.time, self.origin)
        for name, channel in self.channels.items():
            _check_channel(name, channel, self.time, self.origin)

    def __getitem__(self, name: str) -> Channel:
        """Return a channel by name.

        Raises:
            ChannelError: There is none of that name.
        """
        try:
            return self.channels[name]
        except KeyError:
            raise ChannelError(
                f"no channel '{name}'",
                where=self.origin,
                remedy=suggestion("channel", name, self.channels),
            ) from None

    def __len__(self) -> int:
        return self.time.size

    def __reduce__(self) -> tuple[Any, ...]:
        # The read-only view of the channels cannot be pickled, and worker processes need it to be.
        return Recording, (self.time, dict(self.channels), self.origin, self.notes, self.raw)

    @property
    def sample_time(self) -> float:
        """Median step, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    def between(self, start: float, stop: float) -> Recording:
        """Return the samples with `start <= time <= stop`, both in s.

        Raises:
            TimeError: Fewer than two samples lie there.

        Example:
            >>> time = np.arange(5.0)
            >>> Recording(time, {"x": Channel("x", time**2)}).between(1.0, 3.0)["x"].values.tolist()
            [1.0, 4.0, 9.0]
        """
        first = int(np.searchsorted(self.time, start, side="left"))
        last = int(np.searchsorted(self.time, stop, side="right"))
        if last - first < 2:
            raise TimeError(
                f"fewer than two samples between {start:g} s and {stop:g} s",
                where=self.origin,
                remedy=f"the recording spans {self.time[0]:g} s to {self.time[-1]:g} s",
            )
        part = self._resampled(
            self.time[first:last], {n: c.values[first:last] for n, c in self.channels.items()}
        )
        return part if self.raw is None else replace(part, raw=self.raw.between(start, stop))

    def parts(self, longest_gap: float | None = None) -> list[Recording]:
        """Return the recording cut at its gaps; parts of a single sample are left out.

        Args:
            longest_gap: Steps longer than this, in s, are gaps; None: five median steps.

        Example:
            >>> time = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
            >>> [part.duration for part in Recording(time, {"x": Channel("x", time)}).parts()]
            [0.2, 0.09999999999999964]
        """
        limit = LONGEST_GAP * self.sample_time if longest_gap is None else longest_gap
        ends = np.flatnonzero(np.diff(self.time) > limit)
        spans = zip([0, *(ends + 1)], [*ends, len(self) - 1], strict=True)
        return [self.between(float(self.time[a]), float(self.time[b])) for a, b in spans if b > a]

    def select(self, names: Iterable[str]) -> Recording:
        """Return the recording with only the named channels, in that order.

        Raises:
            ChannelError: There is none of that name.

        Example:
            >>> time = np.arange(3.0)
            >>> run = Recording(time, {name: Channel(name, time) for name in "abc"})
            >>> list(run.select(["c", "a"]).channels)
            ['c', 'a']
        """
        chosen = {name: self[name] for name in names}
        return replace(self, channels=chosen, raw=self.raw and self.raw.select(chosen))

    def replace_values(self, values: Mapping[str, ArrayLike]) -> Recording:
        """Return the recording with other numbers in some of its channels.

        Args:
            values: New values by channel name, shape (n,), in the channel's unit.

        Raises:
            ChannelError: There is no such channel, or the numbers do not fit.

        Example:
            >>> run = Recording(np.arange(3.0), {"x": Channel("x", np.ones(3), "m")})
            >>> run.replace_values({"x": run["x"].values - 1.0})["x"].values.tolist()
            [0.0, 0.0, 0.0]
        """
        new = {n: replace(self[n], values=np.asarray(v, np.float64)) for n, v in values.items()}
        return replace(self, channels={**self.channels, **new}, raw=None)

    def with_notes(self, *notes: str) -> Recording:
        """Return the recording with further notes.

        Example:
            >>> run = Recording(np.arange(2.0), {})
            >>> run.with_notes("the motor was warm").notes
            ('the motor was warm',)
        """
        return replace(self, notes=(*self.notes, *notes))

    def uniform(self) -> Recording:
        """Return the recording on equal steps of about the median: measured channels by straight
        lines, commands by their mean over each step, states held.

        First and last time stay; a recording that has equal steps already is returned as it is.

        Raises:
            TimeError: A step is longer than five median ones: interpolation would invent data.

        Example:
            >>> jitter = np.array([0.0, 1.1, 1.9, 3.0])
            >>> run = Recording(jitter, {"x": Channel("x", 2 * jitter)}).uniform()
            >>> run.time.tolist(), np.round(run["x"].values, 9).tolist()
            ([0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 4.0, 6.0])
        """
        steps = np.diff(self.time)
        median = self.sample_time
        if np.all(np.abs(steps - median) <= UNIFORM_TOLERANCE * median):
            return self
        longest = int(np.argmax(steps))
        if steps[longest] > LONGEST_GAP * median:
            raise TimeError(
                f"a gap of {steps[longest]:.4g} s where the usual step is {median:.4g} s",
                where=f"{self.origin}, after {self.time[longest]:.6g} s",
                remedy="cut the recording there and use the parts one by one (Recording.parts)",
            )
        grid = np.linspace(self.time[0], self.time[-1], round(self.duration / median) + 1)
        values = {
            n: resample(self.time, c.values, grid, c.kind or Kind.MEASURED).values
            for n, c in self.channels.items()
        }
        note = f"interpolated linearly from uneven steps to equal ones of {grid[1] - grid[0]:.6g} s"
        return self._resampled(grid, values).with_notes(note)

    def to_frame(self) -> pd.DataFrame:
        """Return the values as a table: one column a channel, `time` in s as the index.

        Example:
            >>> run = Recording(np.array([0.0, 0.5]), {"v": Channel("v", np.array([1.0, 3.0]))})
            >>> run.to_frame()["v"].loc[0.5]
            np.float64(3.0)
        """
        columns = {name: channel.values for name, channel in self.channels.items()}
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time"))

    def plot(self) -> Figure:
        """Return the channels over time as a Matplotlib figure.

        Example:
            >>> run = Recording(np.arange(3.0), {"v": Channel("v", np.ones(3), "m/s")})
            >>> run.plot().axes[0].get_ylabel()
            'v [m/s]'
        """
        from matplotlib.figure import Figure  # noqa: PLC0415 - takes its time

        figure = Figure(figsize=(9.0, 1.3 * len(self.channels) + 0.5), layout="constrained")
        axes = figure.subplots(len(self.channels), 1, sharex=True, squeeze=False)[:, 0]
        for ax, channel in zip(axes, self.channels.values(), strict=True):
            ax.plot(self.time, channel.values, lw=1.0, color="#0072b2")
            ax.set_ylabel(f"{channel.name} [{channel.unit or '1'}]")
            ax.grid(alpha=0.3)
        axes[-1].set_xlabel("time [s]")
        return figure

    def _repr_html_(self) -> str:
        cells = [
            (name, c.unit, f"{np.min(c.values):.4g}", f"{np.max(c.values):.4g}")
            for name, c in self.channels.items()
        ]
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in cells
        )
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.notes)
        return (
            f"<p><strong>{escape(self.origin)}</strong>: {len(self)} samples, "
            f"{self.time[0]:.6g} to {self.time[-1]:.6g} s</p><table><thead><tr><th>Channel</th>"
            f"<th>Unit</th><th>Least</th><th>Most</th></tr></thead><tbody>{body}</tbody></table>"
            + (f"<ul>{notes}</ul>" if notes else "")
        )

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        units: Mapping[str, str] | None = None,
        origin: str = "pandas.DataFrame",
    ) -> Recording:
        """Make a recording of a table whose index, or column `time`, is time in s.

        Args:
            frame: One column a channel.
            units: Units by column; a column without one has none.
            origin: Where the table comes from.

        Raises:
            TimeError: Time is not finite or not increasing.
            ChannelError: A column is not numeric or has a value that is not finite.

        Example:
            >>> frame = pd.DataFrame({"time": [0.0, 0.5], "v": [1.0, 3.0]})
            >>> Recording.from_frame(frame, units={"v": "m/s"})["v"].unit
            'm/s'
        """
        if "time" in frame.columns:
            frame = frame.set_index("time")
        units = units or {}
        channels: dict[str, Channel] = {}
        for name in map(str, frame.columns):
            try:
                values = frame[name].to_numpy(np.float64, na_value=np.nan)
            except (ValueError, TypeError) as error:
                raise ChannelError(
                    f"column '{name}' is not numeric", where=origin, remedy="drop it first"
                ) from error
            channels[name] = Channel(name, values, units.get(name, ""))
        try:
            time = np.asarray(frame.index, np.float64)
        except (ValueError, TypeError) as error:
            raise TimeError(
                "the table's index is not time in s",
                where=origin,
                remedy="name a column 'time' or set the index",
            ) from error
        return cls(time, channels, origin)

    def _resampled(
        self, time: NDArray[np.float64], values: Mapping[str, NDArray[np.float64]]
    ) -> Recording:
        channels = {n: replace(c, values=values[n]) for n, c in self.channels.items()}
        return replace(self, time=time, channels=channels)


def _read_only(values: ArrayLike) -> NDArray[np.float64]:
    view = np.asarray(values, np.float64).view()
    view.flags.writeable = False
    return view


def _check_time(time: NDArray[np.float64], origin: str) -> None:
    if time.ndim != 1 or time.size < 2:
        raise TimeError(
            f"time has shape {time.shape}", where=origin, remedy="a recording needs two samples"
        )
    if not np.all(np.isfinite(time)):
        row = int(np.argmin(np.isfinite(time)))
        raise TimeError(
            f"time is {time[row]}",
            where=f"{origin}, row {row + 1}",
            remedy="remove the row or repair its time",
        )
    if not np.all(steps := np.diff(time) > 0):
        row = int(np.argmin(steps)) + 1
        verb = "repeats" if time[row] == time[row - 1] else "goes back"
        raise TimeError(
            f"time {verb}: {time[row]:.9g} s follows {time[row - 1]:.9g} s",
            where=f"{origin}, row {row + 1}",
            remedy="sort the rows by time and remove repeated ones, or cut the recording there",
        )


def _check_channel(name: str, channel: Channel, time: NDArray[np.float64], origin: str) -> None:
    if channel.name != name:
        raise ChannelError(
            f"channel '{channel.name}' is filed as '{name}'", where=origin, remedy="rename one"
        )
    if channel.values.size != time.size:
        raise ChannelError(
            f"channel '{name}' has {channel.values.size} values for {time.size} times",
            where=origin,
            remedy="all channels of a recording share its time",
        )
    finite = np.isfinite(channel.values)
    if not np.all(finite):
        row = int(np.argmin(finite))
        raise ChannelError(
            f"channel '{name}' is {channel.values[row]}",
            where=f"{origin}, row {row + 1}, {time[row]:.9g} s",
            remedy=f"{np.count_nonzero(~finite)} of its {finite.size} values are not numbers: "
            "cut the recording there or leave the channel out",
        )
