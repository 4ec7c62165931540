"""A scenario in TOML: plant, bus, controller, reference, faults, and what must hold.

name = "balance"
[plant]
model = "Twinproof.Plants.WheeledPendulum"
[plant.sensors.theta_p]
sd = "0.5 deg"
[bus]
interface = "virtual"
[controller]
kind = "pid"
measured = ["theta_p"]
commanded = ["V"]
period = "1 ms"
proportional = -168.0
integral = -800.0
derivative = -8.8
[references.theta_p]
kind = "sines"
amplitudes = ["20 deg"]
frequencies = [1.0]
[[faults]]
kind = "drop"
on = "actuators"
probability = 0.01
[[criteria]]
kind = "limit"
signal = "theta_p"
high = "45 deg"
[run]
duration = 10.0
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Database

from foundation.errors import InputError, TwinproofError, UnknownNameError
from hil.bus.codec import Layout, layouts
from hil.bus.dbc import REFERENCE, Port, bundled_dbc, parse_dbc, plant_dbc, read_dbc
from hil.bus.interface import BusSettings
from hil.controllers import CONTROLLERS, Controller, StateFeedback
from hil.criteria import CRITERIA, Criterion
from hil.faults import FAULTS, Fault, FrameFault, ParameterChange, SignalFault
from hil.linear import linear_model
from hil.loop import LoopSettings
from hil.plants import PlantSettings, from_here, plant_of
from hil.process import ProcessSettings
from hil.settings import Table, build, number, read_toml, unit
from hil.waveforms import Waveform, waveform_of

_KEYS = (
    "name",
    "plant",
    "bus",
    "controller",
    "references",
    "disturbances",
    "faults",
    "criteria",
    "run",
)


@dataclass(frozen=True, kw_only=True)
class BusTable:
    """The bus, as TOML says it.

    Attributes:
        interface, channel, bitrate, options: See `BusSettings`. With `slcan` the channel `bridge`
            is a pair of bridged pseudo-terminals of our own.
        dbc: A file; `bundled`: that of the plant of the library; `plant`: made from its ports.
        profile: Of E2E protection, where the DBC is made.
        signals: Variable → signal, where they are not called the same.
        timeout: After which silence is noticed, on both ends [s].
        safe: Commands while the other end is silent; default 0.
    """

    interface: str = "virtual"
    channel: str = ""
    bitrate: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    dbc: str = ""
    profile: str = "P11"
    signals: Mapping[str, str] = field(default_factory=dict[str, str])
    timeout: float = unit("s", 0.02)
    safe: Mapping[str, float] = field(default_factory=dict[str, float])

    def settings(self, channel: str = "") -> BusSettings:
        """Return how to open it."""
        return BusSettings(
            self.interface, channel or self.channel or "twinproof", self.bitrate, self.options
        )


@dataclass(frozen=True, kw_only=True)
class Messages:
    """What is on the bus, by its DBC.

    Attributes:
        database: All of it.
        origin: The file, for messages.
        sensors, actuators, references: Messages with these variables.
    """

    database: Database
    origin: str
    sensors: tuple[Layout, ...]
    actuators: tuple[Layout, ...]
    references: tuple[Layout, ...]


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scenario, read and checked.

    Attributes:
        name: Of the scenario.
        path: Of its file.
        plant, bus, run: As the file says.
        messages: On the bus.
        controller: Makes the controller: a law in this process; None: it is elsewhere.
        process: The controller as a process of its own; None: it is not.
        references: By output.
        disturbances: By input.
        faults, criteria: As the file says.
        recording: File for what went over the bus.

    Example:
        >>> import tempfile
        >>> text = '''
        ... [plant]
        ... model = "Twinproof.Plants.Pendulum"
        ... [controller]
        ... kind = "pid"
        ... measured = ["theta"]
        ... commanded = ["tau"]
        ... period = "5 ms"
        ... proportional = 6.0
        ... [run]
        ... duration = 1.0
        ... '''
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "hold.toml"
        ...     _ = path.write_text(text)
        ...     scenario = read_scenario(path)
        >>> scenario.name, scenario.run.duration, scenario.recording.name
        ('hold', 1.0, 'hold.blf')
    """

    name: str
    path: Path
    plant: PlantSettings
    bus: BusTable
    messages: Messages
    controller: Callable[[], Controller] | None
    process: ProcessSettings | None
    references: Mapping[str, Waveform]
    disturbances: Mapping[str, Waveform]
    faults: tuple[Fault, ...]
    criteria: tuple[Criterion, ...]
    run: LoopSettings
    recording: Path


def read_scenario(path: Path, *, roots: tuple[Path, ...] = ()) -> Scenario:
    """Read a scenario.

    Args:
        path: The TOML file.
        roots: Folders of further Modelica libraries.

    Raises:
        InputError: The file is missing, or says something that cannot be; says where.
    """
    return scenario_of(read_toml(path), roots)


def scenario_of(table: Table, roots: tuple[Path, ...] = ()) -> Scenario:
    """Return the scenario that a table describes; errors as `read_scenario`."""
    table.only(_KEYS)
    plant = plant_of(table.sub("plant"), roots)
    run_table = table.sub("run")
    run = build(LoopSettings, run_table.without("recording"))
    recording = run_table.values.get("recording", f"{table.path.stem}.blf")
    if not isinstance(recording, str):
        raise InputError(
            f"{recording!r} is no file", where=run_table.where("recording"), remedy='write "x.blf"'
        )
    outputs = {p.name: p.unit for p in plant.outputs}
    inputs = {p.name: p.unit for p in plant.inputs}
    references = _waveforms(table.sub("references"), outputs, "output")
    controller, process = controller_of(table.sub("controller"), plant)
    bus = build(BusTable, table.sub("bus"))
    messages = _messages(bus, table, plant, references)
    _check_safe(bus, inputs, table.sub("bus"))
    if controller is None and bus.interface == "virtual":
        raise InputError(
            "another process cannot be reached over the bus 'virtual'",
            where=table.sub("bus").where("interface"),
            remedy='use interface = "slcan", channel = "bridge", and a real clock',
        )
    if controller is None and run.clock == "virtual":
        raise InputError(
            "another process has no virtual clock",
            where=run_table.where("clock"),
            remedy='write clock = "real"',
        )
    columns = [*outputs, *inputs, *(f"measured.{n}" for n in outputs)]
    columns += [*(f"command.{n}" for n in inputs), *(f"reference.{n}" for n in references)]
    return Scenario(
        name=str(table.values.get("name", table.path.stem)),
        path=table.path,
        plant=plant,
        bus=bus,
        messages=messages,
        controller=controller,
        process=process,
        references=references,
        disturbances=_waveforms(table.sub("disturbances"), inputs, "input"),
        faults=tuple(_fault(t, plant, messages) for t in table.subs("faults")),
        criteria=tuple(
            criterion_of(t, columns, plant, run.duration) for t in table.subs("criteria")
        ),
        run=run,
        recording=table.file(recording),
    )


def controller_of(
    table: Table, plant: PlantSettings
) -> tuple[Callable[[], Controller] | None, ProcessSettings | None]:
    """Return what makes the controller that a table describes, and its process.

    Besides the laws there are `process`, and `external` for a device that is on the bus anyway.

    Raises:
        InputError: See `hil.settings.build`; a variable that the plant does not have.
    """
    kind = table.word("kind", [*CONTROLLERS, ProcessSettings.kind, "external"])
    rest = table.without("kind", "operating_point")
    if kind == ProcessSettings.kind:
        return None, build(ProcessSettings, rest)
    if kind == "external":
        rest.only([])
        return None, None
    for key, ports in (("measured", plant.outputs), ("commanded", plant.inputs)):
        known = [p.name for p in ports]
        listed = rest.values.get(key, [])
        for name in listed if isinstance(listed, list) else []:
            if name not in known:
                raise UnknownNameError(key, str(name), known, where=rest.where(key))
    if kind == "fmu" and isinstance(rest.values.get("model"), str):
        rest = rest.with_value("model", from_here(str(rest.values["model"]), rest))
    point = table.sub("operating_point")
    values = {n: number(v, plant.unit(n), point.where(n)) for n, v in point.values.items()}

    def make() -> Controller:
        controller = build(CONTROLLERS[kind], rest)
        if isinstance(controller, StateFeedback) and not controller.gain:
            linear = linear_model(plant.fmu, point=values, parameters=dict(plant.parameters))
            controller.design(linear)
        return controller

    return make, None


def criterion_of(
    table: Table, columns: list[str], plant: PlantSettings, duration: float
) -> Criterion:
    """Return a criterion, seen to be one that can be evaluated.

    Raises:
        InputError: It cannot; says why.
    """
    kind = CRITERIA[table.word("kind", CRITERIA)]
    own = plant.unit(str(table.values.get("signal", "")))
    criterion = build(kind, table.without("kind"), own=own)
    try:
        criterion.check(columns, duration)
    except TwinproofError as error:
        error.where = table.where("signal" if isinstance(error, UnknownNameError) else "")
        raise
    return criterion


def _waveforms(table: Table, units: Mapping[str, str], kind: str) -> dict[str, Waveform]:
    found: dict[str, Waveform] = {}
    for name in table.values:
        inner = table.sub(name)
        if name not in units:
            raise UnknownNameError(kind, name, units, where=inner.where())
        found[name] = waveform_of(inner, units[name])
    return found


def _messages(
    bus: BusTable, table: Table, plant: PlantSettings, references: Mapping[str, Waveform]
) -> Messages:
    where = table.sub("bus")
    word = bus.dbc or _usual_dbc(plant)
    if word == "plant":
        database = parse_dbc(plant_dbc(plant.inputs, plant.outputs, profile=bus.profile))
        origin = "the DBC made from the plant's ports"
    else:
        path = bundled_dbc(plant.model) if word == "bundled" else where.file(word)
        database, origin = read_dbc(path), str(path)
    signals = dict(bus.signals)
    wanted = [
        Port(f"{p.name}{REFERENCE}", p.unit, p.description)
        for p in plant.outputs
        if p.name in references
    ]

    def find(ports: list[Port]) -> tuple[Layout, ...]:
        try:
            return tuple(layouts(database, ports, signals=signals, where=origin))
        except UnknownNameError as error:
            error.remedy += f"; or say which in {where.where('signals')}"
            raise

    found = Messages(
        database=database,
        origin=origin,
        sensors=find(plant.outputs),
        actuators=find(plant.inputs),
        references=find(wanted),
    )
    _check_rates(found, build(LoopSettings, table.sub("run").without("recording")))
    return found


def _usual_dbc(plant: PlantSettings) -> str:
    try:
        bundled_dbc(plant.model)
    except UnknownNameError:
        return "plant"
    return "bundled" if plant.model.startswith("Twinproof.Plants.") else "plant"


def _check_rates(messages: Messages, run: LoopSettings) -> None:
    """Refuse a DBC whose sensors are to be sent at a rate that the loop cannot keep."""
    for layout in (*messages.sensors, *messages.references):
        if layout.period is None:
            continue
        ratio = layout.period / run.step
        if ratio < 1 - 1e-9 or abs(ratio - round(ratio)) > 1e-6:
            raise InputError(
                f"message {layout.message.name} is to be sent every {1e3 * layout.period:g} ms, "
                f"the loop's step is {1e3 * run.step:g} ms",
                where=messages.origin,
                remedy="choose a run.step that the periods are multiples of, "
                "or correct GenMsgCycleTime",
            )


def _check_safe(bus: BusTable, inputs: Mapping[str, str], table: Table) -> None:
    for name in bus.safe:
        if name not in inputs:
            raise UnknownNameError("input", name, inputs, where=table.sub("safe").where(name))


def _fault(table: Table, plant: PlantSettings, messages: Messages) -> Fault:
    kind = FAULTS[table.word("kind", FAULTS)]
    if kind is ParameterChange:
        return _parameter_change(table, plant)
    ports = plant.outputs if kind.kind in ("stuck", "bias") else plant.inputs
    units = {p.name: p.unit for p in ports}
    signal = str(table.values.get("signal", ""))
    fault = build(kind, table.without("kind"), own=units.get(signal, ""))
    if isinstance(fault, SignalFault) and fault.signal not in units:
        raise UnknownNameError("signal", fault.signal, units, where=table.where("signal"))
    known = [m.name for m in messages.database.messages]
    if isinstance(fault, FrameFault) and fault.message and fault.message not in known:
        raise UnknownNameError("message", fault.message, known, where=table.where("message"))
    return fault


def _parameter_change(table: Table, plant: PlantSettings) -> ParameterChange:
    units = {v.name: v.unit for v in plant.described.parameters}
    own = units.get(str(table.values.get("parameter", "")), "")
    fault = build(ParameterChange, table.without("kind"), own=own)
    where = table.where("parameter")
    if fault.parameter not in units:
        raise UnknownNameError("parameter", fault.parameter, units, where=where)
    if not np.isfinite(plant.value(fault.parameter)):
        raise InputError(
            f"the FMU does not say what {fault.parameter} is before it changes",
            where=where,
            remedy="give its value in [plant.parameters]",
        )
    return fault
