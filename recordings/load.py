"""From a file, or the name of a data set, to a recording in the model's names and units."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ChannelError, RecordingError, TimeError, UnknownNameError
from foundation.units import factor_and_offset
from recordings import datasets
from recordings.channel_map import ChannelMap, ChannelSource, TimeSource, parse_map, read_map
from recordings.clock import even_beat
from recordings.names import listing, suggestion
from recordings.readers import RawSignal, RawTable, Request, Scope, reader_for
from recordings.recording import Recording, Sensor
from recordings.resample import Kind
from recordings.signals import Samples, Signals


def load(
    data: str | Path,
    *,
    variables: Mapping[str, str] | None = None,
    channel_map: Path | None = None,
    dbc: Path | None = None,
    inputs: Collection[str] = (),
    span: tuple[float, float] | None = None,
) -> Recording:
    """Read a recording.

    Args:
        data: A file (`.csv`, `.parquet`, `.mat`, `.mf4`, `.log`, `.log.gz`, `.blf`, `.asc`,
            `.trc`), or the name of a registered data set, which brings its own channel map and DBC.
        variables: Units of the model's inputs and outputs by name. Channels of other names are
            left out with a note, and values are converted to these units; a column of unknown
            unit is taken to be in the model's. None: every channel there is, as it is.
        channel_map: Which column or signal is which variable; adds to a data set's own map.
        dbc: Describes the messages of a CAN log.
        inputs: Variables that are commands, which hold until the next one; the map's `kind` is
            stronger.
        span: First and last time, s, of the part that is wanted; None: all. Of a CAN log nothing
            else is kept in memory.

    Returns:
        The recording; what was left out, interpolated or assumed is in its `notes`, the signals at
        their own times are in `raw`.

    Raises:
        RecordingError: A file is missing, or one of:
        UnknownNameError: There is neither a file nor a data set of that name.
        FormatError: The file is empty, cut, damaged or of an unknown kind.
        TimeError: There is no time, or it does not increase.
        ChannelError: A wanted column is missing, not numeric, or the map is wrong.
        UnitError: A unit is unknown, or does not fit the model's.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "run.csv"
        >>> _ = path.write_text("time,q,spare\\n0,1,7\\n0.5,2,7\\n")
        >>> run = load(path, variables={"q": "m"})
        >>> run.time.tolist(), run["q"].values.tolist(), run.notes
        ([0.0, 0.5], [1.0, 2.0], ('ignored, not of the model: spare',))
    """
    signals = load_signals(
        data, variables=variables, channel_map=channel_map, dbc=dbc, inputs=inputs, span=span
    )
    run = signals.recording()
    return run if span is None else run.between(*span)


def load_signals(
    data: str | Path,
    *,
    variables: Mapping[str, str] | None = None,
    channel_map: Path | None = None,
    dbc: Path | None = None,
    inputs: Collection[str] = (),
    span: tuple[float, float] | None = None,
) -> Signals:
    """Read signals at their own times; arguments and errors as `load`."""
    given = read_map(channel_map) if channel_map is not None else ChannelMap()
    if variables is not None:
        _check_map_names(given, variables)
    path = Path(data)
    mapping, origin = given, str(path)
    if not path.is_file():
        data_set = _data_set(data)
        files = datasets.fetch(data_set.name)
        path, dbc = files.data, dbc or files.dbc
        own = parse_map(data_set.map_text, origin=f"channel map of {data_set.name}")
        mapping = _of_model(own, variables).updated(given)
        origin = f"{data_set.name} ({data_set.repository}@{data_set.commit[:7]}, {data_set.path})"
    reader = reader_for(path)
    names: frozenset[str] | None = None
    if variables is not None:
        names = frozenset([*variables, *(s.source or n for n, s in mapping.channels.items())])
    scope = Scope(names, *(span or ()))
    table = reader.read(path, dbc=dbc, scope=scope)
    notes: tuple[str, ...] = ()
    if dbc is not None and not table.uses_dbc:
        notes = (f"the DBC {dbc.name} is not used: {path.name} is no CAN log",)
    signals = _assemble(table, mapping, variables, inputs, origin, notes)
    return signals if span is None else signals.between(*span)


def _assemble(
    table: RawTable,
    mapping: ChannelMap,
    variables: Mapping[str, str] | None,
    inputs: Collection[str],
    origin: str,
    notes: tuple[str, ...],
) -> Signals:
    wanted = _wanted(table, mapping, variables)
    requests = [Request(s.source or name, s.bus, s.address) for name, s in wanted.items()]
    signals = table.signals(requests)
    own_stamps = signals[0].time is not None
    if not own_stamps:
        signals = _rows(table, signals, mapping.time)
    elif mapping.time.software_clock:
        signals = _on_even_beats(signals)
    samples: dict[str, Samples] = {}
    for (name, source), signal in zip(wanted.items(), signals, strict=True):
        unit = None if variables is None else variables[name]
        samples[name] = _samples(name, signal, source, unit, name in inputs, table.origin)
    used = {mapping.time.source, *(request.name for request in requests)}
    heard = list(dict.fromkeys(note for signal in signals for note in signal.notes))
    left_out = _left_out(table.names, used, list(wanted), variables)
    return Signals(
        samples,
        origin,
        (*notes, *table.notes, *heard, *left_out),
        mapping.time.step if own_stamps else None,
    )


def _wanted(
    table: RawTable, mapping: ChannelMap, variables: Mapping[str, str] | None
) -> dict[str, ChannelSource]:
    """Return where each channel of the recording comes from: by map, else by its own name."""
    by_name = [n for n in table.names if n != mapping.time.source]
    if variables is not None:
        by_name = [n for n in by_name if n in variables]
    else:
        mapped = {source.source or name for name, source in mapping.channels.items()}
        by_name = [n for n in by_name if n not in mapped]
    wanted = {n: ChannelSource() for n in by_name} | dict(mapping.channels)
    if not wanted:
        model = listing(variables) if variables else "none"
        raise ChannelError(
            f"no channel is named as a variable of the model ({model})",
            where=table.origin,
            remedy=f"say which is which with --map; there are: {listing(table.names)}",
        )
    order = [n for n in variables or () if n in wanted]
    return {n: wanted[n] for n in order or wanted}


def _rows(table: RawTable, signals: list[RawSignal], source: TimeSource) -> list[RawSignal]:
    """Return columns with the time column that they share."""
    if source.step is not None:
        size = signals[0].values.size
        time: NDArray[np.float64] = np.arange(size, dtype=np.float64) * source.step
        what = f"{size} equal steps"
    elif source.source not in table.names:
        near = suggestion("column", source.source, table.names)
        raise TimeError(
            f"no time: there is no column '{source.source}'",
            where=table.origin,
            remedy=f"{near}; name it in the channel map: [time] source = ..., or step = ... in s",
        )
    else:
        column = table.signals([Request(source.source)])[0]
        # A unit in the file is better than the map's default.
        unit = column.unit if column.unit and source.unit == "s" else source.unit
        factor, _ = factor_and_offset(unit, "s", where=f"{table.origin}, time")
        time = column.values * factor
        what = f"'{source.source}'"
    for signal in signals:
        if signal.values.size != time.size:
            raise ChannelError(
                f"'{signal.name}' has {signal.values.size} values, time ({what}) has {time.size}",
                where=table.origin,
                remedy="leave it out, or name its own time in the channel map",
            )
    return [replace(signal, time=time) for signal in signals]


def _on_even_beats(signals: list[RawSignal]) -> list[RawSignal]:
    """Return signals with the stamps that their periodic messages would have had on the wire."""
    moved: list[RawSignal] = []
    for signal in signals:
        beat = None if signal.time is None else even_beat(signal.time)
        if beat is None:
            note = f"'{signal.name}' has no even beat: its software stamps stay as they are"
            moved.append(replace(signal, notes=(*signal.notes, note)))
        else:
            note = (
                f"'{signal.name}' put on an even beat of {beat.period:.6g} s: its stamps were "
                f"{beat.lateness:.2g} s late (root mean square)"
            )
            moved.append(replace(signal, time=beat.time, notes=(*signal.notes, note)))
    return moved


def _samples(
    name: str,
    signal: RawSignal,
    source: ChannelSource,
    model_unit: str | None,
    is_input: bool,
    origin: str,
) -> Samples:
    """Return a signal in the model's unit; without one, in the unit it was recorded in."""
    recorded = source.unit if source.unit is not None else signal.unit
    unit = model_unit or recorded or ""
    factor, offset = 1.0, 0.0
    if recorded is not None and model_unit:
        factor, offset = factor_and_offset(recorded, model_unit, where=f"{origin}, '{signal.name}'")
    if source.factor is not None:
        factor, offset = factor * source.factor, offset * source.factor
    offset += source.offset or 0.0
    sensor = source.sensor
    if sensor.resolution is None and signal.resolution is not None:
        sensor = Sensor(sensor.sd, abs(factor) * signal.resolution, sensor.delay)
    values = signal.values if (factor, offset) == (1.0, 0.0) else factor * signal.values + offset
    assert signal.time is not None
    if source.kind is not None:
        kind = source.kind
    elif is_input:
        kind = Kind.COMMAND
    else:
        kind = Kind.STATE if signal.is_state else Kind.MEASURED
    return Samples(name, signal.time, values, unit, sensor, kind)


def _left_out(
    there: Iterable[str],
    used: set[str],
    found: list[str],
    variables: Mapping[str, str] | None,
) -> list[str]:
    notes: list[str] = []
    if variables is None:
        return notes
    if ignored := [name for name in there if name not in used]:
        notes.append(f"ignored, not of the model: {listing(ignored)}")
    if absent := [name for name in variables if name not in found]:
        notes.append(f"not recorded: {listing(absent)}")
    return notes


def _check_map_names(mapping: ChannelMap, variables: Mapping[str, str]) -> None:
    for name in mapping.channels:
        if name not in variables:
            raise ChannelError(
                f"the model has no variable '{name}'",
                where=f"{mapping.origin}, [channels.{name}]",
                remedy=suggestion("variable", name, variables),
            )


def _of_model(mapping: ChannelMap, variables: Mapping[str, str] | None) -> ChannelMap:
    """Return a data set's own map without what this model does not have."""
    if variables is None:
        return mapping
    kept = {name: source for name, source in mapping.channels.items() if name in variables}
    return ChannelMap(kept, mapping.time, mapping.origin)


def _data_set(data: str | Path) -> datasets.DataSet:
    """Return the data set of that name; a name that looks like a file is a missing file."""
    try:
        return datasets.find(str(data))
    except UnknownNameError as error:
        path = Path(data)
        if path.is_dir():
            raise RecordingError(
                "a folder, not a recording", where=str(data), remedy="name a file in it"
            ) from error
        if path.suffix or path.parent != Path():
            near = suggestion("file", path.name, _siblings(path))
            raise RecordingError("no such file", where=str(data), remedy=near) from error
        raise


def _siblings(path: Path) -> list[str]:
    try:
        return sorted(entry.name for entry in path.parent.iterdir() if entry.is_file())
    except OSError:
        return []
