"""The service's CONFIG.toml, read and checked.

    [service]
    listen = "127.0.0.1:8460"
    tokens = "tokens.toml"
    store = "sqlite:///twin.db"
    recordings = "recordings"
    recordings_limit = 20e9         # bytes

    [[twin]]
    name = "robot"
    rate = 1000                     # of the model [Hz]
    [twin.plant]                    # as in scenarios and studies
    model = "Twinproof.Plants.WheeledPendulum"
    parameters_from = "fit.json"    # of `identify --json`: the first verified set
    [twin.plant.sensors.theta_p]
    sd = "0.5 deg"
    [twin.bus]                      # several: [[twin.bus]]
    interface = "socketcan"
    channel = "can0"
    dbc = "robot.dbc"
    [twin.delays]
    V = "1 ms"                      # from a command's frame until it acts
    [twin.estimator]
    disturbances = {V = 0.02}       # unknown, at the inputs: standard deviation
    memory = "20 s"
    [twin.drift]
    false_alarms_per_hour = 0.01
    [twin.verification]
    study = "robust.toml"
    controller = "pid.toml"
    draws = 200
    max_age = "24 h"

Paths start from the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from foundation.errors import InputError, UnknownNameError
from hil.bus.interface import BusSettings
from hil.plants import PlantSettings, plant_of
from hil.settings import Table, build, number, read_toml, unit

_SHORTEST_SILENCE = 0.1
LOOPBACK = ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True, kw_only=True)
class ServiceSettings:
    """The process.

    Attributes:
        listen: Address and port of the API.
        tokens: File with tokens and scopes; empty: none, only loopback.
        store: URL of the database (SQLAlchemy's).
        key: File of the event log's key: made at the first start, kept outside the database.
        scheduler: Of Dask, that verifications run on; empty: in a process
            of this machine.
        recordings: Folder for recorded frames.
        recordings_limit: Of that folder for each twin [byte]; the oldest recordings go first.
        recordings_part: After which time a new file is begun [s].
    """

    listen: str = "127.0.0.1:8460"
    tokens: str = ""
    store: str = "sqlite:///twin.db"
    key: str = "audit.key"
    scheduler: str = ""
    recordings: str = "recordings"
    recordings_limit: float = 20e9
    recordings_part: float = unit("s", 600.0)

    def __post_init__(self) -> None:
        host, colon, port = self.listen.rpartition(":")
        if not (host and colon and port.isdigit() and int(port) < 65536):
            raise InputError(
                f"'{self.listen}' is no address to listen at",
                where="service.listen",
                remedy='write listen = "127.0.0.1:8460"',
            )
        _positive("service", recordings_limit=self.recordings_limit)
        _positive("service", recordings_part=self.recordings_part)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        host, _, port = self.listen.rpartition(":")
        return host.strip("[]"), int(port)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self.address[0] in LOOPBACK


@dataclass(frozen=True, kw_only=True)
class StreamSettings:
    """NATS JetStream, between gateways and workers.

    Attributes:
        url: Of the servers, commas between them; empty: none, one process does all.
        credentials: File with the user's credentials (`.creds`); empty: none are asked for.
        name: Of the stream; one for each file of settings.
        age: How long frames are kept for workers [s]; recordings stay at the gateways.
        limit: Of all frames that are kept [byte].
        replicas: Servers of a cluster that keep the same.
        period: Of what a gateway sends for each twin [s].
    """

    url: str = ""
    credentials: str = ""
    name: str = "twinproof"
    age: float = unit("s", 900.0)
    limit: float = 2e9
    replicas: int = 1
    period: float = unit("s", 0.1)

    def __post_init__(self) -> None:
        _positive("jetstream", age=self.age, limit=self.limit, period=self.period)
        _positive("jetstream", replicas=self.replicas)
        if not self.name or not all(c.isalnum() or c in "-_" for c in self.name):
            raise InputError(
                f"'{self.name}' is no name of a stream",
                where="jetstream.name",
                remedy="use letters, digits, - and _",
            )


@dataclass(frozen=True, kw_only=True)
class TwinBus:
    """A bus that a twin listens to.

    Attributes:
        interface, channel, bitrate, options: See `BusSettings`.
        dbc: Of this bus; empty: the library's for the plant's class; relative to the file.
        signals: Variable → signal, where they are not called the same.
        queue: Frames that wait at most between receiver and pipeline; more are dropped and counted.
    """

    interface: str = "virtual"
    channel: str = "twinproof"
    bitrate: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    dbc: str = ""
    signals: Mapping[str, str] = field(default_factory=dict[str, str])
    queue: int = 100_000

    def settings(self) -> BusSettings:
        """Return how to open it."""
        return BusSettings(self.interface, self.channel, self.bitrate, self.options)


@dataclass(frozen=True, kw_only=True)
class EstimatorSettings:
    """On-line estimation.

    Attributes:
        kind: `kalman`: from the innovations of a Kalman filter with a disturbance at every input;
            `output-filter`: recursive least squares on filtered equations of motion.
        free: Parameters to follow; empty: those with a standard deviation in `parameters_from`.
        disturbances: Input → standard deviation of the unknown disturbance there, its unit.
        disturbance_time: Its correlation time [s].
        memory: After which old data count little [s].
        tau: Time constants of the output filter [s].
        horizon: Over which the model is run by itself, for comparison [s].
        block: Time between two estimates, and between two tests for drift [s].
        excitation: Standard deviation, relative to a parameter's value, that the memory's data
            must promise at least half of the parameters; else the estimate rests.
    """

    kind: Literal["kalman", "output-filter"] = "kalman"
    free: tuple[str, ...] = ()
    disturbances: Mapping[str, float] = field(default_factory=dict[str, float])
    disturbance_time: float = unit("s", 0.3)
    memory: float = unit("s", 20.0)
    tau: float = unit("s", 0.3)
    horizon: float = unit("s", 1.0)
    block: float = unit("s", 0.1)
    excitation: float = 0.1

    def __post_init__(self) -> None:
        _positive("twin.estimator", disturbance_time=self.disturbance_time)
        _positive("twin.estimator", memory=self.memory, block=self.block, tau=self.tau)
        _positive("twin.estimator", horizon=self.horizon)
        _positive("twin.estimator", excitation=self.excitation)


@dataclass(frozen=True, kw_only=True)
class DriftSettings:
    """Tests for drift.

    Attributes:
        false_alarms_per_hour: That the plant as verified may give.
        window: The longest that a test looks back [s].
        diagnose: Of how much data a diagnosis is made [s]; 0: none is.
        margin: Change, relative to a parameter's value, that is no drift.
    """

    false_alarms_per_hour: float = 0.01
    window: float = unit("s", 20.0)
    diagnose: float = unit("s", 10.0)
    margin: float = 0.0

    def __post_init__(self) -> None:
        _positive("twin.drift", false_alarms_per_hour=self.false_alarms_per_hour)
        _positive("twin.drift", window=self.window)


@dataclass(frozen=True, kw_only=True)
class VerificationSettings:
    """Re-verification of the deployed controller.

    Attributes:
        study: TOML file of the what-if study; empty: there is none, the gate stays closed.
        controller: File of the deployed controller.
        draws: Plants that are drawn from the parameters' covariance.
        widening: Factor on the standard deviations of that: the next estimate has an error too.
        approval: `automatic`: what passed is in force; `token`: after a person has approved it.
        settle: How long an estimate must have followed the plant, since a start or a drift [s].
        max_age: Of the evidence [s].
        hold: How long a verdict holds while excitation is low [s].
    """

    study: str = ""
    controller: str = ""
    draws: int = 200
    widening: float = 2.0
    approval: Literal["automatic", "token"] = "automatic"
    settle: float = unit("s", 20.0)
    max_age: float = unit("s", 86400.0)
    hold: float = unit("s", 3600.0)

    def __post_init__(self) -> None:
        _positive("twin.verification", draws=self.draws, max_age=self.max_age, hold=self.hold)
        _positive("twin.verification", widening=self.widening, settle=self.settle)


@dataclass(frozen=True, eq=False)
class TwinSettings:
    """One twin.

    Attributes:
        name: Of the twin; letters, digits, `-` and `_`.
        rate: Of the model [Hz].
        stale: After which silence telemetry is stale [s].
        plant: Model, parameters, sensors.
        buses: That it listens to.
        delays: Input → time from a command's frame until it acts [s].
        estimator, drift, verification: See there.
        path: Of the settings' file.
    """

    name: str
    rate: float
    stale: float
    plant: PlantSettings
    buses: tuple[TwinBus, ...]
    delays: Mapping[str, float]
    estimator: EstimatorSettings
    drift: DriftSettings
    verification: VerificationSettings
    path: Path

    def file(self, name: str) -> Path:
        """Return a path that is written in the settings."""
        return self.path.parent / name


@dataclass(frozen=True, eq=False)
class Settings:
    """A CONFIG.toml.

    Attributes:
        path: Of the file.
        service: The process.
        twins: At least one, each with a name of its own.
        stream: Between gateways and workers.
    """

    path: Path
    service: ServiceSettings
    twins: tuple[TwinSettings, ...]
    stream: StreamSettings = field(default_factory=StreamSettings)

    def file(self, name: str) -> Path:
        """Return a path that is written in the settings."""
        return self.path.parent / name

    def twin(self, name: str) -> TwinSettings:
        """Return a twin by its name.

        Raises:
            UnknownNameError: There is none.
        """
        for twin in self.twins:
            if twin.name == name:
                return twin
        known = [twin.name for twin in self.twins]
        raise UnknownNameError("twin", name, known, where=str(self.path))


def read_settings(path: Path, *, roots: tuple[Path, ...] = ()) -> Settings:
    """Read a CONFIG.toml.

    Args:
        path: The file.
        roots: Folders of further Modelica libraries.

    Raises:
        InputError: The file is missing, or says something that cannot be; says where.
    """
    return settings_of(read_toml(path), roots)


def settings_of(table: Table, roots: tuple[Path, ...] = ()) -> Settings:
    """Return the settings that a table holds; errors as `read_settings`."""
    table.only(["service", "twin", "jetstream"])
    twins = tuple(_twin(t, roots) for t in table.subs("twin"))
    if not twins:
        raise InputError("no twin", where=table.where(), remedy="add a table [[twin]]")
    names = [twin.name for twin in twins]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(
                f"two twins are called '{name}'", where=str(table.path), remedy="rename one"
            )
    return Settings(
        table.path,
        build(ServiceSettings, table.sub("service")),
        twins,
        build(StreamSettings, table.sub("jetstream")),
    )


_TWIN_KEYS = (
    *("name", "rate", "stale", "plant", "bus"),
    *("delays", "estimator", "drift", "verification"),
)


@dataclass(frozen=True, kw_only=True)
class _Head:
    name: str
    rate: float = unit("Hz", 1000.0)
    stale: float = unit("s", 0.5)


def _twin(table: Table, roots: tuple[Path, ...]) -> TwinSettings:
    table.only(_TWIN_KEYS)
    head = build(_Head, table.without(*_TWIN_KEYS[3:]))
    if not head.name or not all(c.isalnum() or c in "-_" for c in head.name):
        raise InputError(
            f"'{head.name}' is no name of a twin",
            where=table.where("name"),
            remedy="use letters, digits, - and _",
        )
    _positive(table.where(), rate=head.rate, stale=head.stale)
    if head.stale < _SHORTEST_SILENCE:
        raise InputError(
            f"telemetry that is stale after {head.stale:g} s",
            where=table.where("stale"),
            remedy=f"allow at least {_SHORTEST_SILENCE:g} s",
        )
    estimator = build(EstimatorSettings, table.sub("estimator"))
    samples = estimator.block * head.rate
    if samples < 1 or abs(samples - round(samples)) > 1e-6 * samples:
        raise InputError(
            f"a block of {estimator.block:g} s at {head.rate:g} Hz is {samples:g} samples",
            where=table.sub("estimator").where("block"),
            remedy="choose a block that is a multiple of the sample time",
        )
    plant = plant_of(table.sub("plant"), roots)
    inputs = [port.name for port in plant.inputs]
    for name in estimator.disturbances:
        if name not in inputs:
            where = table.sub("estimator").sub("disturbances").where(name)
            raise UnknownNameError("input", name, inputs, where=where)
    late = table.sub("delays")
    for name in late.values:
        if name not in inputs:
            raise UnknownNameError("input", name, inputs, where=late.where(name))
    delays = {name: number(v, "s", late.where(name)) for name, v in late.values.items()}
    parameters = [v.name for v in plant.described.parameters]
    for name in estimator.free:
        if name not in parameters:
            where = table.sub("estimator").where("free")
            raise UnknownNameError("parameter", name, parameters, where=where)
    listed = table.values.get("bus", {})
    buses = table.subs("bus") if isinstance(listed, list) else [table.sub("bus")]
    return TwinSettings(
        head.name,
        head.rate,
        head.stale,
        plant,
        tuple(build(TwinBus, bus) for bus in buses),
        delays,
        estimator,
        build(DriftSettings, table.sub("drift")),
        build(VerificationSettings, table.sub("verification")),
        table.path,
    )


def _positive(where: str, **values: float) -> None:
    for name, value in values.items():
        if not value > 0:
            raise InputError(
                f"{name} = {value:g}", where=where, remedy="give a number greater than 0"
            )
